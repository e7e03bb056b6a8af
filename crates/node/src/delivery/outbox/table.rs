//! Stores reports in an SQLite table, synced at each commit.

use rusqlite::{Connection, ErrorCode, Transaction, params};
use uuid::Uuid;

/// "albi": marks the file as ours.
const APPLICATION_ID: i64 = 0x616c_6269;
/// Version 1 is the layout of 0.1.0.
const LAYOUT: i64 = 2;

const SCHEMA: &str = "
CREATE TABLE report (
    id BLOB PRIMARY KEY NOT NULL,
    count INTEGER,
    state INTEGER NOT NULL,
    acknowledged_ms INTEGER NOT NULL DEFAULT 0,
    json BLOB NOT NULL
) STRICT;
CREATE INDEX report_by_state ON report (state, count);
CREATE TABLE counter (name TEXT PRIMARY KEY, value INTEGER NOT NULL) STRICT, WITHOUT ROWID;
";

/// No hub has it.
pub(super) const WAITING: i64 = 0;
/// A hub lost it.
pub(super) const AGAIN: i64 = 1;
/// A hub has it.
pub(super) const ACKNOWLEDGED: i64 = 2;
/// Never to be sent again; the last of the states.
pub(super) const REFUSED: i64 = 3;

/// The maximum size of reports in memory, bytes: some thousand reports.
pub(super) const MEMORY_BYTES: u64 = 8 << 20;

/// The reason a table cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    /// SQLite fails.
    #[error("{0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The file system fails.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Permanent: the folder belongs to another node, or the file to another program or version.
    #[error("{0}")]
    Unusable(String),
}

impl TableError {
    /// True if the contents are corrupt, rather than inaccessible.
    pub(super) fn is_corruption(&self) -> bool {
        let Self::Sqlite(error) = self else {
            return false;
        };
        let broken = [ErrorCode::DatabaseCorrupt, ErrorCode::NotADatabase].map(Some);
        broken.contains(&error.sqlite_error_code())
    }
}

/// A stored report.
#[derive(Clone, Debug)]
pub(super) struct StoredReport {
    pub(super) id: Uuid,
    pub(super) count: Option<u64>,
    pub(super) state: i64,
    pub(super) acknowledged_ms: i64,
    pub(super) json: Vec<u8>,
}

/// Counters that continue after a restart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counters {
    /// The running count of reports; `None` while the earlier count is unknown.
    pub(super) made: Option<u64>,
    /// Reports lost.
    pub(super) lost: u64,
    /// Reports that a hub refused permanently, or that cannot be read.
    pub(super) undeliverable: u64,
}

impl Counters {
    /// The larger of each counter: both count the same reports.
    pub(super) fn max(self, other: Self) -> Self {
        Self {
            made: self.made.max(other.made),
            lost: self.lost.max(other.lost),
            undeliverable: self.undeliverable.max(other.undeliverable),
        }
    }
}

/// The open table and its counters, which are written with each change.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) db: Connection,
    most_bytes: u64,
    pub(super) counters: Counters,
}

impl Table {
    /// Uses an open database, and creates the table in an empty one.
    pub(super) fn new(db: Connection, most_bytes: u64) -> Result<Self, TableError> {
        let application: i64 = db.pragma_query_value(None, "application_id", |row| row.get(0))?;
        let layout: i64 = db.pragma_query_value(None, "user_version", |row| row.get(0))?;
        let tables: i64 =
            db.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
        if tables == 0 {
            db.execute_batch(&format!(
                "BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {LAYOUT};
                 {SCHEMA} COMMIT;"
            ))?;
        } else if application != APPLICATION_ID {
            return Err(TableError::Unusable(
                "it is another program's database: move it away, or choose another node.state_dir"
                    .to_owned(),
            ));
        } else if layout != LAYOUT {
            return Err(TableError::Unusable(format!(
                "it was written by another version of albireo (layout {layout}; this one has {LAYOUT}), such as 0.1.0: \
                 run that one until its reports are delivered, then move the file away"
            )));
        }
        Ok(Self {
            counters: Self::counters(&db)?,
            db,
            most_bytes,
        })
    }

    /// Creates an empty table in memory that continues `counters`.
    pub(super) fn in_memory(counters: Counters) -> Result<Self, TableError> {
        Ok(Self {
            counters,
            ..Self::new(Connection::open_in_memory()?, MEMORY_BYTES)?
        })
    }

    fn counters(db: &Connection) -> Result<Counters, TableError> {
        let mut found = db.prepare("SELECT value FROM counter WHERE name = ?")?;
        let mut counter = |name: &str| match found.query_row([name], |row| row.get::<_, i64>(0)) {
            Err(rusqlite::Error::QueryReturnedNoRows) => Ok(0),
            found => found.map(i64::cast_unsigned),
        };
        Ok(Counters {
            made: Some(counter("made")?),
            lost: counter("lost")?,
            undeliverable: counter("undeliverable")?,
        })
    }

