//! The real detector: session and head, one after the other on the task's thread, for one picture or several
//! of the same run.

use super::classes::Classes;
use super::head::{
    self, Candidate, Head, Suppression, TensorView, Unrecognised, keep_best, suppress,
};
use super::model::Interrupter;
use super::{
    DetectorConfig, ExecutionProvider, Found, HeadName, Model, OnnxSession, PictureInput,
    Preparation, PreparedPicture, RunError, SessionSettings, Signature, StartError, TensorSpec,
    class_names, shape_text,
};
use crate::detection::Detection;
use crate::frame::{InputFormat, InputMapping, Picture};
use crate::geometry::Corners;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// What was found in the model's output and not reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HeadCounts {
    /// Rows with numbers that are not finite or not possible.
    pub rejected: u64,
    /// Boxes outside the picture.
    pub outside: u64,
    /// Boxes of a class whose number the model has no name for.
    pub unknown_class: u64,
    /// Boxes beyond [`MOST_CANDIDATES`](super::head::MOST_CANDIDATES) or the configured most detections; at
    /// least one a frame where there were any.
    pub over_limit: u64,
}

/// The same while it is being counted; outlives the session.
#[derive(Debug, Default)]
pub(super) struct HeadCounters {
    rejected: AtomicU64,
    outside: AtomicU64,
    unknown_class: AtomicU64,
    over_limit: AtomicU64,
}

impl HeadCounters {
    pub(super) fn counts(&self) -> HeadCounts {
        HeadCounts {
            rejected: self.rejected.load(Ordering::Relaxed),
            outside: self.outside.load(Ordering::Relaxed),
            unknown_class: self.unknown_class.load(Ordering::Relaxed),
            over_limit: self.over_limit.load(Ordering::Relaxed),
        }
    }

    fn add(&self, counts: HeadCounts) {
        self.rejected.fetch_add(counts.rejected, Ordering::Relaxed);
        self.outside.fetch_add(counts.outside, Ordering::Relaxed);
        self.unknown_class
            .fetch_add(counts.unknown_class, Ordering::Relaxed);
        self.over_limit
            .fetch_add(counts.over_limit, Ordering::Relaxed);
    }
}

/// A model with all that belongs to it, on the caller's thread: from pictures to detections.
/// [`DetectorHandle`](super::DetectorHandle) is the same for a service, with a queue and supervision.
pub struct Network {
    session: OnnxSession,
    preparation: Preparation,
    reader: Reader,
}

/// Makes detections of the model's output.
struct Reader {
    head: Box<dyn Head>,
    confidence: f64,
    suppression: Suppression,
    classes: Classes,
    candidates: Vec<Candidate>,
    counters: Arc<HeadCounters>,
}

impl Network {
    /// Loads the model, finds and binds its head, and runs it once, so that the first picture is not the slow
    /// one.
    ///
    /// # Errors
    /// When the library, the model, its head or the execution provider is not as configured.
    pub fn open(config: &DetectorConfig) -> Result<Self, StartError> {
        config.check()?;
        Self::open_counting(config, Arc::default())
    }

    pub(super) fn open_counting(
        config: &DetectorConfig,
        counters: Arc<HeadCounters>,
    ) -> Result<Self, StartError> {
        let session = OnnxSession::open(&SessionSettings {
            model: config.model.clone(),
            providers: config.providers.clone(),
            may_fall_back: config.may_fall_back,
            gpu: config.gpu.clone(),
            threads: config.threads,
            onnxruntime: config.onnxruntime.clone(),
        })?;
        check_batch(config, session.signature())?;
        let head = head_for(config, session.signature())?;
        let names = class_names::read(
            config.class_names.as_ref(),
            &session.signature().metadata,
            head.as_ref(),
        )?;
        let classes = Classes::new(&names, config)?;
        let mut network = Self {
            session,
            preparation: Preparation::new(head.input_format()),
            reader: Reader {
                head,
                confidence: config.confidence,
                suppression: Suppression {
                    overlap: config.suppression_overlap,
                    per_class: config.suppression_per_class,
                    most: config.most_detections,
                },
                classes,
                candidates: Vec::new(),
                counters: Arc::default(),
            },
        };
        network
            .warm_up(config.batch_size)
            .map_err(|reason| StartError::WarmUp {
                path: config.model.clone(),
                reason,
            })?;
        // Counting begins with the first picture.
        network.reader.counters = counters;
        Ok(network)
    }

