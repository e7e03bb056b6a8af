//! SQLite, as the thread that writes uses it.

use super::database::{Database, ReportKey, Transaction, add_to_sums, list};
use super::record::{Cell, Record};
use super::tables::{NodeRow, ReportCountsRow, SetupKey, SumRow};
use super::{Dialect, StoreError, greeting};
use rusqlite::types::{ToSqlOutput, Value, ValueRef};
use rusqlite::{Connection, MAIN_DB, OpenFlags, OptionalExtension, TransactionBehavior, params};
use std::collections::{BTreeSet, HashMap};
use uuid::Uuid;

/// A database in one file.
#[derive(Debug)]
pub(super) struct Sqlite {
    url: String,
    timeout_ms: u64,
    connection: Option<Connection>,
}

impl Sqlite {
    pub(super) fn new(url: &str, timeout_ms: u64) -> Self {
        Self {
            url: url.to_owned(),
            timeout_ms,
            connection: None,
        }
    }

    fn connect(&mut self) -> Result<&mut Connection, StoreError> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => {
                let (file, parameters) = self.url.split_once('?').unwrap_or((&self.url, ""));
                let file = file.trim_start_matches("sqlite:").trim_start_matches("//");
                let flags = if parameters.split('&').any(|one| one == "mode=ro") {
                    OpenFlags::SQLITE_OPEN_READ_ONLY
                } else {
                    OpenFlags::SQLITE_OPEN_READ_WRITE
                };
                let connection = Connection::open_with_flags(file, flags)?;
                connection.set_prepared_statement_cache_capacity(64);
                for statement in greeting(Dialect::Sqlite, self.timeout_ms, false) {
                    connection.execute_batch(&statement)?;
                }
                connection
            }
        };
        Ok(self.connection.insert(connection))
    }
}

impl Database for Sqlite {
    fn identity(&mut self) -> Result<Uuid, StoreError> {
        let text: String = self.connect()?.query_row(
            "SELECT value FROM hub_meta WHERE key = 'identity'",
            [],
            |row| row.get(0),
        )?;
        super::identity_of(&text)
    }

    fn begin(&mut self) -> Result<Box<dyn Transaction + '_>, StoreError> {
        let connection = self.connect()?;
        // SQLite begins a transaction on a read-only file too, and only refuses the first statement that writes.
        if connection.is_readonly(MAIN_DB)? {
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

struct Writing<'c>(rusqlite::Transaction<'c>);

impl Writing<'_> {
    /// The number of the row with that key, made where there is none.
    fn id(
        &self,
        select: &str,
        insert: &str,
        key: &[&dyn rusqlite::ToSql],
    ) -> Result<i64, StoreError> {
        let found = (self.0.prepare_cached(select)?)
            .query_row(key, |row| row.get(0))
            .optional()?;
        match found {
            Some(id) => Ok(id),
            None => Ok(self.0.prepare_cached(insert)?.insert(key)?),
        }
    }
}

