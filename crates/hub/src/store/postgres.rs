//! PostgreSQL: each statement is waited for, no longer than the configuration says.

use super::StoreError;
use super::database::{Database, Transaction, list};
use super::record::{Cell, Row};
use serde_json::{Map, Value};
use sqlx::postgres::{PgArguments, PgRow};
use sqlx::query::Query;
use sqlx::{
    AssertSqlSafe, Column as _, Connection as _, Executor as _, PgConnection, Postgres, Row as _,
    TypeInfo as _, ValueRef as _,
};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use uuid::Uuid;

/// A database on a server.
#[derive(Debug)]
pub(super) struct PostgresServer {
    url: String,
    timeout_ms: u64,
    waiter: Waiter,
    connection: Option<PgConnection>,
}

/// Waits for what is asked of the server, on a thread that is none of the runtime's.
#[derive(Clone, Debug)]
struct Waiter {
    runtime: Handle,
    limit: Duration,
}

impl Waiter {
    fn wait<T>(&self, request: impl Future<Output = sqlx::Result<T>>) -> Result<T, StoreError> {
        let limited = async { tokio::time::timeout(self.limit, request).await };
        match self.runtime.block_on(limited) {
            Ok(answered) => Ok(answered?),
            Err(_) => Err(StoreError::Unavailable(format!(
                "the database did not answer within {} ms",
                self.limit.as_millis()
            ))),
        }
    }
}

impl PostgresServer {
    /// To be made on a thread of the runtime, and used on one that is not.
    pub(super) fn new(url: &str, timeout_ms: u64) -> Self {
        Self {
            url: url.to_owned(),
            timeout_ms,
            waiter: Waiter {
                runtime: Handle::current(),
                // The server itself ends a statement after four times the limit of a lock.
                limit: Duration::from_millis(timeout_ms.saturating_mul(5)),
            },
            connection: None,
        }
    }

    /// The connection: the open one if the server still answers on it, else a new one. A server that started again has
    /// closed the old one, and what was asked first would fail.
    fn connect(&mut self) -> Result<&mut PgConnection, StoreError> {
        let open = self.connection.take().and_then(|mut connection| {
            let answered = self.waiter.wait(connection.ping());
            answered.is_ok().then_some(connection)
        });
        let connection = match open {
            Some(connection) => connection,
            None => self.new_connection()?,
        };
        Ok(self.connection.insert(connection))
    }

    fn new_connection(&self) -> Result<PgConnection, StoreError> {
        let (url, timeout_ms) = (self.url.as_str(), self.timeout_ms);
        self.waiter.wait(async move {
            let mut connection = PgConnection::connect(url).await?;
            let settings = format!(
                "SET synchronous_commit TO on; SET statement_timeout TO {}; \
                 SET lock_timeout TO {timeout_ms}; SET client_min_messages TO warning",
                timeout_ms.saturating_mul(4)
            );
            connection
                .execute(sqlx::raw_sql(AssertSqlSafe(settings)))
                .await?;
            Ok(connection)
        })
    }
}

impl Database for PostgresServer {
    fn query(&mut self, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError> {
        let waiter = self.waiter.clone();
        let connection = self.connect()?;
        rows(&waiter.wait(bound(text, values).fetch_all(connection))?)
    }

    fn begin(&mut self) -> Result<Box<dyn Transaction + '_>, StoreError> {
        let waiter = self.waiter.clone();
        let connection = self.connect()?;
        let begun = waiter.wait(connection.begin())?;
        Ok(Box::new(Writing { begun, waiter }))
    }

    fn disconnect(&mut self) {
        self.connection = None;
    }
}

struct Writing<'c> {
    begun: sqlx::Transaction<'c, Postgres>,
    waiter: Waiter,
}

impl Writing<'_> {
    fn run(&mut self, query: Query<'_, Postgres, PgArguments>) -> Result<u64, StoreError> {
        let done = self.waiter.wait(query.execute(&mut *self.begun))?;
        Ok(done.rows_affected())
    }

    fn ask(&mut self, query: Query<'_, Postgres, PgArguments>) -> Result<Vec<PgRow>, StoreError> {
        self.waiter.wait(query.fetch_all(&mut *self.begun))
    }
}

