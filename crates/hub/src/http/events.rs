//! Serves the fleet's events as numbered server-sent events: a reader that reconnects gets the events it missed.

use super::HubView;
use crate::store::{Store, StoredEvent};
use albireo_service::http::Problem;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::{Stream, StreamExt, stream};
use serde::Deserialize;
use serde_json::json;
use std::convert::Infallible;
use std::future::ready;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use utoipa::IntoParams;

/// Most events that are replayed: a reader that missed more reads the present state instead.
const MOST_REPLAYED: i64 = 5000;
/// Most events that are read from the database at a time.
const STEP: i64 = 500;
/// Time between two reads of the database, to which other hubs may write too.
const LOOK: Duration = Duration::from_millis(500);

/// Selects events.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// Number of the last event that the reader has; the header `Last-Event-ID` takes precedence.
    last_event_id: Option<i64>,
    /// Only these kinds, separated by commas; all kinds by default.
    types: Option<String>,
}

struct Reader {
    last: i64,
    store: Store,
    shutdown: CancellationToken,
}

impl Reader {
    /// The next events; nothing once the hub stops.
    async fn next(&mut self) -> Option<Vec<StoredEvent>> {
        loop {
            match self.store.events_after(self.last, STEP).await {
                Ok(events) if !events.is_empty() => {
                    self.last = events.last().map_or(self.last, |event| event.id);
                    return Some(events);
                }
                Ok(_) => {}
                Err(error) => tracing::debug!(%error, "events cannot be read"),
            }
            tokio::select! {
                () = self.shutdown.cancelled() => return None,
                () = tokio::time::sleep(LOOK) => {}
            }
        }
    }
}

fn written(event: StoredEvent) -> Option<sse::Event> {
    let written = sse::Event::default().event(&event.kind);
    written.id(event.id.to_string()).json_data(&event).ok()
}

/// The fleet's events, as server-sent events
///
/// Kinds: `node` (its state changed), `gap`, `reset`, `set_aside`, `clock_off`, `refused`, `drift` (a value was changed
/// at the node), `forgotten`, and `resync`: too many events were missed, so read the present state again.
/// `curl -N http://127.0.0.1:8090/api/v1/events`
#[utoipa::path(
    get, operation_id = "stream_events", path = "/api/v1/events", tag = "events", params(Selection),
    responses((status = 200, content_type = "text/event-stream", body = String))
)]
pub(super) async fn stream(
    State(view): State<HubView>,
    headers: HeaderMap,
    Query(selection): Query<Selection>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>, Problem> {
    let last_id = match headers.get("last-event-id") {
        None => selection.last_event_id,
        Some(value) => {
            let number = value.to_str().ok().and_then(|text| text.parse().ok());
            Some(number.ok_or_else(|| {
                let detail = "Last-Event-ID must be the number of an event";
                Problem::new(StatusCode::BAD_REQUEST, detail)
            })?)
        }
    };
    let store = view.store()?.clone();
    let newest = store.last_event().await?;
    let (last, resync) = match last_id.unwrap_or(newest) {
        last if last > newest => (
            newest,
            Some("the event is from another database".to_owned()),
        ),
        last if newest - last > MOST_REPLAYED => (
            newest,
            Some(format!("{} events were missed", newest - last)),
        ),
        last => (last, None),
    };
    let reader = Reader {
        last,
        store,
        shutdown: view.shutdown.clone(),
    };
    let news = stream::unfold(reader, |mut reader| async move {
        Some((stream::iter(reader.next().await?), reader))
    });
    let types = selection.types;
    let is_wanted = move |event: &StoredEvent| {
        (types.as_ref()).is_none_or(|types| types.split(',').any(|kind| kind == event.kind))
    };
    let news = news
        .flatten()
        .filter_map(move |event| ready(Some(event).filter(&is_wanted).and_then(written)));
    let resync = resync.and_then(|reason| {
        let event = sse::Event::default().event("resync");
        event.json_data(json!({ "reason": reason })).ok()
    });
    let events = stream::iter(resync).chain(news).map(Ok);
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}
