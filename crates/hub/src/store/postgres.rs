//! PostgreSQL, as the thread that writes uses it: each statement is waited for, no longer than the configuration says.

use super::database::{Database, ReportKey, Transaction, add_to_sums, list};
use super::record::{Cell, Record};
use super::tables::{NodeRow, ReportCountsRow, SetupKey, SumRow};
use super::{Dialect, StoreError, greeting};
use serde_json::{Map, Value};
use sqlx::postgres::{PgArguments, PgRow};
use sqlx::query::Query;
use sqlx::{AssertSqlSafe, Connection as _, Executor as _, PgConnection, Postgres, Row as _};
use std::collections::{BTreeSet, HashMap};
use std::future::Future;
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
    fn wait<T>(&self, asked: impl Future<Output = sqlx::Result<T>>) -> Result<T, StoreError> {
        let limited = async { tokio::time::timeout(self.limit, asked).await };
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

    fn connect(&mut self) -> Result<&mut PgConnection, StoreError> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => {
                let (url, timeout_ms) = (self.url.as_str(), self.timeout_ms);
                self.waiter.wait(async move {
                    let mut connection = PgConnection::connect(url).await?;
                    for statement in greeting(Dialect::Postgres, timeout_ms, false) {
                        connection.execute(AssertSqlSafe(statement)).await?;
                    }
                    Ok(connection)
                })?
            }
        };
        Ok(self.connection.insert(connection))
    }
}

impl Database for PostgresServer {
    fn identity(&mut self) -> Result<Uuid, StoreError> {
        let waiter = self.waiter.clone();
        let connection = self.connect()?;
        let row = waiter.wait(
            sqlx::query("SELECT value FROM hub_meta WHERE key = 'identity'").fetch_one(connection),
        )?;
        super::identity_of(&row.try_get::<String, _>(0)?)
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

    fn ids(&mut self, query: Query<'_, Postgres, PgArguments>) -> Result<Vec<i64>, StoreError> {
        let rows = self.ask(query)?;
        Ok(rows
            .iter()
            .map(|row| row.try_get(0))
            .collect::<Result<_, _>>()?)
    }
}

impl Transaction for Writing<'_> {
    fn nodes(&mut self, names: &[&str], now_ms: i64) -> Result<Vec<i64>, StoreError> {
        self.run(
            sqlx::query(
                "INSERT INTO nodes (name, first_seen_ms, state, since_ms, why)
                 SELECT name, $2, 'silent', $2, 'no status has come yet'
                 FROM unnest($1::text[]) AS k (name) ORDER BY name ON CONFLICT DO NOTHING",
            )
            .bind(names)
            .bind(now_ms),
        )?;
        self.ids(
            sqlx::query(
                "SELECT n.id FROM unnest($1::text[]) WITH ORDINALITY AS k (name, place)
                 JOIN nodes n USING (name) ORDER BY place",
            )
            .bind(names),
        )
    }

    fn cameras_of(&mut self, nodes: &[i64]) -> Result<Vec<(i64, String, i64)>, StoreError> {
        let query = sqlx::query("SELECT node_id, name, id FROM cameras WHERE node_id = ANY ($1)");
        let rows = self.ask(query.bind(nodes))?;
        let read = |row: &PgRow| Ok((row.try_get(0)?, row.try_get(1)?, row.try_get(2)?));
        rows.iter().map(read).collect()
    }

    fn add_cameras(&mut self, cameras: &[(i64, &str)]) -> Result<Vec<i64>, StoreError> {
        let (nodes, names): (Vec<i64>, Vec<&str>) = cameras.iter().copied().unzip();
        self.run(
            sqlx::query(
                "INSERT INTO cameras (node_id, name) SELECT node_id, name
                 FROM unnest($1::bigint[], $2::text[]) AS k (node_id, name) ORDER BY 1, 2 ON CONFLICT DO NOTHING",
            )
            .bind(&nodes)
            .bind(&names),
        )?;
        self.ids(
            sqlx::query(
                "SELECT c.id FROM unnest($1::bigint[], $2::text[]) WITH ORDINALITY AS k (node_id, name, place)
                 JOIN cameras c USING (node_id, name) ORDER BY place",
            )
            .bind(&nodes)
            .bind(&names),
        )
    }

