//! Which cameras there are.

use super::RouteState;
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// A camera.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraEntry {
    /// Its name.
    camera: String,
    /// Zenoh key its frames come on.
    key: String,
    /// Frames processed since the node started.
    frames: u64,
    /// Clips ended since the node started.
    clips: u64,
    /// Seconds since its newest frame; absent before the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    last_frame_age_s: Option<f64>,
    /// Columns of its newest frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    width: Option<u32>,
    /// Rows of its newest frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    height: Option<u32>,
}

/// The cameras of a node.
#[derive(Serialize, ToSchema)]
pub(super) struct Cameras {
    /// In the order of the configuration.
    cameras: Vec<CameraEntry>,
}

/// The cameras
///
/// `curl http://127.0.0.1:8080/api/v1/cameras`
#[utoipa::path(get, operation_id = "list_cameras", path = "/api/v1/cameras", tag = "frames", responses((status = 200, body = Cameras)))]
pub(super) async fn list(State(shared): State<RouteState>) -> Json<Cameras> {
    let cameras = shared
        .board()
        .cameras()
        .iter()
        .map(|camera| {
            let snapshot = camera.snapshot();
            CameraEntry {
                camera: camera.name().to_owned(),
                key: camera.key().to_owned(),
                frames: snapshot.states.frames(),
                clips: snapshot.clips,
                last_frame_age_s: snapshot.last_frame_age.map(|age| age.as_secs_f64()),
                width: snapshot.latest.as_ref().map(|latest| latest.width),
                height: snapshot.latest.as_ref().map(|latest| latest.height),
            }
        })
        .collect();
    Json(Cameras { cameras })
}
