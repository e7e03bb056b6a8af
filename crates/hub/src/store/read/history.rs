//! Clips, events, what is known of reports, and what was set aside.

use super::audit::AuditCounts;
use crate::store::{Store, StoreError};
use albireo_wire::AuditFigures;
use serde::Serialize;
use sqlx::Row as _;
use sqlx::any::AnyRow;
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
    /// At most so many.
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
    /// Frames answered from prediction because the detector could not be had.
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
    pub quality: &'static str,
    /// Energy, joules.
    pub joules: Option<f64>,
    /// Energy-delay product, J·ms/frame.
    pub edp: Option<f64>,
    /// What the detector, looking afterwards, found on skipped frames; absent without an audit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
}

/// The name of an energy quality's code.
pub(super) fn quality_name(code: i64) -> &'static str {
    match code {
        0 => "measured",
        1 => "partial",
        2 => "estimated",
        _ => "unavailable",
    }
}

const CLIPS: &str = "SELECT c.*, n.name AS node, m.name AS camera, s.policy, s.knob, s.value, s.model, \
    s.provider, s.power_source FROM clips c JOIN cameras m ON m.id = c.camera_id JOIN nodes n ON n.id = m.node_id \
    JOIN setups s ON s.id = c.setup_id";

fn clip(row: &AnyRow) -> Result<StoredClip, StoreError> {
    let number = |name: &str| row.try_get::<i64, _>(name);
    let milli = |name: &str| number(name).map(|us| us as f64 / 1e3);
    let value: String = row.try_get("value")?;
    Ok(StoredClip {
        id: number("id")?,
        node: row.try_get("node")?,
        camera: row.try_get("camera")?,
        report_id: report_id(row)?,
        count: row.try_get("count")?,
        at_ms: number("at_ms")?,
        received_ms: number("received_ms")?,
        clip: row.try_get("clip")?,
        part: number("part")?,
        ended_by: row.try_get("ended_by")?,
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
        policy: row.try_get("policy")?,
        knob: row.try_get("knob")?,
        value: value.parse().ok(),
        model: row.try_get("model")?,
        provider: row.try_get("provider")?,
        power_source: row.try_get("power_source")?,
        quality: quality_name(number("quality")?),
        joules: row
            .try_get::<Option<i64>, _>("energy_uj")?
            .map(|uj| uj as f64 / 1e6),
        edp: row.try_get("edp")?,
        audit: AuditCounts::of(row)?.figures(),
    })
}

fn report_id(row: &AnyRow) -> Result<String, StoreError> {
    let bytes: Vec<u8> = row.try_get("report_id")?;
    let id = Uuid::from_slice(&bytes).map_err(|error| StoreError::Statement(error.to_string()))?;
    Ok(id.to_string())
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
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
    /// How often the running count began anew: the node's state was made anew, went back in time or was copied.
    pub resets: i64,
}

impl Store {
    /// Clips, the last received first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn clips(&self, wanted: &ClipQuery) -> Result<Vec<StoredClip>, StoreError> {
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
        let mut query = self
            .query(&text)
            .bind(wanted.before_id.unwrap_or(i64::MAX))
            .bind(wanted.since_ms.unwrap_or(i64::MIN))
            .bind(wanted.until_ms.unwrap_or(i64::MAX))
            .bind(wanted.limit);
        if let Some(node) = &wanted.node {
            query = query.bind(node.clone());
            if let Some(camera) = &wanted.camera {
                query = query.bind(camera.clone());
            }
        }
        self.all(query).await?.iter().map(clip).collect()
    }

    /// Number of the last event; 0 without any.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn last_event(&self) -> Result<i64, StoreError> {
        let rows = self
            .all(self.query("SELECT COALESCE(max(id), 0) AS id FROM events"))
            .await?;
        match rows.first() {
            Some(row) => Ok(row.try_get("id")?),
            None => Ok(0),
        }
    }

    /// Events after the one of that number, in order.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn events_after(&self, id: i64, limit: i64) -> Result<Vec<StoredEvent>, StoreError> {
        let query = self
            .query("SELECT * FROM events WHERE id > $1 ORDER BY id LIMIT $2")
            .bind(id)
            .bind(limit);
        self.all(query)
            .await?
            .iter()
            .map(|row| {
                let detail: String = row.try_get("detail")?;
                Ok(StoredEvent {
                    id: row.try_get("id")?,
                    at_ms: row.try_get("at_ms")?,
                    kind: row.try_get("kind")?,
                    node: row.try_get("node")?,
                    detail: serde_json::from_str(&detail).unwrap_or_default(),
                })
            })
            .collect()
    }

    /// What was set aside, the latest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn set_aside(
        &self,
        node: Option<&str>,
        before_id: Option<i64>,
        limit: i64,
    ) -> Result<Vec<StoredSetAside>, StoreError> {
        let query = self
            .query(
                "SELECT a.*, n.name AS node FROM set_aside a JOIN nodes n ON n.id = a.node_id \
                 WHERE a.id < $1 AND ($2 = '' OR n.name = $2) ORDER BY a.id DESC LIMIT $3",
            )
            .bind(before_id.unwrap_or(i64::MAX))
            .bind(node.unwrap_or_default().to_owned())
            .bind(limit);
        self.all(query)
            .await?
            .iter()
            .map(|row| {
                Ok(StoredSetAside {
                    id: row.try_get("id")?,
                    node: row.try_get("node")?,
                    report_id: row.try_get("report_id")?,
                    received_ms: row.try_get("received_ms")?,
                    cause: row.try_get("cause")?,
                    body: row.try_get("body")?,
                })
            })
            .collect()
    }

    /// What is known of the reports of a node; nothing where none came.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn report_counts(&self, node: &str) -> Result<Option<ReportCounts>, StoreError> {
        let query = self
            .query("SELECT r.* FROM report_counts r JOIN nodes n ON n.id = r.node_id WHERE n.name = $1")
            .bind(node.to_owned());
        let read = |row: &AnyRow| {
            let missing: String = row.try_get("missing")?;
            let ranges: Vec<(u64, u64)> = serde_json::from_str(&missing)?;
            // Whether reports with lower counts exist is not known.
            let base: i64 = row.try_get("base")?;
            let missing = ranges
                .iter()
                .filter(|(first, _)| *first >= base.unsigned_abs());
            Ok(ReportCounts {
                first_ms: row.try_get("first_ms")?,
                last_ms: row.try_get("last_ms")?,
                stored: row.try_get("stored")?,
                set_aside: row.try_get("set_aside")?,
                refused: row.try_get("refused")?,
                missing: missing.map(|(first, last)| last - first + 1).sum(),
                resets: row.try_get("resets")?,
            })
        };
        self.all(query).await?.first().map(read).transpose()
    }
}
