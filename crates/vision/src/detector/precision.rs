//! Whether the provider that runs a model finds what the CPU finds: half precision, TensorRT's and CUDA's kernels compute
//! the same sums in other ways, and for some models boxes are lost.

use super::network::DetectorNetwork;
use super::{DetectorConfig, ExecutionProvider, PreparedPicture, StartError};
use crate::worker::RunError;
use albireo_core::detection::Detection;
use albireo_core::geometry::{Corners, PictureSize};
use parking_lot::Mutex;
use std::fmt;
use std::sync::Arc;
use std::thread::JoinHandle;
use tracing::{info, warn};

/// The farthest that a side of a box may be from that of the CPU, in pixels of the model's input.
const FARTHEST_PX: f64 = 2.0;

/// The most that the confidence of a box may differ.
const MOST_CONFIDENCE: f64 = 0.02;

/// The overlap of two boxes of one object.
const LEAST_OVERLAP: f64 = 0.5;

/// The boxes of a provider and of the CPU in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProviderAgreement {
    /// The provider.
    pub provider: ExecutionProvider,
    /// The boxes that it found.
    pub boxes: usize,
    /// The boxes of either that the other did not find.
    pub unpaired: usize,
    /// The greatest distance of the sides of a pair, in pixels of the model's input.
    pub farthest_px: f64,
    /// The greatest difference in confidence of a pair.
    pub confidence: f64,
}

impl ProviderAgreement {
    /// Compares the boxes of `provider`, of at least `confidence`, with those of the CPU, of at least
    /// [`least_on_cpu`](Self::least_on_cpu), for an input of `size`. A box that is only just reported by one may be just
    /// below the confidence on the other.
    fn of(
        provider: ExecutionProvider,
        found: &[Detection],
        on_cpu: &[Detection],
        confidence: f64,
        size: PictureSize,
    ) -> Self {
        let mut agreement = Self {
            provider,
            boxes: found.len(),
            unpaired: 0,
            farthest_px: 0.0,
            confidence: 0.0,
        };
        for one in found {
            match same(one, on_cpu) {
                Some(other) => agreement.pair(one, other, size),
                None => agreement.unpaired += 1,
            }
        }
        let sure = |one: &&Detection| one.confidence >= confidence + MOST_CONFIDENCE;
        let lost = on_cpu.iter().filter(sure).filter(|one| same(one, found).is_none());
        agreement.unpaired += lost.count();
        agreement
    }

    /// The least confidence of boxes of the CPU to compare with a provider that reports those of `confidence`.
    fn least_on_cpu(confidence: f64) -> f64 {
        (confidence - MOST_CONFIDENCE).max(0.0)
    }

    fn pair(&mut self, one: &Detection, other: &Detection, size: PictureSize) {
        let sides = |found: &Detection| {
            let Corners { x1, y1, x2, y2 } = found.bounding_box.corners();
            let width = f64::from(size.width);
            let height = f64::from(size.height);
            [x1 * width, x2 * width, y1 * height, y2 * height]
        };
        for (side, other_side) in sides(one).into_iter().zip(sides(other)) {
            let distance = (side - other_side).abs();
            self.farthest_px = self.farthest_px.max(distance);
        }
        let difference = (one.confidence - other.confidence).abs();
        self.confidence = self.confidence.max(difference);
    }

    /// True if the provider finds what the CPU finds.
    pub fn agrees(&self) -> bool {
        self.unpaired == 0 && self.farthest_px <= FARTHEST_PX && self.confidence <= MOST_CONFIDENCE
    }
}

/// The box of the same class that overlaps `one` most, if any overlaps it by [`LEAST_OVERLAP`].
fn same<'a>(one: &Detection, others: &'a [Detection]) -> Option<&'a Detection> {
    let overlap = |other: &Detection| one.bounding_box.intersection_over_union(other.bounding_box);
    others
        .iter()
        .filter(|other| other.class == one.class && overlap(other) >= LEAST_OVERLAP)
        .max_by(|a, b| overlap(a).total_cmp(&overlap(b)))
}

impl fmt::Display for ProviderAgreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            provider,
            boxes,
            unpaired,
            farthest_px,
            confidence,
        } = self;
        let provider = provider.as_str();
        let its_boxes = match boxes {
            1 => "its box".to_owned(),
            boxes => format!("its {boxes} boxes"),
        };
        let within = format!("within {farthest_px:.1} px of the input and {confidence:.3}");
        if self.agrees() {
            return write!(
                f,
                "`{provider}` finds what the CPU finds ({its_boxes} {within})"
            );
        }
        write!(f, "`{provider}` finds something else than the CPU: ")?;
        if *unpaired > 0 {
            write!(
                f,
                "{unpaired} of {its_boxes} and those of the CPU are not found by the other, "
            )?;
        }
        write!(
            f,
            "pairs are {within}; set detector.gpu.fp16 = false, export the model in float32, or use another provider"
        )
    }
}

