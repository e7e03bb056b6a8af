//! One connection to a database: queries, and one transaction after the other, the same for SQLite and PostgreSQL.

use super::StoreError;
use super::record::{Cell, Record, Row};
use super::tables::{EventRow, LARGEST_SUM, NodeRow, ReportCountsRow, SetupKey, SumRow};
use crate::presence::PresenceState;
use std::collections::{BTreeSet, HashMap};
use uuid::Uuid;

/// A connection to a database. It connects at the first use.
pub(crate) trait Database: Send {
    /// The rows of a query outside of a transaction. Its parameters are `$1`, `$2`, …
    fn query(&mut self, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError>;

    /// Begins a transaction; connects first where there is no connection.
    fn begin(&mut self) -> Result<Box<dyn Transaction + '_>, StoreError>;

    /// Closes the connection, as after an error: the next transaction opens a new one.
    fn disconnect(&mut self);
}

impl dyn Database {
    /// The id of the database, which a copy of it keeps.
    pub(crate) fn identity(&mut self) -> Result<Uuid, StoreError> {
        super::identity_of(&self.query("SELECT value FROM hub_meta WHERE key = 'identity'", &[])?)
    }
}

/// The key of a report: nothing of it is stored twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ReportKey {
    /// The day that it is kept under: that of its identity, or that of receipt, negative, where that cannot be believed.
    pub(crate) day: i64,
    /// Its identity.
    pub(crate) id: Uuid,
    /// The day of the identity's own time, whether it is believed or not.
    pub(crate) own_day: i64,
}

/// A transaction. Nothing of it is there until it is committed; dropped, it is rolled back.
pub(crate) trait Transaction {
    /// Inserts rows with these columns into a table, in order. `rest` ends the statement: an `ON CONFLICT` clause, a
    /// `RETURNING` clause, both, or nothing. Gives the rows that the statement returns.
    fn insert(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        rows: Vec<Vec<Cell>>,
        rest: &str,
    ) -> Result<Vec<Row>, StoreError>;

    /// Keeps other hubs out until the commit, where several may write: those that take the same lock wait.
    fn lock(&mut self, number: i64) -> Result<(), StoreError>;

