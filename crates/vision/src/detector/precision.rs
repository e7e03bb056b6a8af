//! Whether the provider that runs a model finds what the CPU finds: half precision, TensorRT's and CUDA's kernels compute
//! the same sums in other ways, and for some models boxes are lost.

use super::network::DetectorNetwork;
use super::{DetectorConfig, ExecutionProvider, PreparedPicture, StartError};
use crate::picture::InputMapping;
use crate::worker::RunError;
use albireo_core::detection::Detection;
use albireo_core::geometry::Corners;
use parking_lot::Mutex;
use std::fmt;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread::{Builder, JoinHandle};
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
    /// Compares the boxes of `provider`, of at least the confidence `threshold`, with those of the CPU, of at least
    /// [`least_on_cpu`](Self::least_on_cpu), in an input that `mapping` leads to. A box that is only just reported by one may
    /// be just below the threshold on the other.
    fn of(
        provider: ExecutionProvider,
        found: &[Detection],
        on_cpu: &[Detection],
        threshold: f64,
        mapping: InputMapping,
    ) -> Self {
        let mut agreement = Self {
            provider,
            boxes: found.len(),
            unpaired: 0,
            farthest_px: 0.0,
            confidence: 0.0,
        };
        let mut left: Vec<&Detection> = on_cpu.iter().collect();
        for one in found {
            match most_alike(one, &left) {
                Some(place) => {
                    let other = left.swap_remove(place);
                    agreement.pair(one, other, mapping);
                }
                None => agreement.unpaired += 1,
            }
        }
        let is_sure = |one: &&&Detection| one.confidence >= threshold + MOST_CONFIDENCE;
        agreement.unpaired += left.iter().filter(is_sure).count();
        agreement
    }

    /// The least confidence of boxes of the CPU to compare with a provider that reports those of `confidence`.
    fn least_on_cpu(confidence: f64) -> f64 {
        (confidence - MOST_CONFIDENCE).max(0.0)
    }

    fn pair(&mut self, one: &Detection, other: &Detection, mapping: InputMapping) {
        let sides = |found: &Detection| {
            let Corners { x1, y1, x2, y2 } = mapping.to_input(found.bounding_box);
            [x1, y1, x2, y2]
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

/// The index of the box of the same class that overlaps `one` most, if any overlaps it by [`LEAST_OVERLAP`].
fn most_alike(one: &Detection, others: &[&Detection]) -> Option<usize> {
    let overlap = |place: usize| {
        let other = others[place];
        one.bounding_box.intersection_over_union(other.bounding_box)
    };
    (0..others.len())
        .filter(|&place| others[place].class == one.class && overlap(place) >= LEAST_OVERLAP)
        .max_by(|&a, &b| overlap(a).total_cmp(&overlap(b)))
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
            write!(f, "only one of the two finds {unpaired} of the boxes, ")?;
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

/// Compares the provider that runs a model with the CPU on the first picture in which it finds something, and again only
/// after another provider has run the model. Clones share the outcome, so that a session that is built again is not compared
/// again.
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
    /// provider that was compared last. If there is no thread to be had, the next picture is compared instead.
    pub(super) fn found(
        &self,
        provider: ExecutionProvider,
        picture: &PreparedPicture,
        found: &[Detection],
    ) -> Option<JoinHandle<()>> {
        let thread = Builder::new().name("precision".to_owned());
        self.found_in(thread, provider, picture, found)
    }

    /// [`found`](Self::found) with the thread to start.
    fn found_in(
        &self,
        thread: Builder,
        provider: ExecutionProvider,
        picture: &PreparedPicture,
        found: &[Detection],
    ) -> Option<JoinHandle<()>> {
        if provider == ExecutionProvider::Cpu {
            *self.compared.lock() = None;
            *self.outcome.lock() = Precision::NotCompared;
            return None;
        }
        if found.is_empty() {
            return None;
        }
        let compared_last = self.compared.lock().replace(provider);
        if compared_last == Some(provider) {
            return None;
        }
        let proof = self.clone();
        let (give, take) = sync_channel::<ToCompare>(1);
        let compare = move || {
            if let Ok(ToCompare { picture, boxes }) = take.recv() {
                proof.compare(provider, &picture, &boxes);
            }
        };
        match thread.spawn(compare) {
            Ok(started) => {
                // Only now: while no thread can be had, no picture is copied.
                let to_compare = ToCompare {
                    picture: picture.copied(),
                    boxes: found.to_vec(),
                };
                // It has room for one, and the thread takes it.
                let _ = give.send(to_compare);
                Some(started)
            }
            Err(error) => {
                *self.compared.lock() = None;
                let failed = Precision::Failed(error.to_string());
                let mut outcome = self.outcome.lock();
                // Many pictures may come before there is a thread again.
                if *outcome != failed {
                    warn!(%error, "the provider could not be compared with the CPU");
                    *outcome = failed;
                }
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
        // Meanwhile another provider may run the model.
        if *self.compared.lock() != Some(provider) {
            return;
        }
        *self.outcome.lock() = match outcome {
            Ok(agreement) => Precision::Compared(agreement),
            Err(error) => Precision::Failed(error.to_string()),
        };
    }
}

/// What a provider found in a picture.
struct ToCompare {
    picture: PreparedPicture,
    boxes: Vec<Detection>,
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
    // By the CPU's code: on a GPU a graph in front of the model may have converted the pixels, and what that gives is to be
    // compared, too.
    let converted = picture
        .converted(network.input_format())
        .map_err(|fault| RunError::BadPicture(fault.to_string()))?;
    let boxes = network.detect(&converted)?.detections;
    Ok(ProviderAgreement::of(
        provider,
        found,
        &boxes,
        config.confidence,
        converted.mapping(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::Preparation;
    use crate::picture::{
        ColorOrder, Fit, InputElement, InputFormat, Letterbox, Picture, TensorLayout, ValueRange,
    };
    use ExecutionProvider::TensorRt;
    use albireo_core::detection::ClassId;
    use albireo_core::geometry::{BoundingBox, PictureSize};

    /// The confidence from which boxes are reported.
    const THRESHOLD: f64 = 0.5;

    fn format() -> InputFormat {
        InputFormat {
            size: PictureSize::new(400, 400),
            fit: Fit::Centre,
            color_order: ColorOrder::Rgb,
            value_range: ValueRange::To255,
            layout: TensorLayout::Nchw,
            element: InputElement::Float,
        }
    }

    /// How a picture of 1600x800 lies in an input of 400x400: in 200 of its rows.
    fn mapping() -> InputMapping {
        Letterbox::new(format())
            .fill(&Picture::black(PictureSize::new(1600, 800)))
            .unwrap()
    }

    fn found(center_x: f64, confidence: f64) -> Detection {
        Detection {
            bounding_box: BoundingBox::new(center_x, 0.5, 0.1, 0.1),
            class: ClassId(2),
            confidence,
        }
    }

    fn compared(found: &[Detection], on_cpu: &[Detection]) -> ProviderAgreement {
        ProviderAgreement::of(TensorRt, found, on_cpu, THRESHOLD, mapping())
    }

    #[test]
    fn sides_may_differ_by_two_pixels_of_the_input() {
        let on_cpu = [found(0.5, 0.8)];
        assert!(compared(&[found(0.5 + 1.9 / 400.0, 0.8)], &on_cpu).agrees());
        assert!(!compared(&[found(0.5 + 2.1 / 400.0, 0.8)], &on_cpu).agrees());
    }

    #[test]
    fn rows_are_those_that_the_picture_has_in_the_input() {
        let on_cpu = [found(0.5, 0.8)];
        let mut lower = found(0.5, 0.8);
        // In an input without a margin these would be 3.8 pixels.
        lower.bounding_box.center_y += 1.9 / 200.0;
        assert!(compared(&[lower], &on_cpu).agrees());
        lower.bounding_box.center_y += 0.2 / 200.0;
        assert!(!compared(&[lower], &on_cpu).agrees());
    }

    #[test]
    fn the_confidence_may_differ_by_two_hundredths() {
        let on_cpu = [found(0.5, 0.8)];
        assert!(compared(&[found(0.5, 0.819)], &on_cpu).agrees());
        assert!(!compared(&[found(0.5, 0.779)], &on_cpu).agrees());
    }

    #[test]
    fn a_lost_or_an_added_box_does_not_agree() {
        let on_cpu = [found(0.5, 0.8)];
        assert!(!compared(&[], &on_cpu).agrees());
        for added in [found(0.9, 0.8), found(0.5, 0.8)] {
            assert!(!compared(&[found(0.5, 0.8), added], &on_cpu).agrees());
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
    fn the_cpu_is_asked_for_boxes_just_below_the_threshold_too() {
        assert!(ProviderAgreement::least_on_cpu(THRESHOLD) < 0.49);
        assert!(compared(&[found(0.5, 0.505)], &[found(0.5, 0.49)]).agrees());
    }

    #[test]
    fn only_a_box_of_the_cpu_just_above_the_threshold_may_be_missing() {
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
            for pixel in green.pixels.chunks_exact_mut(3) {
                pixel[1] = 204;
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
    fn a_provider_whose_comparison_could_not_begin_is_compared_on_the_next_picture() {
        let proof = PrecisionProof::new(&DetectorConfig {
            model: "missing.onnx".into(),
            ..DetectorConfig::default()
        });
        let format = format();
        let picture = Preparation::new(format).prepare(&Picture::black(format.size)).unwrap();
        let boxes = [found(0.5, 0.8)];
        // No address space has room for such a stack.
        let too_large = Builder::new().stack_size(1 << 60);
        let refused = proof.found_in(too_large, TensorRt, &picture, &boxes);
        assert!(refused.is_none());
        assert!(matches!(proof.outcome(), Precision::Failed(_)));
        let next = proof.found(TensorRt, &picture, &boxes);
        next.unwrap().join().unwrap();
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
    fn the_first_picture_with_boxes_is_run_on_the_cpu_too() {
        assert!(GreenPicture::new().compared(TensorRt).agrees());
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn a_provider_is_compared_once_while_it_runs_the_model() {
        let green = GreenPicture::new();
        for provider in [ExecutionProvider::Cuda, TensorRt] {
            green.compared(provider);
            let again = green.proof.found(provider, &green.picture, &green.boxes);
            assert!(again.is_none());
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn nothing_is_compared_any_more_once_the_cpu_runs_the_model() {
        let green = GreenPicture::new();
        green.compared(TensorRt);
        green.proof.found(ExecutionProvider::Cpu, &green.picture, &green.boxes);
        assert_eq!(green.proof.outcome(), Precision::NotCompared);
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn a_provider_that_loses_confidence_in_half_precision_does_not_agree() {
        let mut green = GreenPicture::new();
        green.boxes[0].confidence -= 0.03;
        assert!(!green.compared(TensorRt).agrees());
    }
}
