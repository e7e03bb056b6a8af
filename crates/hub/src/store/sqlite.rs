//! Connects to SQLite.

use super::file::{FileIdentity, gone, identity, without_links};
use super::row::{Cell, Columns, Param, Row};
use super::{Database, DatabaseKind, StoreError};
use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{Connection, MAIN_DB, OpenFlags, Statement, ToSql};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The purpose of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    /// Creating the file and its tables.
    Create,
    /// Writing.
    Write,
    /// Reading; a query that takes too long is interrupted.
    Read,
}

/// A database in one file.
pub(super) struct Sqlite {
    connection: Connection,
    /// Its write-ahead log, and the identity of the one that this connection uses.
    log: PathBuf,
    used_log: Option<FileIdentity>,
    /// Time limit of a query, on a connection that only reads.
    limit: Option<Duration>,
}

/// The file of a URL.
pub(super) fn file(url: &str) -> &str {
    let (address, _parameters) = url.split_once('?').unwrap_or((url, ""));
    let place = address.strip_prefix("sqlite:").unwrap_or(address);
    // Whatever follows is the path: with four slashes in a row it is absolute, as with three.
    place.strip_prefix("//").unwrap_or(place)
}

/// The write-ahead log of a database file that exists: SQLite names it after the file that a link leads to.
fn log_of(file: &str) -> PathBuf {
    let mut log = without_links(Path::new(file)).into_os_string();
    log.push("-wal");
    log.into()
}

impl Sqlite {
    pub(super) fn open(url: &str, timeout_ms: u64, access: Access) -> Result<Self, StoreError> {
        let parameters = url.split_once('?').map_or("", |(_, rest)| rest);
        let mut flags = if parameters.split('&').any(|one| one == "mode=ro") {
            OpenFlags::SQLITE_OPEN_READ_ONLY
        } else if access == Access::Create {
            OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE
        } else {
            OpenFlags::SQLITE_OPEN_READ_WRITE
        };
        // One thread at a time uses a connection.
        flags |= OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(file(url), flags)?;
        connection.set_prepared_statement_cache_capacity(64);
        connection.busy_timeout(Duration::from_millis(timeout_ms))?;
        connection.execute_batch(
            "PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON; PRAGMA temp_store=MEMORY;",
        )?;
        let settings = match access {
            Access::Read => "PRAGMA cache_size=-4096; PRAGMA query_only=ON;",
            Access::Create | Access::Write => {
                "PRAGMA journal_mode=WAL; PRAGMA cache_size=-32768; PRAGMA wal_autocheckpoint=4000;"
            }
        };
        connection.execute_batch(settings)?;
        let limit = match access {
            Access::Read => Some(Duration::from_millis(timeout_ms.saturating_mul(4))),
            Access::Create | Access::Write => None,
        };
        Ok(Self {
            connection,
            log: log_of(file(url)),
            used_log: None,
            limit,
        })
    }

    /// Runs a query, and calls `take` with the names of its columns for each row.
    pub(super) fn stream(
        &mut self,
        text: &str,
        mut take: impl FnMut(&[String], Row) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let mut statement = self.connection.prepare(text)?;
        let columns: Vec<String> =
            statement.column_names().into_iter().map(str::to_owned).collect();
        for_each_row(&mut statement, &mut |row| take(&columns, row))
    }

    /// Runs a statement once for each list of values, and returns its rows.
    fn run<V: ToSql>(
        &mut self,
        text: &str,
        lists: impl IntoIterator<Item = impl IntoIterator<Item = V>>,
    ) -> Result<Vec<Row>, StoreError> {
        let mut statement = self.connection.prepare_cached(text)?;
        // `$2` is the second parameter, wherever it is; a `?` is the next one.
        let mut places = Vec::with_capacity(statement.parameter_count());
        for number in 1..=statement.parameter_count() {
            let named = statement.parameter_index(&format!("${number}"))?;
            places.push(named.unwrap_or(number));
        }
        let mut returned = Vec::new();
        for values in lists {
            for (value, place) in values.into_iter().zip(&places) {
                statement.raw_bind_parameter(*place, value)?;
            }
            for_each_row(&mut statement, &mut |row| {
                returned.push(row);
                Ok(())
            })?;
        }
        Ok(returned)
    }
}