/// How far a provider has been compared with the CPU.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Precision {
    /// The CPU runs the model, or nothing has been found yet that could be compared.
    #[default]
    NotCompared,
    /// The boxes of one picture were compared.
    Compared(ProviderAgreement),
    /// The comparison failed.
    Failed(String),
}

/// Compares once, on the first picture in which something is found, the provider that runs a model with the CPU. Clones
/// share the outcome, so that a session that is built again is not compared again.
#[derive(Clone, Debug)]
pub struct PrecisionProof {
    config: Arc<DetectorConfig>,
    outcome: Arc<Mutex<Precision>>,
    /// The provider that was compared last.
    compared: Arc<Mutex<Option<ExecutionProvider>>>,
}

impl PrecisionProof {
    pub(super) fn new(config: &DetectorConfig) -> Self {
        Self {
            config: Arc::new(config.clone()),
            outcome: Arc::default(),
            compared: Arc::default(),
        }
    }

    /// The outcome so far.
    pub fn outcome(&self) -> Precision {
        self.outcome.lock().clone()
    }

    /// Compares what `provider` found in a picture with what the CPU finds, and returns the thread that does so: the
    /// model is loaded there once more, for one run. Does nothing for the CPU itself, without boxes, and for the
    /// provider that was compared last.
    pub(super) fn found(
        &self,
        provider: ExecutionProvider,
        picture: &PreparedPicture,
        found: &[Detection],
    ) -> Option<JoinHandle<()>> {
        if provider == ExecutionProvider::Cpu || found.is_empty() {
            return None;
        }
        let compared_last = self.compared.lock().replace(provider);
        if compared_last == Some(provider) {
            return None;
        }
        let proof = self.clone();
        let picture = picture.copied();
        let found = found.to_vec();
        let spawned = std::thread::Builder::new()
            .name("precision".to_owned())
            .spawn(move || proof.compare(provider, &picture, &found));
        match spawned {
            Ok(thread) => Some(thread),
            Err(error) => {
                warn!(%error, "the provider could not be compared with the CPU");
                None
            }
        }
    }

    fn compare(&self, provider: ExecutionProvider, picture: &PreparedPicture, found: &[Detection]) {
        let outcome = compare_with_cpu(&self.config, provider, picture, found);
        match &outcome {
            Ok(agreement) if agreement.agrees() => info!("{agreement}"),
            Ok(agreement) => warn!("{agreement}"),
            Err(error) => warn!(%error, "the provider could not be compared with the CPU"),
        }
        *self.outcome.lock() = match outcome {
            Ok(agreement) => Precision::Compared(agreement),
            Err(error) => Precision::Failed(error.to_string()),
        };
    }
}

