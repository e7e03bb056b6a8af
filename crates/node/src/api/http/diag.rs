//! The route that packs a node's diagnostics into one archive.

use super::{RouteState, cameras, metrics, node, states};
use albireo_service::archive;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::Problem;
use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::Serialize;
use serde_json::json;

/// The maximum number of clips in the archive.
const MOST_CLIPS: usize = 64;

fn text(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec_pretty(value).unwrap_or_default()
}

/// Diagnostics as one tar archive
///
/// Versions, the configuration with its secrets masked, readiness with reasons, cameras, frame-state counters, metrics, the
/// last clips, and the last lines of the log. `curl -O -J http://127.0.0.1:8080/api/v1/diag`
#[utoipa::path(
    get, operation_id = "download_diagnosis", path = "/api/v1/diag", tag = "diagnosis",
    responses(
        (status = 200, content_type = "application/x-tar", body = Vec<u8>),
    )
)]
pub(super) async fn archive(State(shared): State<RouteState>) -> Result<Response, Problem> {
    let now_s = u64::try_from(unix_milliseconds().div_euclid(1000)).unwrap_or(0);
    let board = &shared.board;
    let name = board.node.clone();
    let about = json!({
        "program": "albireo node",
        "node": name,
        "version": env!("CARGO_PKG_VERSION"),
        "system": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        "at_s": now_s,
    });
    let clips = board.recent_clips(None, None, None, MOST_CLIPS);
    let Json(overview) = node::overview(State(shared.clone())).await;
    let Json(cameras) = cameras::list(State(shared.clone())).await;
    let Json(counters) = states::all(State(shared.clone())).await;
    let metrics = metrics::page(&shared).into_text();
    let files = [
        ("about.json", text(&about)),
        ("configuration.json", text(&*shared.config)),
        ("node.json", text(&overview)),
        ("cameras.json", text(&cameras)),
        ("frame-states.json", text(&counters)),
        ("clips.json", text(&clips)),
        ("metrics.txt", metrics.into_bytes()),
    ];
    let name = format!("albireo-node-{name}");
    Ok(archive::diagnostics(&name, &files, now_s))
}