    fn setups(&mut self, setups: &[&SetupKey]) -> Result<Vec<i64>, StoreError> {
        let texts: Vec<[&str; 7]> = setups.iter().map(|setup| setup.texts()).collect();
        let column = |i: usize| texts.iter().map(|texts| texts[i]).collect::<Vec<_>>();
        let columns: [Vec<&str>; 7] = std::array::from_fn(column);
        let names = list(SetupKey::COLUMNS);
        let given = "unnest($1::text[], $2::text[], $3::text[], $4::text[], $5::text[], $6::text[], $7::text[])";
        let insert = format!(
            "INSERT INTO setups ({names}) SELECT {names} FROM {given} AS k ({names}) \
             ORDER BY {names} ON CONFLICT DO NOTHING"
        );
        let select = format!(
            "SELECT s.id FROM {given} WITH ORDINALITY AS k ({names}, place) \
             JOIN setups s USING ({names}) ORDER BY place"
        );
        let bound = |text: String| {
            let query = sqlx::query(AssertSqlSafe(text));
            columns
                .iter()
                .fold(query, |query, column| query.bind(column.clone()))
        };
        self.run(bound(insert))?;
        self.ids(bound(select))
    }

    fn new_reports(&mut self, keys: &BTreeSet<ReportKey>) -> Result<BTreeSet<Uuid>, StoreError> {
        let days: Vec<i64> = keys.iter().map(|key| key.day).collect();
        let ids: Vec<&[u8]> = keys
            .iter()
            .map(|key| key.id.as_bytes().as_slice())
            .collect();
        let own: Vec<i64> = keys.iter().map(|key| key.own_day).collect();
        let rows = self.ask(
            sqlx::query(
                "INSERT INTO report_ids (day, id)
                 SELECT k.day, k.id FROM unnest($1::bigint[], $2::bytea[], $3::bigint[]) AS k (day, id, own_day)
                 WHERE NOT EXISTS (SELECT 1 FROM report_ids r WHERE r.day = k.own_day AND r.id = k.id)
                 AND NOT EXISTS (SELECT 1 FROM report_ids r WHERE r.id = k.id AND r.day < 0)
                 ORDER BY 1, 2 ON CONFLICT DO NOTHING RETURNING id",
            )
            .bind(days)
            .bind(ids)
            .bind(own),
        )?;
        let id = |row: &PgRow| {
            let bytes: Vec<u8> = row.try_get(0)?;
            Uuid::from_slice(&bytes).map_err(|error| StoreError::Statement(error.to_string()))
        };
        rows.iter().map(id).collect()
    }

    fn report_counts(
        &mut self,
        nodes: &[i64],
    ) -> Result<HashMap<i64, ReportCountsRow>, StoreError> {
        // A row to be locked, also where the node is new.
        self.run(
            sqlx::query(
                "INSERT INTO report_counts (node_id, first_ms, last_ms)
                 SELECT id, 0, 0 FROM unnest($1::bigint[]) AS k (id) ORDER BY id ON CONFLICT DO NOTHING",
            )
            .bind(nodes),
        )?;
        let rows = self.ask(
            sqlx::query(
                "SELECT * FROM report_counts WHERE node_id = ANY ($1) ORDER BY node_id FOR UPDATE",
            )
            .bind(nodes),
        )?;
        let read = |row: &PgRow| {
            let number = |name: &str| row.try_get::<i64, _>(name);
            let counts = ReportCountsRow {
                node_id: number("node_id")?,
                first_ms: number("first_ms")?,
                last_ms: number("last_ms")?,
                stored: number("stored")?,
                set_aside: number("set_aside")?,
                refused: number("refused")?,
                resets: number("resets")?,
                base: number("base")?,
                highest: number("highest")?,
                missing: row.try_get("missing")?,
            };
            Ok((counts.node_id, counts))
        };
        let known = rows
            .iter()
            .map(read)
            .filter(|read| !matches!(read, Ok((_, counts)) if counts.first_ms == 0));
        known.collect()
    }

