//! What happens in the fleet, as server-sent events with numbers: a reader that comes back gets what it missed.

use super::{HubView, query};
use crate::store::{Store, StoredEvent};
use albireo_service::http::Problem;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::{Stream, stream};
use serde::Deserialize;
use serde_json::json;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast::{self, error::RecvError};
use tokio_util::sync::CancellationToken;
use utoipa::IntoParams;

/// Most events that are sent again: a reader that missed more reads the present state instead.
const MOST_REPLAYED: i64 = 5000;
/// Of these, read at a time.
const STEP: i64 = 500;

/// From where on.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// Number of the last event the reader has; the header `Last-Event-ID` says the same.
    last_event_id: Option<i64>,
    /// Names of the kinds wanted, separated by commas; all without it.
    types: Option<String>,
}

struct Reader {
    types: Vec<String>,
    waiting: VecDeque<Arc<StoredEvent>>,
    /// What is sent before anything else.
    resync: Option<String>,
    last: Option<i64>,
    /// Up to this number events come from the database.
    replay_until: i64,
    store: Store,
    events: broadcast::Receiver<Arc<StoredEvent>>,
    shutdown: CancellationToken,
}

impl Reader {
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            if let Some(reason) = self.resync.take() {
                let event = sse::Event::default().event("resync");
                return event.json_data(json!({ "reason": reason })).ok();
            }
            if let Some(event) = self.waiting.pop_front() {
                if self.last.is_some_and(|last| event.id <= last) {
                    continue;
                }
                self.last = Some(event.id);
                if !self.types.is_empty() && !self.types.contains(&event.kind) {
                    continue;
                }
                let written = sse::Event::default()
                    .event(event.kind.clone())
                    .id(event.id.to_string())
                    .json_data(&*event);
                if let Ok(written) = written {
                    return Some(written);
                }
                continue;
            }
            if let Some(last) = self.last.filter(|last| *last < self.replay_until) {
                match self.store.events_after(last, STEP).await {
                    Ok(events) if events.is_empty() => self.replay_until = last,
                    Ok(events) => self.waiting.extend(events.into_iter().map(Arc::new)),
                    Err(error) => {
                        self.replay_until = last;
                        self.resync = Some(error.to_string());
                    }
                }
                continue;
            }
            tokio::select! {
                () = self.shutdown.cancelled() => return None,
                received = self.events.recv() => match received {
                    Ok(event) => self.waiting.push_back(event),
                    Err(RecvError::Lagged(lost)) => {
                        self.resync = Some(format!("{lost} events were missed"));
                    }
                    Err(RecvError::Closed) => return None,
                },
            }
        }
    }
}

/// What happens in the fleet, as server-sent events
///
/// Kinds: `node` (its state changed), `gap`, `reset`, `set_aside`, `clock_off`, `refused`, `drift` (a value was changed at the node), and `resync`: more was
/// missed, so read the present state again.
/// `curl -N http://127.0.0.1:8090/api/v1/events`
#[utoipa::path(
    get, operation_id = "stream_events", path = "/api/v1/events", tag = "events", params(Selection),
    responses(
        (status = 200, content_type = "text/event-stream", body = String),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn stream(
    State(view): State<HubView>,
    headers: HeaderMap,
    selection: Result<Query<Selection>, QueryRejection>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>, Problem> {
    let selection = query(selection)?;
    let last_id = match headers.get("last-event-id") {
        None => selection.last_event_id,
        Some(value) => {
            let number = value.to_str().ok().and_then(|text| text.parse().ok());
            Some(number.ok_or_else(|| {
                let detail = "Last-Event-ID is no number of an event";
                Problem::new(StatusCode::BAD_REQUEST, detail)
            })?)
        }
    };
    let store = view.store()?.clone();
    // Before the database is read, so that no event falls between the two.
    let events = view.events.listen();
    let newest = store.last_event().await?;
    let (last, resync) = match last_id {
        None => (newest, None),
        Some(last_id) if last_id > newest => {
            (newest, Some("the number is of another database".to_owned()))
        }
        Some(last_id) if newest - last_id > MOST_REPLAYED => (
            newest,
            Some(format!("{} events were missed", newest - last_id)),
        ),
        Some(last_id) => (last_id, None),
    };
    let types = selection
        .types
        .map(|types| types.split(',').map(str::to_owned).collect())
        .unwrap_or_default();
    let reader = Reader {
        types,
        waiting: VecDeque::new(),
        resync,
        last: Some(last),
        replay_until: newest,
        store,
        events,
        shutdown: view.shutdown.clone(),
    };
    let events = stream::unfold(reader, |mut reader| async move {
        let event = reader.next().await?;
        Some((Ok(event), reader))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}
