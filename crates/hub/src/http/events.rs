//! Serves the fleet's events as numbered server-sent events: a reader that reconnects gets the events it missed.

use crate::history::StoredEvent;
use crate::hub::Hub;
use crate::store::Store;
use albireo_service::http::{Problem, check_event_types};
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::{Stream, StreamExt, stream};
use serde::Deserialize;
use serde_json::json;
use std::future::ready;
use std::time::Duration;
use utoipa::IntoParams;

/// Most events that are replayed: a reader that missed more reads the present state instead.
const MOST_REPLAYED: i64 = 5000;
/// Most events that are read from the database at a time.
const STEP: i64 = 500;
/// Time between two reads of the database, to which other hubs may write too.
const READ_PAUSE: Duration = Duration::from_millis(500);

/// The kinds of events.
const KINDS: [&str; 9] = [
    "node",
    "gap",
    "reset",
    "set_aside",
    "clock_off",
    "refused",
    "drift",
    "forgotten",
    "resync",
];

/// Selects events.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EventSelection {
    /// Number of the last event that the reader has; the header `Last-Event-ID` takes precedence.
    last_event_id: Option<i64>,
    /// Only these kinds, separated by commas; all kinds by default.
    types: Option<String>,
}

/// The fleet's events, as server-sent events
///
/// Kinds: `node` (its state changed), `gap`, `reset`, `set_aside`, `clock_off`, `refused`, `drift` (a value was changed
/// at the node), `forgotten`, and `resync`: too many events were missed, so read the present state again.
/// `curl -N http://127.0.0.1:8090/api/v1/events`
#[utoipa::path(
    get, operation_id = "stream_events", path = "/api/v1/events", tag = "events", params(EventSelection),
    responses((status = 200, content_type = "text/event-stream", body = String))
)]
pub(super) async fn stream(
    State(hub): State<Hub>,
    headers: HeaderMap,
    Query(selection): Query<EventSelection>,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, axum::Error>>>, Problem> {
    check_event_types(selection.types.as_deref(), &KINDS)?;
    let reader_has = match number_in(&headers)? {
        Some(number) => Some(number),
        None => selection.last_event_id,
    };
    let store = hub.store()?.clone();
    let (first, newest) = store.kept_events().await?.into_inner();
    let mut last = reader_has.unwrap_or(newest);
    let deleted = first.saturating_sub(last.saturating_add(1));
    let missed = match newest.saturating_sub(last) {
        ..0 => Some("the event is from another database".to_owned()),
        0..=MOST_REPLAYED if deleted > 0 => {
            Some(format!("{deleted} events were missed and are deleted"))
        }
        0..=MOST_REPLAYED => None,
        behind => Some(format!("{behind} events were missed")),
    };
    if missed.is_some() {
        last = newest;
    }
    let resync = missed
        .map(|reason| sse::Event::default().event("resync").json_data(json!({ "reason": reason })));
    let news = EventsAfter { store, last };
    let types = selection.types;
    let is_wanted = move |event: &StoredEvent| match &types {
        Some(types) => types.split(',').any(|kind| kind == event.kind),
        None => true,
    };
    let sent = stream::unfold(news, |mut news| async move {
        let events = news.next().await;
        Some((stream::iter(events), news))
    })
    .flatten()
    .filter(move |event| ready(is_wanted(event)))
    .map(|event| {
        sse::Event::default()
            .event(&event.kind)
            .id(event.id.to_string())
            .json_data(&event)
    })
    .take_until(hub.shutdown.cancelled_owned());
    let events = stream::iter(resync).chain(sent);
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}

/// The number in the header `Last-Event-ID`, if it is there.
fn number_in(headers: &HeaderMap) -> Result<Option<i64>, Problem> {
    let Some(value) = headers.get("last-event-id") else {
        return Ok(None);
    };
    match value.to_str().ok().and_then(|text| text.parse().ok()) {
        Some(number) => Ok(Some(number)),
        None => Err(Problem::new(
            StatusCode::BAD_REQUEST,
            "Last-Event-ID must be the number of an event",
        )),
    }
}

/// The events after the last one that was read.
struct EventsAfter {
    store: Store,
    last: i64,
}

impl EventsAfter {
    /// Reads the next events; if there are none yet, returns none after a pause.
    async fn next(&mut self) -> Vec<StoredEvent> {
        let events = match self.store.events_after(self.last, STEP).await {
            Ok(events) => events,
            Err(error) => {
                tracing::debug!(%error, "events cannot be read");
                Vec::new()
            }
        };
        match events.last() {
            Some(event) => self.last = event.id,
            None => tokio::time::sleep(READ_PAUSE).await,
        }
        events
    }
}
