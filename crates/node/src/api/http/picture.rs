//! The routes that return a camera's pictures: the latest one, and a stream with boxes.

use super::RouteState;
use crate::frame::AnsweredFrame;
use albireo_service::http::{Problem, within};
use axum::body::Body;
use axum::extract::{Path, Query, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream::{self, StreamExt};
use serde::Deserialize;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::{Instant, sleep_until};
use utoipa::IntoParams;

/// The header with the frame's sequence number, as in its detections.
const FRAME: HeaderName = HeaderName::from_static("albireo-frame");

/// The maximum number of concurrent picture streams of a node: each holds a connection and some pictures.
pub(super) const MOST_VIEWERS: usize = 16;
/// The most pictures per second of a stream.
const MOST_RATE: usize = 30;
/// Pictures per second of a stream by default.
const USUAL_RATE: usize = 10;
/// The line between two pictures of a stream. It follows each picture at once: browsers show a picture when they read it.
const BOUNDARY: &str = "--frame\r\n";

/// What is drawn on a picture.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Drawing {
    /// True for the newest answered picture with its boxes: solid where detected, dashed where predicted.
    #[serde(default)]
    boxes: bool,
}

/// The speed of a stream.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Speed {
    /// Pictures per second at most, 1 to 30; 10 by default.
    rate: Option<usize>,
}

/// The latest picture received from a camera
///
/// The header `albireo-frame` has the sequence number of the frame.
/// `curl -o frame.jpg 'http://127.0.0.1:8080/api/v1/cameras/front/frame.jpg?boxes=true'`
#[utoipa::path(
    get, operation_id = "camera_picture", path = "/api/v1/cameras/{camera}/frame.jpg", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name."), Drawing),
    responses(
        (status = 200, body = Vec<u8>, content_type = "image/jpeg",
         headers(("albireo-frame" = u64, description = "Sequence number of the frame."))),
    )
)]
pub(super) async fn jpeg(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
    Query(Drawing { boxes }): Query<Drawing>,
) -> Result<Response, Problem> {
    let board = shared.camera(&camera)?;
    let none = || {
        let detail = format!("no picture has arrived from camera `{camera}` yet");
        Problem::new(StatusCode::NOT_FOUND, detail)
    };
    let (seq, file) = if boxes {
        let frame = board.answered().borrow().clone().ok_or_else(none)?;
        (frame.seq(), draw(&shared, &frame).await)
    } else {
        // Decodes one picture at a time, and finishes even if the request is gone: the next request can use the picture.
        let turn = Arc::clone(&shared.decoding).lock_owned().await;
        let frame = board.input.latest_frame().ok_or_else(none)?;
        let picture = Arc::clone(&frame);
        let decoded = Arc::clone(&shared.decoded);
        let limits = shared.limits;
        let making = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            if !picture.is_made() {
                decoded.fetch_add(1, Ordering::Relaxed);
            }
            picture.jpeg(&limits)
        });
        let file = making.await.unwrap_or_else(|error| Err(error.to_string()));
        (frame.seq, file)
    };
    let bytes = file.map_err(|reason| {
        let detail = format!("the latest picture of camera `{camera}` cannot be shown: {reason}");
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    })?;
    let headers = [
        (CONTENT_TYPE, "image/jpeg".to_owned()),
        (CACHE_CONTROL, "no-store".to_owned()),
        (FRAME, seq.to_string()),
    ];
    Ok((headers, bytes).into_response())
}

/// Draws a frame's boxes, one picture at a time of all cameras.
async fn draw(shared: &RouteState, frame: &Arc<AnsweredFrame>) -> Result<Bytes, String> {
    let turn = Arc::clone(&shared.decoding).lock_owned().await;
    let frame = Arc::clone(frame);
    let limits = shared.limits;
    let drawing = tokio::task::spawn_blocking(move || {
        let _turn = turn;
        frame.drawn(&limits)
    });
    drawing.await.unwrap_or_else(|error| Err(error.to_string()))
}

/// A camera's pictures with boxes, as motion JPEG
///
/// For whatever shows a camera by its address: a browser, Home Assistant, VLC, ffmpeg. A slow reader gets fewer pictures,
/// never old ones; each picture is drawn once for all readers. Boxes are solid where detected, dashed where predicted.
/// While no frame arrives, none is sent. 503 while 16 streams are open.
/// `curl -N -o front.mjpg 'http://127.0.0.1:8080/api/v1/cameras/front/stream.mjpg?rate=5'` keeps it; players show it:
/// `ffplay 'http://127.0.0.1:8080/api/v1/cameras/front/stream.mjpg?rate=5'`
#[utoipa::path(
    get, operation_id = "camera_stream", path = "/api/v1/cameras/{camera}/stream.mjpg", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name."), Speed),
    responses(
        (status = 200, body = Vec<u8>, content_type = "multipart/x-mixed-replace",
         description = "JPEG files; `albireo-frame` of each part is the sequence number of the frame."),
    )
)]
pub(super) async fn mjpeg(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
    Query(Speed { rate }): Query<Speed>,
) -> Result<Response, Problem> {
    let mut answered = shared.camera(&camera)?.answered();
    // The picture that is there already is the first one.
    answered.mark_changed();
    let rate = within("rate", rate.unwrap_or(USUAL_RATE), 1..=MOST_RATE)?;
    let pause = Duration::from_secs(1) / u32::try_from(rate).unwrap_or(1);
    let place = Arc::clone(&shared.viewers).try_acquire_owned().map_err(|_| {
        let detail = format!(
            "all {MOST_VIEWERS} picture streams are in use; close one and try again, or ask for `frame.jpg?boxes=true`"
        );
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
    })?;
    let shutdown = shared.shutdown.clone().cancelled_owned();
    let viewer = Viewer {
        shared,
        answered,
        next_at: Instant::now(),
        pause,
        _place: place,
    };
    let parts = stream::unfold(viewer, |mut viewer| async move {
        let part = viewer.next().await?;
        Some((part, viewer))
    });
    let first = stream::once(std::future::ready(Bytes::from_static(BOUNDARY.as_bytes())));
    let parts = first.chain(parts).take_until(shutdown);
    let headers = [
        (CONTENT_TYPE, "multipart/x-mixed-replace; boundary=frame"),
        (CACHE_CONTROL, "no-store"),
    ];
    let body = Body::from_stream(parts.map(Ok::<_, Infallible>));
    Ok((headers, body).into_response())
}

/// The reader of a picture stream.
struct Viewer {
    shared: RouteState,
    answered: watch::Receiver<Option<Arc<AnsweredFrame>>>,
    /// The earliest time of its next picture.
    next_at: Instant,
    pause: Duration,
    /// Its place among the readers, given up when the stream is dropped.
    _place: OwnedSemaphorePermit,
}

impl Viewer {
    /// The next part of the stream; `None` at its end.
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            self.answered.changed().await.ok()?;
            sleep_until(self.next_at).await;
            let Some(frame) = self.answered.borrow_and_update().clone() else {
                continue;
            };
            self.next_at = Instant::now() + self.pause;
            // A picture that cannot be decoded is counted where its frame is.
            if let Ok(file) = draw(&self.shared, &frame).await {
                return Some(part(frame.seq(), &file));
            }
        }
    }
}

/// One part of a stream, with the boundary that ends it.
fn part(seq: u64, file: &[u8]) -> Bytes {
    let head = format!(
        "Content-Type: image/jpeg\r\nContent-Length: {}\r\n{FRAME}: {seq}\r\n\r\n",
        file.len()
    );
    [head.as_bytes(), file, b"\r\n", BOUNDARY.as_bytes()].concat().into()
}
