//! Stores reports in a table of SQLite, synced at each commit.

use rusqlite::{Connection, ErrorCode, Transaction, params};
use uuid::Uuid;

/// "albi": other programs' files are not taken for this one's.
const APPLICATION_ID: i64 = 0x616c_6269;
/// Version 1 was that of 0.1.0.
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
CREATE TABLE hub_database (id BLOB PRIMARY KEY NOT NULL) STRICT;
";

/// No hub has it.
const WAITING: i64 = 0;
/// A hub lost it.
const AGAIN: i64 = 1;
/// A hub has it.
const ACKNOWLEDGED: i64 = 2;
/// Never to be sent again; the last of the states.
pub(super) const REFUSED: i64 = 3;

/// Most bytes of reports in memory: some thousand.
pub(super) const MEMORY_BYTES: u64 = 8 << 20;

/// Databases of hubs that are remembered.
const MOST_DATABASES: i64 = 16;

/// The reason for which a table cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    /// SQLite fails.
    #[error("{0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The file system fails.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Waiting does not mend it: the folder is another node's, or the file is of another program or version.
    #[error("{0}")]
    Unusable(String),
}

impl TableError {
    /// Says whether the contents are broken rather than the access to them.
    pub(super) fn is_corruption(&self) -> bool {
        let Self::Sqlite(error) = self else {
            return false;
        };
        let broken = [ErrorCode::DatabaseCorrupt, ErrorCode::NotADatabase].map(Some);
        broken.contains(&error.sqlite_error_code())
    }
}

/// A report as it is kept.
#[derive(Clone, Debug)]
pub(super) struct StoredReport {
    pub(super) id: Uuid,
    count: Option<u64>,
    state: i64,
    acknowledged_ms: i64,
    pub(super) json: Vec<u8>,
}

impl StoredReport {
    /// One that no hub has.
    pub(super) fn new(id: Uuid, count: Option<u64>, json: Vec<u8>) -> Self {
        Self {
            id,
            count,
            state: WAITING,
            acknowledged_ms: 0,
            json,
        }
    }
}

/// These counts go on over restarts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counters {
    /// The running count of reports; `None` while it is not known how many there were before.
    pub(super) made: Option<u64>,
    /// Reports lost.
    pub(super) lost: u64,
    /// Reports that a hub refused for good, or that cannot be read.
    pub(super) undeliverable: u64,
}

impl Counters {
    /// The larger of each: both count the same reports.
    pub(super) fn max(self, other: Self) -> Self {
        Self {
            made: self.made.max(other.made),
            lost: self.lost.max(other.lost),
            undeliverable: self.undeliverable.max(other.undeliverable),
        }
    }
}

/// The changes that a hub's answer makes.
#[derive(Clone, Debug, Default)]
pub(super) struct Answered {
    /// Stored at the hub.
    pub(super) acknowledged: Vec<Uuid>,
    /// Never to be sent again.
    pub(super) refused: Vec<Uuid>,
    /// The hub's database, if the answer named it.
    pub(super) database: Option<Uuid>,
    /// Counts of which the hub misses the reports.
    pub(super) missing: Vec<(u64, u64)>,
}

/// The open table, and what is counted: that is written with each change.
#[derive(Debug)]
pub(super) struct Table {
    db: Connection,
    most_bytes: u64,
    pub(super) counters: Counters,
}

impl Table {
    /// Takes an open database, and makes the table in an empty one.
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

    /// An empty table that no disk holds, in which is counted on.
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

