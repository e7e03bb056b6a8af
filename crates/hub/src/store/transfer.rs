//! Copies a hub's SQLite file into an empty PostgreSQL database.

use super::migrate::{LOCK, MARK, VERSION};
use super::postgres::objects;
use super::sqlite::cell;
use super::{Kind, Store, StoreError};
use crate::config::DatabaseConfig;
use rusqlite::{Connection, OpenFlags, OptionalExtension, TransactionBehavior};
use sqlx::{AssertSqlSafe, Connection as _, PgConnection};

/// Rows of one statement.
const BATCH: usize = 500;

/// The tables of both databases, each after those that it refers to; `hub_meta` is taken over by itself.
const TABLES: [&str; 15] = [
    "nodes",
    "report_counts",
    "report_ids",
    "cameras",
    "setups",
    "clips",
    "sums_5m",
    "sums_day",
    "set_aside",
    "events",
    "counters",
    "desired",
    "orders",
    "order_nodes",
    "runs",
];

/// How far a transfer has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// The table being copied.
    pub table: &'static str,
    /// Rows copied, of all tables.
    pub rows: u64,
    /// Rows to copy, of all tables.
    pub of: u64,
}

/// Copies everything in the file `from` into the database `to`, which must be empty: history, identities of reports, revisions,
/// and the identity of the database itself. All of it is there afterwards, or nothing. The file is locked meanwhile and
/// stays as it is. `progress` is called after each batch. Gives the number of rows.
///
/// # Errors
/// [`StoreError::Refused`] when `from` is not the file of a hub of this version or `to` is not an empty PostgreSQL database;
/// other [`StoreError`]s when a database fails.
pub async fn to_postgres(
    from: &str,
    to: &DatabaseConfig,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<u64, StoreError> {
    if Kind::of(&to.url) != Kind::Postgres || !to.url.contains("://") {
        return Err(StoreError::Refused(format!(
            "{} is not the URL of a PostgreSQL database: write postgres://USER:PASSWORD@HOST/DATABASE",
            to.shown()
        )));
    }
    let mut file = open(from)?;
    // Nothing is written to the file meanwhile.
    let source = file.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let identity = identity(from, &source)?;
    let mut of = 0;
    for table in TABLES {
        of += source
            .query_row(&format!("SELECT COUNT(*) FROM {table}"), [], |row| {
                row.get::<_, i64>(0)
            })?
            .unsigned_abs();
    }

    // Makes the tables where there are none.
    Store::open(to).await?.close().await;
    let mut server = PgConnection::connect(&to.url).await?;
    let mut target = server.begin().await?;
    sqlx::query("SELECT pg_advisory_xact_lock($1)")
        .bind(LOCK)
        .execute(&mut *target)
        .await?;
    for table in TABLES.iter().filter(|table| **table != "counters") {
        let text = AssertSqlSafe(format!("SELECT EXISTS (SELECT 1 FROM {table})"));
        if sqlx::query_scalar(text).fetch_one(&mut *target).await? {
            return Err(StoreError::Refused(format!(
                "{} already holds a hub's history (its table {table} has rows); nothing was changed: move to an empty \
                 database",
                to.shown()
            )));
        }
    }
    sqlx::query("DELETE FROM counters")
        .execute(&mut *target)
        .await?;
    let mut rows = 0;
    for table in TABLES {
        let mut select = source.prepare(&format!("SELECT * FROM {table}"))?;
        let columns: Vec<String> = (select.column_names().into_iter())
            .map(str::to_owned)
            .collect();
        let mut read = select.query([])?;
        loop {
            let mut batch = Vec::with_capacity(BATCH);
            while batch.len() < BATCH
                && let Some(row) = read.next()?
            {
                let cells = (0..columns.len()).map(|at| cell(row.get_ref(at)?));
                batch.push(cells.collect::<Result<Vec<_>, StoreError>>()?);
            }
            if batch.is_empty() {
                break;
            }
            let sent = batch.len() as u64;
            let insert = format!(
                "INSERT INTO {table} OVERRIDING SYSTEM VALUE \
                 SELECT * FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb)"
            );
            let inserted = sqlx::query(AssertSqlSafe(insert))
                .bind(objects(&columns, batch))
                .execute(&mut *target)
                .await?;
            if inserted.rows_affected() != sent {
                return Err(StoreError::Statement(format!(
                    "of {sent} rows of {table}, {} were inserted",
                    inserted.rows_affected()
                )));
            }
            rows += sent;
            progress(Progress { table, rows, of });
        }
        go_on_counting(table, &source, &mut target).await?;
    }
    sqlx::query("UPDATE hub_meta SET value = $1 WHERE key = 'identity'")
        .bind(identity)
        .execute(&mut *target)
        .await?;
    target.commit().await?;
    Ok(rows)
}

fn open(from: &str) -> Result<Connection, StoreError> {
    let file = super::sqlite::file(from);
    Connection::open_with_flags(file, OpenFlags::SQLITE_OPEN_READ_WRITE)
        .map_err(|error| StoreError::Refused(format!("{file} cannot be opened: {error}")))
}

/// The identity of the database, if it is one that this program wrote.
fn identity(from: &str, source: &Connection) -> Result<String, StoreError> {
    let meta = |key: &str| {
        (source.query_row("SELECT value FROM hub_meta WHERE key = ?1", [key], |row| {
            row.get::<_, String>(0)
        }))
        .optional()
    };
    let refused = |what: &str| {
        StoreError::Refused(format!(
            "{from} is not a hub's database that can be moved: {what}"
        ))
    };
    match meta("program") {
        Ok(Some(program)) if program == MARK => {}
        Ok(_) => return Err(refused("it has no mark of a hub")),
        Err(error) => return Err(refused(&error.to_string())),
    }
    let version = meta("version")?.unwrap_or_default();
    if version != VERSION.to_string() {
        return Err(refused(&format!(
            "its tables have version {version:?}; start this version's hub on it once, or use the program that wrote it"
        )));
    }
    meta("identity")?.ok_or_else(|| refused("it has no identity"))
}

/// Ids that were given once are not given again, those of removed rows included.
async fn go_on_counting(
    table: &str,
    source: &Connection,
    target: &mut PgConnection,
) -> Result<(), StoreError> {
    let last: Option<i64> = source
        .query_row(
            "SELECT seq FROM sqlite_sequence WHERE name = ?1",
            [table],
            |row| row.get(0),
        )
        .optional()?;
    if let Some(last) = last.filter(|last| *last > 0) {
        sqlx::query("SELECT setval(pg_get_serial_sequence($1, 'id'), $2)")
            .bind(table)
            .bind(last)
            .execute(target)
            .await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_table_of_both_databases_is_moved() {
        for schema in [
            include_str!("schema/sqlite.sql"),
            include_str!("schema/postgres.sql"),
        ] {
            let tables: Vec<_> = schema
                .lines()
                .filter_map(|line| line.strip_prefix("CREATE TABLE ")?.strip_suffix(" ("))
                .collect();
            assert_eq!(tables, TABLES);
        }
    }
}