/// Why a provider could not be compared with the CPU.
#[derive(Debug, thiserror::Error)]
pub enum PrecisionError {
    /// The model does not load on the CPU.
    #[error("on the CPU {0}")]
    Start(#[from] StartError),
    /// It does not run there.
    #[error("on the CPU {0}")]
    Run(#[from] RunError),
}

/// Compares what `provider` found in a picture with what the CPU finds in it.
///
/// # Errors
/// If the model does not run on the CPU.
pub fn compare_with_cpu(
    config: &DetectorConfig,
    provider: ExecutionProvider,
    picture: &PreparedPicture,
    found: &[Detection],
) -> Result<ProviderAgreement, PrecisionError> {
    let on_cpu = DetectorConfig {
        providers: vec![ExecutionProvider::Cpu],
        confidence: ProviderAgreement::least_on_cpu(config.confidence),
        batch_size: 1,
        ..config.clone()
    };
    let mut network = DetectorNetwork::open(&on_cpu)?;
    // Here, and not by the graph in front of the model, so that what the graph makes is compared, too.
    let converted = picture
        .converted(network.input_format())
        .map_err(|fault| RunError::BadPicture(fault.to_string()))?;
    let boxes = network.detect(&converted)?.detections;
    Ok(ProviderAgreement::of(
        provider,
        found,
        &boxes,
        config.confidence,
        converted.size(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;
    use ExecutionProvider::TensorRt;
    use albireo_core::detection::ClassId;
    use albireo_core::geometry::BoundingBox;

    const SIZE: PictureSize = PictureSize::new(400, 400);

    fn found(center_x: f64, confidence: f64) -> Detection {
        Detection {
            bounding_box: BoundingBox::new(center_x, 0.5, 0.1, 0.1),
            class: ClassId(2),
            confidence,
        }
    }

    fn compared(found: &[Detection], on_cpu: &[Detection]) -> ProviderAgreement {
        ProviderAgreement::of(TensorRt, found, on_cpu, 0.5, SIZE)
    }

    #[test]
    fn a_provider_agrees_within_two_pixels_and_two_hundredths_and_if_no_box_is_lost() {
        let on_cpu = [found(0.5, 0.8)];
        for (boxes, agrees) in [
            (vec![found(0.5, 0.8)], true),
            (vec![found(0.5 + 1.9 / 400.0, 0.8)], true),
            (vec![found(0.5 + 2.1 / 400.0, 0.8)], false),
            (vec![found(0.5, 0.819)], true),
            (vec![found(0.5, 0.779)], false),
            (vec![], false),
            (vec![found(0.5, 0.8), found(0.9, 0.8)], false),
        ] {
            let agreement = compared(&boxes, &on_cpu);
            assert_eq!(agreement.agrees(), agrees, "{agreement}");
        }
    }

    #[test]
    fn a_provider_that_agrees_is_said_to_find_what_the_cpu_finds() {
        let words = compared(&[found(0.5, 0.8)], &[found(0.5, 0.8)]).to_string();
        assert!(words.contains("finds what the CPU finds"), "{words}");
        assert!(!words.contains("detector.gpu.fp16 = false"), "{words}");
    }

    #[test]
    fn of_a_provider_that_does_not_agree_the_way_out_is_said() {
        let words = compared(&[], &[found(0.5, 0.8)]).to_string();
        assert!(words.contains("detector.gpu.fp16 = false"), "{words}");
        assert!(!words.contains("finds what the CPU finds"), "{words}");
    }

    #[test]
    fn a_box_at_the_limit_of_confidence_may_be_reported_by_one_alone() {
        // The CPU's is just not reported, or just is.
        assert!(compared(&[found(0.5, 0.505)], &[found(0.5, 0.49)]).agrees());
        assert!(compared(&[], &[found(0.5, 0.51)]).agrees());
        assert!(!compared(&[], &[found(0.5, 0.53)]).agrees());
    }

    /// What a model has found in a green picture on the CPU, and a proof that has compared nothing yet.
    struct GreenPicture {
        proof: PrecisionProof,
        picture: PreparedPicture,
        boxes: Vec<Detection>,
    }

    impl GreenPicture {
        fn new() -> Self {
            let model = "../../tests/fixtures/models/colours.onnx";
            let config = DetectorConfig {
                model: std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(model),
                ..DetectorConfig::default()
            };
            let mut network = DetectorNetwork::open(&config).unwrap();
            let mut green = Picture::black(network.input_format().size);
            for value in green.pixels.iter_mut().skip(1).step_by(3) {
                *value = 204;
            }
            let picture = network.preparation().prepare(&green).unwrap();
            let boxes = network.detect(&picture).unwrap().detections;
            Self {
                proof: PrecisionProof::new(&config),
                picture,
                boxes,
            }
        }

        /// The comparison of these boxes, as if `provider` had found them.
        fn compared(&self, provider: ExecutionProvider) -> ProviderAgreement {
            let thread = self.proof.found(provider, &self.picture, &self.boxes);
            thread.unwrap().join().unwrap();
            match self.proof.outcome() {
                Precision::Compared(agreement) => agreement,
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn neither_the_cpu_nor_a_picture_without_boxes_is_compared() {
        let green = GreenPicture::new();
        let on_cpu = green.proof.found(ExecutionProvider::Cpu, &green.picture, &green.boxes);
        assert!(on_cpu.is_none());
        assert!(green.proof.found(TensorRt, &green.picture, &[]).is_none());
        assert_eq!(green.proof.outcome(), Precision::NotCompared);
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn the_first_picture_with_boxes_is_run_on_the_cpu_too_and_once_for_each_provider() {
        let green = GreenPicture::new();
        for provider in [ExecutionProvider::Cuda, TensorRt] {
            assert!(green.compared(provider).agrees());
            let again = green.proof.found(provider, &green.picture, &green.boxes);
            assert!(again.is_none());
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn a_provider_that_loses_confidence_in_half_precision_does_not_agree() {
        let mut green = GreenPicture::new();
        green.boxes[0].confidence -= 0.03;
        assert!(!green.compared(TensorRt).agrees());
    }
}
