//! One connection to a database, and what is written over it.

use super::row::{Row, read_all, row};
use super::tables::{EventRow, LARGEST_SUM, NodeRow, ReportCountsRow, SetupKey, SumRow};
use super::{Kind, StoreError, migrate};
use crate::presence::PresenceState;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashMap};
use uuid::Uuid;

/// A connection to a database. Dropped, it rolls back what it has begun.
pub(crate) trait Database: Send {
    fn kind(&self) -> Kind;

    /// Whether it may be used again: a server that restarted has closed it.
    fn is_open(&mut self) -> bool;

    /// Begins a transaction that writes. One at a time does, whichever hub's it is: two would wait for each other's rows.
    fn begin(&mut self) -> Result<(), StoreError>;

    /// Commits; what was written then survives a power loss.
    fn commit(&mut self) -> Result<(), StoreError>;

    /// Runs a statement, and gives the rows that it returns. Its parameters are `$1`, `$2`, …
    fn query(&mut self, text: &str, values: &[Value]) -> Result<Vec<Row>, StoreError>;

    /// Runs a statement for rows with the same columns, in order, and gives the rows that it returns. In SQLite the columns
    /// are the parameters `:column`; PostgreSQL is given all rows at once, as the JSON array `$1`.
    fn each(&mut self, text: &str, rows: Vec<Row>) -> Result<Vec<Row>, StoreError>;

    /// Runs several statements without parameters.
    fn script(&mut self, text: &'static str) -> Result<(), StoreError>;

    /// The one whole number that a statement gives, if it gives any.
    fn number(&mut self, text: &str, values: &[Value]) -> Result<Option<i64>, StoreError> {
        let rows = self.query(text, values)?;
        Ok((rows.first()).and_then(|row| row.values().next()?.as_i64()))
    }
}

/// The key of a report: nothing of it is stored twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(crate) struct ReportKey {
    /// The day that it is kept under: that of its identity, or that of receipt, negative, where that cannot be believed.
    pub(crate) day: i64,
    /// Its identity.
    #[serde(with = "uuid::serde::compact")]
    pub(crate) id: Uuid,
    /// The day of the identity's own time, whether it is believed or not.
    pub(crate) own_day: i64,
}

/// A camera of a node.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct CameraRow {
    pub(crate) id: i64,
    pub(crate) node_id: i64,
    pub(crate) name: String,
}

