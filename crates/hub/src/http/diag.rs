//! Serves the hub's diagnostics as one archive.

use crate::hub::Hub;
use crate::presence::PresenceState;
use crate::store::Store;
use albireo_service::archive;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::Problem;
use axum::extract::State;
use axum::response::Response;
use serde::Serialize;
use serde_json::json;
use std::cmp::Reverse;

/// Most nodes that are not online, most events and most revisions in the archive.
const MOST_NODES: usize = 1000;
const MOST_EVENTS: i64 = 500;
const MOST_REVISIONS: i64 = 100;

/// Diagnostics as one tar archive
///
/// The archive contains versions, the configuration with its secrets masked, readiness, the nodes that are not online,
/// metrics, the last events and revisions, and the last lines of the log. If the database cannot be read, the error is in
/// place of events and revisions.
/// `curl -O -J http://127.0.0.1:8090/api/v1/diag`
#[utoipa::path(
    get, operation_id = "download_diagnosis", path = "/api/v1/diag", tag = "diagnosis",
    responses((status = 200, content_type = "application/x-tar", body = Vec<u8>))
)]
pub(super) async fn archive(State(hub): State<Hub>) -> Response {
    let now_s = u64::try_from(unix_milliseconds().div_euclid(1000)).unwrap_or(0);
    let events = async {
        let store = hub.store()?;
        let kept = store.kept_events().await?;
        Ok(store.events_after(kept.end() - MOST_EVENTS, MOST_EVENTS).await?)
    };
    let revisions = async {
        let store = hub.store()?;
        Ok(store.revisions(i64::MAX, None, MOST_REVISIONS).await?)
    };
    let mut unwell = hub.fleet.views(|node| node.state != PresenceState::Online);
    // The worst states come first.
    unwell.sort_by_key(|node| Reverse(node.state));
    unwell.truncate(MOST_NODES);
    let about = json!({
        "program": "albireo hub",
        "version": env!("CARGO_PKG_VERSION"),
        "system": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        "at_s": now_s,
        "running_s": hub.started.elapsed().as_secs_f64(),
        "database": hub.store().ok().map(Store::kind),
        "not_working": hub.readiness.health().status().reasons,
        "nodes": hub.fleet.by_state(),
    });
    let metrics = super::metrics::page(&hub).await;
    let files = [
        ("about.json", text(Ok(about))),
        ("configuration.json", text(Ok(&*hub.config))),
        ("nodes-not-online.json", text(Ok(unwell))),
        ("events.json", text(events.await)),
        ("revisions.json", text(revisions.await)),
        ("metrics.txt", metrics.into_text().into_bytes()),
    ];
    archive::diagnostics("albireo-hub", &files, now_s)
}

fn text(content: Result<impl Serialize, Problem>) -> Vec<u8> {
    let text = match content {
        Ok(content) => serde_json::to_vec_pretty(&content),
        Err(problem) => serde_json::to_vec_pretty(&problem),
    };
    text.unwrap_or_default()
}
