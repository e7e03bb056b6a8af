//! The route that returns the last log lines.

use super::within;
use albireo_service::http::Problem;
use albireo_service::logging::{self, LogLine};
use axum::Json;
use axum::extract::Query;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// The maximum number of lines per answer: all that are kept.
const MOST: usize = 1000;

/// The selection of lines.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
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
    get, operation_id = "log_tail", path = "/api/v1/log", tag = "diagnosis", params(Selection),
    responses((status = 200, body = Log))
)]
pub(super) async fn tail(Query(selection): Query<Selection>) -> Result<Json<Log>, Problem> {
    let limit = within("limit", selection.limit.unwrap_or(200), 1..=MOST)?;
    Ok(Json(Log {
        lines: logging::lines_after(selection.after, limit),
    }))
}
