//! What the thread that writes needs of a database: one transaction after the other, the same for SQLite and PostgreSQL.

use super::StoreError;
use super::record::{Cell, Record};
use super::tables::{EventRow, NodeRow, ReportCountsRow, SetupKey, SumRow};
use std::collections::{BTreeSet, HashMap};
use uuid::Uuid;

/// A database that is written to.
pub(crate) trait Database: Send {
    /// The identity of the database, which a copy of it keeps.
    fn identity(&mut self) -> Result<Uuid, StoreError>;

    /// Begins a transaction; connects first where there is no connection.
    fn begin(&mut self) -> Result<Box<dyn Transaction + '_>, StoreError>;

    /// Gives the connection up after an error: the next transaction has a new one.
    fn disconnect(&mut self);
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
    /// The numbers of nodes, in order, made where they are new at `now_ms`.
    fn nodes(&mut self, names: &[&str], now_ms: i64) -> Result<Vec<i64>, StoreError>;

    /// The cameras of these nodes: node, name, number.
    fn cameras_of(&mut self, nodes: &[i64]) -> Result<Vec<(i64, String, i64)>, StoreError>;

    /// The numbers of cameras, given by node and name, in order, made where they are new.
    fn add_cameras(&mut self, cameras: &[(i64, &str)]) -> Result<Vec<i64>, StoreError>;

    /// The numbers of setups, in order.
    fn setups(&mut self, setups: &[&SetupKey]) -> Result<Vec<i64>, StoreError>;

    /// Notes reports; those of them that were not known before.
    fn new_reports(&mut self, keys: &BTreeSet<ReportKey>) -> Result<BTreeSet<Uuid>, StoreError>;

    /// What is known of the reports of these nodes; no other hub changes it until the commit. Nodes without any have none.
    fn report_counts(&mut self, nodes: &[i64])
    -> Result<HashMap<i64, ReportCountsRow>, StoreError>;

    /// Writes what is known of the reports of nodes.
    fn write_report_counts(&mut self, rows: &[ReportCountsRow]) -> Result<(), StoreError>;

    /// Inserts rows with these columns into a table.
    fn insert(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        rows: Vec<Vec<Cell>>,
    ) -> Result<(), StoreError>;

    /// Adds sums to those of `table`. The rows come in the order of their keys, so that two hubs do not wait for each other.
    fn add_sums(&mut self, table: &'static str, rows: &[SumRow]) -> Result<(), StoreError>;

    /// Writes what is known of nodes. Those whose state changed are returned with the state before: of several hubs
    /// that see the same, one changes it.
    fn update_nodes(&mut self, rows: &[NodeRow]) -> Result<Vec<(i64, String)>, StoreError>;

    /// From here to the commit no other hub writes events: their numbers then grow in the order of commits, so that
    /// who reads after a number misses none.
    fn lock_events(&mut self) -> Result<(), StoreError>;

    /// Runs a statement with numbers as its parameters; how many rows it touched.
    fn execute(&mut self, text: &'static str, numbers: &[i64]) -> Result<u64, StoreError>;

    /// Commits; what was written then survives a power loss.
    fn commit(self: Box<Self>) -> Result<(), StoreError>;
}

impl dyn Transaction + '_ {
    /// Inserts rows into a table.
    pub(crate) fn insert_rows<R: Record>(
        &mut self,
        table: &'static str,
        rows: &[R],
    ) -> Result<(), StoreError> {
        if rows.is_empty() {
            return Ok(());
        }
        self.insert(table, &R::columns(), rows.iter().map(R::cells).collect())
    }

    /// Writes events and gives them their numbers, in order.
    pub(crate) fn events(&mut self, events: &[EventRow]) -> Result<(), StoreError> {
        if events.is_empty() {
            return Ok(());
        }
        self.lock_events()?;
        self.insert_rows("events", events)
    }
}

/// `column, column`.
pub(super) fn list<'a>(columns: impl IntoIterator<Item = &'a str>) -> String {
    columns.into_iter().collect::<Vec<_>>().join(", ")
}

/// What adds sums to those that are there, in the words of the database for the smaller of two numbers.
pub(super) fn add_to_sums(table: &str, least: &str) -> String {
    let added: Vec<String> = SumRow::summed()
        .map(|name| {
            let most = super::tables::LARGEST_SUM;
            format!("{name} = {least}({table}.{name} + excluded.{name}, {most})")
        })
        .collect();
    format!(
        "ON CONFLICT ({}) DO UPDATE SET {}",
        list(SumRow::KEY),
        added.join(", ")
    )
}
