//! What happens on the node, as server-sent events (WHATWG HTML, section 9.2).

use super::RouteState;
use super::health::provider;
use crate::state::board::{Event, SharedEvent};
use albireo_service::clock::unix_nanoseconds;
use albireo_service::http::Problem;
use albireo_vision::detector::DetectorStatus;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::Stream;
use futures_util::stream;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio_util::sync::CancellationToken;
use utoipa::{IntoParams, ToSchema};

/// Event streams at a time: each holds a connection.
pub(super) const MOST_STREAMS: usize = 64;

/// Names of the events there are, beside those of [`Event`].
const DETECTOR: &str = "detector";
const LAGGED: &str = "lagged";

/// Which events.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// About this camera only. Events about the detector come all the same.
    camera: Option<String>,
    /// Names of the kinds wanted, separated by commas: `frame`, `late`, `clip`, `counters`, `threshold`,
    /// `detector`. All of them without it.
    types: Option<String>,
}

/// How the detector is doing.
#[derive(Serialize, ToSchema)]
pub(super) struct DetectorEvent {
    /// `starting`, `ready` or `degraded`.
    status: &'static str,
    /// Execution provider that really runs it; absent while it starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    provider: Option<&'static str>,
    /// What happened, when degraded.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl DetectorEvent {
    fn new(status: &DetectorStatus) -> Self {
        Self {
            status: match status {
                DetectorStatus::Starting => "starting",
                DetectorStatus::Ready { .. } => "ready",
                _ => "degraded",
            },
            provider: provider(status),
            reason: status.fault().map(str::to_owned),
        }
    }
}

/// A stream's wishes and sources.
struct Reader {
    camera: Option<String>,
    types: Vec<String>,
    /// The present state, sent before new events.
    first: VecDeque<sse::Event>,
    events: broadcast::Receiver<SharedEvent>,
    detector: Option<watch::Receiver<DetectorStatus>>,
    shutdown: CancellationToken,
    /// Given back when the stream ends.
    _place: OwnedSemaphorePermit,
}

fn event(name: &str, data: &impl Serialize) -> Option<sse::Event> {
    match sse::Event::default().event(name).json_data(data) {
        Ok(event) => Some(event),
        Err(error) => {
            tracing::error!(name, %error, "an event cannot be written as JSON");
            None
        }
    }
}

/// The event as it was written for all who read it.
fn written(happened: &SharedEvent) -> Option<sse::Event> {
    let name = happened.name();
    match happened.json() {
        Ok(json) => Some(sse::Event::default().event(name).data(json)),
        Err(error) => {
            tracing::error!(name, error, "an event cannot be written as JSON");
            None
        }
    }
}

impl Reader {
    fn wants(&self, name: &str) -> bool {
        self.types.is_empty() || self.types.iter().any(|wanted| wanted == name)
    }

    fn select(&self, happened: &SharedEvent) -> Option<sse::Event> {
        let about = self
            .camera
            .as_deref()
            .is_none_or(|camera| camera == happened.camera());
        (about && self.wants(happened.name()))
            .then(|| written(happened))
            .flatten()
    }

    /// The next event to send; `None` when the node stops.
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            if let Some(event) = self.first.pop_front() {
                return Some(event);
            }
            let found = tokio::select! {
                () = self.shutdown.cancelled() => return None,
                status = changed(&mut self.detector) => match status {
                    Some(status) => event(DETECTOR, &DetectorEvent::new(&status)),
                    // The detector does not return: its last status remains.
                    None => { self.detector = None; None }
                },
                received = self.events.recv() => match received {
                    Ok(happened) => self.select(&happened),
                    Err(RecvError::Lagged(lost)) => event(LAGGED, &json!({ "lost": lost })),
                    Err(RecvError::Closed) => return None,
                },
            };
            if found.is_some() {
                return found;
            }
        }
    }
}

/// The next status; pending for ever without a receiver, `None` once the sender is dropped.
async fn changed(detector: &mut Option<watch::Receiver<DetectorStatus>>) -> Option<DetectorStatus> {
    match detector {
        None => std::future::pending().await,
        Some(receiver) => {
            receiver.changed().await.ok()?;
            Some(receiver.borrow_and_update().clone())
        }
    }
}

fn wanted(
    selection: Selection,
    shared: &RouteState,
) -> Result<(Option<String>, Vec<String>), Problem> {
    if let Some(camera) = &selection.camera {
        shared.camera(camera)?;
    }
    let types: Vec<String> = selection
        .types
        .map(|types| types.split(',').map(str::to_owned).collect())
        .unwrap_or_default();
    let known: Vec<&str> = Event::NAMES.into_iter().chain([DETECTOR]).collect();
    match types.iter().find(|name| !known.contains(&name.as_str())) {
        None => Ok((selection.camera, types)),
        Some(name) => {
            let detail = format!(
                "there are no events `{name}`; there are: {}",
                known.join(", ")
            );
            Err(Problem::new(StatusCode::BAD_REQUEST, detail).allowing(known))
        }
    }
}

/// What happens on the node, as server-sent events
///
/// First how things stand (counters, thresholds, detector), then each change. A reader that is too slow
/// loses events; the event `lagged` has their number.
/// `curl -N 'http://127.0.0.1:8080/api/v1/events?types=counters,clip'`
#[utoipa::path(
    get, operation_id = "stream_events", path = "/api/v1/events", tag = "events", params(Selection),
    responses(
        (status = 200, content_type = "text/event-stream", body = String,
         description = "Events `frame`, `late`, `clip`, `counters`, `threshold`, `detector`, `lagged`."),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json", description = "Too many streams."),
    )
)]
pub(super) async fn stream(
    State(shared): State<RouteState>,
    selection: Result<Query<Selection>, QueryRejection>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>, Problem> {
    let Query(selection) = selection.map_err(|rejection| {
        Problem::new(StatusCode::BAD_REQUEST, rejection.body_text()).allowing(["camera", "types"])
    })?;
    let (camera, types) = wanted(selection, &shared)?;
    let place = Arc::clone(&shared.streams)
        .try_acquire_owned()
        .map_err(|_| {
            let detail =
                format!("all {MOST_STREAMS} event streams are in use; close one and try again");
            Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
        })?;
    let board = shared.board();
    let mut reader = Reader {
        camera,
        types,
        first: VecDeque::new(),
        // Before the first look at how things stand, so that no change falls between the two.
        events: board.subscribe(),
        detector: None,
        shutdown: shared.shutdown.clone(),
        _place: place,
    };
    let mut first = VecDeque::new();
    if reader.wants(DETECTOR) {
        let mut detector = board.watch_detector();
        first.extend(event(
            DETECTOR,
            &DetectorEvent::new(&detector.borrow_and_update()),
        ));
        reader.detector = Some(detector);
    }
    for happened in board.current(unix_nanoseconds()) {
        first.extend(reader.select(&happened.into()));
    }
    reader.first = first;
    let events = stream::unfold(reader, |mut reader| async move {
        let event = reader.next().await?;
        Some((Ok(event), reader))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}
