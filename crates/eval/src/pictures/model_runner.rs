//! Processes a picture as a node does: decodes it, runs the detector and the screen, and measures the time of
//! each step.

use crate::data::StepTimes;
use crate::data::classes::Evaluated;
use crate::error::EvalError;
use albireo_core::detection::{ClassId, Detection};
use albireo_core::policy::Need;
use albireo_vision::detector::{
    CameraSlot, Choice, DetectorConfig, DetectorHandle, ExecutionProvider,
};
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, Picture, PixelLayout, decode, decode_grey_half, decode_small_grey,
};
use albireo_vision::screen::{ScreenConfig, ScreenHandle, decoding_target};
use std::sync::Arc;
use std::time::Instant;
use tokio::runtime::Runtime;

const CAMERA: CameraSlot = CameraSlot(0);

/// The results for one picture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ModelResults {
    /// The detections, best first, with the evaluation's class numbers.
    pub detections: Vec<Detection>,
    /// The class names of detections whose class is not evaluated.
    pub unmapped: Vec<String>,
    /// True if the screen says that nothing is in view; `None` without a screen or if it gave no verdict.
    pub empty: Option<bool>,
    /// The time of each step.
    pub times: StepTimes,
}

/// A decoded grey picture.
pub(super) struct TimedGrey {
    pub picture: Picture,
    /// The time that decoding took.
    pub milliseconds: f64,
}

/// A detector and perhaps a screen, which process one picture after another.
pub struct ModelRunner {
    detector: DetectorHandle,
    screen: Option<ScreenHandle>,
    evaluated: Evaluated,
    /// For each class of the detector, its number in the evaluation.
    classes: Vec<Option<ClassId>>,
    limits: FrameLimits,
    picture: Arc<Picture>,
    /// Declared last, so that it is dropped last: the handles' tasks run on it.
    runtime: Runtime,
}