    /// Adds reports with their states, and deletes the oldest until there is room, acknowledged ones first. Returns the
    /// number of deleted reports that no hub has.
    pub(super) fn insert(&mut self, reports: &[StoredReport]) -> Result<u64, TableError> {
        let transaction = self.db.transaction()?;
        {
            let mut insert = transaction.prepare_cached(
                "INSERT INTO report (id, count, state, acknowledged_ms, json) VALUES (?1, ?2, ?3, ?4, ?5)
                 ON CONFLICT (id) DO UPDATE SET state = ?3, acknowledged_ms = ?4",
            )?;
            for report in reports {
                let (id, count) = (report.id.as_bytes(), report.count.map(signed));
                let state = (report.state, report.acknowledged_ms);
                insert.execute(params![id, count, state.0, state.1, report.json])?;
            }
        }
        let (mut lost, mut state) = (0, REFUSED);
        while state >= WAITING && used_bytes(&transaction)? > self.most_bytes {
            let oldest = "DELETE FROM report WHERE rowid IN \
                          (SELECT rowid FROM report WHERE state = ? ORDER BY count LIMIT 16)";
            match transaction.execute(oldest, [state])? {
                0 => state -= 1,
                deleted if state == WAITING => lost += deleted as u64,
                _ => {}
            }
        }
        let counters = Counters {
            lost: self.counters.lost + lost,
            ..self.counters
        };
        write_counters(&transaction, &counters)?;
        transaction.commit()?;
        self.counters = counters;
        Ok(lost)
    }

    /// The reports up to that state, by state and then oldest first, at most `most`.
    pub(super) fn reports(
        &self,
        last_state: i64,
        most: usize,
    ) -> Result<Vec<StoredReport>, TableError> {
        let mut select = self.db.prepare_cached(
            "SELECT id, count, state, acknowledged_ms, json FROM report
             WHERE state <= ? ORDER BY state, count",
        )?;
        let found = select.query_map([last_state], |row| {
            Ok(StoredReport {
                id: Uuid::from_bytes(row.get(0)?),
                count: row.get::<_, Option<i64>>(1)?.map(i64::cast_unsigned),
                state: row.get(2)?,
                acknowledged_ms: row.get(3)?,
                json: row.get(4)?,
            })
        })?;
        // Not by `LIMIT ?`: SQLite parses a statement anew whenever such a limit is bound.
        Ok(found.take(most).collect::<Result<_, _>>()?)
    }

    /// Sets the states of concluded reports, acknowledged or refused, and sends those again whose running counts are in
    /// the ranges `missing`. Concluded reports are kept for `kept_ms` from then on, refused ones without their content.
    pub(super) fn conclude(
        &mut self,
        concluded: &[(Uuid, i64)],
        missing: &[(u64, u64)],
        now_ms: i64,
        kept_ms: i64,
    ) -> Result<(), TableError> {
        let transaction = self.db.transaction()?;
        {
            let mut conclude = transaction.prepare_cached(
                "UPDATE report SET state = ?1, acknowledged_ms = ?2, json = iif(?1 = ?4, x'', json) WHERE id = ?3",
            )?;
            for (id, state) in concluded {
                conclude.execute(params![state, now_ms, id.as_bytes(), REFUSED])?;
            }
            let mut again = transaction.prepare_cached(
                "UPDATE report SET state = ?1 WHERE state = ?2 AND count BETWEEN ?3 AND ?4",
            )?;
            for (first, last) in missing {
                again.execute(params![AGAIN, ACKNOWLEDGED, signed(*first), signed(*last)])?;
            }
        }
        // Examines only the oldest, so the cost is limited by the number of deleted rows.
        (transaction.prepare_cached(
            "DELETE FROM report WHERE acknowledged_ms < ?1 AND rowid IN \
             (SELECT rowid FROM report WHERE state >= ?2 ORDER BY state, count LIMIT 400)",
        )?)
        .execute(params![now_ms.saturating_sub(kept_ms), ACKNOWLEDGED])?;
        write_counters(&transaction, &self.counters)?;
        transaction.commit()?;
        Ok(())
    }

    /// The number of reports that no hub has, and of reports that a hub has lost.
    pub(super) fn waiting(&self) -> Result<(u64, u64), TableError> {
        let mut count = (self.db).prepare_cached("SELECT count(*) FROM report WHERE state = ?")?;
        let mut count = |state: i64| count.query_row([state], |row| row.get::<_, i64>(0));
        Ok((
            count(WAITING)?.cast_unsigned(),
            count(AGAIN)?.cast_unsigned(),
        ))
    }
}

fn write_counters(transaction: &Transaction<'_>, counters: &Counters) -> rusqlite::Result<()> {
    let mut write = transaction.prepare_cached(
        "INSERT INTO counter (name, value) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET value = ?2",
    )?;
    for (name, value) in [
        ("made", counters.made.unwrap_or(0)),
        ("lost", counters.lost),
        ("undeliverable", counters.undeliverable),
    ] {
        write.execute(params![name, signed(value)])?;
    }
    Ok(())
}

/// The size of the used pages, bytes.
fn used_bytes(transaction: &Transaction<'_>) -> rusqlite::Result<u64> {
    let pragma =
        |name: &str| transaction.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let pages = pragma("page_count")? - pragma("freelist_count")?;
    Ok((pages * pragma("page_size")?).cast_unsigned())
}

/// Converts to SQLite's signed integers; the counts here stay far below 2^63.
fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}
