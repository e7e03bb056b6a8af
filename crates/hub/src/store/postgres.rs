//! Connects to PostgreSQL. Every statement has a time limit.

use super::row::{Columns, Row, bytes, text};
use super::{Database, DatabaseKind, StoreError};
use serde_json::Value;
use sqlx::postgres::{PgArguments, PgRow};
use sqlx::query::Query;
use sqlx::{
    AssertSqlSafe, Column as _, Connection as _, Executor as _, PgConnection, Postgres, Row as _,
    TypeInfo as _, ValueRef as _,
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

    fn query(&mut self, text: &str, values: &[Value]) -> Result<Vec<Row>, StoreError> {
        let query = sqlx::query(AssertSqlSafe(text.to_owned()));
        let query = values.iter().fold(query, bound);
        let found = wait(
            &self.runtime,
            self.limit,
            query.fetch_all(&mut self.connection),
        )?;
        found.iter().map(read).collect()
    }

    fn each(&mut self, text: &str, rows: Vec<Columns<'_>>) -> Result<Vec<Row>, StoreError> {
        self.query(text, &[recordset(rows).into()])
    }

    fn script(&mut self, text: &'static str) -> Result<(), StoreError> {
        let done = self.connection.execute(sqlx::raw_sql(text));
        wait(&self.runtime, self.limit, done).map(drop)
    }
}

fn bound<'q>(
    query: Query<'q, Postgres, PgArguments>,
    value: &Value,
) -> Query<'q, Postgres, PgArguments> {
    match storable(value.clone()) {
        Value::Number(number) => match number.as_i64() {
            Some(whole) => query.bind(whole),
            None => query.bind(number.as_f64()),
        },
        Value::String(text) => query.bind(text),
        // All parameters that may be null are whole numbers.
        _ => query.bind(None::<i64>),
    }
}

/// Converts any number of rows to one parameter.
fn recordset(rows: Vec<Columns<'_>>) -> String {
    let column = |(name, value): (&str, _)| (name.to_owned(), storable(value));
    let rows = rows.into_iter().map(|row| row.into_iter().map(column).collect());
    Value::Array(rows.map(Value::Object).collect()).to_string()
}

/// Converts a value to the server's form: texts without NUL, bytes as hexadecimal digits.
fn storable(value: Value) -> Value {
    match value {
        Value::String(given) if given.contains('\0') => text(&given).into(),
        Value::Array(numbers) => {
            let mut digits = "\\x".to_owned();
            for byte in bytes(&numbers) {
                let _ = write!(digits, "{byte:02x}");
            }
            digits.into()
        }
        Value::Object(_) => value.to_string().into(),
        value => value,
    }
}

fn read(row: &PgRow) -> Result<Row, StoreError> {
    let columns = row.columns().iter().enumerate();
    let cells = columns.map(|(at, column)| Ok((column.name().to_owned(), cell(row, at)?)));
    cells.collect()
}

fn cell(row: &PgRow, at: usize) -> Result<Value, StoreError> {
    let value = row.try_get_raw(at)?;
    if value.is_null() {
        return Ok(Value::Null);
    }
    Ok(match value.type_info().name() {
        "INT8" => row.try_get::<i64, _>(at)?.into(),
        "INT4" => row.try_get::<i32, _>(at)?.into(),
        "INT2" => row.try_get::<i16, _>(at)?.into(),
        "FLOAT8" => row.try_get::<f64, _>(at)?.into(),
        "TEXT" => row.try_get::<String, _>(at)?.into(),
        "BYTEA" => row.try_get::<Vec<u8>, _>(at)?.into(),
        kind => {
            return Err(StoreError::Statement(format!(
                "a column has the unknown type {kind}"
            )));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_with_a_nul_is_made_storable() {
        let row = vec![("a", "a\0b".into()), ("id", serde_json::json!([1, 255]))];
        let stored = "[{\"a\":\"a\u{fffd}b\",\"id\":\"\\\\x01ff\"}]";
        assert_eq!(recordset(vec![row]), stored);
    }
}