impl Transaction for Writing<'_> {
    fn insert(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        rows: Vec<Vec<Cell>>,
        rest: &str,
    ) -> Result<Vec<Row>, StoreError> {
        let names = list(columns.iter().copied());
        let text = format!(
            "INSERT INTO {table} ({names}) SELECT {names} FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb) {rest}"
        );
        let json = objects(columns, rows);
        self::rows(&self.ask(sqlx::query(AssertSqlSafe(text)).bind(json))?)
    }

    fn lock(&mut self, number: i64) -> Result<(), StoreError> {
        self.run(sqlx::query("SELECT pg_advisory_xact_lock($1)").bind(number))
            .map(drop)
    }

    fn query(&mut self, text: &str, values: &[Cell]) -> Result<Vec<Row>, StoreError> {
        rows(&self.ask(bound(text, values))?)
    }

    fn execute(&mut self, text: &str, values: &[Cell]) -> Result<u64, StoreError> {
        self.run(bound(text, values))
    }

    fn script(&mut self, text: &'static str) -> Result<(), StoreError> {
        let done = self.begun.execute(sqlx::raw_sql(text));
        self.waiter.wait(done).map(drop)
    }

    fn commit(self: Box<Self>) -> Result<(), StoreError> {
        self.waiter.wait(self.begun.commit())
    }
}

fn bound(text: &str, values: &[Cell]) -> Query<'static, Postgres, PgArguments> {
    let query = sqlx::query(AssertSqlSafe(text.to_owned()));
    values
        .iter()
        .fold(query, |query, value| match value.clone() {
            // No statement has a parameter of another type that may be null.
            Cell::Null => query.bind(None::<i64>),
            Cell::Int(number) => query.bind(number),
            Cell::Real(number) => query.bind(number),
            Cell::Text(text) => query.bind(text),
            Cell::Id(id) => query.bind(id.as_bytes().to_vec()),
        })
}

fn rows(found: &[PgRow]) -> Result<Vec<Row>, StoreError> {
    let Some(first) = found.first() else {
        return Ok(Vec::new());
    };
    let columns: Arc<[String]> = (first.columns().iter())
        .map(|column| column.name().to_owned())
        .collect();
    let read = |row: &PgRow| {
        let cells = (0..columns.len()).map(|at| cell(row, at));
        Ok(Row::new(
            Arc::clone(&columns),
            cells.collect::<Result<_, StoreError>>()?,
        ))
    };
    found.iter().map(read).collect()
}

fn cell(row: &PgRow, at: usize) -> Result<Cell, StoreError> {
    let value = row.try_get_raw(at)?;
    if value.is_null() {
        return Ok(Cell::Null);
    }
    let kind = value.type_info().name().to_owned();
    Ok(match kind.as_str() {
        "INT8" => Cell::Int(row.try_get(at)?),
        "INT4" => Cell::Int(row.try_get::<i32, _>(at)?.into()),
        "INT2" => Cell::Int(row.try_get::<i16, _>(at)?.into()),
        "FLOAT8" => Cell::Real(row.try_get(at)?),
        "TEXT" => Cell::Text(row.try_get(at)?),
        "BYTEA" => {
            let bytes: Vec<u8> = row.try_get(at)?;
            let id = Uuid::from_slice(&bytes);
            Cell::Id(id.map_err(|error| StoreError::Statement(error.to_string()))?)
        }
        kind => {
            return Err(StoreError::Statement(format!("a column is of type {kind}")));
        }
    })
}

/// Rows as a JSON array of objects: one parameter, however many they are.
pub(super) fn objects(
    columns: &[impl AsRef<str>],
    rows: impl IntoIterator<Item = Vec<Cell>>,
) -> String {
    let object = |row: Vec<Cell>| {
        let members = columns.iter().zip(row);
        let members = members.map(|(name, cell)| (name.as_ref().to_owned(), json(cell)));
        Value::Object(members.collect::<Map<_, _>>())
    };
    Value::Array(rows.into_iter().map(object).collect()).to_string()
}

fn json(cell: Cell) -> Value {
    match cell {
        Cell::Null => Value::Null,
        Cell::Int(number) => number.into(),
        Cell::Real(number) => number.into(),
        Cell::Text(text) => text.into(),
        Cell::Id(id) => format!("\\x{}", id.simple()).into(),
    }
}
