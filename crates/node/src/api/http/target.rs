//! The routes that read and set the target.

use super::RouteState;
use super::body::{message, off_the_runtime};
use albireo_service::http::Problem;
use albireo_wire::{SettingSource, Target, TargetMessage, TargetReport, check_version};
use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use std::sync::Arc;

const EXPECTED: &str =
    "a JSON object such as {\"target\": {\"skip_rate\": 0.5}}, or {\"target\": null} for none";

/// The target and its state
///
/// `curl http://127.0.0.1:8080/api/v1/target`
#[utoipa::path(get, operation_id = "target", path = "/api/v1/target", tag = "threshold", responses((status = 200, body = TargetReport)))]
pub(super) async fn get(State(shared): State<RouteState>) -> Json<TargetReport> {
    Json(shared.board.target.report())
}

/// Sets a target instead of a threshold
///
/// One of `recall` (against the detector, the lower end of its interval), `skip_rate` and `watts`, or null for none. A
/// controller then moves the threshold of all cameras together, inside its range; setting the threshold by hand
/// switches it off.
/// `curl -X PUT -d '{"target": {"skip_rate": 0.5}}' http://127.0.0.1:8080/api/v1/target`
#[utoipa::path(
    put, operation_id = "set_target", path = "/api/v1/target", tag = "threshold", request_body = TargetMessage,
    responses((status = 200, body = TargetReport))
)]
pub(super) async fn put(
    State(shared): State<RouteState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<TargetReport>, Problem> {
    let refused =
        |what: String| Problem::new(StatusCode::UNPROCESSABLE_ENTITY, what).allowing(Target::NAMES);
    let message: TargetMessage = message(&headers, &body, EXPECTED)?;
    check_version(message.v).map_err(|error| refused(error.to_string()))?;
    let settings = Arc::clone(&shared.settings);
    let local = SettingSource::Local;
    let place = settings.turns.place();
    let set = move || {
        settings.set_in_turn(place, |transaction| {
            transaction.target(message.target, local)
        })
    };
    off_the_runtime(set).await?.map_err(|error| refused(error.to_string()))?;
    Ok(Json(shared.board.target.report()))
}
