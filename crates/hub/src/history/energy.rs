//! Reads sums over time and fleet. Measured, partial and estimated energy are never added.

use super::{AuditColumns, audit_figures, quality};
use crate::store::row::{FromRow, Row, read_all};
use crate::store::{Store, StoreError};
use albireo_wire::{AuditFigures, AuditReport, EnergyQuality};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::{IntoParams, ToSchema};

/// The grouping of sums.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EnergyBy {
    /// Nothing: one sum over all.
    #[default]
    All,
    /// Node.
    Node,
    /// Node and camera.
    Camera,
    /// Day, UTC.
    Day,
    /// Policy.
    Policy,
    /// Policy and value of its threshold, or of the target that moves it.
    Threshold,
    /// Camera and name of the clip; the parts of a long clip are added. Only clips that are still kept individually.
    Clip,
}

/// The length of the spans that were summed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Resolution {
    /// Five minutes.
    FiveMinutes,
    /// Hours.
    Hour,
}

/// The order of the groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sort {
    /// In the order of their names.
    #[default]
    Group,
    /// The most energy first.
    Joules,
}

/// Selects clips and their grouping.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct EnergyQuery {
    /// `all`, `node`, `camera`, `day`, `policy`, `threshold` or `clip`.
    #[serde(default)]
    pub by: EnergyBy,
    /// Only clips that began at this time or later, milliseconds since the Unix epoch; seven days ago by default.
    pub since_ms: Option<i64>,
    /// Only clips that began before this time; now by default.
    pub until_ms: Option<i64>,
    /// Only of this node.
    pub node: Option<String>,
    /// `group`, or `joules` for the groups with the most energy first. A group has one entry for each quality.
    #[serde(default)]
    pub sort: Sort,
    /// Maximum number of groups, up to 10000; 1000 by default.
    pub limit: Option<i64>,
}

/// Sums of one group and one quality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EnergyGroup {
    /// Node, camera (`node/camera`), day (seconds since the Unix epoch), policy, policy and value (`albireo u=0.0003`), or clip (`node/camera/clip`);
    /// empty for the sum over all.
    pub group: String,
    /// Sums of different qualities are never added.
    pub quality: EnergyQuality,
    /// Clips.
    pub clips: i64,
    /// Seconds of clips.
    pub duration_s: f64,
    /// Frames.
    pub frames: i64,
    /// Avoided calls of the detector: frames answered without it, except degraded ones.
    pub avoided_calls: i64,
    /// Calls of the detector.
    pub detector_calls: i64,
    /// Share of frames with state E or P that are not degraded.
    pub skip_rate: f64,
    /// Energy, joules: exact sums of what the nodes report, in whole microjoules.
    pub joules: f64,
    /// Kilometres that were driven in the clips of which both way and energy are known in full; absent if there are none. As
    /// seconds of clips, they count for each camera of a node.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_km: Option<f64>,
    /// Energy of the whole node in those clips per kilometre, joules, of this quality.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joules_per_km: Option<f64>,
    /// Energy that the avoided calls would have cost, joules: always an estimate, summed over the nodes' reports.
    pub saved_joules_estimated: f64,
    /// Avoided calls that the estimate leaves out, because their node did not know the cost of a call.
    pub unpriced_calls: i64,
    /// Audit results of skipped frames; absent without an audit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
    /// Estimated energy of the audit, joules: a part of `joules`.
    pub audit_joules: f64,
    /// The counts of the audit, for sums over groups.
    #[serde(skip)]
    pub audit_counts: AuditReport,
}

impl FromRow for EnergyGroup {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        let group = row.take()?;
        let quality = row.take_named(quality)?;
        // The databases sum whole numbers as floating-point numbers.
        let clips = row.take::<f64>()? as i64;
        let duration_s = row.take()?;
        let frames = row.take::<f64>()? as i64;
        let avoided_calls = row.take::<f64>()? as i64;
        let unpriced_calls = row.take::<f64>()? as i64;
        let detector_calls = row.take::<f64>()? as i64;
        let skip_rate = row.take()?;
        let joules = row.take()?;
        let distance_km = row.take()?;
        let joules_per_km = row.take()?;
        let saved_joules_estimated = row.take()?;
        let audit_joules = row.take()?;
        let AuditColumns(audit_counts) = AuditColumns::from_row(row)?;
        Ok(Self {
            group,
            quality,
            clips,
            duration_s,
            frames,
            avoided_calls,
            detector_calls,
            skip_rate,
            joules,
            distance_km,
            joules_per_km,
            saved_joules_estimated,
            unpriced_calls,
            audit: audit_figures(&audit_counts),
            audit_joules,
            audit_counts,
        })
    }
}

const HOURS: &str = "(SELECT h.*, '' AS clip FROM sums_hour h)";
const FIVE_MINUTES: &str = "(SELECT f.*, '' AS clip FROM sums_5m f)";
/// Single clips, in the columns of sums.
const CLIPS: &str = "(SELECT c.*, c.at_ms / 1000 AS bucket_s, CASE c.part WHEN 0 THEN 1 ELSE 0 END AS clips, \
    CASE WHEN c.avoided_uj IS NULL THEN c.avoided_calls ELSE 0 END AS unpriced_calls, \
    CASE WHEN c.coverage_ppm >= 999000 AND c.node_uj IS NOT NULL THEN c.distance_mm END AS travel_mm, \
    CASE WHEN c.coverage_ppm >= 999000 AND c.distance_mm IS NOT NULL THEN c.node_uj END AS travel_uj FROM clips c)";

const FLEET: &str = "(0) AND $6 = ''";
const CAMERAS: &str = "(SELECT id FROM cameras) AND $6 = ''";
const CAMERAS_OF_NODE: &str =
    "(SELECT c.id FROM cameras c JOIN nodes o ON o.id = c.node_id WHERE o.name = $6)";

impl EnergyBy {
    /// Its name in the statement.
    const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Node => "node",
            Self::Camera => "camera",
            Self::Day => "day",
            Self::Policy => "policy",
            Self::Threshold => "threshold",
            Self::Clip => "clip",
        }
    }
}

impl Store {
    /// The sums of spans that begin within `seconds` since the Unix epoch. Sums over the whole fleet are read from
    /// their own rows.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn energy(
        &self,
        wanted: &EnergyQuery,
        resolution: Resolution,
        seconds: Range<i64>,
    ) -> Result<Vec<EnergyGroup>, StoreError> {
        let table = match (wanted.by, resolution) {
            (EnergyBy::Clip, _) => CLIPS,
            (_, Resolution::FiveMinutes) => FIVE_MINUTES,
            (_, Resolution::Hour) => HOURS,
        };
        let cameras = match (&wanted.node, wanted.by) {
            (Some(_), _) => CAMERAS_OF_NODE,
            (None, EnergyBy::Node | EnergyBy::Camera | EnergyBy::Clip) => CAMERAS,
            (None, _) => FLEET,
        };
        let text = format!(
            "{} FROM {table} t {} {cameras} {}",
            include_str!("sql/energy_sums.sql"),
            include_str!("sql/energy_groups.sql"),
            include_str!("sql/energy_order.sql"),
        );
        let values = vec![
            wanted.by.name().into(),
            seconds.start.into(),
            seconds.end.into(),
            i64::from(wanted.sort == Sort::Joules).into(),
            wanted.limit.unwrap_or(i64::MAX).into(),
            wanted.node.as_deref().unwrap_or_default().into(),
        ];
        read_all(self.query(text, values).await?)
    }
}