    /// The rows of a query. Its parameters are `$1`, `$2`, …
    fn query(&mut self, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError>;

    /// Runs a statement; how many rows it touched.
    fn execute(&mut self, text: &str, values: &[Cell]) -> Result<u64, StoreError>;

    /// Runs several statements without parameters.
    fn script(&mut self, text: &'static str) -> Result<(), StoreError>;

    /// Commits; what was written then survives a power loss.
    fn commit(self: Box<Self>) -> Result<(), StoreError>;
}

/// Keys of one statement: databases bound its parameters.
const KEYS: usize = 1000;

impl dyn Transaction + '_ {
    /// The numbers of nodes by name; a node that is new is added.
    pub(crate) fn nodes(
        &mut self,
        names: &[&str],
        now_ms: i64,
    ) -> Result<Vec<(String, i64)>, StoreError> {
        self.add_nodes(names, now_ms, "DO NOTHING")?;
        let names: Vec<_> = names.iter().map(|name| vec![(*name).into()]).collect();
        let rows = self.with_keys("nodes", &["name"], &names)?;
        let read = |row: &Row| Ok((row.get("name")?, row.get("id")?));
        rows.iter().map(read).collect()
    }

    fn add_nodes(
        &mut self,
        names: &[&str],
        now_ms: i64,
        conflict: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let columns = ["name", "first_seen_ms", "state", "since_ms", "why"];
        let row = |name: &&str| -> Vec<Cell> {
            let why = "no status has come yet";
            let (name, silent) = (Cell::from(*name), PresenceState::Silent.name());
            vec![
                name,
                now_ms.into(),
                silent.into(),
                now_ms.into(),
                why.into(),
            ]
        };
        let rows = names.iter().map(row).collect();
        self.insert(
            "nodes",
            &columns,
            rows,
            &format!("ON CONFLICT (name) {conflict}"),
        )
    }

    /// The cameras of these nodes: node, name, number.
    pub(crate) fn cameras_of(
        &mut self,
        nodes: &[i64],
    ) -> Result<Vec<(i64, String, i64)>, StoreError> {
        let nodes: Vec<_> = nodes.iter().map(|node| vec![(*node).into()]).collect();
        let rows = self.with_keys("cameras", &["node_id"], &nodes)?;
        rows.iter().map(camera).collect()
    }

    /// Adds cameras, given by node and name: node, name, number of each.
    pub(crate) fn add_cameras(
        &mut self,
        cameras: &[(i64, &str)],
    ) -> Result<Vec<(i64, String, i64)>, StoreError> {
        let columns = ["node_id", "name"];
        let key = |(node, name): &(i64, &str)| vec![(*node).into(), (*name).into()];
        let keys: Vec<_> = cameras.iter().map(key).collect();
        self.insert("cameras", &columns, keys.clone(), "ON CONFLICT DO NOTHING")?;
        let rows = self.with_keys("cameras", &columns, &keys)?;
        rows.iter().map(camera).collect()
    }

    /// The numbers of setups; one that is new is added.
    pub(crate) fn setups(
        &mut self,
        setups: &[&SetupKey],
    ) -> Result<Vec<(SetupKey, i64)>, StoreError> {
        let columns = SetupKey::columns();
        let keys: Vec<_> = setups.iter().map(|setup| setup.cells()).collect();
        self.insert("setups", &columns, keys.clone(), "ON CONFLICT DO NOTHING")?;
        let rows = self.with_keys("setups", &columns, &keys)?;
        let read = |row: &Row| Ok((SetupKey::try_from(row)?, row.get("id")?));
        rows.iter().map(read).collect()
    }

    /// The rows of a table that have one of these keys in these columns.
    fn with_keys(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        keys: &[Vec<Cell>],
    ) -> Result<Vec<Row>, StoreError> {
        let mut found = Vec::new();
        for keys in keys.chunks(KEYS) {
            let (places, columns) = (places(keys), list(columns.iter().copied()));
            let text = format!("SELECT * FROM {table} WHERE ({columns}) IN (VALUES {places})");
            found.extend(self.query(&text, &keys.concat())?);
        }
        Ok(found)
    }

    /// Notes reports; those of them that were not known before.
    pub(crate) fn new_reports(
        &mut self,
        keys: &BTreeSet<ReportKey>,
    ) -> Result<BTreeSet<Uuid>, StoreError> {
        let cells = |key: &ReportKey| vec![key.day.into(), key.id.into(), key.own_day.into()];
        let keys: Vec<Vec<Cell>> = keys.iter().map(cells).collect();
        let mut new = BTreeSet::new();
        for keys in keys.chunks(KEYS) {
            let text = format!(
                "WITH k (day, id, own_day) AS (VALUES {}) INSERT INTO report_ids (day, id) SELECT k.day, k.id FROM k \
                 WHERE NOT EXISTS (SELECT 1 FROM report_ids r WHERE r.day = k.own_day AND r.id = k.id) \
                 AND NOT EXISTS (SELECT 1 FROM report_ids r WHERE r.id = k.id AND r.day < 0) \
                 ORDER BY 1, 2 ON CONFLICT DO NOTHING RETURNING id",
                places(keys)
            );
            for row in self.query(&text, &keys.concat())? {
                new.insert(row.get("id")?);
            }
        }
        Ok(new)
    }

    /// What is known of the reports of these nodes; no other hub changes it until the commit.
    pub(crate) fn report_counts(
        &mut self,
        nodes: &[i64],
        now_ms: i64,
    ) -> Result<HashMap<i64, ReportCountsRow>, StoreError> {
        let row = |node: &i64| vec![(*node).into(), now_ms.into(), now_ms.into()];
        let rows = self.insert(
            "report_counts",
            &["node_id", "first_ms", "last_ms"],
            nodes.iter().map(row).collect(),
            // Changes nothing, and locks the row.
            "ON CONFLICT (node_id) DO UPDATE SET node_id = excluded.node_id RETURNING *",
        )?;
        let read = |row: &Row| ReportCountsRow::try_from(row).map(|row| (row.node_id, row));
        rows.iter().map(read).collect()
    }

    /// Writes what is known of nodes, which come in the order of their names. Those whose state changed are returned with
    /// the state before: of several hubs that see the same, one changes it.
    pub(crate) fn update_nodes(
        &mut self,
        rows: &[NodeRow],
        now_ms: i64,
    ) -> Result<HashMap<String, String>, StoreError> {
        let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        // Changes nothing, and locks the row.
        let same = "DO UPDATE SET name = excluded.name RETURNING name, state, since_ms";
        let mut before = HashMap::new();
        for row in self.add_nodes(&names, now_ms, same)? {
            let (name, state): (String, String) = (row.get("name")?, row.get("state")?);
            before.insert(name, (state, row.get::<i64>("since_ms")?));
        }
        // A node that was forgotten since stays so.
        let mut rows = rows.to_vec();
        rows.retain(|row| {
            (before.get(&row.name))
                .is_some_and(|(state, since_ms)| state != "forgotten" || *since_ms < row.since_ms)
        });
        self.upsert_rows(
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
            let (state, _) = before.remove(&row.name)?;
            (state != row.state).then_some((row.name, state))
        });
        Ok(changed.collect())
    }

