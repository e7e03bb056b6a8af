//! Routes that list the cameras and their states.

use super::RouteState;
use super::states::{self, CameraStates};
use crate::state::advice::Advice;
use crate::state::board::{Board, CameraBoard, NoNews};
use crate::state::readiness::{CAMERAS, PICTURES};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::ThresholdSpec;
use albireo_service::http::Problem;
use albireo_wire::{DetectionsMessage, SettingSource};
use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use serde::Serialize;
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// A camera.
#[skip_serializing_none]
#[derive(Serialize, ToSchema)]
pub(super) struct CameraEntry {
    #[serde(flatten)]
    states: CameraStates,
    /// Zenoh key of its frames; absent if it has a source.
    key: Option<String>,
    /// Address of the source that the node opens for it, without credentials.
    source: Option<String>,
    /// What is wrong: why no frames arrive, or why those that arrive are of no use; absent if all is well.
    fault: Option<String>,
    /// True if the last frames that arrived could all not be used; `fault` says why.
    unusable: bool,
    /// Frames per second that come from it, over the last 10 s.
    rate: Option<f64>,
    /// Frames per second that the node takes from its source at most; absent without a limit.
    max_rate: Option<f64>,
    /// Frames that came from it since the node started, also those that `max_rate` leaves out.
    arrived: u64,
    /// Frames of these that show damage: from a complaint of the decoder to the next whole key frame.
    broken: u64,
    /// Present while its picture has not changed (`screen.still_s`).
    no_news: Option<NoNews>,
    /// Video files of its source that could not be played and were passed over.
    passed_over: u64,
    /// The last of these files, and why.
    last_passed_over: Option<String>,
    /// Clips ended since the node started.
    clips: u64,
    /// Columns of its newest frame.
    width: Option<u32>,
    /// Rows of its newest frame.
    height: Option<u32>,
    /// The equivalent of `u` in the published code, for pictures of this size; absent if it is the same number, before the
    /// first frame, and under other policies.
    u_as_published: Option<f64>,
    /// The policy that decides its frames.
    policy: &'static str,
    /// Who chose this policy: `local` where it was switched at the node.
    policy_set_by: SettingSource,
    /// Who set its threshold. While a target moves it, who set the target; after a switch of the policy it is the one that is
    /// configured for the new policy.
    set_by: Option<SettingSource>,
    /// The name, range and default of the policy's threshold; absent if the policy has none.
    threshold_spec: Option<ThresholdSpec>,
    /// Suggested value if nothing is skipped although objects are tracked.
    advice: Option<Advice>,
}

/// The cameras of a node.
#[derive(Serialize, ToSchema)]
pub(super) struct Cameras {
    /// In the order of the configuration.
    cameras: Vec<CameraEntry>,
}

fn entry(board: &Board, camera: &CameraBoard) -> CameraEntry {
    let of_camera = board.readiness.health().faults.into_iter().find(|fault| {
        let subject = fault.subject.strip_suffix(PICTURES).unwrap_or(&fault.subject);
        fault.part == CAMERAS && subject == camera.name()
    });
    let fault = of_camera.map(|fault| fault.fault.reason);
    let source = camera.source.as_deref().map(str::to_owned);
    let snapshot = camera.snapshot();
    let unusable = snapshot.unusable();
    let latest = snapshot.latest.as_ref();
    let picture = latest.map(|latest| PictureSize::new(latest.width, latest.height));
    let key = if source.is_none() {
        Some(camera.key.clone())
    } else {
        None
    };
    let threshold_spec = camera.threshold_spec();
    let set_by = if threshold_spec.is_none() {
        None
    } else if board.target.is_on() {
        Some(board.target.report().source)
    } else {
        Some(camera.threshold_source())
    };
    let policy = board.policy().name;
    let policy_set_by = if policy == board.configured_policy().name {
        SettingSource::Configuration
    } else {
        SettingSource::Local
    };
    CameraEntry {
        states: states::of(camera, &snapshot),
        key,
        source,
        unusable: unusable.is_some(),
        fault: unusable.or(fault),
        rate: snapshot.rate,
        max_rate: camera.max_rate,
        arrived: snapshot.arrived.frames,
        broken: snapshot.arrived.broken,
        no_news: camera.no_news(),
        passed_over: snapshot.arrived.passed_over,
        last_passed_over: camera.input.arrivals.last_passed_over().as_deref().map(str::to_owned),
        clips: snapshot.clips,
        width: picture.map(|picture| picture.width),
        height: picture.map(|picture| picture.height),
        u_as_published: picture.and_then(|picture| camera.published_threshold(picture)),
        policy,
        policy_set_by,
        set_by,
        threshold_spec,
        advice: camera.advice(),
    }
}

/// The cameras
///
/// `curl http://127.0.0.1:8080/api/v1/cameras`
#[utoipa::path(get, operation_id = "list_cameras", path = "/api/v1/cameras", tag = "frames", responses((status = 200, body = Cameras)))]
pub(super) async fn list(State(shared): State<RouteState>) -> Json<Cameras> {
    let board = &shared.board;
    let cameras = board.cameras.iter().map(|camera| entry(board, camera)).collect();
    Json(Cameras { cameras })
}

/// State of a camera: policy, threshold, frame states, suggestions
///
/// `curl http://127.0.0.1:8080/api/v1/cameras/front`
#[utoipa::path(
    get, path = "/api/v1/cameras/{camera}", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses((status = 200, body = CameraEntry))
)]
pub(super) async fn one(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Json<CameraEntry>, Problem> {
    let camera = shared.camera(&camera)?;
    Ok(Json(entry(&shared.board, camera)))
}

/// The detections of a camera's newest frame
///
/// The message as published on Zenoh; 404 before the first frame.
/// `curl http://127.0.0.1:8080/api/v1/cameras/front/detections`
#[utoipa::path(
    get, path = "/api/v1/cameras/{camera}/detections", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses((status = 200, body = DetectionsMessage))
)]
pub(super) async fn detections(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Json<DetectionsMessage>, Problem> {
    let camera = shared.camera(&camera)?;
    let latest = camera.snapshot().latest.ok_or_else(|| {
        let name = camera.name();
        let from = camera.source.as_ref().unwrap_or(&camera.key);
        let detail = format!("no frame of camera `{name}` has arrived yet from {from}");
        Problem::new(StatusCode::NOT_FOUND, detail)
    })?;
    Ok(Json(DetectionsMessage::clone(&latest)))
}
