//! The route that lists recent clip reports.

use super::RouteState;
use crate::state::board::RECENT_CLIPS;
use albireo_service::http::{Problem, within};
use albireo_wire::ClipReport;
use axum::Json;
use axum::extract::{Query, State};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

/// The selection of clips.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ClipSelection {
    /// Only reports of this camera.
    camera: Option<String>,
    /// Maximum number; 50 by default.
    #[param(minimum = 1, maximum = 256)]
    limit: Option<usize>,
    /// Only reports older than the one with this id: for earlier clips, the `next` of the previous answer.
    #[param(value_type = Option<String>, format = "uuid")]
    before: Option<Uuid>,
    /// Only reports newer than the one with this id: for later clips, the id of the newest known report.
    #[param(value_type = Option<String>, format = "uuid")]
    after: Option<Uuid>,
}

/// Recent clip reports, newest first.
#[derive(Serialize, ToSchema)]
pub(super) struct Clips {
    /// The reports, as published on Zenoh.
    #[schema(value_type = Vec<ClipReport>)]
    clips: Vec<Arc<ClipReport>>,
    /// The `before` of the next page; absent if there are no earlier clips in memory.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, format = "uuid")]
    next: Option<Uuid>,
}

/// Recent clip reports, newest first
///
/// The node keeps the newest 256 in memory. `before` and `after` take the `id` of a report.
/// `curl 'http://127.0.0.1:8080/api/v1/clips?camera=front&limit=10'`
#[utoipa::path(
    get, operation_id = "list_clips", path = "/api/v1/clips", tag = "clips", params(ClipSelection),
    responses((status = 200, body = Clips))
)]
pub(super) async fn list(
    State(shared): State<RouteState>,
    Query(selection): Query<ClipSelection>,
) -> Result<Json<Clips>, Problem> {
    let limit = within("limit", selection.limit.unwrap_or(50), 1..=RECENT_CLIPS)?;
    if let Some(camera) = &selection.camera {
        shared.camera(camera)?;
    }
    let ClipSelection { before, after, .. } = selection;
    // One more than requested shows whether there are more.
    let board = &shared.board;
    let mut clips = board.recent_clips(selection.camera.as_deref(), before, after, limit + 1);
    let more = clips.len() > limit;
    clips.truncate(limit);
    let next = match clips.last() {
        Some(last) if more => Some(last.id),
        _ => None,
    };
    Ok(Json(Clips { clips, next }))
}
