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
    let wanted_since_s = wanted.since_ms.map(|ms| ms.div_euclid(1000));
    let wanted_until_s = wanted.until_ms.map(|ms| ms.div_euclid(1000));
    let is_whole_hour = |time: Option<i64>| time.is_none_or(|time| time.rem_euclid(HOUR) == 0);
    let kept_s = now_s - i64::from(hub.five_minutes_days) * DAY;
    let first_s = wanted_since_s.unwrap_or(now_s - 7 * DAY);
    let is_too_old = first_s < kept_s;
    let are_whole_hours = is_whole_hour(wanted_since_s) && is_whole_hour(wanted_until_s);
    let resolution = if are_whole_hours || is_too_old {
        Resolution::Hour
    } else {
        Resolution::FiveMinutes
    };
    let span = match resolution {
        Resolution::Hour => HOUR,
        Resolution::FiveMinutes => FIVE_MINUTES,
    };
    let round_down = |time: i64| time.div_euclid(span).saturating_mul(span);
    let since_s = round_down(first_s);
    let until_s = wanted_until_s.unwrap_or(now_s + DAY);
    let end_s = round_down(until_s.saturating_add(span - 1));
    let limit = within("limit", wanted.limit.unwrap_or(1000), 1..=10_000)?;
    wanted.limit = Some(limit);
    let store = hub.store()?;
    let groups = store.energy(&wanted, resolution, since_s..end_s).await?;
    let mut audit = AuditReport::default();
    for group in &groups {
        audit.merge(&group.audit_counts);
    }
    Ok(Json(Energy {
        audit: audit_figures(&audit),
        resolution,
        since_ms: since_s.saturating_mul(1000),
        until_ms: end_s.saturating_mul(1000),
        groups,
    }))
}
