//! A detector network: ONNX Runtime session, preparation, head and class names, all on the caller's thread.

use super::classes::Classes;
use super::head::{Evidence, Head, Objection};
use super::heads::Heads;
use super::inputs::percent;
use super::opening::{self, Among};
use super::precision::PrecisionProof;
use super::reader::{Parts, Reader};
use super::{Agreement, ModelInput, PreparedPicture, USUAL_PICTURE, class_names};
use super::{DetectorConfig, HeadCounts, HeadMeter, HeadName, Preparation};
use crate::onnx::{
    ExecutionProvider, NOT_RECORDED, OnnxSession, Signature, StartError, TensorView,
};
use crate::picture::{InputFormat, Picture};
use crate::worker::{Model, RunError, WorkerInput, batch_sizes};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use std::time::{Duration, Instant};
use tracing::warn;

/// The detections in one picture, and the duration of each step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Best first, normalised to the source picture, above the configured confidence, overlaps suppressed.
    pub detections: Vec<Detection>,
    /// Resizing and conversion to the model's input tensor.
    pub letterbox: Duration,
    /// The model alone; for a batch, all its pictures.
    pub model: Duration,
    /// From output tensors to detections.
    pub head: Duration,
}

/// A model with its preparation and its head, on the caller's thread: from pictures to detections.
/// [`DetectorHandle`](super::DetectorHandle) does the same for several cameras, with a queue and deadlines.
pub struct DetectorNetwork {
    session: OnnxSession,
    preparation: Preparation,
    heads: Heads,
    reader: Reader,
    /// The least confidence of a detection.
    confidence: f64,
    /// The number of consecutive runs with only impossible results.
    impossible_runs: u32,
    /// What the last of these said against the head, if it was asked.
    doubt: Option<Objection>,
    /// What compares the provider with the CPU.
    proof: Option<PrecisionProof>,
}

/// This many consecutive runs with only impossible results are a fault of the model.
const IMPOSSIBLE_RUNS: u32 = 5;

impl DetectorNetwork {
    /// Loads the model, finds and binds its head, and runs it once, so that the first picture is not slow.
    ///
    /// # Errors
    /// If the library, the model, its head or the execution provider is not as configured.
    pub fn open(config: &DetectorConfig) -> Result<Self, StartError> {
        config.check()?;
        Self::open_counting(config, Among::All, HeadMeter::default())
    }

    pub(super) fn open_counting(
        config: &DetectorConfig,
        among: Among,
        meter: HeadMeter,
    ) -> Result<Self, StartError> {
        let begun = Instant::now();
        let (session, mut heads) = opening::open(config, among)?;
        let read = class_names::read(
            config.class_names.as_ref(),
            &session.signature().metadata,
            heads.largest(),
        )?;
        heads.assume(read.assumed);
        let classes = Classes::new(&read.names, config)?;
        let input = opening::model_input(config, session.signature(), heads.largest());
        let mut network = Self {
            session,
            preparation: Preparation::new(input),
            heads,
            reader: Reader::new(classes, config),
            confidence: config.confidence,
            impossible_runs: 0,
            doubt: None,
            proof: None,
        };
        let sizes = network
            .warm_up(config.batch_size)
            .map_err(|reason| StartError::first_run(&config.model, reason))?;
        network.session.keep_build_time(begun.elapsed());
        let recorded = if network.session.records() {
            network.record_runs(&sizes, config.batch_size)
        } else {
            Ok(())
        };
        if let Err(reason) = recorded {
            warn!(reason, "{NOT_RECORDED}");
            let mut unrecorded = config.clone();
            unrecorded.gpu.cuda_graph = false;
            // CUDA may be left in the middle of a recording: another session begins anew.
            drop(network);
            return Self::open_counting(&unrecorded, among, meter);
        }
        // Counting begins with the first picture.
        network.reader.meter = meter;
        network.impossible_runs = 0;
        network.doubt = None;
        Ok(network)
    }

    /// Has the provider compared with the CPU.
    pub(super) fn proved_by(self, proof: PrecisionProof) -> Self {
        Self {
            proof: Some(proof),
            ..self
        }
    }

    /// Runs the model on black pictures, in all numbers that a run may have, to get over the slow first runs: memory is
    /// laid out, TensorRT builds its engine, and CUDA's library looks for the fastest kernels of each number and size that
    /// it meets, which takes seconds. The largest comes first, so that memory and engine fit the others. Returns the sizes
    /// of the pictures.
    fn warm_up(&mut self, batch_size: usize) -> Result<Vec<PictureSize>, String> {
        let largest = self.input_format().size;
        self.warm_up_at(largest, batch_size)?;
        let mut sizes = vec![largest];
        if self.input().open.is_some() && self.provider() != ExecutionProvider::Cpu {
            let smallest = self.input().smallest_for(USUAL_PICTURE);
            // If the model does not run at it, the comparison with the largest input tells.
            let warmed = self.warm_up_at(smallest, batch_size);
            if warmed.is_ok() {
                sizes.push(smallest);
            }
        }
        Ok(sizes)
    }