impl Transaction for Writing<'_> {
    fn nodes(&mut self, names: &[&str], now_ms: i64) -> Result<Vec<i64>, StoreError> {
        let id = |name: &&str| {
            self.id(
                "SELECT id FROM nodes WHERE name = ?1 AND ?2 IS NOT NULL",
                "INSERT INTO nodes (name, first_seen_ms, state, since_ms, why)
                 VALUES (?1, ?2, 'silent', ?2, 'no status has come yet')",
                params![name, now_ms],
            )
        };
        names.iter().map(id).collect()
    }

    fn cameras_of(&mut self, nodes: &[i64]) -> Result<Vec<(i64, String, i64)>, StoreError> {
        let mut select =
            (self.0).prepare_cached("SELECT node_id, name, id FROM cameras WHERE node_id = ?")?;
        let mut found = Vec::new();
        for node in nodes {
            let rows =
                select.query_map([node], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
            for row in rows {
                found.push(row?);
            }
        }
        Ok(found)
    }

    fn add_cameras(&mut self, cameras: &[(i64, &str)]) -> Result<Vec<i64>, StoreError> {
        let id = |(node, name): &(i64, &str)| {
            self.id(
                "SELECT id FROM cameras WHERE node_id = ? AND name = ?",
                "INSERT INTO cameras (node_id, name) VALUES (?, ?)",
                params![node, name],
            )
        };
        cameras.iter().map(id).collect()
    }

    fn setups(&mut self, setups: &[&SetupKey]) -> Result<Vec<i64>, StoreError> {
        let columns = list(SetupKey::COLUMNS);
        let (select, insert) = (
            format!("SELECT id FROM setups WHERE ({columns}) = (?, ?, ?, ?, ?, ?, ?)"),
            format!("INSERT INTO setups ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)"),
        );
        let id = |setup: &&SetupKey| {
            let texts = setup.texts();
            let key: Vec<&dyn rusqlite::ToSql> = texts.iter().map(|text| text as _).collect();
            self.id(&select, &insert, &key)
        };
        setups.iter().map(id).collect()
    }

    fn new_reports(&mut self, keys: &BTreeSet<ReportKey>) -> Result<BTreeSet<Uuid>, StoreError> {
        let mut insert = self.0.prepare_cached(
            "INSERT INTO report_ids (day, id) SELECT ?1, ?2
             WHERE NOT EXISTS (SELECT 1 FROM report_ids WHERE day = ?3 AND id = ?2)
             AND NOT EXISTS (SELECT 1 FROM report_ids WHERE id = ?2 AND day < 0)
             ON CONFLICT DO NOTHING",
        )?;
        let mut new = BTreeSet::new();
        for key in keys {
            if insert.execute(params![key.day, key.id.as_bytes(), key.own_day])? > 0 {
                new.insert(key.id);
            }
        }
        Ok(new)
    }

    fn report_counts(
        &mut self,
        nodes: &[i64],
    ) -> Result<HashMap<i64, ReportCountsRow>, StoreError> {
        let columns = list(ReportCountsRow::columns());
        let text = format!("SELECT {columns} FROM report_counts WHERE node_id = ?");
        let mut select = self.0.prepare_cached(&text)?;
        let mut found = HashMap::new();
        for node in nodes {
            let row = select.query_row([node], |row| {
                Ok(ReportCountsRow {
                    node_id: row.get(0)?,
                    first_ms: row.get(1)?,
                    last_ms: row.get(2)?,
                    stored: row.get(3)?,
                    set_aside: row.get(4)?,
                    refused: row.get(5)?,
                    resets: row.get(6)?,
                    base: row.get(7)?,
                    highest: row.get(8)?,
                    missing: row.get(9)?,
                })
            });
            found.extend(row.optional()?.map(|row| (*node, row)));
        }
        Ok(found)
    }

    fn write_report_counts(&mut self, rows: &[ReportCountsRow]) -> Result<(), StoreError> {
        let columns = ReportCountsRow::columns();
        let text = format!(
            "INSERT OR REPLACE INTO report_counts ({}) VALUES ({})",
            list(columns.iter().copied()),
            list(columns.iter().map(|_| "?"))
        );
        let mut write = self.0.prepare_cached(&text)?;
        for row in rows {
            write.execute(rusqlite::params_from_iter(row.cells()))?;
        }
        Ok(())
    }

    fn insert(
        &mut self,
        table: &'static str,
        columns: &[&'static str],
        rows: Vec<Vec<Cell>>,
    ) -> Result<(), StoreError> {
        let places = list(columns.iter().map(|_| "?"));
        let columns = list(columns.iter().copied());
        let text = format!("INSERT INTO {table} ({columns}) VALUES ({places})");
        let mut insert = self.0.prepare_cached(&text)?;
        for row in rows {
            insert.execute(rusqlite::params_from_iter(row))?;
        }
        Ok(())
    }

    fn add_sums(&mut self, table: &'static str, rows: &[SumRow]) -> Result<(), StoreError> {
        let columns = SumRow::columns();
        let text = format!(
            "INSERT INTO {table} ({}) VALUES ({}) {}",
            list(columns.iter().copied()),
            list(columns.iter().map(|_| "?")),
            add_to_sums(table, "min")
        );
        let mut add = self.0.prepare_cached(&text)?;
        for row in rows {
            add.execute(rusqlite::params_from_iter(row.cells()))?;
        }
        Ok(())
    }

    fn update_nodes(&mut self, rows: &[NodeRow]) -> Result<Vec<(i64, String)>, StoreError> {
        // Nothing where the node was forgotten since.
        let mut before = self.0.prepare_cached(
            "SELECT state FROM nodes WHERE id = ?1 AND (state <> 'forgotten' OR since_ms < ?2)",
        )?;
        // What is not known now stays as it was.
        let mut update = self.0.prepare_cached(
            "UPDATE nodes SET state = ?2, since_ms = CASE WHEN state = ?2 THEN since_ms ELSE ?3 END, why = ?4,
             heard_ms = COALESCE(?5, heard_ms), run = COALESCE(?6, run), started_ns = COALESCE(?7, started_ns),
             revision = ?8, status = COALESCE(?9, status) WHERE id = ?1",
        )?;
        let mut changed = Vec::new();
        for row in rows {
            let known = before.query_row([row.id, row.since_ms], |row| row.get(0));
            let Some(state) = known.optional()? else {
                continue;
            };
            if state != row.state {
                changed.push((row.id, state));
            }
            update.execute(rusqlite::params_from_iter(row.cells()))?;
        }
        Ok(changed)
    }

    fn lock_events(&mut self) -> Result<(), StoreError> {
        // There is one writer.
        Ok(())
    }

    fn execute(&mut self, text: &'static str, numbers: &[i64]) -> Result<u64, StoreError> {
        let mut statement = self.0.prepare_cached(text)?;
        Ok(statement.execute(rusqlite::params_from_iter(numbers))? as u64)
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
