//! Returns the recent past of a node, for a page that was just opened.

use super::{RouteState, bad_request};
use crate::state::board::{
    CameraPiece, Clock, FRAMES, PastFrame, PowerPiece, SLOT_S, SkipEstimate,
};
use albireo_core::policy::{CallCause, FrameState};
use albireo_service::http::{Problem, within};
use albireo_wire::Threshold;
use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// The amount of history.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HistorySelection {
    /// Maximum number of frames, 0 to 8192; 3000 by default.
    frames: Option<usize>,
}

/// The last frames in columns: the n-th entry of each belongs to the n-th frame, the oldest first.
#[derive(Default, Serialize, ToSchema)]
pub(super) struct PastFrames {
    /// Sequence number.
    seq: Vec<u64>,
    /// Milliseconds between its answer and `now_ms`.
    age_ms: Vec<u64>,
    /// Frame state.
    state: Vec<FrameState>,
    /// Cause of the detector call; null if there was none.
    cause: Vec<Option<CallCause>>,
    /// True if the detector was needed but not available.
    degraded: Vec<bool>,
    /// Boxes reported.
    boxes: Vec<u16>,
    /// Largest uncertainty before the decision; null without objects.
    tau_max: Vec<Option<f32>>,
    /// Threshold in force; null if the policy has none.
    threshold: Vec<Option<f32>>,
    /// Milliseconds of the detector; null if it did not run.
    detector_ms: Vec<Option<f32>>,
    /// Milliseconds from reception to publication.
    total_ms: Vec<f32>,
}

/// Recent frames of a camera.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraHistory {
    /// Camera.
    camera: String,
    /// The node's clock now, milliseconds since the Unix epoch.
    now_ms: i64,
    /// Length of a piece of the hour, seconds.
    slot_s: u64,
    /// The last hour in pieces, the oldest first, the last one still open; pieces without a frame are left out.
    slots: Vec<CameraPiece>,
    /// The last frames.
    frames: PastFrames,
    /// How many of the last of these the policy in force decided: the uncertainties and thresholds of others are those of another
    /// policy.
    of_policy: usize,
}

fn columns(frames: &[PastFrame], clock: &Clock) -> PastFrames {
    let mut columns = PastFrames::default();
    for frame in frames {
        columns.seq.push(frame.seq);
        columns.age_ms.push(clock.before_now_ms(frame.at_ms));
        columns.state.push(frame.state);
        columns.cause.push(frame.cause);
        columns.degraded.push(frame.degraded);
        columns.boxes.push(frame.boxes);
        columns.tau_max.push(frame.tau_max);
        columns.threshold.push(frame.threshold);
        columns.detector_ms.push(frame.detector_ms);
        columns.total_ms.push(frame.total_ms);
    }
    columns
}

/// A camera's last minutes frame by frame, and its last hour in pieces
///
/// The node always keeps the newest 8192 frames and 360 pieces of ten seconds in memory.
/// `curl 'http://127.0.0.1:8080/api/v1/cameras/front/history?frames=100'`
#[utoipa::path(
    get, operation_id = "camera_history", path = "/api/v1/cameras/{camera}/history", tag = "frames",
    params(("camera" = String, Path, description = "The camera's name."), HistorySelection),
    responses((status = 200, body = CameraHistory))
)]
pub(super) async fn camera(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
    Query(selection): Query<HistorySelection>,
) -> Result<Json<CameraHistory>, Problem> {
    let most = within("frames", selection.frames.unwrap_or(3000), 0..=FRAMES)?;
    let camera = shared.camera(&camera)?;
    let past = camera.past(most);
    Ok(Json(CameraHistory {
        camera: camera.name().to_owned(),
        now_ms: past.now.now_ms,
        slot_s: SLOT_S,
        frames: columns(&past.frames, &past.now),
        of_policy: past.of_policy,
        slots: past.pieces,
    }))
}

/// Power over the last hour.
#[derive(Serialize, ToSchema)]
pub(super) struct PowerHistory {
    /// Length of a piece, seconds.
    slot_s: u64,
    /// The finished pieces, the oldest first; pieces without a figure are left out.
    slots: Vec<PowerPiece>,
}

