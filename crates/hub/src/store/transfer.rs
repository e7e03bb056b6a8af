//! Copies a hub's SQLite file into an empty PostgreSQL database.

use super::migrate::{tables, upgrade};
use super::row::{Cell, Columns, Param};
use super::sqlite::Sqlite;
use super::{
    Access, CLIPS, Database, DatabaseKind, FIVE_MINUTE_SUMS, REPORT_IDS, Store, StoreError,
    keep_days,
};
use crate::config::DatabaseConfig;
use albireo_service::clock::{DAY_MS, unix_milliseconds};

/// Rows per statement.
const BATCH: usize = 500;

/// The progress of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MoveProgress {
    /// The table being copied.
    pub table: String,
    /// Rows copied so far, over all tables.
    pub rows: u64,
    /// Rows to copy, over all tables.
    pub total: u64,
}

/// Copies everything in the file `from` into the database `to`, which must be empty: history, identities of reports
/// and revisions; of a database of albireo 0.1 what `sql/read_0_1.sql` names. It copies all or nothing. The file is locked
/// during the copy and not changed. Calls `progress` after each batch. Returns the number of rows.
///
/// # Errors
/// [`StoreError::Refused`] when `from` is not the file of a hub of this version or `to` is not an empty PostgreSQL database;
/// other [`StoreError`]s when a database fails.
pub async fn to_postgres(
    from: &str,
    to: &DatabaseConfig,
    progress: impl Fn(MoveProgress) + Send + 'static,
) -> Result<u64, StoreError> {
    if DatabaseKind::of(&to.url) != DatabaseKind::Postgres || !to.url.contains("://") {
        return Err(StoreError::Refused(format!(
            "{} is not the URL of a PostgreSQL database: write postgres://USER:PASSWORD@HOST/DATABASE",
            to.shown()
        )));
    }
    let from = from.to_owned();
    let shown = to.shown();
    let timeout_ms = to.timeout_ms;
    let source = super::blocking(move || {
        let refused = |error: StoreError| {
            let text = format!("{from} is not a hub's database that can be moved: {error}");
            StoreError::Refused(text)
        };
        let mut source = Sqlite::open(&from, timeout_ms, Access::Write).map_err(refused)?;
        // Locks the file against writers.
        source.begin()?;
        let text = "SELECT 1 FROM hub_meta WHERE key = 'version' AND value BETWEEN '3' AND '5'";
        let is_of_0_1 = matches!(source.number(text, &[]), Ok(Some(_)));
        if is_of_0_1 {
            source.script(include_str!("sql/read_0_1.sql"))?;
        } else {
            // Within the transaction, which is never committed: the file keeps its version.
            upgrade(&mut source).map_err(refused)?;
        }
        Ok(source)
    })
    .await?;
    // Creates the tables if there are none.
    let store = Store::open(to).await?;
    let copied = super::blocking(move || {
        let mut target = store.connect(Access::Write, None)?;
        copy(source, &mut *target, &shown, &progress)
    });
    copied.await
}

fn copy(
    mut source: Sqlite,
    target: &mut dyn Database,
    shown: &str,
    progress: &dyn Fn(MoveProgress),
) -> Result<u64, StoreError> {
    target.begin()?;
    let known = tables(target)?;
    let mut moved = tables(&mut source)?;
    // Tables of other programs in the file stay there; `hub_meta` is the same in both.
    moved.retain(|table| known.contains(table) && table != "hub_meta");
    let mut total = 0;
    for table in &moved {
        let count = format!("SELECT count(*) FROM {table}");
        total += source.number(&count, &[])?.unwrap_or(0).unsigned_abs();
        if table != "counters" && target.number(&count, &[])? > Some(0) {
            return Err(StoreError::Refused(format!(
                "{shown} already holds a hub's history (its table {table} has rows); nothing was changed: move to an \
                 empty database"
            )));
        }
    }
    target.query("DELETE FROM counters", &[])?;
    let today = unix_milliseconds().div_euclid(DAY_MS);
    for table in [CLIPS, REPORT_IDS, FIVE_MINUTE_SUMS] {
        keep_days(target, table, 0, today)?;
    }
    let mut rows = 0;
    for table in &moved {
        let mut batch = RowBatch {
            table,
            names: Vec::new(),
            rows: Vec::with_capacity(BATCH),
        };
        let mut send = |batch: &mut RowBatch<'_>| {
            rows += batch.send(target)?;
            progress(MoveProgress {
                table: table.clone(),
                rows,
                total,
            });
            Ok::<_, StoreError>(())
        };
        source.stream(&format!("SELECT * FROM {table}"), |names, row| {
            if batch.names.is_empty() {
                batch.names = names.to_vec();
            }
            batch.rows.push(row.into_cells());
            if batch.rows.len() == BATCH {
                send(&mut batch)?;
            }
            Ok(())
        })?;
        send(&mut batch)?;
        // No id is assigned twice, not even the id of a deleted row.
        let sequence = format!("SELECT seq FROM sqlite_sequence WHERE name = '{table}'");
        if let Some(last) = source.number(&sequence, &[])?
            && last > 0
        {
            let values: [Param; 2] = [table.as_str().into(), last.into()];
            target.query(
                "SELECT setval(pg_get_serial_sequence($1, 'id'), $2)",
                &values,
            )?;
        }
    }
    target.commit()?;
    Ok(rows)
}

/// Rows that one statement inserts.
struct RowBatch<'a> {
    table: &'a str,
    /// The names of the columns.
    names: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

impl RowBatch<'_> {
    /// Inserts the rows, and empties the batch. Returns their number.
    fn send(&mut self, target: &mut dyn Database) -> Result<u64, StoreError> {
        let mut rows: Vec<Columns<'_>> = Vec::with_capacity(self.rows.len());
        for cells in self.rows.drain(..) {
            rows.push(self.names.iter().map(String::as_str).zip(cells).collect());
        }
        let sent = rows.len() as u64;
        target.insert_columns(self.table, rows, "")?;
        Ok(sent)
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_table_of_both_databases_is_moved() {
        fn tables(schema: &str) -> Vec<&str> {
            schema
                .lines()
                .filter_map(|line| line.strip_prefix("CREATE TABLE ")?.strip_suffix(" ("))
                .collect()
        }
        let sqlite = tables(include_str!("schema/sqlite.sql"));
        assert_eq!(sqlite, tables(include_str!("schema/postgres.sql")));
        assert_eq!(sqlite.len(), 15, "every table was found in its schema");
    }
}
