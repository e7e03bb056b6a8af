//! The events of a node.

use albireo_vision::detector::{ExecutionProvider, ModelStatus};
use albireo_wire::{ClipReport, CountersMessage, DetectionsMessage, Sighting, Threshold};
use serde::Serialize;
use std::sync::{Arc, OnceLock};

/// An event for many readers: its JSON is created once, for the first of them.
#[derive(Debug)]
pub struct Event {
    /// The content.
    pub news: News,
    json: OnceLock<String>,
}

impl Event {
    pub(crate) fn new(news: News) -> Arc<Self> {
        let json = OnceLock::new();
        Arc::new(Self { news, json })
    }

    /// The event as JSON.
    pub(crate) fn json(&self) -> &str {
        // News can always be serialised.
        let write = || serde_json::to_string(&self.news).unwrap_or_default();
        self.json.get_or_init(write)
    }
}

/// The content of an event. Serialised without the variant's name, which [`News::name`] returns.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum News {
    /// A frame was answered.
    Frame(FrameEvent),
    /// A pending frame got its final answer.
    Late(FrameEvent),
    /// A class appeared, or left.
    Sighting(Arc<Sighting>),
    /// A clip ended.
    Clip(Arc<ClipReport>),
    /// The counters of a camera, once per second.
    Counters(Arc<CountersMessage>),
    /// A threshold changed.
    Threshold(ThresholdEvent),
    /// The detector's status.
    Detector(DetectorEvent),
}

impl News {
    /// The names of all kinds, as returned by [`News::name`].
    pub(crate) const NAMES: [&'static str; 7] = [
        "frame",
        "late",
        "sighting",
        "clip",
        "counters",
        "threshold",
        "detector",
    ];

    /// The kind, as in the `event:` line of a server-sent event.
    pub(crate) const fn name(&self) -> &'static str {
        match self {
            Self::Frame(_) => "frame",
            Self::Late(_) => "late",
            Self::Sighting(_) => "sighting",
            Self::Clip(_) => "clip",
            Self::Counters(_) => "counters",
            Self::Threshold(_) => "threshold",
            Self::Detector(_) => "detector",
        }
    }

    /// The camera, if the event is about a single one.
    pub(crate) fn camera(&self) -> Option<&str> {
        match self {
            Self::Frame(event) | Self::Late(event) => Some(&event.camera),
            Self::Sighting(sighting) => Some(&sighting.camera),
            Self::Clip(report) => Some(&report.camera),
            Self::Counters(message) => Some(&message.camera),
            Self::Threshold(event) => Some(&event.camera),
            Self::Detector(_) => None,
        }
    }
}

/// A frame was answered: its detections message and its camera.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub struct FrameEvent {
    /// Camera.
    #[schema(value_type = String)]
    pub camera: Arc<str>,
    /// The message as published.
    #[serde(flatten)]
    #[schema(value_type = DetectionsMessage)]
    pub detections: Arc<DetectionsMessage>,
}

/// A threshold changed; it applies from the camera's next frame.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ThresholdEvent {
    /// Camera.
    #[schema(value_type = String)]
    pub camera: Arc<str>,
    /// The threshold now.
    pub threshold: Threshold,
}

/// The state of the detector.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub struct DetectorEvent {
    /// `starting`, `ready` or `degraded`.
    status: &'static str,
    /// Execution provider that runs it; absent while it starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    provider: Option<&'static str>,
    /// The reason, if degraded.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl DetectorEvent {
    pub(super) fn new(status: &ModelStatus) -> Self {
        Self {
            status: match status {
                ModelStatus::Starting => "starting",
                ModelStatus::Ready { .. } => "ready",
                _ => "degraded",
            },
            provider: provider(status),
            reason: status.fault().map(str::to_owned),
        }
    }
}

/// The provider in use, according to the status.
pub(crate) fn provider(status: &ModelStatus) -> Option<&'static str> {
    status.provider().map(ExecutionProvider::as_str)
}
