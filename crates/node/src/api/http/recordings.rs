//! The routes that show the recordings and ask for one.

use super::RouteState;
use super::body::message;
use crate::recorder::RecordingStatus;
use albireo_service::http::Problem;
use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use serde::Deserialize;
use std::time::Duration;
use utoipa::ToSchema;

const EXPECTED: &str =
    "empty, or a JSON object such as {\"reason\": \"braking\", \"camera\": \"front\"}";

/// The longest reason, bytes: it is a word or two for who looks at the recording.
const LONGEST_REASON: usize = 200;

/// A camera without a frame for this long sends none.
const SILENT: Duration = Duration::from_secs(10);

/// A request for a recording: `{"reason": "braking"}`.
#[derive(Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct NewRecording {
    /// Why, in a few words, which the recording keeps.
    reason: Option<String>,
    /// The camera; all cameras by default.
    camera: Option<String>,
}

/// The recordings
///
/// `curl http://127.0.0.1:8080/api/v1/recordings`
#[utoipa::path(get, operation_id = "recordings", path = "/api/v1/recordings", tag = "recordings", responses((status = 200, body = RecordingStatus)))]
pub(super) async fn get(State(shared): State<RouteState>) -> Json<RecordingStatus> {
    Json(status(&shared, None))
}

/// The status of the recordings, with what keeps one camera's or all cameras' frames away.
fn status(shared: &RouteState, camera: Option<usize>) -> RecordingStatus {
    let mut status = shared.recorder.status();
    if status.folder.is_none() {
        return status;
    }
    let cameras = &shared.board.cameras;
    let wanted = match camera {
        Some(place) => &cameras[place..=place],
        None => cameras.as_slice(),
    };
    let mut silent = Vec::new();
    for camera in wanted {
        if camera.snapshot().last_frame_age().is_none_or(|age| age > SILENT) {
            silent.push(camera.name());
        }
    }
    if !silent.is_empty() {
        let names = silent.join(", ");
        status.missing = Some(format!(
            "no frames come from {names}: nothing is recorded until they do; /readyz says why, and a camera without `source` \
             needs a sender, such as `albireo replay`"
        ));
    }
    status
}

/// Records what happens now
///
/// Keeps the last `record.before_s` seconds and the next `record.after_s` of one camera or of all; a request while a
/// recording runs prolongs it. Answers 409 if the node has no `record.folder`.
/// `curl -X PUT -d '{"reason": "braking"}' http://127.0.0.1:8080/api/v1/recordings`
#[utoipa::path(
    put, operation_id = "record", path = "/api/v1/recordings", tag = "recordings", request_body = NewRecording,
    responses((status = 202, body = RecordingStatus))
)]
pub(super) async fn put(
    State(shared): State<RouteState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<(StatusCode, Json<RecordingStatus>), Problem> {
    let wanted: NewRecording = if body.is_empty() {
        NewRecording::default()
    } else {
        message(&headers, &body, EXPECTED)?
    };
    let camera = match &wanted.camera {
        Some(name) => Some(shared.camera_place(name)?),
        None => None,
    };
    let reason = wanted.reason.as_deref().unwrap_or("request");
    if reason.len() > LONGEST_REASON {
        let detail = format!(
            "the reason has {} bytes; at most {LONGEST_REASON}",
            reason.len()
        );
        return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail));
    }
    let is_recorded = shared.recorder.event(camera, reason);
    if !is_recorded {
        let detail = "nothing is recorded here: set record.folder in the configuration";
        return Err(Problem::new(StatusCode::CONFLICT, detail));
    }
    Ok((StatusCode::ACCEPTED, Json(status(&shared, camera))))
}