    /// [`warm_up`](Self::warm_up) at an input of `size`.
    fn warm_up_at(&mut self, size: PictureSize, batch_size: usize) -> Result<(), String> {
        let pictures = self.black_pictures(size, batch_size)?;
        for count in batch_sizes(batch_size).rev() {
            // Black pictures show nothing, however often.
            self.impossible_runs = 0;
            match self.run(&pictures[..count]) {
                Ok(_) => {}
                Err(error) if count == 1 => return Err(error.to_string()),
                Err(error) => {
                    return Err(format!("{error} (with detector.batch_size = {batch_size})"));
                }
            }
        }
        Ok(())
    }

    fn black_pictures(
        &self,
        size: PictureSize,
        count: usize,
    ) -> Result<Vec<PreparedPicture>, String> {
        // `self.preparation` would keep these buffers, and a batch of them may be large.
        let preparation = Preparation::new(self.preparation.format());
        let black = Picture::black(size);
        let mut pictures = Vec::new();
        for _ in 0..count.max(1) {
            let prepared = preparation.prepare_at(&black, size);
            pictures.push(prepared.map_err(|error| error.to_string())?);
        }
        Ok(pictures)
    }

    /// Has CUDA record the runs that [`warm_up`](Self::warm_up) made.
    fn record_runs(&mut self, sizes: &[PictureSize], batch_size: usize) -> Result<(), String> {
        let format = self.preparation.format();
        for &size in sizes {
            let pictures = self.black_pictures(size, batch_size)?;
            let inputs: Vec<_> = pictures.iter().map(PreparedPicture::tensor).collect();
            for count in batch_sizes(batch_size).rev() {
                self.session.record(format.shape_of(size), size, &inputs[..count])?;
            }
        }
        Ok(())
    }

    /// Finds the objects in one picture. If nothing in it is possible, [`doubt`](Self::doubt) says at once what that tells
    /// against the head.
    ///
    /// # Errors
    /// If the run failed.
    pub fn detect(&mut self, picture: &PreparedPicture) -> Result<Found, RunError> {
        self.find(std::slice::from_ref(picture), true)?
            .pop()
            .ok_or_else(|| RunError::Failed("the model returned no answer".to_owned()))
    }

    /// The time of a run on a black picture at an input of `size`: that of the largest input, or a smaller one of a model
    /// whose sides are open.
    ///
    /// # Errors
    /// If the run failed.
    pub fn time_at(&mut self, size: PictureSize) -> Result<Duration, RunError> {
        let black = Preparation::new(self.preparation.format())
            .prepare_at(&Picture::black(size), size)
            .map_err(|error| RunError::BadPicture(error.to_string()))?;
        Ok(self.detect(&black)?.model)
    }

    /// True if CUDA replays the runs of the warm-up's shapes instead of starting them layer by layer.
    pub fn replays(&self) -> bool {
        self.session.records()
    }

    /// The input of the model, and the sizes that it may have.
    pub fn input(&self) -> ModelInput {
        self.preparation.model()
    }

    /// Makes the model's input from pictures.
    pub fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// The names of the reported classes, by reported number.
    pub fn class_names(&self) -> &[String] {
        &self.reader.classes.reported
    }

    /// The head that reads the model's output.
    pub fn head(&self) -> HeadName {
        self.heads.largest().name
    }

    /// The names of the model's classes that are not reported.
    pub fn left_out(&self) -> &[String] {
        &self.reader.classes.left_out
    }

    /// What the last pictures say against the head if nothing in them was possible.
    pub fn doubt(&self) -> Option<&Objection> {
        self.doubt.as_ref()
    }

    /// The head and the input, with what a picture of 16:9 leaves empty of it, and what was assumed of the model, in
    /// one line. Where so much is left empty that [`InputUse`](super::InputUse) has a word for it, it is left to that.
    pub fn description(&self) -> String {
        let InputFormat {
            size,
            fit,
            color_order,
            value_range,
            ..
        } = self.input_format();
        let usual = self.input().first_use(USUAL_PICTURE);
        let open = match self.input().open {
            Some(_) => format!(
                " or less, as the picture needs: for 16:9 {} with {} of padding",
                usual.smallest.size,
                percent(usual.smallest.padding)
            ),
            None if usual.largest.padding > 0.0 && !usual.is_wasteful() => {
                format!(
                    ", for 16:9 with {} of padding",
                    percent(usual.largest.padding)
                )
            }
            None => String::new(),
        };
        let mut text = format!(
            "head {}, input {size}{open} ({}, {}, {})",
            self.head().as_str(),
            fit.as_str(),
            color_order.as_str(),
            value_range.as_str(),
        );
        for assumed in self.heads.assumed() {
            text.push_str("; ");
            text.push_str(assumed);
        }
        text
    }

