//! Defines a connection to a database, and the statements that all rooms share.

use super::row::{Columns, IntoRow, Param, Row};
use super::{DatabaseKind, StoreError};

/// A connection to a database. Dropping it rolls back an open transaction.
pub(crate) trait Database: Send {
    fn kind(&self) -> DatabaseKind;

    /// True if it can still be used: a server that restarts closes it.
    ///
    /// # Errors
    /// When a new connection would not help: SQLite's log was deleted.
    fn is_open(&mut self) -> Result<bool, StoreError>;

    /// Begins a transaction that writes. Only one writes at a time, across all hubs: two would wait for each other's
    /// rows.
    fn begin(&mut self) -> Result<(), StoreError>;

    /// Runs a statement and returns its rows. Its parameters are `$1`, `$2`, …
    fn query(&mut self, text: &str, values: &[Param]) -> Result<Vec<Row>, StoreError>;

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
        self.query(text, &[now_ms.to_string().into()])?;
        Ok(())
    }

    /// Runs a query for one column of text, and returns it.
    fn texts(&mut self, text: &str) -> Result<Vec<String>, StoreError> {
        let rows = self.query(text, &[])?;
        rows.into_iter().map(|mut row| row.take()).collect()
    }

    /// Runs a statement and returns the whole number in its first row, if any.
    fn number(&mut self, text: &str, values: &[Param]) -> Result<Option<i64>, StoreError> {
        match self.query(text, values)?.first_mut() {
            Some(row) => row.take().map(Some),
            None => Ok(None),
        }
    }
}

impl dyn Database + '_ {
    /// Inserts rows into their table, in order. `rest` ends the statement: an `ON CONFLICT` clause, a `RETURNING` clause, both,
    /// or nothing.
    pub(crate) fn insert<R: IntoRow>(
        &mut self,
        rows: &[R],
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let rows = rows.iter().map(IntoRow::columns).collect::<Result<_, _>>()?;
        self.insert_columns(R::TABLE, rows, rest)
    }

    /// Does the same as [`insert`](Self::insert) for columns, the same ones for every row.
    pub(crate) fn insert_columns(
        &mut self,
        table: &str,
        rows: Vec<Columns<'_>>,
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let Some(first) = rows.first() else {
            return Ok(Vec::new());
        };
        let names = first
            .iter()
            .map(|(column, _)| format!("\"{column}\""))
            .collect::<Vec<_>>()
            .join(", ");
        let values = match self.kind() {
            DatabaseKind::Sqlite => format!("VALUES ({})", vec!["?"; first.len()].join(", ")),
            DatabaseKind::Postgres => {
                format!("SELECT {names} FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb)")
            }
        };
        let text = format!("INSERT INTO {table} ({names}) {values} {rest}");
        self.each(&text, rows)
    }

    /// Runs a query that ends with a text column and `IN`, for the given texts.
    pub(crate) fn among(&mut self, query: &str, texts: &[&str]) -> Result<Vec<Row>, StoreError> {
        let list = match self.kind() {
            DatabaseKind::Sqlite => "(SELECT value FROM json_each($1))",
            DatabaseKind::Postgres => "(SELECT jsonb_array_elements_text($1::jsonb))",
        };
        self.query(
            &format!("{query} {list}"),
            &[serde_json::to_string(texts)?.into()],
        )
    }
}
