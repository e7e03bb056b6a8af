//! The latest picture of a camera.

use super::RouteState;
use crate::frame::to_jpeg;
use albireo_service::http::Problem;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};

/// Which frame it is: its sequence number, as in the frame's detections.
const FRAME: HeaderName = HeaderName::from_static("albireo-frame");

/// The latest picture received from a camera
///
/// The header `albireo-frame` has the sequence number of the frame.
/// `curl -o frame.jpg http://127.0.0.1:8080/api/v1/cameras/front/frame.jpg`
#[utoipa::path(
    get, path = "/api/v1/cameras/{camera}/frame.jpg", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses(
        (status = 200, body = Vec<u8>, content_type = "image/jpeg",
         headers(("albireo-frame" = u64, description = "Sequence number of the frame."))),
        (status = 404, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn jpeg(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Response, Problem> {
    let Some(frame) = shared.camera(&camera)?.latest_frame() else {
        let detail = format!("no picture came from camera `{camera}` yet");
        return Err(Problem::new(StatusCode::NOT_FOUND, detail));
    };
    let failed = |reason: String| {
        let detail = format!("the latest picture of camera `{camera}` cannot be shown: {reason}");
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    };
    let limits = shared.view.limits;
    // Decoding and encoding a picture takes milliseconds of a core.
    let bytes = tokio::task::spawn_blocking(move || to_jpeg(&frame.picture, &limits))
        .await
        .map_err(|error| failed(error.to_string()))?
        .map_err(|fault| failed(fault.to_string()))?;
    let headers = [
        (CONTENT_TYPE, "image/jpeg".to_owned()),
        (CACHE_CONTROL, "no-store".to_owned()),
        (FRAME, frame.seq.to_string()),
    ];
    Ok((headers, bytes).into_response())
}