    /// The execution provider that runs the model: not the first configured one if that does not work and a fallback is
    /// allowed.
    pub fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }

    /// The input that the model expects; the largest, if its sides are open.
    pub fn input_format(&self) -> InputFormat {
        self.heads.largest().input_format
    }

    /// Names, types and shapes of the model's inputs and outputs, and its metadata.
    pub fn signature(&self) -> &Signature {
        self.session.signature()
    }

    /// Rows and boxes of the model's output that were not reported.
    pub fn counts(&self) -> HeadCounts {
        self.reader.meter.read()
    }
}

/// What users of a detector rely on: the class names, whose numbers are in use, and the input that pictures are prepared
/// for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Facts {
    /// The names of the reported classes, by class number.
    pub class_names: Vec<String>,
    /// The names of the model's classes that are not reported.
    pub left_out: Vec<String>,
    /// The input that pictures are prepared for.
    pub input: ModelInput,
    /// Head and input, in words.
    pub description: String,
}

impl Model for DetectorNetwork {
    type Input = PreparedPicture;
    type Output = Found;
    type Facts = Facts;

    fn facts(&self) -> Facts {
        Facts {
            class_names: self.class_names().to_vec(),
            left_out: self.left_out().to_vec(),
            input: self.input(),
            description: self.description(),
        }
    }

    fn run(&mut self, pictures: &[PreparedPicture]) -> Result<Vec<Found>, RunError> {
        // The cause is looked for when it is told: that passes over all numbers of the outputs.
        let may_fail = self.impossible_runs.saturating_add(1) >= IMPOSSIBLE_RUNS;
        self.find(pictures, may_fail)
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }
}

/// The answer of one run.
struct Answered {
    found: Vec<Found>,
    /// The number of pictures in which only impossible boxes were found.
    impossible: usize,
    /// What the first of these says against the head, if it was asked.
    doubt: Option<Objection>,
    /// True if a number is not finite where only impossible boxes were found, if that was asked.
    overflows: bool,
    to_compare: Vec<Compared>,
}

impl Answered {
    /// Asks the outputs of a picture in which nothing is possible what that may come from.
    fn ask(&mut self, head: &Head, outputs: &[TensorView<'_>], confidence: f64) {
        let mut numbers = outputs.iter().flat_map(|output| output.values);
        self.overflows |= numbers.any(|number| !number.is_finite());
        if self.doubt.is_none()
            && let Evidence::Against(objection) = head.evidence(outputs, confidence)
        {
            self.doubt = Some(objection);
        }
    }
}

/// A picture whose smallest input is to be compared with the largest.
struct Compared {
    /// Its place in the run.
    picture: usize,
    /// The boxes that were found in it.
    boxes: Vec<Detection>,
}

impl DetectorNetwork {
    /// Finds the objects in pictures of one size; with `asks`, what tells against the head where nothing is possible.
    fn find(&mut self, pictures: &[PreparedPicture], asks: bool) -> Result<Vec<Found>, RunError> {
        let answered = self.answer(pictures, asks)?;
        for largest in &answered.to_compare {
            self.compare(&pictures[largest.picture], &largest.boxes);
        }
        if answered.impossible < pictures.len() {
            self.impossible_runs = 0;
            self.doubt = None;
            if let Some(proof) = &self.proof {
                for (picture, found) in pictures.iter().zip(&answered.found) {
                    proof.found(self.provider(), picture, &found.detections);
                }
            }
            return Ok(answered.found);
        }
        self.impossible_runs = self.impossible_runs.saturating_add(1);
        self.doubt = answered.doubt;
        if self.impossible_runs >= IMPOSSIBLE_RUNS {
            let cause = match &self.doubt {
                Some(objection) => format!(
                    "it is not a model of the head `{}`, as {objection}",
                    self.head().as_str()
                ),
                None if answered.overflows => {
                    "export it again, without half precision if it has that".to_owned()
                }
                None => "its numbers are finite: its scores may not be from 0 to 1, or its boxes not in the input; \
                         export it so that they are, or set detector.head to another"
                    .to_owned(),
            };
            return Err(RunError::Implausible(format!(
                "everything that the model finds is impossible (numbers that are not finite, boxes without an area, \
                 outside of the picture or much larger than it), {IMPOSSIBLE_RUNS} runs in a row or more: {cause}"
            )));
        }
        Ok(answered.found)
    }