    fn write_report_counts(&mut self, rows: &[ReportCountsRow]) -> Result<(), StoreError> {
        let columns = ReportCountsRow::columns();
        let sets: Vec<String> = (columns.iter().skip(1))
            .map(|name| format!("{name} = k.{name}"))
            .collect();
        let text = format!(
            "UPDATE report_counts r SET {} FROM jsonb_populate_recordset(NULL::report_counts, $1::jsonb) k \
             WHERE r.node_id = k.node_id",
            sets.join(", ")
        );
        let json = objects(&columns, rows.iter().map(Record::cells));
        self.run(sqlx::query(AssertSqlSafe(text)).bind(json))
            .map(drop)
    }

    fn insert(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        rows: Vec<Vec<Cell>>,
    ) -> Result<(), StoreError> {
        let names = list(columns.iter().copied());
        let text = format!(
            "INSERT INTO {table} ({names}) SELECT {names} FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb)"
        );
        let json = objects(columns, rows);
        self.run(sqlx::query(AssertSqlSafe(text)).bind(json))
            .map(drop)
    }

    fn add_sums(&mut self, table: &'static str, rows: &[SumRow]) -> Result<(), StoreError> {
        let columns = SumRow::columns();
        let names = list(columns.iter().copied());
        let text = format!(
            "INSERT INTO {table} ({names}) SELECT {names} FROM jsonb_populate_recordset(NULL::{table}, $1::jsonb) {}",
            add_to_sums(table, "LEAST")
        );
        let json = objects(&columns, rows.iter().map(Record::cells));
        self.run(sqlx::query(AssertSqlSafe(text)).bind(json))
            .map(drop)
    }

    fn update_nodes(&mut self, rows: &[NodeRow]) -> Result<Vec<(i64, String)>, StoreError> {
        let json = objects(&NodeRow::columns(), rows.iter().map(Record::cells));
        // Locked in one order, whatever hub heard of them in which.
        let before = self.ask(
            sqlx::query(
                "SELECT n.id, n.state, n.state <> k.state FROM jsonb_populate_recordset(NULL::nodes, $1::jsonb) k
                 JOIN nodes n USING (id) WHERE n.state <> 'forgotten' OR n.since_ms < k.since_ms
                 ORDER BY n.id FOR UPDATE OF n",
            )
            .bind(json.clone()),
        )?;
        // What is not known now stays as it was, and so does a node that was forgotten since.
        self.run(
            sqlx::query(
                "UPDATE nodes n SET state = k.state,
                 since_ms = CASE WHEN n.state = k.state THEN n.since_ms ELSE k.since_ms END, why = k.why,
                 heard_ms = COALESCE(k.heard_ms, n.heard_ms), run = COALESCE(k.run, n.run),
                 started_ns = COALESCE(k.started_ns, n.started_ns), revision = k.revision,
                 status = COALESCE(k.status, n.status)
                 FROM jsonb_populate_recordset(NULL::nodes, $1::jsonb) k WHERE n.id = k.id
                 AND (n.state <> 'forgotten' OR n.since_ms < k.since_ms)",
            )
            .bind(json),
        )?;
        let mut changed = Vec::new();
        for row in &before {
            if row.try_get(2)? {
                changed.push((row.try_get(0)?, row.try_get(1)?));
            }
        }
        Ok(changed)
    }

    fn lock_events(&mut self) -> Result<(), StoreError> {
        /// Number of the lock.
        const LOCK: i64 = 0x0a1b_14e1;
        self.run(sqlx::query("SELECT pg_advisory_xact_lock($1)").bind(LOCK))
            .map(drop)
    }

    fn execute(&mut self, text: &'static str, numbers: &[i64]) -> Result<u64, StoreError> {
        let query = numbers
            .iter()
            .fold(sqlx::query(text), |query, number| query.bind(*number));
        self.run(query)
    }

    fn commit(self: Box<Self>) -> Result<(), StoreError> {
        self.waiter.wait(self.begun.commit())
    }
}

/// Rows as a JSON array of objects: one parameter, however many they are.
fn objects(columns: &[&'static str], rows: impl IntoIterator<Item = Vec<Cell>>) -> String {
    let object = |row: Vec<Cell>| {
        let members = columns.iter().zip(row);
        let members = members.map(|(name, cell)| ((*name).to_owned(), json(cell)));
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
