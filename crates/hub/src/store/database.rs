//! Defines a connection to a database, and the statements of ingest.

use super::read::ReportCounts;
use super::row::{Columns, Row, columns, read_all, row};
use super::{Kind, StoreError};
use crate::ingest::Counts;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashMap, HashSet};
use uuid::Uuid;

/// The statements that add clips to sums, with the length of their spans in seconds.
const ADD_SUMS: [(&str, i64); 2] = [
    (
        concat!("INSERT INTO sums_5m", include_str!("sql/add_sums.sql")),
        300,
    ),
    (
        concat!("INSERT INTO sums_hour", include_str!("sql/add_sums.sql")),
        3600,
    ),
];

/// The largest sum. Sums saturate there, so that none is too large for its column.
const LARGEST_SUM: i64 = 1 << 62;

/// A connection to a database. Dropping it rolls back an open transaction.
pub(crate) trait Database: Send {
    fn kind(&self) -> Kind;

    /// True if it can still be used: a server that restarts closes it.
    ///
    /// # Errors
    /// When a new connection would not help: SQLite's log was deleted.
    fn is_open(&mut self) -> Result<bool, StoreError>;

    /// Begins a transaction that writes. Only one writes at a time, across all hubs: two would wait for each other's
    /// rows.
    fn begin(&mut self) -> Result<(), StoreError>;

    /// Runs a statement and returns its rows. Its parameters are `$1`, `$2`, …
    fn query(&mut self, text: &str, values: &[Value]) -> Result<Vec<Row>, StoreError>;

    /// Runs a statement for rows with the same columns, in order, and returns its rows. In SQLite the columns of a row
    /// are the parameters `?1`, `?2`, …; PostgreSQL gets all rows at once, as the JSON array `$1`.
    fn each(&mut self, text: &str, rows: Vec<Columns<'_>>) -> Result<Vec<Row>, StoreError>;

    /// Runs several statements without parameters.
    fn script(&mut self, text: &'static str) -> Result<(), StoreError>;

    /// Commits. The rows then survive a power loss.
    fn commit(&mut self) -> Result<(), StoreError> {
        self.script("COMMIT")
    }

    /// Writes one row, which shows whether the database accepts a commit.
    fn prove_writing(&mut self, now_ms: i64) -> Result<(), StoreError> {
        let text = "INSERT INTO hub_meta (key, value) VALUES ('written_ms', $1) \
                    ON CONFLICT (key) DO UPDATE SET value = excluded.value";
        self.query(text, &[now_ms.to_string().into()]).map(drop)
    }

    /// Runs a statement and returns the whole number in its first row, if any.
    fn number(&mut self, text: &str, values: &[Value]) -> Result<Option<i64>, StoreError> {
        let rows = self.query(text, values)?;
        Ok(rows.first().and_then(|row| row.values().next()?.as_i64()))
    }
}

/// The unique key of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(crate) struct ReportKey {
    /// The day under which it is stored: the identity's own day, or the negative day of receipt if that is not
    /// believed.
    pub(crate) day: i64,
    /// Its identity.
    #[serde(with = "uuid::serde::compact")]
    pub(crate) id: Uuid,
    /// The identity's own day, believed or not.
    pub(crate) own_day: i64,
}

/// Counts of a node's reports.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ReportCountsRow {
    /// The node's name, if the query returns it.
    #[serde(default, skip_serializing)]
    pub(crate) name: String,
    pub(crate) node_id: i64,
    #[serde(flatten)]
    pub(crate) totals: ReportCounts,
    #[serde(flatten)]
    pub(crate) counts: Counts,
}

/// Most cameras of a node.
pub(crate) const MOST_CAMERAS: usize = 64;