    /// Runs the model on a black picture, and on a full batch of them: the slow first runs, in which memory is
    /// laid out and an engine built, are over then.
    fn warm_up(&mut self, batch_size: usize) -> Result<(), String> {
        let black = Picture::black(self.input_format().size);
        let mut pictures = Vec::new();
        for _ in 0..batch_size.max(1) {
            let prepared = self.preparation.prepare(&black);
            pictures.push(prepared.map_err(|error| error.to_string())?);
        }
        self.run(&pictures[..1])
            .map_err(|RunError(reason)| reason)?;
        if batch_size > 1 {
            self.run(&pictures).map_err(|RunError(reason)| {
                format!("{reason} (with detector.batch_size = {batch_size})")
            })?;
        }
        Ok(())
    }

    /// Finds the objects in one picture.
    ///
    /// # Errors
    /// When the run failed.
    pub fn detect(&mut self, picture: &PreparedPicture) -> Result<Found, RunError> {
        let found = self.run(std::slice::from_ref(picture))?.pop();
        found.ok_or_else(|| RunError("the model gave no answer".to_owned()))
    }

    /// Where pictures become the model's input.
    pub fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// The names of the reported classes, by the number they are reported under.
    pub fn class_names(&self) -> &[String] {
        &self.reader.classes.reported
    }

    /// The head that reads the model's output.
    pub fn head(&self) -> HeadName {
        self.reader.head.name()
    }

    /// What the model wants to see.
    pub fn input_format(&self) -> InputFormat {
        self.preparation.format()
    }

    /// Names, types and shapes of the model's inputs and outputs, and its metadata.
    pub fn signature(&self) -> &Signature {
        self.session.signature()
    }

    /// What was found in the model's output and not reported.
    pub fn counts(&self) -> HeadCounts {
        self.reader.counters.counts()
    }
}

impl Reader {
    /// What is found in the output for one picture.
    fn read(
        &mut self,
        outputs: &[TensorView<'_>],
        mapping: InputMapping,
    ) -> Result<Vec<Detection>, RunError> {
        self.candidates.clear();
        let rejected = self
            .head
            .read(outputs, self.confidence, &mut self.candidates)
            .map_err(RunError)?;
        self.counters
            .rejected
            .fetch_add(rejected, Ordering::Relaxed);
        Ok(self.detections(mapping))
    }

    /// The candidates that stay, as detections in the source picture.
    fn detections(&mut self, mapping: InputMapping) -> Vec<Detection> {
        let mut counts = HeadCounts::default();
        let classes = &self.classes;
        self.candidates.retain_mut(|candidate| {
            let Some(reported) = classes.reported_as(candidate.class) else {
                counts.unknown_class += 1;
                return false;
            };
            if let Some(class) = reported {
                candidate.class = class;
            }
            reported.is_some()
        });
        counts.over_limit = if self.head.overlaps() {
            suppress(&mut self.candidates, self.suppression)
        } else {
            keep_best(&mut self.candidates, self.suppression.most)
        };
        let detections: Vec<_> = self
            .candidates
            .iter()
            .filter_map(|candidate| detection(candidate, mapping))
            .collect();
        counts.outside = (self.candidates.len() - detections.len()) as u64;
        self.counters.add(counts);
        detections
    }
}

/// Whether the model takes as many pictures at once as are configured.
fn check_batch(config: &DetectorConfig, signature: &Signature) -> Result<(), StartError> {
    let is_open = |input: &TensorSpec| input.shape.first() == Some(&-1);
    if config.batch_size == 1 || signature.inputs.iter().all(is_open) {
        return Ok(());
    }
    Err(StartError::Configuration {
        key: "detector.batch_size".to_owned(),
        reason: format!(
            "is {}, and {} takes one picture at a time ({signature}); export it with an open batch (Ultralytics: \
             dynamic=True), or leave batch_size at 1",
            config.batch_size,
            config.model.display()
        ),
    })
}

/// The outputs of a run of `pictures`, one list for each picture, in which every output has a batch of 1.
fn of_each<'a>(
    outputs: &[TensorView<'a>],
    shapes: &'a [Vec<i64>],
    pictures: usize,
) -> Vec<Vec<TensorView<'a>>> {
    (0..pictures)
        .map(|picture| {
            let of_one = outputs.iter().zip(shapes).map(|(output, shape)| {
                let length = output.values.len() / pictures;
                TensorView {
                    shape,
                    values: &output.values[picture * length..][..length],
                }
            });
            of_one.collect()
        })
        .collect()
}