impl ModelRunner {
    /// Loads the models and warms them up.
    ///
    /// # Errors
    /// [`EvalError`] when a model cannot be loaded or used.
    pub fn start(
        detector_config: &DetectorConfig,
        screen_config: &ScreenConfig,
    ) -> Result<Self, EvalError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .map_err(|error| {
                EvalError::new(format!(
                    "the asynchronous runtime cannot be started: {error}"
                ))
            })?;
        let detector_start = DetectorHandle::start(detector_config);
        let detector = runtime.block_on(detector_start).map_err(EvalError::new)?;
        let library = detector_config.onnxruntime.as_deref();
        let screen_start = ScreenHandle::start(screen_config, library);
        let screen = runtime.block_on(screen_start).map_err(EvalError::new)?;
        let evaluated = Evaluated::of_model(detector.class_names());
        Ok(Self {
            classes: numbers(&evaluated, detector.class_names()),
            evaluated,
            detector,
            screen,
            limits: FrameLimits::default(),
            picture: Arc::default(),
            runtime,
        })
    }

    /// The names of the detector's classes.
    pub fn class_names(&self) -> &[String] {
        self.detector.class_names()
    }

    /// The classes that are evaluated: at first those that the model itself asks for.
    pub const fn evaluated(&self) -> &Evaluated {
        &self.evaluated
    }

    /// Evaluates these classes: those of the ground truth.
    pub fn evaluate(&mut self, evaluated: &Evaluated) {
        self.classes = numbers(evaluated, self.detector.class_names());
        self.evaluated = evaluated.clone();
    }

    /// True if there is a screen.
    pub fn has_screen(&self) -> bool {
        self.screen.is_some()
    }

    /// The detector's execution provider.
    pub fn provider(&self) -> ExecutionProvider {
        self.detector.provider()
    }

    /// True if the detector chooses the size of its input by the shape of the picture.
    pub(super) fn chooses_input(&self) -> bool {
        self.detector.preparation().model().open.is_some()
    }

    /// True if it has chosen the input for the picture that was decoded last.
    pub(super) fn has_chosen_input(&self) -> bool {
        let picture = self.picture.source_size;
        let smallest = self.detector.preparation().model().smallest_for(picture);
        self.detector
            .inputs()
            .iter()
            .find(|found| found.smallest.size == smallest)
            .is_some_and(|found| !matches!(found.choice, Choice::Comparing(_)))
    }

    /// The inputs of the detector so far, in words: one line for each shape of picture.
    pub fn inputs(&self) -> Vec<String> {
        self.detector.inputs().iter().map(ToString::to_string).collect()
    }

    /// Decodes the picture that [`run`](Self::run) then looks at; returns the milliseconds that this took.
    ///
    /// # Errors
    /// [`EvalError`] when it cannot be decoded.
    pub(super) fn decode(&mut self, encoded: &EncodedPicture) -> Result<f64, EvalError> {
        let start = Instant::now();
        // The buffer of the last picture is reused, unless a model still holds it.
        let mut picture = Arc::try_unwrap(std::mem::take(&mut self.picture)).unwrap_or_default();
        let screen = self.screen.as_ref().map(ScreenHandle::input_format);
        let target = decoding_target(self.detector.preparation().format(), screen, encoded.size);
        decode(
            encoded,
            &self.limits,
            PixelLayout::Rgb8,
            Some(target),
            &mut picture,
        )
        .map_err(EvalError::new)?;
        self.picture = Arc::new(picture);
        Ok(milliseconds(start))
    }

    /// Runs the models on the picture that was decoded last.
    ///
    /// # Errors
    /// [`EvalError`] when the detector fails on it.
    pub(super) fn run(&mut self) -> Result<ModelResults, EvalError> {
        let mut times = StepTimes::default();
        let start = Instant::now();
        let run = self.detector.detect(CAMERA, Arc::clone(&self.picture));
        let found = self
            .runtime
            .block_on(run)
            .map_err(|error| EvalError::new(format!("the detector failed: {error}")))?
            .output;
        times.detector = milliseconds(start);

        let mut empty = None;
        if let Some(screen) = &self.screen {
            let start = Instant::now();
            let run = screen.ask(CAMERA, Arc::clone(&self.picture));
            empty = self.runtime.block_on(run).ok().map(|verdict| verdict.empty);
            times.screen = milliseconds(start);
        }
        let mut unmapped = Vec::new();
        let mut detections = Vec::with_capacity(found.detections.len());
        for detection in found.detections {
            let number = usize::from(detection.class.0);
            match self.classes.get(number).copied().flatten() {
                Some(class) => detections.push(Detection { class, ..detection }),
                None => {
                    let name = self.detector.class_names().get(number);
                    unmapped.push(name.cloned().unwrap_or_else(|| format!("class {number}")));
                }
            }
        }
        Ok(ModelResults {
            detections,
            unmapped,
            empty,
            times,
        })
    }

    /// Decodes the picture to grey in the size that `need` names.
    ///
    /// # Errors
    /// When it cannot be decoded or is too small to be halved.
    pub(super) fn grey(
        &self,
        encoded: &EncodedPicture,
        need: Need,
    ) -> Result<TimedGrey, EvalError> {
        let start = Instant::now();
        let mut grey = Picture::default();
        let decoded = match need {
            Need::SmallGreyPicture { width } => {
                decode_small_grey(encoded, &self.limits, width, &mut grey)
            }
            _ => decode_grey_half(encoded, &self.limits, &mut grey),
        };
        decoded.map_err(EvalError::new)?;
        grey.pixels.shrink_to_fit();
        Ok(TimedGrey {
            picture: grey,
            milliseconds: milliseconds(start),
        })
    }
}

/// The numbers of the classes `names` in the evaluation.
fn numbers(evaluated: &Evaluated, names: &[String]) -> Vec<Option<ClassId>> {
    names.iter().map(|name| evaluated.find(name).ok()).collect()
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
