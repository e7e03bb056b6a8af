//! The frame-state counters.

use super::RouteState;
use crate::camera::audit::AuditCount;
use crate::state::board::CameraBoard;
use albireo_service::clock::{seconds, significant};
use albireo_service::http::Problem;
use albireo_wire::{AuditFigures, DetectorCalls, DroppedFrames, FrameStates, Threshold};
use axum::Json;
use axum::extract::{Path, State};
use serde::Serialize;
use utoipa::ToSchema;

/// Frames of a camera since the node started. The five states add up to `frames`.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraStates {
    /// Camera.
    camera: String,
    /// Frames processed.
    frames: u64,
    /// Number of frames in each state.
    states: FrameStates,
    /// Share of frames that skipped the detector: state E or P and not degraded.
    skip_rate: f64,
    /// Frames answered from prediction because the detector was not available.
    degraded_frames: u64,
    /// Frames that the detector was called for, by cause; degraded ones are among them.
    #[schema(value_type = std::collections::BTreeMap<String, u64>)]
    calls: DetectorCalls,
    /// Frames not processed, by kind.
    dropped: DroppedFrames,
    /// Largest uncertainty of the newest frame; absent without objects.
    #[serde(skip_serializing_if = "Option::is_none")]
    tau_max: Option<f64>,
    /// Threshold in force; absent when the policy has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    threshold: Option<Threshold>,
    /// Audit results of skipped frames; absent without an audit.
    #[serde(skip_serializing_if = "Option::is_none")]
    audit: Option<AuditFigures>,
    /// Seconds since the newest frame; absent before the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    last_frame_age_s: Option<f64>,
}

/// What became of all frames since the node started.
#[derive(Serialize, ToSchema)]
pub(super) struct NodeStates {
    /// Node.
    node: String,
    /// Seconds since it started.
    uptime_s: f64,
    /// Frames processed, all cameras together.
    frames: u64,
    /// Number of frames in each state, all cameras together.
    states: FrameStates,
    /// Share of frames that skipped the detector, all cameras together: state E or P and not degraded.
    skip_rate: f64,
    /// Frames answered from prediction because the detector was not available, all cameras together.
    degraded_frames: u64,
    /// Frames that the detector was called for, by cause, all cameras together.
    #[schema(value_type = std::collections::BTreeMap<String, u64>)]
    calls: DetectorCalls,
    /// Audit results of skipped frames, all cameras together; absent without an audit.
    #[serde(skip_serializing_if = "Option::is_none")]
    audit: Option<AuditFigures>,
    /// Each camera's.
    cameras: Vec<CameraStates>,
}

fn of(camera: &CameraBoard) -> CameraStates {
    let snapshot = camera.snapshot();
    CameraStates {
        camera: camera.name().to_owned(),
        frames: snapshot.states.frames(),
        states: snapshot.states,
        skip_rate: significant(snapshot.skip_rate(), 4),
        degraded_frames: snapshot.degraded_frames,
        calls: snapshot.calls,
        dropped: snapshot.dropped,
        tau_max: snapshot.latest.and_then(|latest| latest.tau_max),
        threshold: camera.threshold_in_force(),
        audit: (camera.audit_is_on()).then(|| snapshot.audit.figures()),
        last_frame_age_s: snapshot.last_frame_age.map(seconds),
    }
}

/// The frame-state counters of all cameras
///
/// `curl http://127.0.0.1:8080/api/v1/frame-states`
#[utoipa::path(get, operation_id = "frame_states", path = "/api/v1/frame-states", tag = "frames", responses((status = 200, body = NodeStates)))]
pub(super) async fn all(State(shared): State<RouteState>) -> Json<NodeStates> {
    let board = shared.board();
    let cameras: Vec<_> = board.cameras().iter().map(|camera| of(camera)).collect();
    let mut states = FrameStates::default();
    let mut calls = DetectorCalls::default();
    for camera in &cameras {
        states += camera.states;
        calls += &camera.calls;
    }
    let mut audit = AuditCount::default();
    for camera in board.cameras() {
        audit.merge(&camera.audit());
    }
    let audited = board.cameras().iter().any(|camera| camera.audit_is_on());
    let degraded_frames = cameras.iter().map(|camera| camera.degraded_frames).sum();
    Json(NodeStates {
        node: board.node().to_owned(),
        uptime_s: seconds(board.uptime()),
        frames: states.frames(),
        states,
        skip_rate: significant(states.skip_rate(degraded_frames), 4),
        degraded_frames,
        calls,
        audit: audited.then(|| audit.figures()),
        cameras,
    })
}

/// The frame-state counters of a camera
///
/// `curl http://127.0.0.1:8080/api/v1/cameras/front/frame-states`
#[utoipa::path(
    get, operation_id = "camera_frame_states", path = "/api/v1/cameras/{camera}/frame-states", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses(
        (status = 200, body = CameraStates),
        (status = 404, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn one(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Json<CameraStates>, Problem> {
    Ok(Json(of(shared.camera(&camera)?)))
}