    /// Inserts rows into a table.
    pub(crate) fn insert_rows<R: Record>(
        &mut self,
        table: &'static str,
        rows: &[R],
    ) -> Result<(), StoreError> {
        self.upsert_rows(table, rows, "")
    }

    /// Inserts rows into a table; `conflict` says what is done with those whose key is there already.
    pub(crate) fn upsert_rows<R: Record>(
        &mut self,
        table: &'static str,
        rows: &[R],
        conflict: &str,
    ) -> Result<(), StoreError> {
        if rows.is_empty() {
            return Ok(());
        }
        let cells = rows.iter().map(R::cells).collect();
        self.insert(table, &R::columns(), cells, conflict).map(drop)
    }

    /// Adds sums to those of `table`. The rows come in the order of their keys, so that two hubs do not wait for each other.
    pub(crate) fn add_sums(
        &mut self,
        table: &'static str,
        rows: &[SumRow],
    ) -> Result<(), StoreError> {
        let added: Vec<String> = SumRow::summed()
            .map(|name| {
                format!(
                    "{name} = CASE WHEN {table}.{name} > {LARGEST_SUM} - excluded.{name} THEN {LARGEST_SUM} \
                     ELSE {table}.{name} + excluded.{name} END"
                )
            })
            .collect();
        let (key, added) = (list(SumRow::KEY), added.join(", "));
        let conflict = format!("ON CONFLICT ({key}) DO UPDATE SET {added}");
        self.upsert_rows(table, rows, &conflict)
    }

    /// Writes what is known of the reports of nodes.
    pub(crate) fn write_report_counts(
        &mut self,
        rows: &[ReportCountsRow],
    ) -> Result<(), StoreError> {
        let columns = ReportCountsRow::columns();
        let sets: Vec<String> = (columns.iter().skip(1))
            .map(|name| format!("{name} = excluded.{name}"))
            .collect();
        let conflict = format!("ON CONFLICT (node_id) DO UPDATE SET {}", sets.join(", "));
        self.upsert_rows("report_counts", rows, &conflict)
    }

    /// Writes events and gives them their numbers, in order. The numbers grow in the order of commits, so that who reads
    /// after a number misses none.
    pub(crate) fn events(&mut self, events: &[EventRow]) -> Result<(), StoreError> {
        if events.is_empty() {
            return Ok(());
        }
        /// Number of the lock.
        const LOCK: i64 = 0x0a1b_14e1;
        self.lock(LOCK)?;
        self.insert_rows("events", events)
    }
}

fn camera(row: &Row) -> Result<(i64, String, i64), StoreError> {
    Ok((row.get("node_id")?, row.get("name")?, row.get("id")?))
}

/// `($1, $2), ($3, $4)`: the places of these rows among the parameters.
fn places(rows: &[Vec<Cell>]) -> String {
    let mut numbers = 1..;
    let row = |row: &Vec<Cell>| {
        let places = numbers
            .by_ref()
            .take(row.len())
            .map(|number| format!("${number}"));
        format!("({})", places.collect::<Vec<_>>().join(", "))
    };
    rows.iter().map(row).collect::<Vec<_>>().join(", ")
}

/// `column, column`.
pub(super) fn list<'a>(columns: impl IntoIterator<Item = &'a str>) -> String {
    columns.into_iter().collect::<Vec<_>>().join(", ")
}
