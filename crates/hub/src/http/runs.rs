//! Rollouts and trials.

use super::HubView;
use super::body;
use crate::store::RunRow;
use crate::tuning::members::Member;
use crate::tuning::rollout::{Command, Entry, Phase, RolloutPlan, RolloutRequest, What};
use crate::tuning::runs::{LeftOut, Run, RunError, counts};
use crate::tuning::trial::{TrialPhase, TrialPlan, TrialResult};
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Caller, Problem};
use albireo_wire::Threshold;
use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Extension, Path, Query, State};
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};

/// Most rollouts or trials of one answer.
const MOST: i64 = 200;

impl From<RunError> for Problem {
    fn from(error: RunError) -> Self {
        let status = match &error {
            RunError::Plan(_) => StatusCode::UNPROCESSABLE_ENTITY,
            RunError::Command(_) | RunError::Elsewhere { .. } | RunError::Taken { .. } => {
                StatusCode::CONFLICT
            }
            RunError::Unknown { .. } => StatusCode::NOT_FOUND,
            RunError::Store(_) => StatusCode::SERVICE_UNAVAILABLE,
        };
        Self::new(status, error.to_string())
    }
}

/// Which rollouts or trials.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct Which {
    /// Only those with numbers below this.
    before: Option<i64>,
    /// How many at most; 20 by default.
    limit: Option<i64>,
}

/// A stage of a rollout.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct StageView {
    /// Nodes that are new in it.
    pub nodes: usize,
    /// How many of them have which outcome.
    pub counts: BTreeMap<String, usize>,
}

/// A rollout.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct RolloutView {
    /// Its number.
    pub id: i64,
    /// Who began it.
    pub who: String,
    /// When, milliseconds since the Unix epoch.
    pub begun_ms: i64,
    /// When it ended.
    pub ended_ms: Option<i64>,
    /// The new value.
    pub to: Threshold,
    /// Where it is.
    #[serde(flatten)]
    pub phase: Phase,
    /// Why the old values were returned; absent where they were not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why_returned: Option<String>,
    /// Whether it is paused.
    pub paused: bool,
    /// The stage it is in, from 1.
    pub stage: usize,
    /// Its stages.
    pub stages: Vec<StageView>,
    /// Its plan.
    pub plan: RolloutPlan,
    /// The seed that drew the order of the nodes.
    pub seed: u64,
    /// What happened, with its numbers; absent in a list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub record: Option<Vec<Entry>>,
    /// Its nodes; absent in a list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<Vec<Member>>,
    /// Selected nodes that take no part; only in the answer to its begin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
}

/// A trial.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct TrialView {
    /// Its number.
    pub id: i64,
    /// Who began it.
    pub who: String,
    /// When, milliseconds since the Unix epoch.
    pub begun_ms: i64,
    /// When it ended.
    pub ended_ms: Option<i64>,
    /// Where it is.
    #[serde(flatten)]
    pub phase: TrialPhase,
    /// Who ended it before its time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended_by: Option<String>,
    /// Its plan.
    pub plan: TrialPlan,
    /// The seed that drew the groups.
    pub seed: u64,
    /// How many nodes have which outcome.
    pub counts: BTreeMap<String, usize>,
    /// What was measured, once it is over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub result: Option<TrialResult>,
    /// Its nodes; absent in a list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<Vec<Member>>,
    /// Selected nodes that take no part; only in the answer to its begin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
}

/// Rollouts, the newest first.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Rollouts {
    /// One entry for each.
    pub rollouts: Vec<RolloutView>,
    /// Give it as `before` for the next page; absent on the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<i64>,
}

/// Trials, the newest first.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Trials {
    /// One entry for each.
    pub trials: Vec<TrialView>,
    /// Give it as `before` for the next page; absent on the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<i64>,
}

/// A rollout or a trial as it is shown.
trait RunView: Sized {
    const KIND: &'static str;

    /// With its nodes and its record if it is the `whole`; `None` of a run of the other kind.
    fn new(row: RunRow, run: Run, whole: bool) -> Option<Self>;
}

impl RunView for RolloutView {
    const KIND: &'static str = "rollout";