    /// Runs the model on pictures of one size and reads its outputs.
    fn answer(&mut self, pictures: &[PreparedPicture], asks: bool) -> Result<Answered, RunError> {
        let started = Instant::now();
        let inputs: Vec<_> = pictures.iter().map(PreparedPicture::tensor).collect();
        let format = self.preparation.format();
        let size = pictures.first().map_or(format.size, WorkerInput::size);
        let head = self.heads.at(size).map_err(RunError::Failed)?;
        let confidence = self.confidence;
        let least = Agreement::least_confidence(confidence);
        let reader = &mut self.reader;
        let mut answered = Answered {
            found: Vec::with_capacity(pictures.len()),
            impossible: 0,
            doubt: None,
            overflows: false,
            to_compare: Vec::new(),
        };
        let ran = self.session.run(format.shape_of(size), size, &inputs, |outputs| {
            let model = started.elapsed();
            let parts = match pictures {
                [_] => None,
                several => Some(Parts::of(outputs, several.len())?),
            };
            for (number, picture) in pictures.iter().enumerate() {
                let start = Instant::now();
                let part = parts.as_ref().map(|parts| parts.get(outputs, number));
                let of_picture = part.as_deref().unwrap_or(outputs);
                let read = reader.read(head, of_picture, picture.mapping())?;
                answered.found.push(Found {
                    detections: read.detections,
                    letterbox: picture.took(),
                    model,
                    head: start.elapsed(),
                });
                answered.impossible += usize::from(read.is_impossible);
                if read.is_impossible && asks {
                    answered.ask(head, of_picture, confidence);
                }
                if size == format.size && picture.inputs().compared(picture.source()).is_some() {
                    let boxes = reader
                        .uncounted(head, of_picture, picture.mapping(), least)
                        .map_err(RunError::Failed)?;
                    answered.to_compare.push(Compared {
                        picture: number,
                        boxes,
                    });
                }
            }
            Ok(answered)
        });
        ran.map_err(RunError::Failed)?
    }

    /// Runs the model on a picture at the smallest input, and adds how its boxes agree with those of the largest.
    fn compare(&mut self, picture: &PreparedPicture, largest: &[Detection]) {
        let Some(size) = picture.inputs().compared(picture.source()) else {
            return;
        };
        let boxes = self.boxes_at(size, picture);
        let agreement = boxes.map(|boxes| Agreement::of(largest, &boxes, self.confidence));
        picture.inputs().add(size, agreement);
    }

    /// Runs the model on a picture at an input of `size`: the boxes to compare.
    fn boxes_at(
        &mut self,
        size: PictureSize,
        picture: &PreparedPicture,
    ) -> Result<Vec<Detection>, String> {
        let format = self.preparation.format();
        let (values, mapping) = picture.tensor().cut(format, picture.source(), size);
        let least = Agreement::least_confidence(self.confidence);
        let head = self.heads.at(size)?;
        let reader = &mut self.reader;
        self.session.run(format.shape_of(size), size, &[&values], |outputs| {
            reader.uncounted(head, outputs, mapping, least)
        })?
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ort::memory::Allocator;
    use std::path::Path;

    fn open(model: &str, batch_size: usize) -> DetectorNetwork {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/models");
        let config = DetectorConfig {
            model: models.join(model),
            // There is none here, but pictures are prepared as for one.
            providers: vec![ExecutionProvider::Cuda, ExecutionProvider::Cpu],
            batch_size,
            report_classes: Some(Vec::new()),
            ..DetectorConfig::default()
        };
        DetectorNetwork::open(&config).unwrap()
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn runs_recorded_for_each_number_of_pictures_find_the_same_boxes() {
        let mut plain = open("yolo_open.onnx", 3);
        let mut recorded = open("yolo_open.onnx", 3);
        recorded.session.record_in(Allocator::default());
        let sizes = recorded.warm_up(3).unwrap();
        recorded.record_runs(&sizes, 3).unwrap();
        let size = plain.input_format().size;
        let filled_with = |rgb: [u8; 3]| {
            let mut picture = Picture::black(size);
            picture.pixels = rgb.repeat((size.width * size.height) as usize);
            plain.preparation().prepare(&picture).unwrap()
        };
        let pictures = [[200, 0, 0], [0, 200, 0], [160, 160, 0]].map(filled_with);
        let detections = |network: &mut DetectorNetwork, pictures: &[PreparedPicture]| {
            let found = network.run(pictures).unwrap();
            found.into_iter().map(|found| found.detections).collect::<Vec<_>>()
        };
        for count in 1..=pictures.len() {
            let some = &pictures[..count];
            let found = detections(&mut recorded, some);
            assert!(found.iter().all(|boxes| !boxes.is_empty()));
            assert_eq!(found, detections(&mut plain, some));
        }
    }
}