    /// Adds reports, with the state they have, and lets the oldest go until there is room: what is acknowledged first. How
    /// many went that no hub has.
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
        let mut lost = 0;
        for state in [REFUSED, ACKNOWLEDGED, AGAIN, WAITING] {
            while used_bytes(&transaction)? > self.most_bytes {
                let deleted = remove_oldest(&transaction, state, 16)?;
                if deleted == 0 {
                    break;
                }
                if state == WAITING {
                    lost += deleted;
                }
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

    /// The reports to be sent, the oldest first, no more than `most`; those that a hub has lost behind those that none had,
    /// and only if they go `again` now.
    pub(super) fn due(&self, again: bool, most: usize) -> Result<Vec<StoredReport>, TableError> {
        self.reports(if again { AGAIN } else { WAITING }, most)
    }

    /// Reports up to that state, the oldest of each first, no more than `most`.
    pub(super) fn reports(
        &self,
        last_state: i64,
        most: usize,
    ) -> Result<Vec<StoredReport>, TableError> {
        let mut select = self.db.prepare_cached(
            "SELECT id, count, state, acknowledged_ms, json FROM report
             WHERE state <= ? ORDER BY state, count LIMIT ?",
        )?;
        let found = select.query_map([last_state, signed(most as u64)], |row| {
            Ok(StoredReport {
                id: Uuid::from_bytes(row.get(0)?),
                count: row.get::<_, Option<i64>>(1)?.map(i64::cast_unsigned),
                state: row.get(2)?,
                acknowledged_ms: row.get(3)?,
                json: row.get(4)?,
            })
        })?;
        Ok(found.collect::<Result<_, _>>()?)
    }

    /// Takes a hub's answer. What was acknowledged is kept for `kept_ms` after that.
    pub(super) fn answered(
        &mut self,
        answered: &Answered,
        now_ms: i64,
        kept_ms: i64,
    ) -> Result<(), TableError> {
        let transaction = self.db.transaction()?;
        {
            let mut acknowledge = transaction.prepare_cached(
                "UPDATE report SET state = ?1, acknowledged_ms = ?2 WHERE id = ?3",
            )?;
            for id in &answered.acknowledged {
                acknowledge.execute(params![ACKNOWLEDGED, now_ms, id.as_bytes()])?;
            }
            let mut refuse = transaction.prepare_cached(
                "UPDATE report SET state = ?1, acknowledged_ms = ?2, json = x'' WHERE id = ?3",
            )?;
            for id in &answered.refused {
                refuse.execute(params![REFUSED, now_ms, id.as_bytes()])?;
            }
            let mut again = transaction.prepare_cached(
                "UPDATE report SET state = ?1 WHERE state = ?2 AND count BETWEEN ?3 AND ?4",
            )?;
            for (first, last) in &answered.missing {
                again.execute(params![AGAIN, ACKNOWLEDGED, signed(*first), signed(*last)])?;
            }
        }
        if let Some(database) = answered.database {
            take_database(&transaction, database, &answered.acknowledged)?;
        }
        // Only the oldest are examined, so that this costs no more than what is deleted.
        transaction.execute(
            "DELETE FROM report WHERE acknowledged_ms < ?1 AND rowid IN \
             (SELECT rowid FROM report WHERE state >= ?2 ORDER BY state, count LIMIT 400)",
            params![now_ms.saturating_sub(kept_ms), ACKNOWLEDGED],
        )?;
        write_counters(&transaction, &self.counters)?;
        transaction.commit()?;
        Ok(())
    }

    /// Reports that no hub has, and reports that a hub has lost.
    pub(super) fn waiting(&self) -> Result<(u64, u64), TableError> {
        let mut count = (self.db).prepare_cached("SELECT count(*) FROM report WHERE state = ?")?;
        let mut count = |state: i64| count.query_row([state], |row| row.get::<_, i64>(0));
        Ok((
            count(WAITING)?.cast_unsigned(),
            count(AGAIN)?.cast_unsigned(),
        ))
    }

    #[cfg(test)]
    pub(super) fn connection(&self) -> &Connection {
        &self.db
    }
}

/// Remembers the database of a hub. A new one beside others has none of the reports that those have: but for those just
/// `acknowledged` all are sent again.
fn take_database(
    transaction: &Transaction<'_>,
    database: Uuid,
    acknowledged: &[Uuid],
) -> rusqlite::Result<()> {
    let insert = "INSERT OR IGNORE INTO hub_database (id) VALUES (?)";
    if transaction.execute(insert, [database.as_bytes()])? == 0 {
        return Ok(());
    }
    let known: i64 =
        transaction.query_row("SELECT count(*) FROM hub_database", [], |row| row.get(0))?;
    if known > 1 {
        tracing::warn!(%database, "a hub with another database: it is sent again what is still here");
        let again = "UPDATE report SET state = ? WHERE state = ?";
        transaction.execute(again, [AGAIN, ACKNOWLEDGED])?;
        let mut there = transaction.prepare("UPDATE report SET state = ? WHERE id = ?")?;
        for id in acknowledged {
            there.execute(params![ACKNOWLEDGED, id.as_bytes()])?;
        }
    }
    transaction.execute(
        "DELETE FROM hub_database WHERE rowid <= (SELECT max(rowid) FROM hub_database) - ?",
        [MOST_DATABASES],
    )?;
    Ok(())
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

fn remove_oldest(transaction: &Transaction<'_>, state: i64, most: i64) -> rusqlite::Result<u64> {
    let deleted = transaction.execute(
        "DELETE FROM report WHERE rowid IN (SELECT rowid FROM report WHERE state = ? ORDER BY count LIMIT ?)",
        [state, most],
    )?;
    Ok(deleted as u64)
}

/// Bytes of the pages that hold something.
fn used_bytes(transaction: &Transaction<'_>) -> rusqlite::Result<u64> {
    let pragma =
        |name: &str| transaction.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let pages = pragma("page_count")? - pragma("freelist_count")?;
    Ok((pages * pragma("page_size")?).cast_unsigned())
}

/// SQLite's integers have a sign; what is counted here stays far below 2^63.
fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}