    fn new(row: RunRow, run: Run, whole: bool) -> Option<Self> {
        let Run::Rollout(rollout) = run else {
            return None;
        };
        let stage = |group: usize| {
            let members: Vec<Member> = rollout
                .members
                .iter()
                .filter(|m| m.group == group)
                .cloned()
                .collect();
            StageView {
                nodes: members.len(),
                counts: counts(&members),
            }
        };
        let returned = (rollout.record.iter().rev()).find(|entry| entry.what == What::Returning);
        let why_returned = match rollout.phase {
            Phase::Returned => returned.map(|entry| entry.text.clone()),
            _ => None,
        };
        Some(Self {
            id: row.id,
            who: row.who,
            begun_ms: row.begun_ms,
            ended_ms: row.ended_ms,
            why_returned,
            to: rollout.knob,
            paused: rollout.paused_ms.is_some(),
            stage: rollout.stage + 1,
            stages: (0..rollout.stages).map(stage).collect(),
            phase: rollout.phase,
            plan: rollout.plan,
            seed: rollout.seed,
            record: whole.then_some(rollout.record),
            nodes: whole.then_some(rollout.members),
            left_out: Vec::new(),
        })
    }
}

impl RunView for TrialView {
    const KIND: &'static str = "trial";

    fn new(row: RunRow, run: Run, whole: bool) -> Option<Self> {
        let Run::Trial(trial) = run else {
            return None;
        };
        Some(Self {
            id: row.id,
            who: row.who,
            begun_ms: row.begun_ms,
            ended_ms: row.ended_ms,
            phase: trial.phase,
            ended_by: trial.ended_by,
            plan: trial.plan,
            seed: trial.seed,
            counts: counts(&trial.members),
            result: trial.result,
            nodes: whole.then_some(trial.members),
            left_out: Vec::new(),
        })
    }
}

/// A page of rollouts or trials, and where the next one begins.
async fn page<V: RunView>(view: &HubView, which: &Which) -> Result<(Vec<V>, Option<i64>), Problem> {
    let limit = which.limit.unwrap_or(20).clamp(1, MOST);
    let found = view
        .tuner()?
        .list_runs(V::KIND, which.before.unwrap_or(i64::MAX), limit)
        .await?;
    let next = found
        .last()
        .filter(|_| found.len() as i64 == limit)
        .map(|(row, _)| row.id);
    let shown = (found.into_iter()).filter_map(|(row, run)| V::new(row, run, false));
    Ok((shown.collect(), next))
}

/// One rollout or trial with its record and its nodes.
async fn whole<V: RunView>(view: &HubView, id: i64) -> Result<V, Problem> {
    let (row, run) = view.tuner()?.run(V::KIND, id).await?;
    V::new(row, run, true).ok_or_else(|| {
        let detail = "the database has something else under that number";
        Problem::new(StatusCode::NOT_FOUND, detail)
    })
}

/// Begins a rollout
///
/// The body is its plan with the new threshold beside it:
/// `{"u": 5e-4, "select": ["cam-*"], "stages": ["1", "10%", "50%", "100%"], "soak_s": 1800, "gates": ["joules<=+5%"]}`.
#[utoipa::path(
    post, operation_id = "begin_rollout", path = "/api/v1/rollouts", tag = "tuning", request_body = RolloutPlan,
    responses(
        (status = 201, body = RolloutView),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn begin_rollout(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    bytes: Result<Bytes, BytesRejection>,
) -> Result<(StatusCode, Json<RolloutView>), Problem> {
    let (knob, plan): (_, RolloutPlan) = body::with_threshold(body::object(bytes)?)?;
    let request = RolloutRequest { knob, plan };
    let (id, left_out) = (view.tuner()?)
        .begin_rollout(request, &caller.name, unix_milliseconds())
        .await?;
    let begun = RolloutView {
        left_out,
        ..whole(&view, id).await?
    };
    Ok((StatusCode::CREATED, Json(begun)))
}

/// Rollouts, the newest first
#[utoipa::path(
    get, operation_id = "list_rollouts", path = "/api/v1/rollouts", tag = "tuning", params(Which),
    responses((status = 200, body = Rollouts), (status = 503, body = Problem, content_type = "application/problem+json"))
)]
pub(super) async fn rollouts(
    State(view): State<HubView>,
    Query(which): Query<Which>,
) -> Result<Json<Rollouts>, Problem> {
    let (rollouts, next) = page(&view, &which).await?;
    Ok(Json(Rollouts { rollouts, next }))
}

