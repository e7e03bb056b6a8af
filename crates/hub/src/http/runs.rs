//! Serves rollouts and trials, and their commands.

use super::body;
use crate::hub::Hub;
use crate::tuning::plan::{RolloutPlan, TrialPlan};
use crate::tuning::run::{Command, Kind, Run};
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Caller, Problem, within};
use axum::Json;
use axum::body::Bytes;
use axum::extract::{Extension, Path, Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

/// Most rollouts or trials per answer.
const MOST: i64 = 200;

/// Selects rollouts or trials.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct Which {
    /// Only those with a lower number.
    before: Option<i64>,
    /// Maximum number, up to 200; 20 by default.
    limit: Option<i64>,
}

/// Rollouts or trials, the newest first.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Runs {
    /// One entry per run, without its record and nodes.
    pub runs: Vec<Run>,
    /// The `before` of the next page; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<i64>,
}

/// A page of runs.
async fn page(hub: &Hub, kind: &str, which: &Which) -> Result<Json<Runs>, Problem> {
    let limit = within("limit", which.limit.unwrap_or(20), 1..=MOST)?;
    let before = which.before.unwrap_or(i64::MAX);
    let mut runs = hub.store()?.runs(kind, before, limit + 1).await?;
    let next = body::cut_page(&mut runs, limit, |run| run.id);
    for run in &mut runs {
        run.record.clear();
        run.members.clear();
    }
    Ok(Json(Runs { runs, next }))
}

async fn begin(hub: &Hub, kind: Kind, caller: &Caller) -> Result<(StatusCode, Json<Run>), Problem> {
    let now = unix_milliseconds();
    let begun = hub.tuner()?.begin(kind, &caller.name, now).await?;
    Ok((StatusCode::CREATED, Json(begun)))
}

/// Executes a command, and shows the run after it.
async fn carry_out(
    hub: &Hub,
    kind: &str,
    id: i64,
    command: Command,
    caller: &Caller,
) -> Result<Json<Run>, Problem> {
    let tuner = hub.tuner()?;
    let now = unix_milliseconds();
    tuner.command(kind, id, command, &caller.name, now).await?;
    tuner.run(kind, id).await.map(Json)
}

/// Begins a rollout
///
/// The body is its plan with the new threshold beside it:
/// `{"u": 5e-4, "select": ["cam-*"], "stages": ["1", "10%", "50%", "90%"], "soak_s": 1800, "gates": ["joules<=+5%"]}`.
#[utoipa::path(
    post, operation_id = "begin_rollout", path = "/api/v1/rollouts", tag = "tuning", request_body = RolloutPlan,
    responses((status = 201, body = Run))
)]
pub(super) async fn begin_rollout(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    bytes: Bytes,
) -> Result<(StatusCode, Json<Run>), Problem> {
    let (to, plan): (_, RolloutPlan) = body::with_threshold(body::object(&bytes)?)?;
    begin(&hub, Kind::Rollout { to, plan }, &caller).await
}

/// Rollouts, the newest first
#[utoipa::path(
    get, operation_id = "list_rollouts", path = "/api/v1/rollouts", tag = "tuning", params(Which),
    responses((status = 200, body = Runs))
)]
pub(super) async fn rollouts(
    State(hub): State<Hub>,
    Query(which): Query<Which>,
) -> Result<Json<Runs>, Problem> {
    page(&hub, "rollout", &which).await
}

/// A rollout with its record and its nodes
#[utoipa::path(
    get, operation_id = "rollout", path = "/api/v1/rollouts/{id}", tag = "tuning", params(("id" = i64, Path, description = "Its number.")),
    responses((status = 200, body = Run))
)]
pub(super) async fn one_rollout(
    State(hub): State<Hub>,
    Path(id): Path<i64>,
) -> Result<Json<Run>, Problem> {
    hub.tuner()?.run("rollout", id).await.map(Json)
}

/// Pauses, resumes, advances, returns or stops a rollout
#[utoipa::path(
    post, operation_id = "command_rollout", path = "/api/v1/rollouts/{id}/{command}", tag = "tuning",
    params(
        ("id" = i64, Path, description = "Its number."),
        ("command" = Command, Path, description = "`pause`, `resume`, `next`, `return` or `stop`."),
    ),
    responses((status = 200, body = Run))
)]
pub(super) async fn command_rollout(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    Path((id, command)): Path<(i64, String)>,
) -> Result<Json<Run>, Problem> {
    let command = Command::named(&command).ok_or_else(|| {
        let detail = format!("`{command}` is not a command of rollouts");
        Problem::new(StatusCode::NOT_FOUND, detail).allowing(Command::ALL.map(Command::name))
    })?;
    carry_out(&hub, "rollout", id, command, &caller).await
}

/// Begins a trial
///
/// `{"values": [{"u": 1e-4}, {"u": 3e-4}], "select": ["cam-*"], "duration_s": 3600}`
#[utoipa::path(
    post, operation_id = "begin_trial", path = "/api/v1/trials", tag = "tuning", request_body = TrialPlan,
    responses((status = 201, body = Run))
)]
pub(super) async fn begin_trial(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    bytes: Bytes,
) -> Result<(StatusCode, Json<Run>), Problem> {
    let mut object = body::object(&bytes)?;
    if let Some(values) = object.get_mut("values").and_then(Value::as_array_mut) {
        for value in values {
            body::name_threshold(value)?;
        }
    }
    let plan: TrialPlan = body::known_fields(object)?;
    begin(&hub, Kind::Trial { plan }, &caller).await
}

/// Trials, the newest first
#[utoipa::path(
    get, operation_id = "list_trials", path = "/api/v1/trials", tag = "tuning", params(Which),
    responses((status = 200, body = Runs))
)]
pub(super) async fn trials(
    State(hub): State<Hub>,
    Query(which): Query<Which>,
) -> Result<Json<Runs>, Problem> {
    page(&hub, "trial", &which).await
}

/// A trial with its result and its nodes
#[utoipa::path(
    get, operation_id = "trial", path = "/api/v1/trials/{id}", tag = "tuning", params(("id" = i64, Path, description = "Its number.")),
    responses((status = 200, body = Run))
)]
pub(super) async fn one_trial(
    State(hub): State<Hub>,
    Path(id): Path<i64>,
) -> Result<Json<Run>, Problem> {
    hub.tuner()?.run("trial", id).await.map(Json)
}

/// Ends a trial before its time
///
/// The measurements until now are its result; the old values return.
#[utoipa::path(
    post, operation_id = "end_trial", path = "/api/v1/trials/{id}/end", tag = "tuning", params(("id" = i64, Path, description = "Its number.")),
    responses((status = 200, body = Run))
)]
pub(super) async fn end_trial(
    State(hub): State<Hub>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<i64>,
) -> Result<Json<Run>, Problem> {
    carry_out(&hub, "trial", id, Command::Return, &caller).await
}
