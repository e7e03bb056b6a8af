//! The routes that read and switch the policy.

use super::RouteState;
use super::body::{message, off_the_runtime};
use crate::settings::RefusedPolicy;
use albireo_core::policy::{PolicyConfigError, known_policies, no_pause};
use albireo_service::http::Problem;
use albireo_wire::PolicyChoice;
use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use serde::Serialize;
use serde_with::skip_serializing_none;
use std::sync::Arc;
use utoipa::ToSchema;

const EXPECTED: &str = "a JSON object such as {\"name\": \"expected-loss\"}";

/// The policy in force.
#[skip_serializing_none]
#[derive(Serialize, ToSchema)]
pub(super) struct PolicyInForce {
    /// Its name.
    name: &'static str,
    /// The name of its threshold; absent if it has none.
    threshold: Option<&'static str>,
    /// The policy of the configuration, `policy.name`.
    configured: &'static str,
    /// True if a switch survives a restart.
    survives_restart: bool,
    /// What does nothing under it although it is set, in words.
    notes: Vec<String>,
    /// The names of all policies.
    policies: Vec<&'static str>,
}

fn in_force(shared: &RouteState) -> PolicyInForce {
    let board = &shared.board;
    let policy = board.policy();
    let mut notes = Vec::new();
    if board.empty_road().pause_s > 0.0 && !policy.takes_pause {
        let reason = no_pause(policy.name);
        notes.push(format!("screen.pause_s is set, but {reason}"));
    }
    if let Some(off) = board.target.not_under_this_policy() {
        notes.push(format!("no target is held: {off}"));
    }
    PolicyInForce {
        name: policy.name,
        threshold: policy.spec.map(|spec| spec.name),
        configured: board.configured_policy().name,
        survives_restart: shared.settings.survive_restart(),
        notes,
        policies: known_policies().collect(),
    }
}

/// The policy in force
///
/// `curl http://127.0.0.1:8080/api/v1/policy`
#[utoipa::path(get, operation_id = "policy", path = "/api/v1/policy", tag = "threshold", responses((status = 200, body = PolicyInForce)))]
pub(super) async fn get(State(shared): State<RouteState>) -> Json<PolicyInForce> {
    Json(in_force(&shared))
}

/// Switches the policy of all cameras
///
/// Applies from each camera's next frame, which begins as at the start of a stream: the objects of the policy before are
/// forgotten, and its clip ends there and is reported under its name. The threshold is the one that is configured for the new
/// policy. A target is held from there, if the new policy has a threshold for it.
/// `curl -X PUT -d '{"name": "expected-loss"}' http://127.0.0.1:8080/api/v1/policy`
#[utoipa::path(
    put, operation_id = "set_policy", path = "/api/v1/policy", tag = "threshold", request_body = PolicyChoice,
    responses((status = 200, body = PolicyInForce))
)]
pub(super) async fn put(
    State(shared): State<RouteState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<PolicyInForce>, Problem> {
    let sent: PolicyChoice =
        message(&headers, &body, EXPECTED).map_err(|problem| problem.allowing(known_policies()))?;
    let settings = Arc::clone(&shared.settings);
    let place = settings.turns.place();
    let set = move || settings.set_in_turn(place, |transaction| transaction.policy(&sent.name));
    off_the_runtime(set).await?.map_err(|refused| {
        let words = refused.to_string();
        match refused {
            RefusedPolicy::Invalid(PolicyConfigError::UnknownPolicy { .. }) => {
                Problem::new(StatusCode::UNPROCESSABLE_ENTITY, words).allowing(known_policies())
            }
            RefusedPolicy::Invalid(_) | RefusedPolicy::Waits { .. } => {
                Problem::new(StatusCode::CONFLICT, words)
            }
        }
    })?;
    Ok(Json(in_force(&shared)))
}
