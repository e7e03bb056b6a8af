//! The real detector: runs the session and then the head on the worker's thread, for one picture or all of a run.

use super::classes::Classes;
use super::head::{self, Head, TensorView};
use super::reader::{HeadCounts, Parts, Reader};
use super::{
    DetectorConfig, ExecutionProvider, HeadName, InferenceError, OnnxSession, Preparation,
    PreparedPicture, Signature, StartError, TensorSpec, class_names,
};
use crate::picture::{InputFormat, Picture};
use crate::worker::{Model, WorkerMeter};
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
        Self::open_counting(config, WorkerMeter::default())
    }

    pub(super) fn open_counting(
        config: &DetectorConfig,
        meter: WorkerMeter,
    ) -> Result<Self, StartError> {
        let session = OnnxSession::open(config)?;
        check_batch(config, session.signature())?;
        let head = head_for(config, session.signature())?;
        let names = class_names::read(
            config.class_names.as_ref(),
            &session.signature().metadata,
            head.name,
            head.classes,
        )?;
        let classes = Classes::new(&names, config)?;
        let mut network = Self {
            session,
            preparation: Preparation::new(head.input_format),
            reader: Reader::new(head, classes, config),
            impossible_runs: 0,
        };
        network
            .warm_up(config.batch_size)
            .map_err(|reason| StartError::first_run(&config.model, reason))?;
        // Counting begins with the first picture.
        network.reader.meter = meter;
        network.impossible_runs = 0;
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
    pub fn detect(&mut self, picture: &PreparedPicture) -> Result<Found, InferenceError> {
        let found = self.run(std::slice::from_ref(picture))?.pop();
        found.ok_or_else(|| InferenceError::Failed("the model returned no answer".to_owned()))
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
        self.reader.meter.read().head
    }
}

/// Checks that the model accepts as many pictures at once as configured.
fn check_batch(config: &DetectorConfig, signature: &Signature) -> Result<(), StartError> {
    let is_open = |input: &TensorSpec| input.shape.first() == Some(&-1);
    if config.batch_size == 1 || signature.inputs.iter().all(is_open) {
        return Ok(());
    }
    Err(StartError(format!(
        "detector.batch_size: is {}, and {} takes one picture at a time ({signature}); export it with an open batch \
         (Ultralytics: dynamic=True), or leave batch_size at 1",
        config.batch_size,
        config.model.display()
    )))
}

/// The head for a model: the configured one, or the recognised one.
fn head_for(config: &DetectorConfig, signature: &Signature) -> Result<Head, StartError> {
    let does_not_fit = |name: HeadName, expected: &str, reason: String| {
        let head = (name.as_str(), expected);
        StartError::does_not_fit(&config.model, signature, head, reason)
    };
    let input = signature.picture_input(config.input_size());
    let input = input.map_err(|reason| {
        let expected = "one picture input [1, 3, rows, columns] or [1, rows, columns, 3]";
        does_not_fit(config.head, expected, reason)
    })?;
    let not_recognised = |reason: String| {
        StartError(format!(
            "the model {} is not recognised: {reason}. The model has {signature}. If you know how to read it, set \
             detector.head",
            config.model.display()
        ))
    };
    let name = match config.head {
        HeadName::Auto => head::recognise(signature, input).map_err(not_recognised)?,
        name => name,
    };
    head::bind(name, signature, input)
        .map_err(|reason| does_not_fit(name, name.looks_for(), reason))
}

impl Model for DetectorNetwork {
    type Input = PreparedPicture;
    type Output = Found;
    /// The class names, whose numbers are in use, and the input that pictures are prepared for.
    type Facts = (Vec<String>, InputFormat);

    fn facts(&self) -> Self::Facts {
        (self.class_names().to_vec(), self.input_format())
    }

    fn run(&mut self, pictures: &[PreparedPicture]) -> Result<Vec<Found>, InferenceError> {
        let Self {
            session,
            preparation,
            reader,
            ..
        } = self;
        let started = Instant::now();
        let inputs: Vec<_> = pictures.iter().map(PreparedPicture::values).collect();
        let mut impossible = 0;
        let found = session.run(preparation.format().shape(), &inputs, |outputs| {
            let model = started.elapsed();
            let mut read = |picture: &PreparedPicture, outputs: &[TensorView<'_>]| {
                let start = Instant::now();
                let read = reader.read(outputs, picture.mapping())?;
                impossible += usize::from(read.is_impossible);
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
        })??;
        self.impossible_runs = match impossible == pictures.len() {
            true => self.impossible_runs.saturating_add(1),
            false => 0,
        };
        if self.impossible_runs >= IMPOSSIBLE_RUNS {
            return Err(InferenceError::Implausible(format!(
                "everything that the model finds is impossible (numbers that are not finite, boxes without an area or \
                 outside of the picture), {IMPOSSIBLE_RUNS} runs in a row or more: export it again, without half \
                 precision if it has that"
            )));
        }
        Ok(found)
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }
}
