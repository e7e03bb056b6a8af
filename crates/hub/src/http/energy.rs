//! Serves the energy of the fleet's clips.

use crate::history::{EnergyGroup, EnergyQuery, Resolution, audit_figures};
use crate::hub::Hub;
use albireo_service::clock::unix_milliseconds;
use albireo_service::http::{Problem, within};
use albireo_wire::{AuditFigures, AuditReport};
use axum::Json;
use axum::extract::{Query, State};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

const DAY: i64 = 86_400;
const HOUR: i64 = 3600;
const FIVE_MINUTES: i64 = 300;

/// Sums by group and quality.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Energy {
    /// The spans that were summed: hours if the requested times are whole hours, or so old that sums over five minutes are no
    /// longer kept; else five minutes.
    pub resolution: Resolution,
    /// The beginning of the first span, milliseconds since the Unix epoch.
    pub since_ms: i64,
    /// The end of the last span.
    pub until_ms: i64,
    /// One entry for each group and quality.
    pub groups: Vec<EnergyGroup>,
    /// The audit's figures over all these groups, regardless of the quality of their energy; absent without an audit.
    /// They compare with the detector, not with the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
}

/// Energy over time and fleet, separately measured, partial and estimated, and compared with vanilla
///
/// `curl 'http://127.0.0.1:8090/api/v1/energy?by=policy'`
#[utoipa::path(
    get, operation_id = "energy_sums", path = "/api/v1/energy", tag = "history", params(EnergyQuery),
    responses((status = 200, body = Energy))
)]
pub(super) async fn sums(
    State(hub): State<Hub>,
    Query(mut wanted): Query<EnergyQuery>,
) -> Result<Json<Energy>, Problem> {
    let now_s = unix_milliseconds().div_euclid(1000);
    let asked = [wanted.since_ms, wanted.until_ms].map(|ms| Some(ms?.div_euclid(1000)));
    let mut times = asked.iter().flatten();
    let whole_hours = times.all(|time| time.rem_euclid(HOUR) == 0);
    let kept_s = now_s - i64::from(hub.five_minutes_days) * DAY;
    let (resolution, span) = if whole_hours || asked[0].is_some_and(|since| since < kept_s) {
        (Resolution::Hour, HOUR)
    } else {
        (Resolution::FiveMinutes, FIVE_MINUTES)
    };
    let down = |time: i64| time.div_euclid(span).saturating_mul(span);
    let since_s = down(asked[0].unwrap_or(now_s - 7 * DAY));
    let until_s = down(asked[1].unwrap_or(now_s + DAY).saturating_add(span - 1));
    let limit = within("limit", wanted.limit.unwrap_or(1000), 1..=10_000)?;
    wanted.limit = Some(limit);
    let sums = hub.store()?.energy(&wanted, resolution, since_s..until_s);
    let groups = sums.await?;
    let mut audit = AuditReport::default();
    for group in &groups {
        audit.merge(&group.audit_counts);
    }
    Ok(Json(Energy {
        audit: audit_figures(&audit),
        resolution,
        since_ms: since_s.saturating_mul(1000),
        until_ms: until_s.saturating_mul(1000),
        groups,
    }))
}
