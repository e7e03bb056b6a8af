//! The routes that read and set the pause on an empty road.

use super::RouteState;
use super::body::{message, off_the_runtime};
use crate::settings::RefusedPause;
use albireo_service::http::Problem;
use albireo_wire::Pauses;
use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use serde::Serialize;
use std::sync::Arc;
use utoipa::ToSchema;

const EXPECTED: &str = "a JSON object such as {\"pause_s\": 0.2}, with seconds; `after_s` and `still_s` may follow, and 0 \
                        means no pause";

/// What the pause means for a camera.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraPause {
    /// Camera.
    camera: String,
    /// Its measured frames per second; absent before its second frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    frames_per_second: Option<f64>,
    /// On an empty road, one frame in this many is looked at: 1 if the pause is shorter than two frames at this rate.
    looks_at_one_in: u32,
}

/// The pause on an empty road.
#[derive(Serialize, ToSchema)]
pub(super) struct Pause {
    /// Seconds from one look at an empty road to the next; 0 looks at every frame.
    pause_s: f64,
    /// Seconds without a detection after which the road is empty.
    after_s: f64,
    /// Seconds from one look at a picture without news to the next; 0 compares no pictures. Works under every policy that
    /// looks at no pictures itself.
    still_s: f64,
    /// False if the policy takes no pause on an empty road: it does not call the detector whenever nothing is tracked.
    applies: bool,
    /// True if what was set at run time survives a restart.
    survives_restart: bool,
    /// What it means for each camera.
    cameras: Vec<CameraPause>,
}

fn pause(shared: &RouteState) -> Pause {
    let board = &shared.board;
    let empty_road = board.empty_road();
    let cameras = board.cameras.iter().map(|camera| {
        let rate = camera.rate();
        CameraPause {
            camera: camera.name().to_owned(),
            frames_per_second: rate.map(|rate| (rate * 10.0).round() / 10.0),
            looks_at_one_in: empty_road.frames(rate).every.max(1),
        }
    });
    Pause {
        pause_s: empty_road.pause_s,
        after_s: empty_road.after_s,
        still_s: empty_road.still_s,
        applies: board.can_pause(),
        survives_restart: shared.settings.survive_restart(),
        cameras: cameras.collect(),
    }
}

/// The pause on an empty road
///
/// `curl http://127.0.0.1:8080/api/v1/screen`
#[utoipa::path(get, operation_id = "screen", path = "/api/v1/screen", tag = "threshold", responses((status = 200, body = Pause)))]
pub(super) async fn get(State(shared): State<RouteState>) -> Json<Pause> {
    Json(pause(&shared))
}

/// Changes the pause on an empty road, of all cameras
///
/// Applies from each camera's next frame. Once nothing was detected for `after_s`, one frame per `pause_s` is looked at
/// until something is found; the others are answered with state E. With `still_s`, one frame per so many seconds is looked at
/// while the picture does not change.
/// `curl -X PUT -d '{"pause_s": 0.2}' http://127.0.0.1:8080/api/v1/screen`
#[utoipa::path(
    put, operation_id = "set_screen", path = "/api/v1/screen", tag = "threshold", request_body = Pauses,
    responses((status = 200, body = Pause))
)]
pub(super) async fn put(
    State(shared): State<RouteState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Pause>, Problem> {
    let sent: Pauses = message(&headers, &body, EXPECTED)?;
    let settings = Arc::clone(&shared.settings);
    let place = settings.turns.place();
    let set = move || settings.set_in_turn(place, |transaction| transaction.pauses(sent));
    off_the_runtime(set).await?.map_err(|refused| {
        let status = match refused {
            RefusedPause::OutOfRange(..) | RefusedPause::Nothing => {
                StatusCode::UNPROCESSABLE_ENTITY
            }
            RefusedPause::NoPause(_) => StatusCode::CONFLICT,
        };
        Problem::new(status, refused.to_string())
    })?;
    Ok(Json(pause(&shared)))
}