/// The node's power over the last hour, in pieces
///
/// `curl http://127.0.0.1:8080/api/v1/power`
#[utoipa::path(get, operation_id = "power_history", path = "/api/v1/power", tag = "energy", responses((status = 200, body = PowerHistory)))]
pub(super) async fn power(State(shared): State<RouteState>) -> Json<PowerHistory> {
    Json(PowerHistory {
        slot_s: SLOT_S,
        slots: shared.board.power_past(),
    })
}

/// The threshold values to estimate.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Values {
    /// Values of the threshold, separated by commas, at most 64; by default 41, from a hundredth of the default threshold to a
    /// hundred times it.
    values: Option<String>,
}

/// Estimates of the frames that other thresholds would have skipped over the last minutes.
#[derive(Serialize, ToSchema)]
pub(super) struct SkipEstimates {
    /// Camera.
    camera: String,
    /// Always true: under another value other frames would have been matched, so objects would have evolved differently.
    /// Recorded uncertainties are scaled by how they grew with the time since a call.
    estimated: bool,
    #[serde(flatten)]
    estimate: SkipEstimate,
    /// The threshold in force.
    threshold: Threshold,
}

/// The maximum number of values per request.
const MOST_VALUES: usize = 64;

/// Reads the values of a request.
fn thresholds(text: &str) -> Result<Vec<f64>, Problem> {
    let parsed: Result<Vec<f64>, _> = text.split(',').map(|value| value.trim().parse()).collect();
    let is_positive = |value: &f64| *value > 0.0 && value.is_finite();
    match parsed {
        Ok(values) if values.len() <= MOST_VALUES && values.iter().all(is_positive) => Ok(values),
        _ => Err(bad_request(format!(
            "`values` must be at most {MOST_VALUES} numbers above 0, separated by commas"
        ))),
    }
}

/// The frames that other thresholds would have skipped over the last minutes
///
/// An estimate from the uncertainties that were recorded frame by frame, for the threshold `u`; 409 for another
/// threshold, and while nothing is recorded.
/// `curl 'http://127.0.0.1:8080/api/v1/cameras/front/skip-estimate?values=1e-4,3e-4,1e-3'`
#[utoipa::path(
    get, operation_id = "skip_estimate", path = "/api/v1/cameras/{camera}/skip-estimate", tag = "threshold",
    params(("camera" = String, Path, description = "The camera's name."), Values),
    responses((status = 200, body = SkipEstimates))
)]
pub(super) async fn skip_estimate(
    State(shared): State<RouteState>,
    Path(camera): Path<String>,
    Query(values): Query<Values>,
) -> Result<Json<SkipEstimates>, Problem> {
    let camera = shared.camera(&camera)?;
    let cannot = |why: &str| Problem::new(StatusCode::CONFLICT, why);
    let (Some(threshold), Some(about)) = (camera.threshold_in_force(), camera.threshold_spec())
    else {
        return Err(cannot("the policy has no threshold to estimate with"));
    };
    if threshold.name.as_str() != "u" {
        let why = format!(
            "only the threshold `u` can be estimated; the threshold of this policy is `{}`",
            threshold.name
        );
        return Err(cannot(&why));
    }
    let values = match values.values.as_deref() {
        Some(text) => thresholds(text)?,
        None => (0..=40)
            .map(|step| about.default * 10_f64.powf((f64::from(step) - 20.0) / 10.0))
            .collect(),
    };
    // Takes some milliseconds, so it must not run on a thread that frames wait for.
    let name = camera.name().to_owned();
    let camera = std::sync::Arc::clone(camera);
    let computed = tokio::task::spawn_blocking(move || camera.skip_estimate(&values));
    let Ok(Some(estimate)) = computed.await else {
        return Err(cannot("no frame after a detector call is recorded yet"));
    };
    Ok(Json(SkipEstimates {
        camera: name,
        estimated: true,
        estimate,
        threshold,
    }))
}
