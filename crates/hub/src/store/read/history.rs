//! Clips, events, what is known of reports, and what was set aside.

use super::audit::AuditCounts;
use crate::store::record::{Cell, Row};
use crate::store::{Store, StoreError};
use albireo_wire::{AuditFigures, EnergyQuality};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

/// Which clips.
#[derive(Clone, Debug, Default)]
pub struct ClipQuery {
    /// Of this node.
    pub node: Option<String>,
    /// Of this camera of it.
    pub camera: Option<String>,
    /// Begun at this time or later, milliseconds since the Unix epoch.
    pub since_ms: Option<i64>,
    /// Begun before this time.
    pub until_ms: Option<i64>,
    /// Received before the clip of this number.
    pub before_id: Option<i64>,
    /// Maximum number.
    pub limit: i64,
}

/// A clip.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct StoredClip {
    /// Its number in the database: the later it was received, the higher.
    pub id: i64,
    /// Node.
    pub node: String,
    /// Camera.
    pub camera: String,
    /// Identity of the report.
    pub report_id: String,
    /// Running count of the report at its node.
    pub count: Option<i64>,
    /// The time it is filed under, milliseconds since the Unix epoch: when it began, or when it was received where the
    /// node's clock is off.
    pub at_ms: i64,
    /// When it was received.
    pub received_ms: i64,
    /// Clip id.
    pub clip: String,
    /// Number of this part of the clip, from 0.
    pub part: i64,
    /// Why it ended.
    pub ended_by: String,
    /// Its length, seconds.
    pub duration_s: f64,
    /// Frames.
    pub frames: i64,
    /// Frames with state E.
    pub e: i64,
    /// Frames with state P.
    pub p: i64,
    /// Frames with state E+I.
    pub ei: i64,
    /// Frames with state I.
    pub i: i64,
    /// Frames with state AI.
    pub ai: i64,
    /// Frames answered from prediction because the detector was not available.
    pub degraded: i64,
    /// Frames not processed.
    pub dropped: i64,
    /// Mean latency, milliseconds.
    pub latency_mean_ms: f64,
    /// 99th percentile of the latency, milliseconds.
    pub latency_p99_ms: f64,
    /// Calls of the detector.
    pub detector_calls: i64,
    /// Mean time of a call, milliseconds.
    pub detector_mean_ms: f64,
    /// Policy.
    pub policy: String,
    /// Name of its knob; empty without one.
    pub knob: String,
    /// The knob's value at the end of the clip.
    pub value: Option<f64>,
    /// Detector model.
    pub model: String,
    /// Execution provider.
    pub provider: String,
    /// Where the energy comes from.
    pub power_source: String,
    /// `measured`, `partial`, `estimated` or `unavailable`.
    pub quality: EnergyQuality,
    /// Energy, joules.
    pub joules: Option<f64>,
    /// Energy-delay product, J·ms/frame.
    pub edp: Option<f64>,
    /// Audit results of skipped frames; absent without an audit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
}

/// The energy quality of a code in the database.
pub(super) const fn quality(code: i64) -> EnergyQuality {
    match code {
        0 => EnergyQuality::Measured,
        1 => EnergyQuality::Partial,
        2 => EnergyQuality::Estimated,
        _ => EnergyQuality::Unavailable,
    }
}

const CLIPS: &str = "SELECT c.*, n.name AS node, m.name AS camera, s.policy, s.knob, s.value, s.model, \
    s.provider, s.power_source FROM clips c JOIN cameras m ON m.id = c.camera_id JOIN nodes n ON n.id = m.node_id \
    JOIN setups s ON s.id = c.setup_id";

fn clip(row: &Row) -> Result<StoredClip, StoreError> {
    let number = |name: &str| row.get::<i64>(name);
    let milli = |name: &str| number(name).map(|us| us as f64 / 1e3);
    let value: String = row.get("value")?;
    Ok(StoredClip {
        id: number("id")?,
        node: row.get("node")?,
        camera: row.get("camera")?,
        report_id: row.get::<Uuid>("report_id")?.to_string(),
        count: row.get("count")?,
        at_ms: number("at_ms")?,
        received_ms: number("received_ms")?,
        clip: row.get("clip")?,
        part: number("part")?,
        ended_by: row.get("ended_by")?,
        duration_s: number("duration_us")? as f64 / 1e6,
        frames: number("frames")?,
        e: number("frames_e")?,
        p: number("frames_p")?,
        ei: number("frames_ei")?,
        i: number("frames_i")?,
        ai: number("frames_ai")?,
        degraded: number("degraded")?,
        dropped: number("dropped")?,
        latency_mean_ms: milli("latency_mean_us")?,
        latency_p99_ms: milli("latency_p99_us")?,
        detector_calls: number("detector_calls")?,
        detector_mean_ms: milli("detector_mean_us")?,
        policy: row.get("policy")?,
        knob: row.get("knob")?,
        value: value.parse().ok(),
        model: row.get("model")?,
        provider: row.get("provider")?,
        power_source: row.get("power_source")?,
        quality: quality(number("quality")?),
        joules: row
            .get::<Option<i64>>("energy_uj")?
            .map(|uj| uj as f64 / 1e6),
        edp: row.get("edp")?,
        audit: AuditCounts::of(row)?.figures(),
    })
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct StoredEvent {
    /// Its number: the later, the higher.
    pub id: i64,
    /// When, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// What kind: `node`, `gap`, `reset`, `set_aside`, `clock_off`, `refused`.
    pub kind: String,
    /// The node it is about.
    pub node: Option<String>,
    /// The rest, by kind.
    pub detail: serde_json::Value,
}

/// A report that makes no sense.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct StoredSetAside {
    /// Its number.
    pub id: i64,
    /// The node that sent it.
    pub node: String,
    /// Identity of the report.
    pub report_id: Option<String>,
    /// When it came.
    pub received_ms: i64,
    /// Why it is not taken.
    pub cause: String,
    /// What came, at most 2 KiB of it.
    pub body: String,
}

