//! Streams the node's events as server-sent events (WHATWG HTML, section 9.2).

use super::RouteState;
use crate::state::board::News;
use albireo_service::clock::unix_nanoseconds;
use albireo_service::http::{Problem, check_event_types};
use axum::extract::{Query, State};
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::Stream;
use futures_util::stream::{self, StreamExt};
use parking_lot::Mutex;
use serde::Deserialize;
use serde_json::json;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio_util::sync::CancellationToken;
use utoipa::IntoParams;

/// The maximum number of concurrent event streams: each holds a connection.
const MOST_STREAMS: usize = 64;

/// The name of the only event that is not a [`News`].
const LAGGED: &str = "lagged";

/// The open event streams, the oldest first.
#[derive(Default)]
pub(super) struct OpenStreams(Mutex<VecDeque<CancellationToken>>);

impl OpenStreams {
    /// Adds a stream, and ends the oldest if there are too many: readers that only hold streams keep nobody out, and a page
    /// opens its stream again. The token ends the stream; cancel it when the stream is closed.
    fn add(&self, shutdown: &CancellationToken) -> CancellationToken {
        let mut open = self.0.lock();
        open.retain(|stream| !stream.is_cancelled());
        if open.len() >= MOST_STREAMS
            && let Some(oldest) = open.pop_front()
        {
            oldest.cancel();
        }
        let stream = shutdown.child_token();
        open.push_back(stream.clone());
        stream
    }
}

/// The selection of events.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EventSelection {
    /// Only events of this camera, and of the detector.
    camera: Option<String>,
    /// Only these kinds, separated by commas: `frame`, `late`, `sighting`, `clip`, `counters`, `threshold`,
    /// `detector`. All kinds by default.
    types: Option<String>,
}

impl EventSelection {
    /// Checks the names.
    fn check(&self, shared: &RouteState) -> Result<(), Problem> {
        if let Some(camera) = &self.camera {
            shared.camera(camera)?;
        }
        check_event_types(self.types.as_deref(), &News::NAMES)
    }

    fn wants(&self, news: &News) -> bool {
        let camera = self.camera.as_deref();
        let types = self.types.as_deref();
        // News of no single camera is for everybody.
        let is_of_camera = camera.is_none() || news.camera().is_none() || camera == news.camera();
        is_of_camera && types.is_none_or(|types| types.split(',').any(|name| name == news.name()))
    }
}

/// The node's events, as server-sent events
///
/// First the present state (counters, thresholds, detector), then each change. A reader that is too slow
/// loses events; the event `lagged` reports how many. With 64 streams open, the oldest ends for a new one.
/// `curl -N 'http://127.0.0.1:8080/api/v1/events?types=counters,clip'`
#[utoipa::path(
    get, operation_id = "stream_events", path = "/api/v1/events", tag = "events", params(EventSelection),
    responses(
        (status = 200, content_type = "text/event-stream", body = String,
         description = "Events `frame`, `late`, `sighting`, `clip`, `counters`, `threshold`, `detector`, `lagged`."),
    )
)]
pub(super) async fn stream(
    State(shared): State<RouteState>,
    Query(selection): Query<EventSelection>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>, Problem> {
    selection.check(&shared)?;
    let end = shared.streams.add(&shared.shutdown);
    let ends_at_drop = end.clone().drop_guard();
    // Subscribes before the present state is read, so that no change is missed in between.
    let changes = stream::unfold(shared.board.subscribe(), |mut events| async move {
        let next = match events.recv().await {
            Ok(event) => Ok(event),
            Err(RecvError::Lagged(lost)) => Err(lost),
            Err(RecvError::Closed) => return None,
        };
        Some((next, events))
    });
    let current = shared.board.current(unix_nanoseconds());
    let events = stream::iter(current).map(Ok).chain(changes).filter_map(move |event| {
        // The closure owns the guard, so that the stream's place is free once the stream is dropped.
        let _guard = &ends_at_drop;
        let message = sse::Event::default();
        let sent = match event {
            Ok(event) if !selection.wants(&event.news) => None,
            Ok(event) => Some(message.event(event.news.name()).data(event.json())),
            Err(lost) => Some(message.event(LAGGED).data(json!({ "lost": lost }).to_string())),
        };
        std::future::ready(sent)
    });
    let until_end = events.map(Ok).take_until(end.cancelled_owned());
    Ok(Sse::new(until_end).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}
