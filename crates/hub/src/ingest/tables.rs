//! The tables of ingest: identities of reports, clips and their sums, cameras, setups, and counts of reports.

use super::clip::{SetupRow, StoredClipRow};
use super::plan::Counts;
use crate::store::row::{Columns, FromRow, IntoRow, Row, read_all};
use crate::store::{Database, DatabaseKind, StoreError};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use utoipa::ToSchema;
use uuid::Uuid;

/// A statement that adds clips to sums.
struct AddSums {
    text: &'static str,
    /// The length of the spans of time that are summed.
    span_s: i64,
}

const ADD_SUMS: [AddSums; 2] = [
    AddSums {
        text: concat!("INSERT INTO sums_5m", include_str!("sql/add_sums.sql")),
        span_s: 300,
    },
    AddSums {
        text: concat!("INSERT INTO sums_hour", include_str!("sql/add_sums.sql")),
        span_s: 3600,
    },
];

/// The largest sum. Sums saturate there, so that none is too large for its column.
const LARGEST_SUM: i64 = 1 << 62;

/// Most cameras that are kept of a node, under whatever names: each stays, because sums over hours do.
pub(super) const MOST_CAMERA_NAMES: i64 = 4096;

/// The unique key of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ReportKey {
    /// The day under which it is stored: the identity's own day, or the negative day of receipt if that is not
    /// believed.
    pub(crate) day: i64,
    /// Its identity.
    pub(crate) id: Uuid,
    /// The identity's own day, believed or not.
    pub(crate) own_day: i64,
}

impl ReportKey {
    /// The columns that the statements about identities name.
    fn columns(&self) -> Columns<'static> {
        vec![
            ("day", self.day.into()),
            ("id", self.id.into()),
            ("own_day", self.own_day.into()),
        ]
    }
}

/// Counts of a node's reports.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ReportCountsRow {
    /// The node's name, which is in another table.
    pub(crate) name: String,
    pub(crate) node_id: i64,
    /// The number of its cameras, which are in another table.
    pub(crate) cameras: i64,
    pub(crate) totals: ReportCounts,
    pub(crate) counts: Counts,
}

impl FromRow for ReportCountsRow {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            name: row.take()?,
            node_id: row.take()?,
            cameras: row.take()?,
            totals: ReportCounts::from_row(row)?,
            counts: Counts::from_row(row)?,
        })
    }
}

impl IntoRow for ReportCountsRow {
    const TABLE: &'static str = "report_counts";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        let totals = &self.totals;
        let [base, highest, ranges, displaced] = self.counts.cells()?;
        Ok(vec![
            ("node_id", self.node_id.into()),
            ("first_ms", totals.first_ms.into()),
            ("last_ms", totals.last_ms.into()),
            ("stored", totals.stored.into()),
            ("set_aside", totals.set_aside.into()),
            ("refused", totals.refused.into()),
            (
                "missing",
                i64::try_from(totals.missing).unwrap_or(i64::MAX).into(),
            ),
            ("resets", totals.resets.into()),
            ("base", base),
            ("highest", highest),
            ("ranges", ranges),
            ("displaced", displaced),
        ])
    }
}

/// Counts of a node's reports.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportCounts {
    /// When the first batch was received, milliseconds since the Unix epoch.
    pub first_ms: i64,
    /// When the last batch was received.
    pub last_ms: i64,
    /// Reports stored.
    pub stored: i64,
    /// Invalid reports.
    pub set_aside: i64,
    /// Reports refused, because they were too old.
    pub refused: i64,
    /// Reports that were never received, by their running counts.
    pub missing: u64,
    /// How often the running count restarted: the node's state was new, older or a copy.
    pub resets: i64,
}

impl FromRow for ReportCounts {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            first_ms: row.take()?,
            last_ms: row.take()?,
            stored: row.take()?,
            set_aside: row.take()?,
            refused: row.take()?,
            missing: row.take()?,
            resets: row.take()?,
        })
    }
}

/// A camera of a node.
struct CameraRow {
    id: i64,
    node_id: i64,
    name: String,
}

impl FromRow for CameraRow {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            id: row.take()?,
            node_id: row.take()?,
            name: row.take()?,
        })
    }
}

/// A setup with its id.
struct NumberedSetup {
    id: i64,
    setup: SetupRow,
}

impl FromRow for NumberedSetup {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            id: row.take()?,
            setup: SetupRow::from_row(row)?,
        })
    }
}