impl dyn Database + '_ {
    /// The id of the database, which a copy of it keeps.
    pub(crate) fn identity(&mut self) -> Result<Uuid, StoreError> {
        let identity = migrate::meta(self)?.identity;
        identity.ok_or_else(|| StoreError::Statement("the database has no id".to_owned()))
    }

    /// Inserts rows into a table, in order. `rest` ends the statement: an `ON CONFLICT` clause, a `RETURNING` clause, both, or
    /// nothing.
    pub(crate) fn insert<R: Serialize>(
        &mut self,
        table: &str,
        rows: &[R],
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let rows = rows.iter().map(row).collect::<Result<Vec<_>, _>>()?;
        let Some(first) = rows.first() else {
            return Ok(Vec::new());
        };
        let columns = list(first.keys().map(String::as_str), "");
        let values = match self.kind() {
            Kind::Sqlite => format!("VALUES ({})", list(first.keys().map(String::as_str), ":")),
            Kind::Postgres => {
                format!("SELECT {columns} FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb)")
            }
        };
        self.each(
            &format!("INSERT INTO {table} ({columns}) {values} {rest}"),
            rows,
        )
    }

    /// The numbers of nodes by name; a node that is new is added.
    pub(crate) fn nodes(
        &mut self,
        names: &[&str],
        now_ms: i64,
    ) -> Result<Vec<(String, i64)>, StoreError> {
        self.add_nodes(names, now_ms, "DO NOTHING")?;
        let mut numbered = Vec::new();
        for name in names {
            let id = self.number("SELECT id FROM nodes WHERE name = $1", &[(*name).into()])?;
            numbered.extend(id.map(|id| ((*name).to_owned(), id)));
        }
        Ok(numbered)
    }

    /// Adds nodes of these names; `conflict` says what is done with those that are there already.
    fn add_nodes(
        &mut self,
        names: &[&str],
        now_ms: i64,
        conflict: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let new = |name: &&str| {
            json!({
                "name": name,
                "first_seen_ms": now_ms,
                "state": PresenceState::Silent,
                "since_ms": now_ms,
                "why": "no status has come yet",
            })
        };
        let new: Vec<Value> = names.iter().map(new).collect();
        self.insert("nodes", &new, &format!("ON CONFLICT (name) {conflict}"))
    }

    /// The cameras of a node.
    pub(crate) fn cameras_of(&mut self, node: i64) -> Result<Vec<CameraRow>, StoreError> {
        let text = "SELECT id, node_id, name FROM cameras WHERE node_id = $1";
        read_all(self.query(text, &[node.into()])?)
    }

    /// Adds cameras, given by node and name.
    pub(crate) fn add_cameras(
        &mut self,
        cameras: &[(i64, &str)],
    ) -> Result<Vec<CameraRow>, StoreError> {
        let new = |(node, name): &(i64, &str)| json!({ "node_id": node, "name": name });
        let new: Vec<Value> = cameras.iter().map(new).collect();
        let conflict = "ON CONFLICT (node_id, name) DO UPDATE SET name = excluded.name RETURNING id, node_id, name";
        read_all(self.insert("cameras", &new, conflict)?)
    }

    /// The numbers of setups; one that is new is added.
    pub(crate) fn setups(
        &mut self,
        setups: &[&SetupKey],
    ) -> Result<Vec<(SetupKey, i64)>, StoreError> {
        #[derive(Deserialize)]
        struct Numbered {
            id: i64,
            #[serde(flatten)]
            setup: SetupKey,
        }
        let conflict = "ON CONFLICT (policy, knob, value, model, provider, power_source, total_from) \
                        DO UPDATE SET policy = excluded.policy RETURNING *";
        let numbered: Vec<Numbered> = read_all(self.insert("setups", setups, conflict)?)?;
        Ok(numbered
            .into_iter()
            .map(|one| (one.setup, one.id))
            .collect())
    }

    /// Notes reports; those of them that were not known before.
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
        let rows = keys.iter().map(row).collect::<Result<_, _>>()?;
        let new: Vec<New> = read_all(self.each(text, rows)?)?;
        Ok(new.into_iter().map(|one| one.id).collect())
    }

    /// What is known of the reports of these nodes.
    pub(crate) fn report_counts(
        &mut self,
        nodes: &[i64],
        now_ms: i64,
    ) -> Result<HashMap<i64, ReportCountsRow>, StoreError> {
        let new = |node: &i64| json!({ "node_id": node, "first_ms": now_ms, "last_ms": now_ms });
        let new: Vec<Value> = nodes.iter().map(new).collect();
        // Changes nothing, and returns the row.
        let conflict = "ON CONFLICT (node_id) DO UPDATE SET node_id = excluded.node_id RETURNING *";
        let known: Vec<ReportCountsRow> =
            read_all(self.insert("report_counts", &new, conflict)?)?;
        Ok(known.into_iter().map(|row| (row.node_id, row)).collect())
    }

    /// Writes what is known of the reports of nodes.
    pub(crate) fn write_report_counts(
        &mut self,
        rows: &[ReportCountsRow],
    ) -> Result<(), StoreError> {
        let conflict = "ON CONFLICT (node_id) DO UPDATE SET first_ms = excluded.first_ms, last_ms = excluded.last_ms, \
                        stored = excluded.stored, set_aside = excluded.set_aside, refused = excluded.refused, \
                        resets = excluded.resets, base = excluded.base, highest = excluded.highest, \
                        missing = excluded.missing";
        self.insert("report_counts", rows, conflict).map(drop)
    }

    /// Writes what is known of nodes, which come in the order of their names. Those whose state changed are returned with
    /// the state before: of several hubs that see the same, one changes it.
    pub(crate) fn update_nodes(
        &mut self,
        rows: &[NodeRow],
        now_ms: i64,
    ) -> Result<HashMap<String, String>, StoreError> {
        #[derive(Deserialize)]
        struct Before {
            name: String,
            state: String,
            since_ms: i64,
        }
        let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        // Changes nothing, and returns the row.
        let same = "DO UPDATE SET name = excluded.name RETURNING name, state, since_ms";
        let before: Vec<Before> = read_all(self.add_nodes(&names, now_ms, same)?)?;
        let mut before: HashMap<String, Before> = before
            .into_iter()
            .map(|node| (node.name.clone(), node))
            .collect();
        // A node that was forgotten since stays so.
        let mut rows = rows.to_vec();
        rows.retain(|row| {
            (before.get(&row.name))
                .is_some_and(|node| node.state != "forgotten" || node.since_ms < row.since_ms)
        });
        self.insert(
            "nodes",
            &rows,
            // What is not known now stays as it was.
            "ON CONFLICT (name) DO UPDATE SET state = excluded.state, \
             since_ms = CASE WHEN nodes.state = excluded.state THEN nodes.since_ms ELSE excluded.since_ms END, \
             why = excluded.why, heard_ms = COALESCE(excluded.heard_ms, nodes.heard_ms), \
             run = COALESCE(excluded.run, nodes.run), started_ns = COALESCE(excluded.started_ns, nodes.started_ns), \
             revision = excluded.revision, status = COALESCE(excluded.status, nodes.status)",
        )?;
        let changed = rows.into_iter().filter_map(|row| {
            let before = before.remove(&row.name)?;
            (before.state != row.state).then_some((row.name, before.state))
        });
        Ok(changed.collect())
    }

    /// Adds sums to those of `table`.
    pub(crate) fn add_sums(&mut self, table: &str, rows: &[SumRow]) -> Result<(), StoreError> {
        let added: Vec<String> = SumRow::summed()
            .map(|name| {
                format!(
                    "{name} = CASE WHEN {table}.{name} > {LARGEST_SUM} - excluded.{name} THEN {LARGEST_SUM} \
                     ELSE {table}.{name} + excluded.{name} END"
                )
            })
            .collect();
        let (key, added) = (SumRow::KEY.join(", "), added.join(", "));
        let conflict = format!("ON CONFLICT ({key}) DO UPDATE SET {added}");
        self.insert(table, rows, &conflict).map(drop)
    }

    /// Writes events and gives them their numbers, in order. The numbers grow in the order of commits, so that who reads
    /// after a number misses none.
    pub(crate) fn events(&mut self, events: &[EventRow]) -> Result<(), StoreError> {
        self.insert("events", events, "").map(drop)
    }
}

/// `column, column`, each after a prefix.
fn list<'a>(columns: impl Iterator<Item = &'a str>, prefix: &str) -> String {
    let columns = columns.map(|column| format!("{prefix}{column}"));
    columns.collect::<Vec<_>>().join(", ")
}