impl dyn Database + '_ {
    /// Inserts rows into a table, in order. `rest` ends the statement: an `ON CONFLICT` clause, a `RETURNING` clause, both, or
    /// nothing.
    pub(crate) fn insert<R: Serialize>(
        &mut self,
        table: &str,
        rows: &[R],
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let rows = rows.iter().map(row).collect::<Result<Vec<_>, _>>()?;
        self.insert_rows(table, rows.iter().map(columns).collect(), rest)
    }

    /// Does the same as [`insert`](Self::insert) for rows, which must all have the same columns.
    pub(super) fn insert_rows(
        &mut self,
        table: &str,
        rows: Vec<Columns<'_>>,
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let Some(first) = rows.first() else {
            return Ok(Vec::new());
        };
        let columns = first
            .iter()
            .map(|(column, _)| format!("\"{column}\""))
            .collect::<Vec<_>>()
            .join(", ");
        let values = match self.kind() {
            Kind::Sqlite => format!("VALUES ({})", vec!["?"; first.len()].join(", ")),
            Kind::Postgres => {
                format!("SELECT {columns} FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb)")
            }
        };
        self.each(
            &format!("INSERT INTO {table} ({columns}) {values} {rest}"),
            rows,
        )
    }

    /// Runs a query that ends with a text column and `IN`, for the given texts.
    pub(crate) fn among(&mut self, query: &str, texts: &[&str]) -> Result<Vec<Row>, StoreError> {
        let list = match self.kind() {
            Kind::Sqlite => "(SELECT value FROM json_each($1))",
            Kind::Postgres => "(SELECT jsonb_array_elements_text($1::jsonb))",
        };
        self.query(
            &format!("{query} {list}"),
            &[json!(texts).to_string().into()],
        )
    }

    /// Returns the report counts of nodes, by name. Adds new nodes.
    pub(crate) fn reporting_nodes(
        &mut self,
        names: &[&str],
        now_ms: i64,
    ) -> Result<HashMap<String, ReportCountsRow>, StoreError> {
        let text = include_str!("sql/reporting_nodes.sql");
        let mut nodes = self.among(text, names)?;
        if nodes.len() < names.len() {
            let add = "INSERT INTO nodes (name, state, since_ms, why) \
                       VALUES ($1, 'silent', $2, 'no status was received yet') ON CONFLICT (name) DO NOTHING";
            for name in names {
                self.query(add, &[(*name).into(), now_ms.into()])?;
            }
            nodes = self.among(text, names)?;
        }
        let nodes: Vec<ReportCountsRow> = read_all(nodes)?;
        let nodes = nodes.into_iter().map(|mut node| {
            // Only of a new row; that of an old one is not changed.
            node.totals.first_ms = now_ms;
            (node.name.clone(), node)
        });
        Ok(nodes.collect())
    }

    /// Returns the ids of the cameras of these nodes, by node id and name.
    pub(crate) fn cameras(
        &mut self,
        nodes: &[&str],
    ) -> Result<HashMap<i64, HashMap<String, i64>>, StoreError> {
        #[derive(Deserialize)]
        struct Camera {
            id: i64,
            node_id: i64,
            name: String,
        }
        let mut cameras: HashMap<i64, HashMap<String, i64>> = HashMap::new();
        let text = "SELECT c.id, c.node_id, c.name FROM cameras c JOIN nodes n ON n.id = c.node_id WHERE n.name IN";
        for camera in read_all::<Camera>(self.among(text, nodes)?)? {
            let known = cameras.entry(camera.node_id).or_default();
            known.insert(camera.name, camera.id);
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
        setups: HashSet<&Row>,
    ) -> Result<HashMap<Row, i64>, StoreError> {
        // The update changes nothing; it makes the statement return the row.
        let conflict = "ON CONFLICT (policy, threshold, value, model, provider, power_source, total_from) \
                        DO UPDATE SET policy = excluded.policy RETURNING *";
        let setups = setups.into_iter().map(columns).collect();
        let numbered = self
            .insert_rows("setups", setups, conflict)?
            .into_iter()
            .filter_map(|mut setup| Some((setup.remove("id")?, setup)));
        let ids = numbered.filter_map(|(id, setup)| Some((setup, id.as_i64()?)));
        Ok(ids.collect())
    }

    /// Stores the identities of reports, and returns those that are new.
    pub(crate) fn new_reports(
        &mut self,
        keys: &BTreeSet<ReportKey>,
    ) -> Result<BTreeSet<Uuid>, StoreError> {
        #[derive(Deserialize)]
        struct New {
            #[serde(with = "uuid::serde::compact")]
            id: Uuid,
        }
        if keys.is_empty() {
            return Ok(BTreeSet::new());
        }
        let text = match self.kind() {
            Kind::Sqlite => include_str!("sql/new_reports_sqlite.sql"),
            Kind::Postgres => include_str!("sql/new_reports_postgres.sql"),
        };
        let rows = keys.iter().map(row).collect::<Result<Vec<_>, _>>()?;
        let columns = rows.iter().map(columns).collect();
        let new: Vec<New> = read_all(self.each(text, columns)?)?;
        Ok(new.into_iter().map(|one| one.id).collect())
    }

    /// Removes identities that [`new_reports`](Self::new_reports) stored, of reports that are refused.
    pub(crate) fn forget_reports(&mut self, keys: &BTreeSet<ReportKey>) -> Result<(), StoreError> {
        if keys.is_empty() {
            return Ok(());
        }
        let text = match self.kind() {
            Kind::Sqlite => "DELETE FROM report_ids WHERE day = ?1 AND id = ?2 AND ?3 = ?3",
            Kind::Postgres => {
                "DELETE FROM report_ids r USING jsonb_to_recordset($1::jsonb) AS k (day BIGINT, id BYTEA) \
                 WHERE r.day = k.day AND r.id = k.id"
            }
        };
        let rows = keys.iter().map(row).collect::<Result<Vec<_>, _>>()?;
        self.each(text, rows.iter().map(columns).collect()).map(drop)
    }

    /// Writes the report counts of nodes.
    pub(crate) fn write_report_counts(
        &mut self,
        rows: Vec<ReportCountsRow>,
    ) -> Result<(), StoreError> {
        let conflict = "ON CONFLICT (node_id) DO UPDATE SET last_ms = excluded.last_ms, \
                        stored = excluded.stored, set_aside = excluded.set_aside, refused = excluded.refused, \
                        resets = excluded.resets, base = excluded.base, highest = excluded.highest, \
                        missing = excluded.missing, ranges = excluded.ranges";
        self.insert("report_counts", &rows, conflict).map(drop)
    }

    /// Inserts clips, and adds them to the sums of their cameras and of the fleet.
    pub(crate) fn insert_clips(&mut self, clips: Vec<Columns<'_>>) -> Result<(), StoreError> {
        let first = self.number("SELECT COALESCE(max(id), 0) + 1 FROM clips", &[])?;
        self.insert_rows("clips", clips, "")?;
        for (text, seconds) in ADD_SUMS {
            self.query(text, &[first.into(), seconds.into(), LARGEST_SUM.into()])?;
        }
        Ok(())
    }
}
