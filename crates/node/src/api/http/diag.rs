//! The routes for diagnosis: the last log lines, and all of a node's diagnostics in one archive.

use super::{RouteState, cameras, metrics, node, states};
use albireo_service::archive;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Problem, within};
use albireo_service::logging::{self, LogLine};
use axum::Json;
use axum::extract::{Query, State};
use axum::response::Response;
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::{IntoParams, ToSchema};

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
    let metrics = metrics::text(State(shared.clone())).await.into_text();
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

/// The maximum number of lines per answer: all that are kept.
const MOST_LINES: usize = 1000;

/// The selection of lines.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LogSelection {
    /// Only lines after the one with this number.
    #[serde(default)]
    after: u64,
    /// Maximum number of lines, the newest ones, 1 to 1000; 200 by default.
    limit: Option<usize>,
}

/// Lines of the log.
#[derive(Serialize, ToSchema)]
pub(super) struct Log {
    /// The oldest first.
    lines: Vec<LogLine>,
}

/// The last lines of the log
///
/// The node keeps the newest 1000 lines of level `info` and above in memory, regardless of the level on standard error.
/// Configured secrets are masked. `curl 'http://127.0.0.1:8080/api/v1/log?limit=20'`
#[utoipa::path(
    get, operation_id = "log_tail", path = "/api/v1/log", tag = "diagnosis", params(LogSelection),
    responses((status = 200, body = Log))
)]
pub(super) async fn tail(Query(selection): Query<LogSelection>) -> Result<Json<Log>, Problem> {
    let limit = within("limit", selection.limit.unwrap_or(200), 1..=MOST_LINES)?;
    Ok(Json(Log {
        lines: logging::lines_after(selection.after, limit),
    }))
}
