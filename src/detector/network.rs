//! The real detector: letterbox, session, head, one after the other on the task's thread.

use super::head::{Candidate, Head, suppress};
use super::model::Interrupter;
use super::{
    CameraSlot, DetectorConfig, ExecutionProvider, Found, Model, ModelError, OnnxSession,
    SessionSettings, StartError, class_names,
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
    /// Rows with numbers that are not finite or not possible, and boxes outside the picture.
    pub rejected: u64,
    /// Candidates beyond [`MOST_CANDIDATES`](super::head::MOST_CANDIDATES).
    pub over_limit: u64,
}

/// The same while it is being counted; outlives the session.
#[derive(Debug, Default)]
pub(super) struct HeadCounters {
    rejected: AtomicU64,
    over_limit: AtomicU64,
}

impl HeadCounters {
    pub(super) fn counts(&self) -> HeadCounts {
        HeadCounts {
            rejected: self.rejected.load(Ordering::Relaxed),
            over_limit: self.over_limit.load(Ordering::Relaxed),
        }
    }
}

pub(super) struct Network {
    session: OnnxSession,
    letterbox: Letterbox,
    format: InputFormat,
    head: Head,
    confidence: f64,
    suppression_overlap: f64,
    /// For each class, whether it is reported.
    reported: Vec<bool>,
    candidates: Vec<Candidate>,
    counters: Arc<HeadCounters>,
}

impl Network {
    /// Loads the model, binds its head and runs it once, so that the first picture is not the slow one.
    pub(super) fn open(
        config: &DetectorConfig,
        class_names: &[String],
        counters: Arc<HeadCounters>,
    ) -> Result<Self, StartError> {
        let reported = class_names::reported(class_names, &config.report_classes)?;
        let session = OnnxSession::open(&SessionSettings {
            model: config.model.clone(),
            providers: config.providers.clone(),
            may_fall_back: config.may_fall_back,
            threads: config.threads,
            onnxruntime: config.onnxruntime.clone(),
        })?;
        let signature = session.signature();
        let head = Head::bind(config.head, signature, class_names.len()).map_err(|misfit| {
            StartError::ModelDoesNotFit {
                path: config.model.clone(),
                head: config.head.as_str(),
                model: signature.to_string(),
                expected: misfit.expected,
                reason: misfit.reason,
            }
        })?;
        let format = head.input_format();
        let mut network = Self {
            session,
            letterbox: Letterbox::new(format),
            format,
            head,
            confidence: config.confidence,
            suppression_overlap: config.suppression_overlap,
            reported,
            candidates: Vec::new(),
            counters,
        };
        network.infer().map_err(|error| StartError::WarmUp {
            path: config.model.clone(),
            reason: error.0,
        })?;
        network.candidates.clear();
        Ok(network)
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
        session.run(format.size, letterbox.tensor(), |outputs| {
            let model_ended = Instant::now();
            let rejected = head
                .read(outputs, *confidence, candidates)
                .map_err(ModelError)?;
            counters.rejected.fetch_add(rejected, Ordering::Relaxed);
            Ok(model_ended)
        })?
    }

    /// The candidates that stay, as detections in the source picture.
    fn detections(&mut self, mapping: InputMapping) -> Vec<Detection> {
        let over_limit = suppress(&mut self.candidates, self.suppression_overlap);
        let mut outside = 0;
        let mut detections = Vec::with_capacity(self.candidates.len());
        for candidate in &self.candidates {
            if !self.reported[usize::from(candidate.class.0)] {
                continue;
            }
            match detection(candidate, mapping) {
                Some(detection) => detections.push(detection),
                None => outside += 1,
            }
        }
        self.counters.rejected.fetch_add(outside, Ordering::Relaxed);
        self.counters
            .over_limit
            .fetch_add(over_limit, Ordering::Relaxed);
        detections
    }
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
            .map_err(|error| ModelError(error.to_string()))?;
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
