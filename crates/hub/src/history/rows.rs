//! Reads clips, events, report counts and invalid reports.

use super::{AuditColumns, audit_figures, quality};
use crate::ingest::ReportCounts;
use crate::store::row::{FromRow, Param, Row, read_all};
use crate::store::{Store, StoreError};
use albireo_wire::{AuditFigures, EnergyQuality};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::ops::RangeInclusive;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

/// Selects clips.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ClipQuery {
    /// Only of this node.
    pub node: Option<String>,
    /// Only of this camera of that node.
    pub camera: Option<String>,
    /// Only clips that began at this time or later, milliseconds since the Unix epoch.
    pub since_ms: Option<i64>,
    /// Only clips that began before this time, milliseconds since the Unix epoch.
    pub until_ms: Option<i64>,
    /// `next` of the previous page.
    pub cursor: Option<i64>,
    /// Maximum number, up to 1000; 100 by default.
    pub limit: Option<i64>,
}

/// A clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StoredClip {
    /// Its number in the database: the later it was received, the higher.
    pub id: i64,
    /// Node.
    pub node: String,
    /// Camera.
    pub camera: String,
    /// Identity of the report.
    #[schema(value_type = String)]
    pub report_id: Uuid,
    /// Running count of the report at its node.
    pub count: Option<i64>,
    /// The time under which it is stored, milliseconds since the Unix epoch: when it began, or when it was received if the
    /// node's clock is wrong.
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
    /// Name of its threshold, or of the target that moves it; empty without one.
    pub threshold: String,
    /// The value of the threshold at the end of the clip, or of the target.
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
    /// Distance driven, metres, if the node knows its position. `/api/v1/positions.geojson` has the way.
    pub distance_m: Option<f64>,
    /// Audit results of skipped frames; absent without an audit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub audit: Option<AuditFigures>,
}

const CLIPS: &str = concat!(include_str!("sql/clips.sql"), "ORDER BY c.id DESC LIMIT $4");
const CLIPS_OF_NODE: &str = concat!(
    include_str!("sql/clips.sql"),
    // From the index alone: the clips of a camera lie far apart.
    "AND c.id IN (SELECT x.id FROM clips x WHERE x.camera_id IN (SELECT k.id FROM cameras k JOIN nodes o ON o.id = k.node_id \
     WHERE o.name = $5 AND ($6 = '' OR k.name = $6)) AND x.id < $1 AND x.at_ms >= $2 AND x.at_ms < $3 \
     ORDER BY x.id DESC LIMIT $4) ORDER BY c.id DESC"
);

/// An event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StoredEvent {
    /// Its number: the later, the higher.
    pub id: i64,
    /// When, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Its kind: `node`, `gap`, `reset`, `set_aside`, `clock_off`, `refused`, `drift`, `forgotten`.
    pub kind: String,
    /// The node it is about.
    pub node: Option<String>,
    /// Details, by kind.
    pub detail: Value,
}

/// An invalid report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StoredSetAside {
    /// Its number.
    pub id: i64,
    /// The node that sent it.
    pub node: String,
    /// Identity of the report.
    pub report_id: Option<String>,
    /// When it was received.
    pub received_ms: i64,
    /// Why it is invalid.
    pub cause: String,
    /// Its text, at most 16 KiB.
    pub body: String,
}

impl FromRow for StoredClip {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            id: row.take()?,
            node: row.take()?,
            camera: row.take()?,
            report_id: row.take()?,
            count: row.take()?,
            at_ms: row.take()?,
            received_ms: row.take()?,
            clip: row.take()?,
            part: row.take()?,
            ended_by: row.take()?,
            duration_s: row.take()?,
            frames: row.take()?,
            e: row.take()?,
            p: row.take()?,
            ei: row.take()?,
            i: row.take()?,
            ai: row.take()?,
            degraded: row.take()?,
            dropped: row.take()?,
            latency_mean_ms: row.take()?,
            latency_p99_ms: row.take()?,
            detector_calls: row.take()?,
            detector_mean_ms: row.take()?,
            policy: row.take()?,
            threshold: row.take()?,
            value: row.take_json()?,
            model: row.take()?,
            provider: row.take()?,
            power_source: row.take()?,
            quality: row.take_named(quality)?,
            joules: row.take()?,
            edp: row.take()?,
            distance_m: row.take()?,
            audit: audit_figures(&AuditColumns::from_row(row)?.0),
        })
    }
}

