//! The routes of the frame-state counters.

use super::RouteState;
use crate::state::board::{CameraBoard, CameraSnapshot};
use albireo_service::clock::seconds;
use albireo_service::http::Problem;
use albireo_wire::{
    AuditFigures, AuditReport, DetectorCalls, DroppedFrames, FrameStates, Threshold, significant,
};
use axum::Json;
use axum::extract::{Path, State};
use serde::Serialize;
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// Counts of frames since the node started.
#[skip_serializing_none]
#[derive(Serialize, ToSchema)]
pub(super) struct FrameCounts {
    /// Frames processed.
    frames: u64,
    /// Number of frames in each state; they add up to `frames`.
    states: FrameStates,
    /// Share of frames that skipped the detector: state E or P and not degraded.
    skip_rate: f64,
    /// Frames answered from prediction because the detector was not available.
    degraded_frames: u64,
    /// Frames for which the detector was called, by cause, including degraded ones.
    #[schema(value_type = std::collections::BTreeMap<String, u64>)]
    calls: DetectorCalls,
    /// Audit results of skipped frames since the node started, or since the policy was switched; absent without an audit.
    audit: Option<AuditFigures>,
}

/// Frames of a camera since the node started.
#[skip_serializing_none]
#[derive(Serialize, ToSchema)]
pub(super) struct CameraStates {
    /// Camera.
    camera: String,
    #[serde(flatten)]
    counts: FrameCounts,
    /// Frames not processed, by kind.
    dropped: DroppedFrames,
    /// Largest uncertainty of the newest frame; absent without objects.
    tau_max: Option<f64>,
    /// Threshold in force; absent when the policy has none.
    threshold: Option<Threshold>,
    /// Seconds since the newest frame; absent before the first.
    last_frame_age_s: Option<f64>,
}

/// Counts of all frames since the node started.
#[derive(Serialize, ToSchema)]
pub(super) struct NodeStates {
    /// Node.
    node: String,
    /// Seconds since it started.
    uptime_s: f64,
    /// The sums over all cameras.
    #[serde(flatten)]
    counts: FrameCounts,
    /// The counts of each camera.
    cameras: Vec<CameraStates>,
}

impl FrameCounts {
    /// Sums the counts of these cameras.
    fn of<'a>(cameras: impl IntoIterator<Item = &'a CameraSnapshot>) -> Self {
        let mut states = FrameStates::default();
        let mut calls = DetectorCalls::default();
        let mut audit: Option<AuditReport> = None;
        let mut degraded_frames = 0;
        for snapshot in cameras {
            states += snapshot.states;
            calls += &snapshot.calls;
            degraded_frames += snapshot.degraded_frames;
            if let Some(found) = &snapshot.policy_audit {
                audit.get_or_insert_default().merge(found);
            }
        }
        Self {
            frames: states.frames(),
            states,
            skip_rate: significant(states.skip_rate(degraded_frames), 4),
            degraded_frames,
            calls,
            audit: audit.as_ref().map(AuditReport::figures),
        }
    }
}

pub(super) fn of(camera: &CameraBoard, snapshot: &CameraSnapshot) -> CameraStates {
    CameraStates {
        camera: camera.name().to_owned(),
        counts: FrameCounts::of([snapshot]),
        dropped: snapshot.dropped,
        tau_max: snapshot.latest.as_ref().and_then(|latest| latest.tau_max),
        threshold: camera.threshold_in_force(),
        last_frame_age_s: snapshot.last_frame_age().map(seconds),
    }
}

/// The frame-state counters of all cameras
///
/// `curl http://127.0.0.1:8080/api/v1/frame-states`
#[utoipa::path(get, operation_id = "frame_states", path = "/api/v1/frame-states", tag = "frames", responses((status = 200, body = NodeStates)))]
pub(super) async fn all(State(shared): State<RouteState>) -> Json<NodeStates> {
    let board = &shared.board;
    let snapshots: Vec<_> = board.cameras.iter().map(|camera| camera.snapshot()).collect();
    let cameras = board
        .cameras
        .iter()
        .zip(&snapshots)
        .map(|(camera, snapshot)| of(camera, snapshot))
        .collect();
    Json(NodeStates {
        node: board.node.clone(),
        uptime_s: seconds(board.uptime()),
        counts: FrameCounts::of(&snapshots),
        cameras,
    })
}

/// The frame-state counters of a camera
///
/// `curl http://127.0.0.1:8080/api/v1/cameras/front/frame-states`
#[utoipa::path(
    get, operation_id = "camera_frame_states", path = "/api/v1/cameras/{camera}/frame-states", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses((status = 200, body = CameraStates))
)]
pub(super) async fn one(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Json<CameraStates>, Problem> {
    let camera = shared.camera(&camera)?;
    Ok(Json(of(camera, &camera.snapshot())))
}
