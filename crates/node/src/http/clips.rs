//! Recent clip reports.

use super::RouteState;
use crate::board::RECENT_CLIPS;
use albireo_service::http::Problem;
use albireo_wire::ClipReport;
use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::{IntoParams, ToSchema};

/// Which clips.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// Of this camera only.
    camera: Option<String>,
    /// At most this many, 1 to 256; 50 by default.
    limit: Option<usize>,
}

/// Recent clip reports, newest first.
#[derive(Serialize, ToSchema)]
pub(super) struct Clips {
    /// The reports, as published on Zenoh.
    #[schema(value_type = Vec<ClipReport>)]
    clips: Vec<ArcReport>,
}

/// A shared report; serialised as the report itself.
struct ArcReport(Arc<ClipReport>);

impl Serialize for ArcReport {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

/// Recent clip reports, newest first
///
/// The node keeps the newest 256 in memory.
/// `curl 'http://127.0.0.1:8080/api/v1/clips?camera=front&limit=10'`
#[utoipa::path(
    get, operation_id = "list_clips", path = "/api/v1/clips", tag = "clips", params(Selection),
    responses(
        (status = 200, body = Clips),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(
    State(shared): State<RouteState>,
    selection: Result<Query<Selection>, QueryRejection>,
) -> Result<Json<Clips>, Problem> {
    let Query(selection) = selection.map_err(|rejection| {
        Problem::new(StatusCode::BAD_REQUEST, rejection.body_text()).allowing(["camera", "limit"])
    })?;
    let limit = selection.limit.unwrap_or(50);
    if !(1..=RECENT_CLIPS).contains(&limit) {
        let detail = format!("`limit` must be from 1 to {RECENT_CLIPS}, not {limit}");
        return Err(Problem::new(StatusCode::BAD_REQUEST, detail));
    }
    if let Some(camera) = &selection.camera {
        shared.camera(camera)?;
    }
    let clips = shared
        .board()
        .recent_clips(selection.camera.as_deref(), limit);
    Ok(Json(Clips {
        clips: clips.into_iter().map(ArcReport).collect(),
    }))
}
