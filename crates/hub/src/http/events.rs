//! Serves the fleet's events as numbered server-sent events: a reader that reconnects gets the events it missed.

use crate::history::StoredEvent;
use crate::hub::Hub;
use albireo_service::http::Problem;
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
const LOOK: Duration = Duration::from_millis(500);

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
    let store = hub.store()?.clone();
    let newest = store.last_event().await?;
    let last = last_id.unwrap_or(newest);
    let missed = match newest.saturating_sub(last) {
        ..0 => Some("the event is from another database".to_owned()),
        0..=MOST_REPLAYED => None,
        behind => Some(format!("{behind} events were missed")),
    };
    let last = if missed.is_some() { newest } else { last };
    let resync = missed.map(|reason| {
        let event = sse::Event::default().event("resync");
        event.json_data(json!({ "reason": reason }))
    });
    let steps = stream::unfold((store, last), |(store, last)| async move {
        let events = match store.events_after(last, STEP).await {
            Ok(events) => events,
            Err(error) => {
                tracing::debug!(%error, "events cannot be read");
                Vec::new()
            }
        };
        if events.is_empty() {
            tokio::time::sleep(LOOK).await;
        }
        let last = events.last().map_or(last, |event| event.id);
        Some((stream::iter(events), (store, last)))
    });
    let types = selection.types;
    let is_wanted = move |event: &StoredEvent| match &types {
        Some(types) => types.split(',').any(|kind| kind == event.kind),
        None => true,
    };
    let news = steps
        .flatten()
        .filter(move |event| ready(is_wanted(event)))
        .map(|event| {
            let written = sse::Event::default().event(&event.kind);
            written.id(event.id.to_string()).json_data(&event)
        })
        .take_until(hub.shutdown.cancelled_owned());
    let events = stream::iter(resync).chain(news);
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}
