//! Sums over time and fleet. Measured, partial and estimated energy are never added.

use super::audit::AuditCounts;
use super::history::quality;
use crate::store::record::Cell;
use crate::store::tables::SumRow;
use crate::store::{Store, StoreError};
use albireo_wire::{AuditFigures, EnergyQuality};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What sums are grouped by.
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
    /// Policy and value of its knob.
    Knob,
    /// Camera and name of the clip: the parts of a long clip are added. Of clips that are still kept one by one.
    Clip,
}

/// How long the spans are that the sums were made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Resolution {
    /// Five minutes.
    FiveMinutes,
    /// Days, UTC.
    Day,
}

/// Which clips are summed.
#[derive(Clone, Debug)]
pub struct EnergyQuery {
    /// Grouped by.
    pub by: EnergyBy,
    /// From spans of that length.
    pub resolution: Resolution,
    /// From this time on, seconds since the Unix epoch.
    pub since_s: i64,
    /// Before this time.
    pub until_s: i64,
    /// Of this node only.
    pub node: Option<String>,
    /// The groups with the most energy first, each quality for itself; else in the order of the groups.
    pub largest_first: bool,
    /// Maximum number of groups.
    pub limit: i64,
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
    /// Frames answered without the detector, degraded ones not among them: calls of it that were avoided.
    pub avoided_calls: i64,
    /// Calls of the detector.
    pub detector_calls: i64,
    /// Share of frames with state E or P that are not degraded.
    pub skip_rate: f64,
    /// Energy, joules: exact sums of what the nodes report, in whole microjoules.
    pub joules: f64,
    /// Of it the GPU's.
    pub gpu_joules: f64,
    /// Of it the processor's.
    pub cpu_joules: f64,
    /// Of it memory's and input and output's.
    pub io_mem_joules: f64,
    /// Estimate, whatever the quality, of what the avoided calls would have added, joules: sum of what the nodes report.
    pub saved_joules_estimated: f64,
    /// Avoided calls in clips whose node did not know what a call adds: they are not in the estimate.
    pub unpriced_calls: i64,
    /// Audit results of skipped frames; absent where none was audited.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
    /// Estimate of what the audit added, joules: a part of `joules`.
    pub audit_joules: f64,
    /// The sums of the audit, to be added up further.
    #[serde(skip)]
    pub audit_counts: AuditCounts,
}

/// Clips one by one, as sums of their own.
const CLIPS: &str = "(SELECT c.*, c.at_ms / 1000 AS bucket_s, CASE c.part WHEN 0 THEN 1 ELSE 0 END AS clips, \
    CASE WHEN c.avoided_uj IS NULL THEN c.avoided_calls ELSE 0 END AS unpriced_calls FROM clips c)";

impl Store {
    /// Sums, in the order of the groups.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn energy(&self, wanted: &EnergyQuery) -> Result<Vec<EnergyGroup>, StoreError> {
        let table = match (wanted.by, wanted.resolution) {
            (EnergyBy::Clip, _) => CLIPS,
            (_, Resolution::FiveMinutes) => "sums_5m",
            (_, Resolution::Day) => "sums_day",
        };
        let cameras = "JOIN cameras m ON m.id = t.camera_id JOIN nodes n ON n.id = m.node_id";
        let setups = "JOIN setups s ON s.id = t.setup_id";
        let (group, mut joins) = match wanted.by {
            EnergyBy::All => ("''", String::new()),
            EnergyBy::Node => ("n.name", cameras.to_owned()),
            EnergyBy::Camera => ("n.name || '/' || m.name", cameras.to_owned()),
            EnergyBy::Day => (
                "CAST((t.bucket_s - t.bucket_s % 86400) AS TEXT)",
                String::new(),
            ),
            EnergyBy::Policy => ("s.policy", setups.to_owned()),
            EnergyBy::Knob => (
                "s.policy || CASE WHEN s.knob = '' THEN '' ELSE ' ' || s.knob || '=' || s.value END",
                setups.to_owned(),
            ),
            EnergyBy::Clip => (
                "n.name || '/' || m.name || '/' || t.clip",
                cameras.to_owned(),
            ),
        };
        let mut filter = String::new();
        if wanted.node.is_some() {
            filter += " AND n.name = $4";
            if !joins.contains("cameras") {
                joins = format!("{joins} {cameras}");
            }
        }
        let sum = |column: &str| {
            // As a floating-point number: no sum is too large for it, and it is exact to 2^53.
            format!("COALESCE(SUM(CAST(t.{column} AS DOUBLE PRECISION)), 0) AS {column}")
        };
        let sums: Vec<String> = [
            "clips",
            "duration_us",
            "frames",
            "avoided_calls",
            "unpriced_calls",
            "detector_calls",
            "avoided_uj",
            "energy_uj",
            "gpu_uj",
            "cpu_uj",
            "io_mem_uj",
        ]
        .into_iter()
        .chain(SumRow::summed().filter(|column| column.starts_with("audit_")))
        .map(sum)
        .collect();
        let order = if wanted.largest_first {
            "energy_uj DESC, 1, 2"
        } else {
            "1, 2"
        };
        let text = format!(
            "SELECT {group} AS grouped, t.quality AS quality, {} FROM {table} t {joins} \
             WHERE t.bucket_s >= $1 AND t.bucket_s < $2{filter} GROUP BY 1, 2 ORDER BY {order} LIMIT $3",
            sums.join(", ")
        );
        let mut values: Vec<Cell> = [wanted.since_s, wanted.until_s, wanted.limit]
            .map(Cell::from)
            .into();
        values.extend(wanted.node.as_deref().map(Cell::from));
        self.query(text, values)
            .await?
            .iter()
            .map(|row| {
                let number = |name: &str| row.get::<i64>(name);
                let joules = |name: &str| number(name).map(|uj| uj as f64 / 1e6);
                let (frames, avoided) = (number("frames")?, number("avoided_calls")?);
                let audit_counts = AuditCounts::of(row)?;
                Ok(EnergyGroup {
                    audit: audit_counts.figures(),
                    audit_joules: joules("audit_uj")?,
                    audit_counts,
                    group: row.get("grouped")?,
                    quality: quality(number("quality")?),
                    clips: number("clips")?,
                    duration_s: number("duration_us")? as f64 / 1e6,
                    frames,
                    avoided_calls: avoided,
                    detector_calls: number("detector_calls")?,
                    skip_rate: if frames > 0 {
                        avoided as f64 / frames as f64
                    } else {
                        0.0
                    },
                    joules: joules("energy_uj")?,
                    gpu_joules: joules("gpu_uj")?,
                    cpu_joules: joules("cpu_uj")?,
                    io_mem_joules: joules("io_mem_uj")?,
                    saved_joules_estimated: joules("avoided_uj")?,
                    unpriced_calls: number("unpriced_calls")?,
                })
            })
            .collect()
    }
}