/// What is known of the reports of a node.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportCounts {
    /// When a batch came first, milliseconds since the Unix epoch.
    pub first_ms: i64,
    /// When a batch came last.
    pub last_ms: i64,
    /// Reports stored.
    pub stored: i64,
    /// Reports that make no sense.
    pub set_aside: i64,
    /// Reports refused, because they were too old.
    pub refused: i64,
    /// Running counts that never came.
    pub missing: u64,
    /// How often the running count began again: the node's state was made new, went back in time or was copied.
    pub resets: i64,
}

impl Store {
    /// Clips, the last received first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn clips(&self, wanted: &ClipQuery) -> Result<Vec<StoredClip>, StoreError> {
        let mut text = format!("{CLIPS} WHERE c.id < $1 AND c.at_ms >= $2 AND c.at_ms < $3");
        if wanted.node.is_some() {
            text += " AND c.camera_id IN (SELECT m2.id FROM cameras m2 JOIN nodes n2 ON n2.id = m2.node_id \
                     WHERE n2.name = $5";
            text += if wanted.camera.is_some() {
                " AND m2.name = $6)"
            } else {
                ")"
            };
        }
        text += " ORDER BY c.id DESC LIMIT $4";
        let mut values: Vec<Cell> = vec![
            wanted.before_id.unwrap_or(i64::MAX).into(),
            wanted.since_ms.unwrap_or(i64::MIN).into(),
            wanted.until_ms.unwrap_or(i64::MAX).into(),
            wanted.limit.into(),
        ];
        if let Some(node) = &wanted.node {
            values.push(node.as_str().into());
            values.extend(wanted.camera.as_deref().map(Cell::from));
        }
        self.query(text, values).await?.iter().map(clip).collect()
    }

    /// Number of the last event; 0 without any.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn last_event(&self) -> Result<i64, StoreError> {
        let text = "SELECT COALESCE(max(id), 0) AS id FROM events";
        let rows = self.query(text, Vec::new()).await?;
        match rows.first() {
            Some(row) => Ok(row.get("id")?),
            None => Ok(0),
        }
    }

    /// Events after the one of that number, in order.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn events_after(
        &self,
        id: i64,
        limit: i64,
    ) -> Result<Vec<StoredEvent>, StoreError> {
        let text = "SELECT * FROM events WHERE id > $1 ORDER BY id LIMIT $2";
        self.query(text, vec![id.into(), limit.into()])
            .await?
            .iter()
            .map(|row| {
                let detail: String = row.get("detail")?;
                Ok(StoredEvent {
                    id: row.get("id")?,
                    at_ms: row.get("at_ms")?,
                    kind: row.get("kind")?,
                    node: row.get("node")?,
                    detail: serde_json::from_str(&detail).unwrap_or_default(),
                })
            })
            .collect()
    }

    /// What was set aside, the latest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn set_aside(
        &self,
        node: Option<&str>,
        before_id: Option<i64>,
        limit: i64,
    ) -> Result<Vec<StoredSetAside>, StoreError> {
        let text = "SELECT a.*, n.name AS node FROM set_aside a JOIN nodes n ON n.id = a.node_id \
                    WHERE a.id < $1 AND ($2 = '' OR n.name = $2) ORDER BY a.id DESC LIMIT $3";
        let values = vec![
            before_id.unwrap_or(i64::MAX).into(),
            node.unwrap_or_default().into(),
            limit.into(),
        ];
        self.query(text, values)
            .await?
            .iter()
            .map(|row| {
                Ok(StoredSetAside {
                    id: row.get("id")?,
                    node: row.get("node")?,
                    report_id: row.get("report_id")?,
                    received_ms: row.get("received_ms")?,
                    cause: row.get("cause")?,
                    body: row.get("body")?,
                })
            })
            .collect()
    }

    /// What is known of the reports of a node; nothing where none came.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn report_counts(
        &self,
        node: &str,
    ) -> Result<Option<ReportCounts>, StoreError> {
        let text =
            "SELECT r.* FROM report_counts r JOIN nodes n ON n.id = r.node_id WHERE n.name = $1";
        let read = |row: &Row| {
            let missing: String = row.get("missing")?;
            let ranges: Vec<(u64, u64)> = serde_json::from_str(&missing)?;
            // Whether reports with lower counts exist is not known.
            let base: i64 = row.get("base")?;
            let missing = ranges
                .iter()
                .filter(|(first, _)| *first >= base.unsigned_abs());
            Ok(ReportCounts {
                first_ms: row.get("first_ms")?,
                last_ms: row.get("last_ms")?,
                stored: row.get("stored")?,
                set_aside: row.get("set_aside")?,
                refused: row.get("refused")?,
                missing: missing.map(|(first, last)| last - first + 1).sum(),
                resets: row.get("resets")?,
            })
        };
        let rows = self.query(text, vec![node.into()]).await?;
        rows.first().map(read).transpose()
    }
}
