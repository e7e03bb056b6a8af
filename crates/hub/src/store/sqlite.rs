//! A connection to SQLite.

use super::StoreError;
use super::database::{Database, Transaction, list};
use super::record::{Cell, Row};
use rusqlite::types::{ToSqlOutput, Value, ValueRef};
use rusqlite::{Connection, MAIN_DB, OpenFlags, Statement, TransactionBehavior};
use std::sync::Arc;
use std::time::{Duration, Instant};
use uuid::Uuid;

/// What a connection is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    /// Creating the file and its tables.
    Create,
    /// Writing.
    Write,
    /// Reading; a query that takes too long is ended.
    Read,
}

/// A database in one file.
#[derive(Debug)]
pub(super) struct Sqlite {
    url: String,
    timeout_ms: u64,
    access: Access,
    connection: Option<Connection>,
}

/// The file of a URL.
pub(super) fn file(url: &str) -> &str {
    let file = url.split('?').next().unwrap_or(url);
    file.trim_start_matches("sqlite:").trim_start_matches("//")
}

impl Sqlite {
    pub(super) fn new(url: &str, timeout_ms: u64, access: Access) -> Self {
        Self {
            url: url.to_owned(),
            timeout_ms,
            access,
            connection: None,
        }
    }

    fn connect(&mut self) -> Result<&mut Connection, StoreError> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => self.open()?,
        };
        Ok(self.connection.insert(connection))
    }

    fn open(&self) -> Result<Connection, StoreError> {
        let parameters = self.url.split_once('?').map_or("", |(_, rest)| rest);
        let flags = if parameters.split('&').any(|one| one == "mode=ro") {
            OpenFlags::SQLITE_OPEN_READ_ONLY
        } else if self.access == Access::Create {
            OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE
        } else {
            OpenFlags::SQLITE_OPEN_READ_WRITE
        };
        let connection = Connection::open_with_flags(file(&self.url), flags)?;
        connection.set_prepared_statement_cache_capacity(64);
        connection.busy_timeout(Duration::from_millis(self.timeout_ms))?;
        connection.execute_batch(
            "PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON; PRAGMA temp_store=MEMORY;",
        )?;
        connection.execute_batch(match self.access {
            Access::Read => "PRAGMA cache_size=-4096; PRAGMA query_only=ON;",
            Access::Create | Access::Write => {
                "PRAGMA journal_mode=WAL; PRAGMA cache_size=-32768; PRAGMA wal_autocheckpoint=4000;"
            }
        })?;
        Ok(connection)
    }
}

impl Database for Sqlite {
    fn query(&mut self, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError> {
        let limit = Duration::from_millis(self.timeout_ms.saturating_mul(4));
        let connection = self.connect()?;
        let begun = Instant::now();
        connection.progress_handler(10_000, Some(move || begun.elapsed() > limit))?;
        query(connection, text, values)
    }

    fn begin(&mut self) -> Result<Box<dyn Transaction + '_>, StoreError> {
        let access = self.access;
        let connection = self.connect()?;
        // SQLite begins a transaction on a read-only file too, and only refuses the first statement that writes.
        if access == Access::Write && connection.is_readonly(MAIN_DB)? {
            return Err(StoreError::Unavailable("the database is readonly".into()));
        }
        // A transaction that begins by reading and then writes fails at once when another wrote in between.
        let begun = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        Ok(Box::new(Writing(begun)))
    }

    fn disconnect(&mut self) {
        self.connection = None;
    }
}

/// Gives a statement the values of its parameters `$1`, `$2`, …
fn bind(statement: &mut Statement<'_>, values: &[Cell]) -> Result<(), StoreError> {
    for at in 1..=statement.parameter_count() {
        let name = statement.parameter_name(at).unwrap_or_default();
        let number = name.trim_start_matches('$').parse::<usize>();
        let value = number
            .ok()
            .and_then(|number| values.get(number.wrapping_sub(1)));
        let value = value
            .ok_or_else(|| StoreError::Statement(format!("the parameter {name} has no value")))?;
        statement.raw_bind_parameter(at, value)?;
    }
    Ok(())
}

fn query(connection: &Connection, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError> {
    let mut statement = connection.prepare_cached(text)?;
    bind(&mut statement, values)?;
    found(&mut statement)
}

/// The rows of a statement whose parameters have their values.
fn found(statement: &mut Statement<'_>) -> Result<Vec<Row>, StoreError> {
    let columns: Arc<[String]> = (statement.column_names().into_iter())
        .map(str::to_owned)
        .collect();
    let mut found = Vec::new();
    let mut rows = statement.raw_query();
    while let Some(row) = rows.next()? {
        let cells = (0..columns.len()).map(|at| cell(row.get_ref(at)?));
        let cells = cells.collect::<Result<_, StoreError>>()?;
        found.push(Row::new(Arc::clone(&columns), cells));
    }
    Ok(found)
}

/// A value of a row.
pub(super) fn cell(value: ValueRef<'_>) -> Result<Cell, StoreError> {
    let foreign = |error: &dyn std::fmt::Display| StoreError::Statement(error.to_string());
    Ok(match value {
        ValueRef::Null => Cell::Null,
        ValueRef::Integer(number) => Cell::Int(number),
        ValueRef::Real(number) => Cell::Real(number),
        ValueRef::Text(text) => {
            let text = std::str::from_utf8(text).map_err(|error| foreign(&error))?;
            Cell::Text(text.to_owned())
        }
        ValueRef::Blob(bytes) => {
            Cell::Id(Uuid::from_slice(bytes).map_err(|error| foreign(&error))?)
        }
    })
}

struct Writing<'c>(rusqlite::Transaction<'c>);

impl Transaction for Writing<'_> {
    fn insert(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        rows: Vec<Vec<Cell>>,
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let places = list(columns.iter().map(|_| "?"));
        let columns = list(columns.iter().copied());
        let text = format!("INSERT INTO {table} ({columns}) VALUES ({places}) {rest}");
        let mut insert = self.0.prepare_cached(&text)?;
        let mut returned = Vec::new();
        for row in rows {
            for (at, value) in (1..).zip(row) {
                insert.raw_bind_parameter(at, value)?;
            }
            returned.append(&mut found(&mut insert)?);
        }
        Ok(returned)
    }

    fn lock(&mut self, _: i64) -> Result<(), StoreError> {
        // There is one writer.
        Ok(())
    }

    fn query(&mut self, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError> {
        query(&self.0, text, values)
    }

    fn execute(&mut self, text: &str, values: &[Cell]) -> Result<u64, StoreError> {
        let mut statement = self.0.prepare_cached(text)?;
        bind(&mut statement, values)?;
        Ok(statement.raw_execute()? as u64)
    }

    fn script(&mut self, text: &'static str) -> Result<(), StoreError> {
        Ok(self.0.execute_batch(text)?)
    }

    fn commit(self: Box<Self>) -> Result<(), StoreError> {
        Ok(self.0.commit()?)
    }
}

impl rusqlite::ToSql for Cell {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(match self {
            Self::Null => ToSqlOutput::Owned(Value::Null),
            Self::Int(number) => (*number).into(),
            Self::Real(number) => (*number).into(),
            Self::Text(text) => ToSqlOutput::Borrowed(ValueRef::Text(text.as_bytes())),
            Self::Id(id) => ToSqlOutput::Borrowed(ValueRef::Blob(id.as_bytes())),
        })
    }
}