impl dyn Database + '_ {
    /// Returns the report counts of nodes, by name. Adds new nodes.
    pub(crate) fn reporting_nodes(
        &mut self,
        names: &[&str],
        now_ms: i64,
    ) -> Result<HashMap<String, ReportCountsRow>, StoreError> {
        let text = include_str!("sql/reporting_nodes.sql");
        let mut rows = self.among(text, names)?;
        if rows.len() < names.len() {
            let add = "INSERT INTO nodes (name, state, since_ms, why) \
                       VALUES ($1, 'silent', $2, 'no status was received yet') ON CONFLICT (name) DO NOTHING";
            for name in names {
                self.query(add, &[(*name).into(), now_ms.into()])?;
            }
            rows = self.among(text, names)?;
        }
        let mut nodes = HashMap::new();
        for mut node in read_all::<ReportCountsRow>(rows)? {
            // It is written with a new row; an update leaves the one of an old row.
            node.totals.first_ms = now_ms;
            nodes.insert(node.name.clone(), node);
        }
        Ok(nodes)
    }

    /// Returns the ids of the cameras with these names, which are by node id, by node id and name. A camera that its node has
    /// not had yet is left out.
    pub(crate) fn cameras(
        &mut self,
        names: &BTreeMap<i64, BTreeSet<&str>>,
    ) -> Result<HashMap<i64, HashMap<String, i64>>, StoreError> {
        let text = match self.kind() {
            DatabaseKind::Sqlite => {
                "SELECT id, node_id, name FROM cameras WHERE node_id = ?1 AND name = ?2"
            }
            DatabaseKind::Postgres => {
                "SELECT c.id, c.node_id, c.name FROM cameras c \
                 JOIN jsonb_to_recordset($1::jsonb) AS k (node_id BIGINT, name TEXT) \
                 ON c.node_id = k.node_id AND c.name = k.name"
            }
        };
        let mut rows: Vec<Columns<'static>> = Vec::new();
        for (node_id, names) in names {
            for name in names {
                rows.push(vec![
                    ("node_id", (*node_id).into()),
                    ("name", (*name).into()),
                ]);
            }
        }
        let mut cameras: HashMap<i64, HashMap<String, i64>> = HashMap::new();
        for camera in read_all::<CameraRow>(self.each(text, rows)?)? {
            cameras.entry(camera.node_id).or_default().insert(camera.name, camera.id);
        }
        Ok(cameras)
    }

    /// Adds a camera to a node, and returns its id.
    pub(crate) fn add_camera(&mut self, node_id: i64, name: &str) -> Result<i64, StoreError> {
        let text = "INSERT INTO cameras (node_id, name) VALUES ($1, $2) RETURNING id";
        let id = self.number(text, &[node_id.into(), name.into()])?;
        id.ok_or_else(|| StoreError::Statement(format!("the camera {name} got no id")))
    }

    /// Returns the ids of setups. Adds new setups.
    pub(crate) fn setups(
        &mut self,
        setups: HashSet<&SetupRow>,
    ) -> Result<HashMap<SetupRow, i64>, StoreError> {
        // The update changes nothing; it makes the statement return the row.
        let conflict = "ON CONFLICT (policy, threshold, value, model, provider, power_source, total_from) \
                        DO UPDATE SET policy = excluded.policy \
                        RETURNING id, policy, threshold, value, model, provider, power_source, total_from";
        let setups: Vec<&SetupRow> = setups.into_iter().collect();
        let numbered: Vec<NumberedSetup> = read_all(self.insert(&setups, conflict)?)?;
        Ok(numbered.into_iter().map(|one| (one.setup, one.id)).collect())
    }

    /// Stores the identities of reports, and returns those that are new.
    pub(crate) fn new_reports(
        &mut self,
        keys: &BTreeSet<ReportKey>,
    ) -> Result<BTreeSet<Uuid>, StoreError> {
        if keys.is_empty() {
            return Ok(BTreeSet::new());
        }
        let text = match self.kind() {
            DatabaseKind::Sqlite => include_str!("sql/new_reports_sqlite.sql"),
            DatabaseKind::Postgres => include_str!("sql/new_reports_postgres.sql"),
        };
        let rows = keys.iter().map(ReportKey::columns).collect();
        let new = self.each(text, rows)?;
        new.into_iter().map(|mut row| row.take()).collect()
    }

    /// Removes identities that [`new_reports`](Self::new_reports) stored, of reports that are refused.
    pub(crate) fn forget_reports(&mut self, keys: &BTreeSet<ReportKey>) -> Result<(), StoreError> {
        if keys.is_empty() {
            return Ok(());
        }
        let text = match self.kind() {
            DatabaseKind::Sqlite => "DELETE FROM report_ids WHERE day = ?1 AND id = ?2 AND ?3 = ?3",
            DatabaseKind::Postgres => {
                "DELETE FROM report_ids r USING jsonb_to_recordset($1::jsonb) AS k (day BIGINT, id BYTEA) \
                 WHERE r.day = k.day AND r.id = k.id"
            }
        };
        let rows = keys.iter().map(ReportKey::columns).collect();
        self.each(text, rows)?;
        Ok(())
    }

    /// Writes the report counts of nodes.
    pub(crate) fn write_report_counts(
        &mut self,
        rows: &[ReportCountsRow],
    ) -> Result<(), StoreError> {
        let conflict = "ON CONFLICT (node_id) DO UPDATE SET last_ms = excluded.last_ms, \
                        stored = excluded.stored, set_aside = excluded.set_aside, refused = excluded.refused, \
                        resets = excluded.resets, base = excluded.base, highest = excluded.highest, \
                        missing = excluded.missing, ranges = excluded.ranges, displaced = excluded.displaced";
        self.insert(rows, conflict)?;
        Ok(())
    }

    /// Inserts clips, and adds them to the sums of their cameras and of the fleet.
    pub(crate) fn insert_clips(&mut self, clips: &[StoredClipRow]) -> Result<(), StoreError> {
        let first = self
            .number("SELECT COALESCE(max(id), 0) + 1 FROM clips", &[])?
            .ok_or_else(|| StoreError::Statement("clips have no next id".to_owned()))?;
        self.insert(clips, "")?;
        for add in ADD_SUMS {
            let values = [first.into(), add.span_s.into(), LARGEST_SUM.into()];
            self.query(add.text, &values)?;
        }
        Ok(())
    }
}
