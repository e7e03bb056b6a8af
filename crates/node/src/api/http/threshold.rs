//! The routes that read and set the uncertainty threshold.

use super::RouteState;
use super::body::{message, off_the_runtime};
use crate::state::board::CameraBoard;
use albireo_core::policy::{InvalidThreshold, ThresholdSpec, short};
use albireo_service::http::Problem;
use albireo_wire::{SettingSource, Threshold, VERSION, check_version};
use axum::Json;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::Arc;
use utoipa::ToSchema;

/// A threshold as users write it, the value under the policy's name for it: `"u": 3e-4`. Empty when the policy has none.
type NamedValue = BTreeMap<String, f64>;

fn named(threshold: Option<Threshold>) -> NamedValue {
    threshold
        .map(|threshold| (threshold.name.to_string(), threshold.value))
        .into_iter()
        .collect()
}

/// A new threshold: `{"u": 3e-4}`, or `{"lambda": 0.3}` under expected-loss.
#[derive(Deserialize, ToSchema)]
pub(super) struct NewThreshold {
    /// Version of the message; may be left out.
    v: Option<u32>,
    #[serde(flatten, with = "serde_with::rust::maps_duplicate_key_is_error")]
    #[schema(value_type = BTreeMap<String, f64>)]
    value: NamedValue,
}

/// One camera's threshold.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraThreshold {
    /// Camera.
    camera: String,
    /// The value in force from its next frame on; absent when the policy has none.
    #[serde(flatten)]
    #[schema(value_type = BTreeMap<String, f64>)]
    value: NamedValue,
    /// Its name in the policy, its range and its default; absent if the policy has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    threshold_spec: Option<ThresholdSpec>,
    /// True if what was set at run time survives a restart: a `state_dir` is set, and the settings are written there.
    survives_restart: bool,
}

/// The thresholds of a node.
#[derive(Serialize, ToSchema)]
pub(super) struct Thresholds {
    /// The value in force, if all cameras have the same.
    #[serde(flatten)]
    #[schema(value_type = BTreeMap<String, f64>)]
    value: NamedValue,
    /// True if values set at run time survive a restart.
    survives_restart: bool,
    /// The thresholds of each camera.
    cameras: Vec<CameraThreshold>,
}

fn of(shared: &RouteState, camera: &CameraBoard) -> CameraThreshold {
    CameraThreshold {
        camera: camera.name().to_owned(),
        value: named(camera.threshold_in_force()),
        threshold_spec: camera.threshold_spec(),
        survives_restart: shared.settings.survive_restart(),
    }
}

fn thresholds(shared: &RouteState) -> Thresholds {
    let cameras: Vec<_> = shared.board.cameras.iter().map(|camera| of(shared, camera)).collect();
    let value = match cameras.first() {
        Some(first) if cameras.iter().all(|camera| camera.value == first.value) => {
            first.value.clone()
        }
        _ => NamedValue::new(),
    };
    Thresholds {
        value,
        survives_restart: shared.settings.survive_restart(),
        cameras,
    }
}

/// Sets the threshold of these cameras to the value in a request.
async fn put(
    shared: &RouteState,
    cameras: Vec<Arc<CameraBoard>>,
    headers: &HeaderMap,
    body: &Bytes,
) -> Result<(), Problem> {
    // All cameras have the node's policy.
    let Some(spec) = cameras.first().and_then(|camera| camera.threshold_spec()) else {
        let policy = shared.board.policy().name;
        let absent = InvalidThreshold::Absent { policy }.to_string();
        return Err(Problem::new(StatusCode::CONFLICT, absent));
    };
    let expected = format!(
        "a JSON object such as {{\"{}\": {}}} with {}",
        spec.name,
        short(spec.default),
        spec.range()
    );
    let fault = |what: &dyn Display| {
        let detail = format!("the body must be {expected}: {what}");
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail).with_threshold_spec(spec)
    };
    let sent: NewThreshold =
        message(headers, body, &expected).map_err(|problem| problem.with_threshold_spec(spec))?;
    check_version(sent.v.unwrap_or(VERSION)).map_err(|error| fault(&error))?;
    let mut values = sent.value.into_iter();
    let (Some((name, value)), None) = (values.next(), values.next()) else {
        return Err(fault(&"it must have exactly one value"));
    };
    let threshold = Threshold::new(&name, value);
    let local = SettingSource::Local;
    let settings = Arc::clone(&shared.settings);
    let place = settings.turns.place();
    let set = move || {
        settings.set_in_turn(place, |transaction| {
            transaction.thresholds(&cameras, threshold, local)
        })
    };
    off_the_runtime(set).await?.map_err(|error| fault(&error))
}

/// The thresholds in force
///
/// `curl http://127.0.0.1:8080/api/v1/threshold`
#[utoipa::path(get, operation_id = "thresholds", path = "/api/v1/threshold", tag = "threshold", responses((status = 200, body = Thresholds)))]
pub(super) async fn get_all(State(shared): State<RouteState>) -> Json<Thresholds> {
    Json(thresholds(&shared))
}

/// Changes the threshold of all cameras, or of none
///
/// Applies from each camera's next frame. The threshold has the policy's name for it: `u`, or `lambda` under
/// expected-loss.
/// `curl -X PUT -d '{"u": 5e-4}' http://127.0.0.1:8080/api/v1/threshold`
#[utoipa::path(
    put, operation_id = "set_thresholds", path = "/api/v1/threshold", tag = "threshold", request_body = NewThreshold,
    responses((status = 200, body = Thresholds))
)]
pub(super) async fn put_all(
    State(shared): State<RouteState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Thresholds>, Problem> {
    let cameras = shared.board.cameras.clone();
    put(&shared, cameras, &headers, &body).await?;
    Ok(Json(thresholds(&shared)))
}

/// A camera's threshold in force
///
/// `curl http://127.0.0.1:8080/api/v1/cameras/front/threshold`
#[utoipa::path(
    get, operation_id = "camera_threshold", path = "/api/v1/cameras/{camera}/threshold", tag = "threshold",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses((status = 200, body = CameraThreshold))
)]
pub(super) async fn get_one(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Json<CameraThreshold>, Problem> {
    let camera = shared.camera(&camera)?;
    Ok(Json(of(&shared, camera)))
}

/// Changes a camera's threshold
///
/// Applies from the camera's next frame.
/// `curl -X PUT -d '{"u": 5e-4}' http://127.0.0.1:8080/api/v1/cameras/front/threshold`
#[utoipa::path(
    put, operation_id = "set_camera_threshold", path = "/api/v1/cameras/{camera}/threshold", tag = "threshold", request_body = NewThreshold,
    params(("camera" = String, Path, description = "The camera's name.")),
    responses((status = 200, body = CameraThreshold))
)]
pub(super) async fn put_one(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<CameraThreshold>, Problem> {
    let camera = shared.camera(&camera)?;
    put(&shared, vec![Arc::clone(camera)], &headers, &body).await?;
    Ok(Json(of(&shared, camera)))
}