/// A rollout with its record and its nodes
#[utoipa::path(
    get, operation_id = "rollout", path = "/api/v1/rollouts/{id}", tag = "tuning", params(("id" = i64, Path, description = "Its number.")),
    responses(
        (status = 200, body = RolloutView),
        (status = 404, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn one_rollout(
    State(view): State<HubView>,
    Path(id): Path<i64>,
) -> Result<Json<RolloutView>, Problem> {
    Ok(Json(whole(&view, id).await?))
}

/// Pauses, resumes, advances, returns or stops a rollout
#[utoipa::path(
    post, operation_id = "command_rollout", path = "/api/v1/rollouts/{id}/{command}", tag = "tuning",
    params(
        ("id" = i64, Path, description = "Its number."),
        ("command" = Command, Path, description = "`pause`, `resume`, `next`, `return` or `stop`."),
    ),
    responses(
        (status = 200, body = RolloutView),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn command_rollout(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    Path((id, command)): Path<(i64, String)>,
) -> Result<Json<RolloutView>, Problem> {
    let command = Command::named(&command).ok_or_else(|| {
        let detail = format!("a rollout cannot be asked to `{command}`");
        Problem::new(StatusCode::NOT_FOUND, detail).allowing(Command::ALL.map(Command::name))
    })?;
    view.tuner()?
        .command_rollout(id, command, &caller.name, unix_milliseconds())
        .await?;
    Ok(Json(whole(&view, id).await?))
}

/// Begins a trial
///
/// `{"values": [{"u": 1e-4}, {"u": 3e-4}], "select": ["cam-*"], "duration_s": 3600}`
#[utoipa::path(
    post, operation_id = "begin_trial", path = "/api/v1/trials", tag = "tuning", request_body = TrialPlan,
    responses(
        (status = 201, body = TrialView),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn begin_trial(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    bytes: Result<Bytes, BytesRejection>,
) -> Result<(StatusCode, Json<TrialView>), Problem> {
    let mut object = body::object(bytes)?;
    if let Some(values) = object.get_mut("values").and_then(Value::as_array_mut) {
        values.iter_mut().try_for_each(body::name_threshold)?;
    }
    let plan: TrialPlan = body::rest(object)?;
    let (id, left_out) = view
        .tuner()?
        .begin_trial(plan, &caller.name, unix_milliseconds())
        .await?;
    let begun = TrialView {
        left_out,
        ..whole(&view, id).await?
    };
    Ok((StatusCode::CREATED, Json(begun)))
}

/// Trials, the newest first
#[utoipa::path(
    get, operation_id = "list_trials", path = "/api/v1/trials", tag = "tuning", params(Which),
    responses((status = 200, body = Trials), (status = 503, body = Problem, content_type = "application/problem+json"))
)]
pub(super) async fn trials(
    State(view): State<HubView>,
    Query(which): Query<Which>,
) -> Result<Json<Trials>, Problem> {
    let (trials, next) = page(&view, &which).await?;
    Ok(Json(Trials { trials, next }))
}

/// A trial with its result and its nodes
#[utoipa::path(
    get, operation_id = "trial", path = "/api/v1/trials/{id}", tag = "tuning", params(("id" = i64, Path, description = "Its number.")),
    responses(
        (status = 200, body = TrialView),
        (status = 404, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn one_trial(
    State(view): State<HubView>,
    Path(id): Path<i64>,
) -> Result<Json<TrialView>, Problem> {
    Ok(Json(whole(&view, id).await?))
}

/// Ends a trial before its time
///
/// What was measured until now is its result; the old values return.
#[utoipa::path(
    post, operation_id = "end_trial", path = "/api/v1/trials/{id}/end", tag = "tuning", params(("id" = i64, Path, description = "Its number.")),
    responses(
        (status = 200, body = TrialView),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn end_trial(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<i64>,
) -> Result<Json<TrialView>, Problem> {
    view.tuner()?
        .end_trial(id, &caller.name, unix_milliseconds())
        .await?;
    Ok(Json(whole(&view, id).await?))
}