/// The shapes of the outputs' parts for one picture of `pictures`.
///
/// # Errors
/// When an output has another number of parts, in words.
fn shapes_of_one(outputs: &[TensorView<'_>], pictures: usize) -> Result<Vec<Vec<i64>>, String> {
    let shape_of_one = |output: &TensorView<'_>| match output.shape {
        [batch, rest @ ..] if usize::try_from(*batch) == Ok(pictures) => Ok([&[1], rest].concat()),
        shape => Err(format!(
            "the model gave an output of {} for {pictures} pictures",
            shape_text(shape)
        )),
    };
    outputs.iter().map(shape_of_one).collect()
}

/// The head for a model: the configured one, or the one it is recognised to need.
fn head_for(config: &DetectorConfig, signature: &Signature) -> Result<Box<dyn Head>, StartError> {
    let does_not_fit =
        |name: HeadName, expected: String, reason: String| StartError::ModelDoesNotFit {
            path: config.model.clone(),
            head: name.as_str(),
            model: signature.to_string(),
            expected,
            reason,
        };
    let input: PictureInput = signature
        .picture_input(config.input_size())
        .map_err(|reason| {
            let expected = "one picture input [1, 3, rows, columns] or [1, rows, columns, 3]";
            does_not_fit(config.head, expected.to_owned(), reason)
        })?;
    let name =
        match config.head {
            HeadName::Auto => head::recognise(signature, input).map_err(
                |Unrecognised { reason, looked_for }| StartError::ModelNotRecognised {
                    path: config.model.clone(),
                    reason,
                    model: signature.to_string(),
                    looked_for,
                },
            )?,
            name => name,
        };
    head::bind(name, signature, input)
        .map_err(|misfit| does_not_fit(name, misfit.expected, misfit.reason))
}

/// The candidate clipped to the source picture; `None` when nothing of it is inside.
fn detection(candidate: &Candidate, mapping: InputMapping) -> Option<Detection> {
    let corners = mapping.to_source(candidate.corners).corners();
    let clipped = Corners {
        x1: corners.x1.clamp(0.0, 1.0),
        y1: corners.y1.clamp(0.0, 1.0),
        x2: corners.x2.clamp(0.0, 1.0),
        y2: corners.y2.clamp(0.0, 1.0),
    };
    (clipped.area() > 0.0).then(|| Detection {
        bounding_box: clipped.normalise(crate::geometry::PictureSize::new(1, 1)),
        class: candidate.class,
        confidence: f64::from(candidate.confidence),
    })
}

impl Model for Network {
    type Input = PreparedPicture;
    type Output = Found;
    /// The class names, whose numbers are in use, and the input that pictures are prepared for.
    type Facts = (Vec<String>, InputFormat);

    fn facts(&self) -> Self::Facts {
        (self.class_names().to_vec(), self.input_format())
    }

    fn run(&mut self, pictures: &[PreparedPicture]) -> Result<Vec<Found>, RunError> {
        let Self {
            session,
            preparation,
            reader,
        } = self;
        let started = Instant::now();
        let inputs: Vec<_> = pictures.iter().map(PreparedPicture::values).collect();
        session.run(preparation.format().shape(), &inputs, |outputs| {
            let model = started.elapsed();
            let shapes = shapes_of_one(outputs, pictures.len()).map_err(RunError)?;
            let parts = of_each(outputs, &shapes, pictures.len());
            let read = |(picture, outputs): (&PreparedPicture, Vec<TensorView<'_>>)| {
                let start = Instant::now();
                Ok(Found {
                    detections: reader.read(&outputs, picture.mapping())?,
                    letterbox: picture.took(),
                    model,
                    head: start.elapsed(),
                })
            };
            pictures.iter().zip(parts).map(read).collect()
        })?
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }

    fn interrupter(&self) -> Option<Interrupter> {
        Some(self.session.interrupter())
    }
}
