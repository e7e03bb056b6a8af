//! The real detector: letterbox, session, head, one after the other on the task's thread.

use super::classes::Classes;
use super::head::{self, Candidate, Head, Suppression, Unrecognised, keep_best, suppress};
use super::model::Interrupter;
use super::{
    CameraSlot, DetectorConfig, ExecutionProvider, Found, HeadName, Model, ModelError, OnnxSession,
    PictureInput, SessionSettings, Signature, StartError, class_names,
};
use crate::detection::Detection;
use crate::frame::{InputFormat, InputMapping, Letterbox, Picture};
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

/// A model with all that belongs to it, on the caller's thread: from a picture to detections.
/// [`DetectorHandle`](super::DetectorHandle) is the same for a service, with a queue and supervision.
pub struct Network {
    session: OnnxSession,
    letterbox: Letterbox,
    format: InputFormat,
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
        let head = head_for(config, session.signature())?;
        let names = class_names::read(
            config.class_names.as_ref(),
            &session.signature().metadata,
            head.as_ref(),
        )?;
        let classes = Classes::new(&names, config)?;
        let format = head.input_format();
        let mut network = Self {
            session,
            letterbox: Letterbox::new(format),
            format,
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
        };
        network.infer().map_err(|error| StartError::WarmUp {
            path: config.model.clone(),
            reason: error.to_string(),
        })?;
        // Counting begins with the first picture.
        Ok(Self {
            counters,
            ..network
        })
    }

    /// The names of the reported classes, by the number they are reported under.
    pub fn class_names(&self) -> &[String] {
        &self.classes.reported
    }

    /// The head that reads the model's output.
    pub fn head(&self) -> HeadName {
        self.head.name()
    }

    /// What the model wants to see.
    pub fn input_format(&self) -> InputFormat {
        self.format
    }

    /// What the model was given last, before any conversion to its element type.
    pub fn input(&self) -> &[f32] {
        self.letterbox.tensor()
    }

    /// Names, types and shapes of the model's inputs and outputs, and its metadata.
    pub fn signature(&self) -> &Signature {
        self.session.signature()
    }

    /// What was found in the model's output and not reported.
    pub fn counts(&self) -> HeadCounts {
        self.counters.counts()
    }

    /// Runs the model on what is in the letterbox and reads its output; returns when the model had ended.
    fn infer(&mut self) -> Result<Instant, ModelError> {
        let Self {
            session,
            letterbox,
            format,
            head,
            confidence,
            candidates,
            counters,
            ..
        } = self;
        candidates.clear();
        session.run(format.shape(), letterbox.tensor(), |outputs| {
            let model_ended = Instant::now();
            let rejected = head
                .read(outputs, *confidence, candidates)
                .map_err(ModelError::Run)?;
            counters.rejected.fetch_add(rejected, Ordering::Relaxed);
            Ok(model_ended)
        })?
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
    type Output = Found;

    fn run(&mut self, _camera: CameraSlot, picture: &Picture) -> Result<Found, ModelError> {
        let started = Instant::now();
        let mapping = self
            .letterbox
            .fill(picture)
            .map_err(|error| ModelError::Picture(error.to_string()))?;
        let letterboxed = Instant::now();
        let model_ended = self.infer()?;
        let detections = self.detections(mapping);
        Ok(Found {
            detections,
            letterbox: letterboxed - started,
            model: model_ended - letterboxed,
            head: model_ended.elapsed(),
        })
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }

    fn interrupter(&self) -> Option<Interrupter> {
        Some(self.session.interrupter())
    }
}
