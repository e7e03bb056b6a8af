//! Connects to PostgreSQL. Every statement has a time limit.

use super::row::{Cell, Columns, Param, Row, text};
use super::{Database, DatabaseKind, StoreError};
use serde::ser::{Serialize, SerializeMap as _, Serializer};
use sqlx::postgres::{PgArguments, PgRow};
use sqlx::query::Query;
use sqlx::{
    AssertSqlSafe, Connection as _, Executor as _, PgConnection, Postgres, Row as _, TypeInfo as _,
    ValueRef as _,
};
use std::fmt::Write as _;
use std::time::Duration;
use tokio::runtime::Handle;

/// A connection to a server.
pub(super) struct PostgresServer {
    connection: PgConnection,
    runtime: Handle,
    limit: Duration,
}

/// Waits for an answer of the server, on a thread outside the runtime.
fn wait<T>(
    runtime: &Handle,
    limit: Duration,
    request: impl Future<Output = sqlx::Result<T>>,
) -> Result<T, StoreError> {
    let limited = async { tokio::time::timeout(limit, request).await };
    match runtime.block_on(limited) {
        Ok(answered) => Ok(answered?),
        Err(_) => Err(StoreError::Unavailable(format!(
            "the database did not answer within {} ms",
            limit.as_millis()
        ))),
    }
}

impl PostgresServer {
    /// Connects. Must not be called on a thread of the runtime.
    pub(super) fn open(url: &str, timeout_ms: u64, runtime: Handle) -> Result<Self, StoreError> {
        // The server itself ends a statement after four times the lock timeout.
        let limit = Duration::from_millis(timeout_ms.saturating_mul(5));
        let connection = wait(&runtime, limit, async move {
            let mut connection = PgConnection::connect(url).await?;
            let settings = format!(
                "SET synchronous_commit TO on; SET statement_timeout TO {}; \
                 SET lock_timeout TO {timeout_ms}; SET client_min_messages TO warning",
                timeout_ms.saturating_mul(4)
            );
            connection.execute(sqlx::raw_sql(AssertSqlSafe(settings))).await?;
            Ok(connection)
        })?;
        Ok(Self {
            connection,
            runtime,
            limit,
        })
    }
}

impl Database for PostgresServer {
    fn kind(&self) -> DatabaseKind {
        DatabaseKind::Postgres
    }

    fn is_open(&mut self) -> Result<bool, StoreError> {
        Ok(wait(&self.runtime, self.limit, self.connection.ping()).is_ok())
    }

    fn begin(&mut self) -> Result<(), StoreError> {
        // The number is arbitrary, and the same in every hub.
        self.script("BEGIN; SELECT pg_advisory_xact_lock(169546976)")
    }

    fn query(&mut self, text: &str, values: &[Param]) -> Result<Vec<Row>, StoreError> {
        let mut query = sqlx::query(AssertSqlSafe(text.to_owned()));
        for value in values {
            query = bind(query, value);
        }
        let found = wait(
            &self.runtime,
            self.limit,
            query.fetch_all(&mut self.connection),
        )?;
        found.iter().map(read).collect()
    }

    fn each(&mut self, text: &str, rows: Vec<Columns<'_>>) -> Result<Vec<Row>, StoreError> {
        self.query(text, &[recordset(&rows)?.into()])
    }

    fn script(&mut self, text: &'static str) -> Result<(), StoreError> {
        let request = self.connection.execute(sqlx::raw_sql(text));
        wait(&self.runtime, self.limit, request)?;
        Ok(())
    }
}

fn bind<'q>(
    query: Query<'q, Postgres, PgArguments>,
    value: &Param,
) -> Query<'q, Postgres, PgArguments> {
    match value {
        Param::Whole(number) => query.bind(*number),
        Param::Text(given) => query.bind(text(given)),
    }
}

/// Any number of rows as one parameter: one statement for all of them, which is several times as fast as one for each.
fn recordset(rows: &[Columns<'_>]) -> Result<String, StoreError> {
    let rows: Vec<JsonRow> = rows.iter().map(|row| JsonRow(row)).collect();
    Ok(serde_json::to_string(&rows)?)
}

/// A row as a JSON object, in the server's forms: texts without NUL, bytes as hexadecimal digits.
struct JsonRow<'a>(&'a [(&'a str, Cell)]);

impl Serialize for JsonRow<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut object = to.serialize_map(Some(self.0.len()))?;
        for (column, cell) in self.0 {
            match cell {
                Cell::Null => object.serialize_entry(column, &())?,
                Cell::Whole(number) => object.serialize_entry(column, number)?,
                Cell::Real(number) => object.serialize_entry(column, number)?,
                Cell::Text(given) if given.contains('\0') => {
                    object.serialize_entry(column, &text(given))?;
                }
                Cell::Text(given) => object.serialize_entry(column, given)?,
                Cell::Bytes(bytes) => object.serialize_entry(column, &digits(bytes))?,
            }
        }
        object.end()
    }
}

/// Bytes in the server's form.
fn digits(bytes: &[u8]) -> String {
    let mut digits = "\\x".to_owned();
    for byte in bytes {
        let _ = write!(digits, "{byte:02x}");
    }
    digits
}

fn read(row: &PgRow) -> Result<Row, StoreError> {
    let cells = (0..row.len()).map(|at| cell(row, at)).collect::<Result<_, _>>()?;
    Ok(Row::new(cells))
}

fn cell(row: &PgRow, at: usize) -> Result<Cell, StoreError> {
    let value = row.try_get_raw(at)?;
    if value.is_null() {
        return Ok(Cell::Null);
    }
    let cell = match value.type_info().name() {
        "INT8" => Cell::Whole(row.try_get(at)?),
        "INT4" => Cell::Whole(row.try_get::<i32, _>(at)?.into()),
        "INT2" => Cell::Whole(row.try_get::<i16, _>(at)?.into()),
        "FLOAT8" => Cell::Real(row.try_get(at)?),
        "TEXT" => Cell::Text(row.try_get(at)?),
        "BYTEA" => Cell::Bytes(row.try_get(at)?),
        kind => {
            return Err(StoreError::Statement(format!(
                "a column has the unknown type {kind}"
            )));
        }
    };
    Ok(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_with_a_nul_is_made_storable() {
        let row = vec![
            ("a", "a\0b".into()),
            ("id", Cell::Bytes(vec![1, 255])),
            ("none", Cell::Null),
        ];
        let stored = "[{\"a\":\"a\u{fffd}b\",\"id\":\"\\\\x01ff\",\"none\":null}]";
        assert_eq!(recordset(&[row]).unwrap(), stored);
    }
}
