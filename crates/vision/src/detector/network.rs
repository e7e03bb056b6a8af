//! A detector network: ONNX Runtime session, preparation, head and class names, all on the caller's thread.

use super::classes::Classes;
use super::head::{self, Evidence, Head};
use super::reader::{Parts, Reader};
use super::{DetectorConfig, HeadCounts, HeadMeter, HeadName, HeadSetting, Preparation};
use super::{PreparedPicture, class_names};
use crate::onnx::{ExecutionProvider, OnnxSession, PictureInput, Signature};
use crate::onnx::{StartError, StartErrorKind, TensorSpec, TensorView};
use crate::picture::{ColorOrder, Fit, InputFormat, Picture, ValueRange};
use crate::worker::{Model, RunError};
use albireo_core::detection::Detection;
use std::time::{Duration, Instant};

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
    reader: Reader,
    /// The number of consecutive runs with only impossible results.
    impossible_runs: u32,
    /// What the last of these showed, if it showed that another head is needed.
    doubt: Option<String>,
}

/// This many consecutive runs with only impossible results are a fault of the model.
const IMPOSSIBLE_RUNS: u32 = 5;

/// Scores of a real run are above it, and unused rows are 0.
const LEAST_SCORE: f64 = 1e-4;

impl DetectorNetwork {
    /// Loads the model, finds and binds its head, and runs it once, so that the first picture is not slow.
    ///
    /// # Errors
    /// If the library, the model, its head or the execution provider is not as configured.
    pub fn open(config: &DetectorConfig) -> Result<Self, StartError> {
        config.check()?;
        Self::open_counting(config, HeadMeter::default())
    }

    pub(super) fn open_counting(
        config: &DetectorConfig,
        meter: HeadMeter,
    ) -> Result<Self, StartError> {
        let mut session = OnnxSession::open(&config.session_settings())?;
        check_batch(config, session.signature())?;
        let head = head_for(config, &mut session)?;
        let names = class_names::read(
            config.class_names.as_ref(),
            &session.signature().metadata,
            &head,
        )?;
        let classes = Classes::new(&names, config)?;
        let mut network = Self {
            session,
            preparation: Preparation::new(head.input_format),
            reader: Reader::new(head, classes, config),
            impossible_runs: 0,
            doubt: None,
        };
        network
            .warm_up(config.batch_size)
            .map_err(|reason| StartError::first_run(&config.model, reason))?;
        // Counting begins with the first picture.
        network.reader.meter = meter;
        network.impossible_runs = 0;
        network.doubt = None;
        Ok(network)
    }

    /// Runs the model on a black picture, then on a full batch of them, to get over the slow first runs, in which
    /// memory is laid out and an engine is built.
    fn warm_up(&mut self, batch_size: usize) -> Result<(), String> {
        // `self.preparation` would keep these buffers, and a batch of them may be large.
        let preparation = Preparation::new(self.input_format());
        let black = Picture::black(self.input_format().size);
        let mut pictures = Vec::new();
        for _ in 0..batch_size.max(1) {
            let prepared = preparation.prepare(&black);
            pictures.push(prepared.map_err(|error| error.to_string())?);
        }
        self.run(&pictures[..1]).map_err(|error| error.to_string())?;
        if batch_size > 1 {
            self.run(&pictures)
                .map_err(|error| format!("{error} (with detector.batch_size = {batch_size})"))?;
        }
        Ok(())
    }

    /// Finds the objects in one picture.
    ///
    /// # Errors
    /// If the run failed.
    pub fn detect(&mut self, picture: &PreparedPicture) -> Result<Found, RunError> {
        let found = self.run(std::slice::from_ref(picture))?.pop();
        found.ok_or_else(|| RunError::Failed("the model returned no answer".to_owned()))
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
        self.reader.head.name
    }

    /// The names of the model's classes that are not reported.
    pub fn left_out(&self) -> &[String] {
        &self.reader.classes.left_out
    }

    /// What the last pictures showed if nothing in them was possible and another head is needed.
    pub fn doubt(&self) -> Option<&str> {
        self.doubt.as_deref()
    }

    /// The head, the input and the classes, in one line.
    pub fn description(&self) -> String {
        let InputFormat {
            size,
            fit,
            color_order,
            value_range,
            ..
        } = self.input_format();
        format!(
            "head {}, input {size} ({}, {}, {})",
            self.head().as_str(),
            fit.as_str(),
            color_order.as_str(),
            value_range.as_str(),
        )
    }