impl FromRow for StoredEvent {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            id: row.take()?,
            at_ms: row.take()?,
            kind: row.take()?,
            node: row.take()?,
            detail: row.take_json()?,
        })
    }
}

impl FromRow for StoredSetAside {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            id: row.take()?,
            node: row.take()?,
            report_id: row.take()?,
            received_ms: row.take()?,
            cause: row.take()?,
            body: row.take()?,
        })
    }
}

impl Store {
    /// At most `limit` clips, the last received first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn clips(
        &self,
        wanted: &ClipQuery,
        limit: i64,
    ) -> Result<Vec<StoredClip>, StoreError> {
        let mut values: Vec<Param> = vec![
            wanted.cursor.unwrap_or(i64::MAX).into(),
            wanted.since_ms.unwrap_or(i64::MIN).into(),
            wanted.until_ms.unwrap_or(i64::MAX).into(),
            limit.into(),
        ];
        let text = match &wanted.node {
            Some(node) => {
                values.push(node.as_str().into());
                values.push(wanted.camera.as_deref().unwrap_or_default().into());
                CLIPS_OF_NODE
            }
            None => CLIPS,
        };
        read_all(self.query(text, values).await?)
    }

    /// The numbers of the first event that was not deleted and of the last; both are 0 if there is none.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn kept_events(&self) -> Result<RangeInclusive<i64>, StoreError> {
        // Each for itself: SQLite would read the whole table for both at once.
        let text = "SELECT COALESCE((SELECT min(id) FROM events), 0), \
                    COALESCE((SELECT max(id) FROM events), 0)";
        match self.query(text, Vec::new()).await?.first_mut() {
            Some(row) => {
                let first = row.take()?;
                let last = row.take()?;
                Ok(first..=last)
            }
            None => Ok(0..=0),
        }
    }

    /// Events with numbers above `id`, in order.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn events_after(
        &self,
        id: i64,
        limit: i64,
    ) -> Result<Vec<StoredEvent>, StoreError> {
        let text =
            "SELECT id, at_ms, kind, node, detail FROM events WHERE id > $1 ORDER BY id LIMIT $2";
        read_all(self.query(text, vec![id.into(), limit.into()]).await?)
    }

    /// Invalid reports, the latest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn set_aside(
        &self,
        node: Option<&str>,
        before_id: Option<i64>,
        limit: i64,
    ) -> Result<Vec<StoredSetAside>, StoreError> {
        let text = "SELECT a.id, n.name, a.report_id, a.received_ms, a.cause, a.body FROM set_aside a JOIN nodes n ON n.id = a.node_id \
                    WHERE a.id < $1 AND ($2 = '' OR n.name = $2) ORDER BY a.id DESC LIMIT $3";
        let values = vec![
            before_id.unwrap_or(i64::MAX).into(),
            node.unwrap_or_default().into(),
            limit.into(),
        ];
        read_all(self.query(text, values).await?)
    }

    /// Counts of a node's reports; `None` if none was received.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn report_counts(
        &self,
        node: &str,
    ) -> Result<Option<ReportCounts>, StoreError> {
        let text = "SELECT r.first_ms, r.last_ms, r.stored, r.set_aside, r.refused, r.missing, r.resets \
                    FROM report_counts r JOIN nodes n ON n.id = r.node_id WHERE n.name = $1";
        let rows: Vec<ReportCounts> = read_all(self.query(text, vec![node.into()]).await?)?;
        Ok(rows.into_iter().next())
    }
}
