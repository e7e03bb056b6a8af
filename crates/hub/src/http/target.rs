//! Sets a target on selected nodes.

use super::HubView;
use super::body;
use super::order::{OrderAnswer, carry_out};
use crate::tuning::change::ChangeRequest;
use crate::tuning::selector::Selector;
use albireo_service::http::{Caller, Problem};
use albireo_wire::DesiredSetting;
use albireo_wire::Target;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

/// The target that selected nodes are to hold.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TargetRequest {
    /// One of `recall`, `skip_rate`, `detector_ms_per_s`, `watts` and `joules_per_day`; null for nothing: the knob then stays
    /// where it is.
    #[serde(deserialize_with = "required")]
    #[schema(required)]
    target: Option<Target>,
    /// Which nodes: names, globs, labels, `all`.
    #[schema(value_type = Vec<String>, examples(json!(["cam-*", "region=north"])))]
    select: Selector,
    /// Only say who would change.
    #[serde(default)]
    dry_run: bool,
    /// Why; kept in the history.
    #[serde(default)]
    why: String,
    /// How long to wait for the nodes, seconds: 5 by default, at most 8 for a plain answer.
    #[serde(default)]
    wait_s: Option<f64>,
}

/// An `Option` that may be null and may not be missing.
fn required<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<Target>, D::Error> {
    Option::deserialize(deserializer)
}

/// Sets a target on selected nodes instead of a threshold
///
/// It holds at a node when the node **reports** it; how far it is met is in the node's status. A threshold that is ordered
/// or set at the node later switches it off. Otherwise as `/api/v1/threshold`.
/// `curl -X PUT -d '{"target": {"skip_rate": 0.5}, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/target`
#[utoipa::path(
    put, operation_id = "set_target", path = "/api/v1/target", tag = "tuning", request_body = TargetRequest,
    responses(
        (status = 200, body = OrderAnswer),
        (status = "4XX", body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn put(
    State(view): State<HubView>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    bytes: Result<Bytes, BytesRejection>,
) -> Result<Response, Problem> {
    let object = body::object(bytes)?;
    let names = |detail: String| body::unusable(detail).allowing(Target::NAMES);
    let target = object.get("target").cloned().ok_or_else(|| {
        names("the body must have a target, such as \"target\": {\"skip_rate\": 0.5}, or null for none".to_owned())
    })?;
    // For its own words: what is wrong with the rest has nothing to do with the names of targets.
    serde_json::from_value::<Option<Target>>(target)
        .map_err(|error| names(format!("target: {error}")))?;
    let request: TargetRequest = body::rest(object)?;
    let setting = match request.target {
        Some(target) => DesiredSetting::Target(Some(
            target.check().map_err(|error| names(error.to_string()))?,
        )),
        None => DesiredSetting::Target(None),
    };
    let change = ChangeRequest {
        setting,
        select: request.select,
        dry_run: request.dry_run,
        why: request.why,
    };
    carry_out(&view, &caller, &headers, change, request.wait_s).await
}