    /// The execution provider that runs the model: not the first configured one if that does not work and a fallback is
    /// allowed.
    pub fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }

    /// The input that the model expects.
    pub fn input_format(&self) -> InputFormat {
        self.preparation.format()
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

/// Checks that the model accepts and returns as many pictures at once as configured.
fn check_batch(config: &DetectorConfig, signature: &Signature) -> Result<(), StartError> {
    let is_open = |tensor: &TensorSpec| tensor.shape.first() == Some(&-1);
    // An output of rows has those of all pictures one after another.
    let is_split = |output: &TensorSpec| {
        output.shape.len() > 2 || output.name == "labels" || output.name == "scores"
    };
    if config.batch_size == 1
        || signature.inputs.iter().all(is_open) && signature.outputs.iter().all(is_split)
    {
        return Ok(());
    }
    Err(StartError::configuration(
        "detector.batch_size",
        format_args!(
            "is {}, and {} takes one picture at a time ({signature}); export it with an open batch (Ultralytics: \
             dynamic=True), or leave batch_size at 1",
            config.batch_size,
            config.model.display()
        ),
    ))
}

/// The head for a model: the configured one, or the recognised one.
fn head_for(config: &DetectorConfig, session: &mut OnnxSession) -> Result<Head, StartError> {
    let signature = session.signature().clone();
    let name = config.head.name();
    let not_recognised = |reason: String| {
        StartError::new(
            StartErrorKind::DoesNotFit,
            format_args!(
                "the model {} is not recognised: {reason}\n  The model has {signature}.\n  If you know how to read it, \
                 set detector.head",
                config.model.display()
            ),
        )
    };
    let does_not_fit = |reason: String| match name {
        HeadName::Auto => not_recognised(reason),
        name => {
            let head = (name.as_str(), name.looks_for());
            StartError::does_not_fit(&config.model, &signature, head, reason)
        }
    };
    let names = class_names::count(config.class_names.as_ref(), &signature.metadata);
    if signature.lacks_size(config.input_size()) {
        // A model that no head reads is not asked for its size first.
        let any = signature.picture_input(Some(ANY_SIZE)).map_err(&does_not_fit)?;
        if name == HeadName::Auto {
            head::recognise(&signature, any, names).map_err(|reason| {
                not_recognised(format!(
                    "{reason}\n  Its input size is open as well: set detector.input_size, for example [640, 640]"
                ))
            })?;
        }
        return Err(StartError::configuration(
            "detector.input_size",
            format_args!(
                "the input size of {} is open: set it to the columns and rows that the model was trained with, for \
                 example [640, 640]",
                config.model.display()
            ),
        ));
    }
    let input = signature.picture_input(config.input_size()).map_err(&does_not_fit)?;
    let setting = match name {
        HeadName::Auto => {
            let found = head::recognise(&signature, input, names).map_err(&not_recognised)?;
            let name = match found.only() {
                Some(name) => name,
                None => look_at_black(session, input, |outputs| {
                    found.by_values(&signature, outputs)
                })
                .map_err(|reason| StartError::first_run(&config.model, reason))?
                .map_err(&not_recognised)?,
            };
            HeadSetting::Named(name)
        }
        _ => config.head.clone(),
    };
    let bound =
        head::bind(&setting, &signature, input, config.overrides()).map_err(&does_not_fit)?;
    let evidence = look_at_black(session, input, |outputs| {
        bound.evidence(outputs, LEAST_SCORE)
    });
    match evidence.map_err(|reason| StartError::first_run(&config.model, reason))? {
        Evidence::Against(reason) => Err(does_not_fit(format!(
            "its shapes are those of the head `{}`, but {reason}. If you know the columns of its output, list them: \
             detector.head = {{ columns = \"x1 y1 x2 y2 score class\" }}",
            setting.name().as_str()
        ))),
        Evidence::For | Evidence::None => Ok(bound),
    }
}

/// A size to try heads with while that of the input is open.
const ANY_SIZE: albireo_core::geometry::PictureSize =
    albireo_core::geometry::PictureSize::new(640, 640);

/// Runs the model on zeros, which are black in most ranges, and shows the outputs.
fn look_at_black<R>(
    session: &mut OnnxSession,
    input: PictureInput,
    look: impl FnOnce(&[TensorView<'_>]) -> R,
) -> Result<R, String> {
    let format = input.format(Fit::Stretch, ColorOrder::Rgb, ValueRange::To255);
    let pixels = 3 * usize::try_from(format.size.pixels()).unwrap_or_default();
    session.run(format.shape(), format.size, &[&vec![0.0; pixels]], look)
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
    pub input: InputFormat,
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
            input: self.input_format(),
            description: self.description(),
        }
    }

    fn run(&mut self, pictures: &[PreparedPicture]) -> Result<Vec<Found>, RunError> {
        let Self {
            session,
            preparation,
            reader,
            ..
        } = self;
        let started = Instant::now();
        let inputs: Vec<_> = pictures.iter().map(PreparedPicture::values).collect();
        let mut impossible = 0;
        let mut doubt = None;
        let format = preparation.format();
        let found = session.run(format.shape(), format.size, &inputs, |outputs| {
            let model = started.elapsed();
            let mut read = |picture: &PreparedPicture, outputs: &[TensorView<'_>]| {
                let start = Instant::now();
                let read = reader.read(outputs, picture.mapping())?;
                impossible += usize::from(read.is_impossible);
                doubt = doubt.take().or(read.doubt);
                Ok(Found {
                    detections: read.detections,
                    letterbox: picture.took(),
                    model,
                    head: start.elapsed(),
                })
            };
            if let [picture] = pictures {
                return Ok(vec![read(picture, outputs)?]);
            }
            let parts = Parts::of(outputs, pictures.len())?;
            let each = pictures.iter().enumerate();
            each.map(|(number, picture)| read(picture, &parts.get(outputs, number)))
                .collect()
        });
        let found = found.map_err(RunError::Failed)??;
        if impossible < pictures.len() {
            self.impossible_runs = 0;
            self.doubt = None;
            return Ok(found);
        }
        self.impossible_runs = self.impossible_runs.saturating_add(1);
        self.doubt = doubt;
        if self.impossible_runs >= IMPOSSIBLE_RUNS {
            let cause = match &self.doubt {
                Some(reason) => format!(
                    "{reason}: it is not a model of the head `{}`; set detector.head to another, or to the columns of \
                     its output, {{ columns = \"x1 y1 x2 y2 score class\" }}",
                    self.head().as_str()
                ),
                None => "export it again, without half precision if it has that".to_owned(),
            };
            return Err(RunError::Implausible(format!(
                "everything that the model finds is impossible (numbers that are not finite, boxes without an area, \
                 outside of the picture or much larger than it), {IMPOSSIBLE_RUNS} runs in a row or more: {cause}"
            )));
        }
        Ok(found)
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }
}
