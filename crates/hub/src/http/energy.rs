//! Energy of the fleet's clips.

use super::HubView;
use crate::store::{AuditCounts, EnergyBy, EnergyGroup, EnergyQuery, Resolution};
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::Problem;
use albireo_wire::AuditFigures;
use axum::Json;
use axum::extract::{Query, State};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

const DAY: i64 = 86_400;
const FIVE_MINUTES: i64 = 300;

/// Which clips, and how they are grouped.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Selection {
    /// `all`, `node`, `camera`, `day`, `policy` or `knob`.
    #[serde(default)]
    by: EnergyBy,
    /// Clips begun from this time on, milliseconds since the Unix epoch; seven days ago by default.
    since_ms: Option<i64>,
    /// Clips begun before this time; now by default.
    until_ms: Option<i64>,
    /// Of this node only.
    node: Option<String>,
    /// `group`, or `joules`: the groups with the most energy first. A group has a line for each quality.
    #[serde(default)]
    sort: Sort,
    /// Maximum number of groups, up to 10000; 1000 by default.
    limit: Option<i64>,
}

/// Which group comes first.
#[derive(Clone, Copy, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Sort {
    /// In the order of their names.
    #[default]
    Group,
    /// The most energy first.
    Joules,
}

/// Sums by group and quality.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Energy {
    /// The spans the sums were made from: days where the times asked for begin and end with one, else five minutes.
    pub resolution: Resolution,
    /// From this time on, milliseconds since the Unix epoch: the beginning of a span.
    pub since_ms: i64,
    /// Before this time: the end of a span.
    pub until_ms: i64,
    /// One entry for each group and quality.
    pub groups: Vec<EnergyGroup>,
    /// What was audited in all these groups together, whatever the quality of their energy; absent where nothing was.
    /// Against the detector, not against the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
}

/// Energy over time and fleet: measured, partial and estimated apart, and against vanilla
///
/// `curl 'http://127.0.0.1:8090/api/v1/energy?by=policy'`
#[utoipa::path(
    get, operation_id = "energy_sums", path = "/api/v1/energy", tag = "history", params(Selection),
    responses((status = 200, body = Energy))
)]
pub(super) async fn sums(
    State(view): State<HubView>,
    Query(selection): Query<Selection>,
) -> Result<Json<Energy>, Problem> {
    let now_s = unix_milliseconds().div_euclid(1000);
    let seconds = |ms: i64| ms.div_euclid(1000);
    let asked_until = selection.until_ms.map(seconds);
    let asked_since = selection.since_ms.map(seconds);
    let since = asked_since.unwrap_or(now_s - 7 * DAY);
    let until = asked_until.unwrap_or(now_s + DAY);
    let whole_days = [asked_since, asked_until]
        .into_iter()
        .flatten()
        .all(|time| time.rem_euclid(DAY) == 0);
    let (resolution, span) = if whole_days {
        (Resolution::Day, DAY)
    } else {
        (Resolution::FiveMinutes, FIVE_MINUTES)
    };
    let down = |time: i64| time.div_euclid(span).saturating_mul(span);
    let since_s = down(since);
    let until_s = down(until.saturating_add(span - 1));
    let wanted = EnergyQuery {
        by: selection.by,
        resolution,
        since_s,
        until_s,
        node: selection.node,
        largest_first: selection.sort == Sort::Joules,
        limit: selection.limit.unwrap_or(1000).clamp(1, 10_000),
    };
    let groups = view.store()?.energy(&wanted).await?;
    let mut audit = AuditCounts::default();
    for group in &groups {
        audit.merge(&group.audit_counts);
    }
    Ok(Json(Energy {
        audit: audit.figures(),
        resolution,
        since_ms: since_s.saturating_mul(1000),
        until_ms: until_s.saturating_mul(1000),
        groups,
    }))
}
