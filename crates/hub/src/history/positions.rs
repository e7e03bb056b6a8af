//! Reads and deletes where clips were made.

use super::quality;
use crate::store::row::{FromRow, Row, read_all};
use crate::store::{Store, StoreError};
use albireo_wire::{ClipTravel, EnergyQuality};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::{IntoParams, ToSchema};

/// Selects clips with positions.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PositionQuery {
    /// Only of this node.
    pub node: Option<String>,
    /// Only of cameras of this name.
    pub camera: Option<String>,
    /// Only clips that began at this time or later, milliseconds since the Unix epoch; a day ago by default.
    pub since_ms: Option<i64>,
    /// Only clips that began before this time; all by default, also those of a node whose clock is ahead.
    pub until_ms: Option<i64>,
    /// Maximum number of clips, up to 5000; 1000 by default.
    pub limit: Option<i64>,
}

/// A clip with its figures, where positions are known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PositionedClip {
    /// Its number in the database.
    #[serde(skip_serializing)]
    pub id: i64,
    /// Node.
    pub node: String,
    /// Camera.
    pub camera: String,
    /// Clip id.
    pub clip: String,
    /// Number of this part of the clip, from 0.
    pub part: i64,
    /// When it began, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Its length, seconds.
    pub duration_s: f64,
    /// Frames.
    pub frames: i64,
    /// Share of frames that skipped the detector.
    pub skip_rate: f64,
    /// Distance driven, metres.
    pub distance_m: f64,
    /// Quality of the energy.
    pub quality: EnergyQuality,
    /// Energy of the camera's share, joules.
    pub joules: Option<f64>,
    /// Energy of the whole node per kilometre, joules; null if it is not known in full or the camera did not move.
    pub joules_per_km: Option<f64>,
    /// Its way.
    #[serde(skip_serializing)]
    #[schema(ignore)]
    pub travel: ClipTravel,
}

impl FromRow for PositionedClip {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            id: row.take()?,
            node: row.take()?,
            camera: row.take()?,
            clip: row.take()?,
            part: row.take()?,
            at_ms: row.take()?,
            duration_s: row.take()?,
            frames: row.take()?,
            skip_rate: row.take()?,
            distance_m: row.take()?,
            quality: row.take_named(quality)?,
            joules: row.take()?,
            joules_per_km: row.take()?,
            travel: row.take_json()?,
        })
    }
}

impl Store {
    /// At most `limit` clips with positions that began within `times`, milliseconds since the Unix epoch, the last first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn positions(
        &self,
        wanted: &PositionQuery,
        times: Range<i64>,
        limit: i64,
    ) -> Result<Vec<PositionedClip>, StoreError> {
        let text = include_str!("sql/positions.sql").to_owned();
        let values = vec![
            times.start.into(),
            times.end.into(),
            wanted.node.as_deref().unwrap_or_default().into(),
            wanted.camera.as_deref().unwrap_or_default().into(),
            limit.into(),
        ];
        read_all(self.query(text, values).await?)
    }

    /// Deletes the ways of a node's clips that began before `until_ms`, and the texts of its invalid reports with a way. Clips
    /// and sums stay. Returns the number of clips.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub(crate) async fn delete_positions(
        &self,
        node: String,
        until_ms: i64,
    ) -> Result<usize, StoreError> {
        self.write(move |database| {
            let delete_ways = "UPDATE clips SET distance_mm = NULL, travel = NULL \
                        WHERE distance_mm IS NOT NULL AND at_ms < $2 AND camera_id IN \
                        (SELECT c.id FROM cameras c JOIN nodes n ON n.id = c.node_id WHERE n.name = $1) RETURNING 1 AS gone";
            let values = [node.into(), until_ms.into()];
            let gone = database.query(delete_ways, &values)?;
            let empty_texts = "UPDATE set_aside SET body = '' WHERE received_ms < $2 AND body LIKE '%\"travel\"%' \
                        AND node_id IN (SELECT id FROM nodes WHERE name = $1)";
            database.query(empty_texts, &values)?;
            Ok(gone.len())
        })
        .await
    }
}
