//! The route that returns a camera's latest picture.

use super::RouteState;
use albireo_service::http::Problem;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// The header with the frame's sequence number, as in its detections.
const FRAME: HeaderName = HeaderName::from_static("albireo-frame");

/// The latest picture received from a camera
///
/// The header `albireo-frame` has the sequence number of the frame.
/// `curl -o frame.jpg http://127.0.0.1:8080/api/v1/cameras/front/frame.jpg`
#[utoipa::path(
    get, operation_id = "camera_picture", path = "/api/v1/cameras/{camera}/frame.jpg", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name.")),
    responses(
        (status = 200, body = Vec<u8>, content_type = "image/jpeg",
         headers(("albireo-frame" = u64, description = "Sequence number of the frame."))),
    )
)]
pub(super) async fn jpeg(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
) -> Result<Response, Problem> {
    let board = shared.camera(&camera)?;
    // Decodes one picture at a time, and finishes even if the request is gone: the next request can use the picture.
    let turn = Arc::clone(&shared.decoding).lock_owned().await;
    let frame = board.input.latest_frame().ok_or_else(|| {
        let detail = format!("no picture has arrived from camera `{camera}` yet");
        Problem::new(StatusCode::NOT_FOUND, detail)
    })?;
    let (picture, decoded, limits) = (Arc::clone(&frame), shared.decoded.clone(), shared.limits);
    let making = tokio::task::spawn_blocking(move || {
        let _turn = turn;
        if !picture.is_made() {
            decoded.fetch_add(1, Ordering::Relaxed);
        }
        picture.jpeg(&limits)
    });
    let file = making.await.unwrap_or_else(|error| Err(error.to_string()));
    let bytes = file.map_err(|reason| {
        let detail = format!("the latest picture of camera `{camera}` cannot be shown: {reason}");
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    })?;
    let headers = [
        (CONTENT_TYPE, "image/jpeg".to_owned()),
        (CACHE_CONTROL, "no-store".to_owned()),
        (FRAME, frame.seq.to_string()),
    ];
    Ok((headers, bytes).into_response())
}