impl Database for Sqlite {
    fn kind(&self) -> DatabaseKind {
        DatabaseKind::Sqlite
    }

    fn is_open(&mut self) -> Result<bool, StoreError> {
        // Nobody but SQLite's last connection removes the log, so one that differs was deleted by hand.
        let log = identity(&self.log);
        if self.used_log.is_some() && self.used_log != log {
            return Err(gone(&self.log));
        }
        self.used_log = log;
        Ok(true)
    }

    fn begin(&mut self) -> Result<(), StoreError> {
        // SQLite begins a transaction even on a read-only file, and refuses only the first statement that writes.
        if self.connection.is_readonly(MAIN_DB)? {
            return Err(StoreError::Unavailable("the database is read-only".into()));
        }
        // A transaction that reads first fails at its first write if another transaction wrote in between.
        self.script("BEGIN IMMEDIATE")
    }

    fn query(&mut self, text: &str, values: &[Param]) -> Result<Vec<Row>, StoreError> {
        if let Some(limit) = self.limit {
            let begun = Instant::now();
            let is_over = move || begun.elapsed() > limit;
            self.connection.progress_handler(10_000, Some(is_over))?;
        }
        self.run(text, [values])
    }

    fn each(&mut self, text: &str, rows: Vec<Columns<'_>>) -> Result<Vec<Row>, StoreError> {
        let values = rows.iter().map(|row| row.iter().map(|(_, cell)| cell));
        self.run(text, values)
    }

    fn script(&mut self, text: &'static str) -> Result<(), StoreError> {
        Ok(self.connection.execute_batch(text)?)
    }
}

/// Runs a statement whose parameters are bound, and calls `take` for each row.
fn for_each_row(
    statement: &mut Statement<'_>,
    take: &mut dyn FnMut(Row) -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    let columns = statement.column_count();
    let mut rows = statement.raw_query();
    while let Some(row) = rows.next()? {
        let cells = (0..columns)
            .map(|at| read(row.get_ref(at)?))
            .collect::<Result<_, StoreError>>()?;
        take(Row::new(cells))?;
    }
    Ok(())
}

fn read(value: ValueRef<'_>) -> Result<Cell, StoreError> {
    let cell = match value {
        ValueRef::Null => Cell::Null,
        ValueRef::Integer(number) => Cell::Whole(number),
        ValueRef::Real(number) => Cell::Real(number),
        ValueRef::Text(text) => std::str::from_utf8(text)
            .map_err(|error| StoreError::Statement(error.to_string()))?
            .into(),
        ValueRef::Blob(bytes) => Cell::Bytes(bytes.to_vec()),
    };
    Ok(cell)
}

impl ToSql for Cell {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        let value = match self {
            Self::Null => ValueRef::Null,
            Self::Whole(number) => ValueRef::Integer(*number),
            Self::Real(number) => ValueRef::Real(*number),
            Self::Text(text) => ValueRef::Text(text.as_bytes()),
            Self::Bytes(bytes) => ValueRef::Blob(bytes),
        };
        Ok(ToSqlOutput::Borrowed(value))
    }
}

impl ToSql for Param {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        let value = match self {
            Self::Whole(number) => ValueRef::Integer(*number),
            Self::Text(text) => ValueRef::Text(text.as_bytes()),
        };
        Ok(ToSqlOutput::Borrowed(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_absolute_path_has_three_slashes_or_four_or_one() {
        for (url, path) in [
            ("sqlite:hub.db", "hub.db"),
            ("sqlite://hub.db?mode=ro", "hub.db"),
            ("sqlite:/var/lib/hub.db", "/var/lib/hub.db"),
            ("sqlite:///var/lib/hub.db", "/var/lib/hub.db"),
            ("sqlite:////var/lib/hub.db", "//var/lib/hub.db"),
        ] {
            assert_eq!(file(url), path);
        }
    }
}
