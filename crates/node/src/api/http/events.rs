//! Streams the node's events as server-sent events (WHATWG HTML, section 9.2).

use super::{RouteState, bad_request, query};
use crate::state::board::{Event, News};
use albireo_service::clock::unix_nanoseconds;
use albireo_service::http::Problem;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::Stream;
use futures_util::stream::{self, StreamExt};
use serde::Deserialize;
use serde_json::json;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio_util::sync::CancellationToken;
use utoipa::IntoParams;

/// The maximum number of concurrent event streams: each holds a connection.
pub(super) const MOST_STREAMS: usize = 64;

/// The name of the only event that is not a [`News`].
const LAGGED: &str = "lagged";

/// The selection of events.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// Only events of this camera, and of the detector.
    camera: Option<String>,
    /// Only these kinds, separated by commas: `frame`, `late`, `clip`, `counters`, `threshold`, `detector`. All kinds by
    /// default.
    types: Option<String>,
}

/// The selection and the sources of one stream.
struct Reader {
    camera: Option<String>,
    types: Vec<String>,
    events: broadcast::Receiver<Arc<Event>>,
    shutdown: CancellationToken,
    /// Released when the stream ends.
    _place: OwnedSemaphorePermit,
}

impl Reader {
    fn wants(&self, name: &str) -> bool {
        self.types.is_empty() || self.types.iter().any(|wanted| wanted == name)
    }

    fn select(&self, happened: &Event) -> Option<sse::Event> {
        let (camera, news) = (self.camera.as_deref(), &happened.news);
        let is_about = camera.is_none() || news.camera().is_none() || camera == news.camera();
        let name = news.name();
        if !is_about || !self.wants(name) {
            return None;
        }
        match happened.json() {
            Ok(json) => Some(sse::Event::default().event(name).data(json)),
            Err(error) => {
                tracing::error!(name, error, "an event cannot be written as JSON");
                None
            }
        }
    }

    /// The next event to send; `None` when the node stops.
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            let received = self.shutdown.run_until_cancelled(self.events.recv());
            match received.await? {
                Ok(happened) => match self.select(&happened) {
                    None => {}
                    event => return event,
                },
                Err(RecvError::Lagged(lost)) => {
                    let lost = json!({ "lost": lost }).to_string();
                    return Some(sse::Event::default().event(LAGGED).data(lost));
                }
                Err(RecvError::Closed) => return None,
            }
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
    let known = News::NAMES;
    match types.iter().find(|name| !known.contains(&name.as_str())) {
        None => Ok((selection.camera, types)),
        Some(name) => {
            let detail = format!(
                "there is no event type `{name}`; there are: {}",
                known.join(", ")
            );
            Err(bad_request(detail).allowing(known))
        }
    }
}

/// The node's events, as server-sent events
///
/// First the present state (counters, thresholds, detector), then each change. A reader that is too slow
/// loses events; the event `lagged` reports how many. 503 while 64 streams are open.
/// `curl -N 'http://127.0.0.1:8080/api/v1/events?types=counters,clip'`
#[utoipa::path(
    get, operation_id = "stream_events", path = "/api/v1/events", tag = "events", params(Selection),
    responses(
        (status = 200, content_type = "text/event-stream", body = String,
         description = "Events `frame`, `late`, `clip`, `counters`, `threshold`, `detector`, `lagged`."),
    )
)]
pub(super) async fn stream(
    State(shared): State<RouteState>,
    selection: Result<Query<Selection>, QueryRejection>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>, Problem> {
    let selection = query(selection, &["camera", "types"])?;
    let (camera, types) = wanted(selection, &shared)?;
    let place = Arc::clone(&shared.streams)
        .try_acquire_owned()
        .map_err(|_| {
            let detail =
                format!("all {MOST_STREAMS} event streams are in use; close one and try again");
            Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
        })?;
    let board = &shared.board;
    let reader = Reader {
        camera,
        types,
        // Subscribes before the present state is read, so that no change is missed in between.
        events: board.subscribe(),
        shutdown: shared.shutdown.clone(),
        _place: place,
    };
    let current = board.current(unix_nanoseconds());
    let current: Vec<_> = (current
        .iter()
        .filter_map(|happened| reader.select(happened)))
    .map(Ok)
    .collect();
    let events = stream::unfold(reader, |mut reader| async move {
        let event = reader.next().await?;
        Some((Ok(event), reader))
    });
    let events = stream::iter(current).chain(events);
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}
