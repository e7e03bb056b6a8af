//! Stores reports in an SQLite table, synced at each commit.

use albireo_service::clock::Uptime;
use rusqlite::{Connection, ErrorCode, Row, Transaction, params};
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
    json BLOB NOT NULL,
    boot INTEGER,
    uptime_s INTEGER,
    sent INTEGER NOT NULL DEFAULT 0,
    checksum INTEGER
) STRICT;
CREATE INDEX report_by_state ON report (state, count);
CREATE TABLE counter (name TEXT PRIMARY KEY, value INTEGER NOT NULL) STRICT, WITHOUT ROWID;
";

/// The columns that earlier versions of this layout lack, and ignore.
const ADDED: [(&str, &str); 4] = [
    ("boot", "INTEGER"),
    ("uptime_s", "INTEGER"),
    ("sent", "INTEGER NOT NULL DEFAULT 0"),
    ("checksum", "INTEGER"),
];

/// A file up to this size is checked as a whole when it is opened, bytes: that takes a slow disk about a second.
const CHECKED_BYTES: i64 = 32 << 20;

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
    /// The content contradicts itself.
    #[error("it is damaged: {0}")]
    Damaged(String),
}

impl TableError {
    /// True if the contents are corrupt, rather than inaccessible.
    pub(super) fn is_corruption(&self) -> bool {
        let Self::Sqlite(error) = self else {
            return matches!(self, Self::Damaged(_));
        };
        match error {
            // `Unknown`: a table or column that we created is not there.
            rusqlite::Error::SqliteFailure(error, _) => matches!(
                error.code,
                ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase | ErrorCode::Unknown
            ),
            rusqlite::Error::InvalidColumnType(..)
            | rusqlite::Error::FromSqlConversionFailure(..)
            | rusqlite::Error::IntegralValueOutOfRange(..) => true,
            _ => false,
        }
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
    /// The uptime when it was made, if it is known.
    pub(super) made: Option<Uptime>,
    /// True if it was sent, perhaps without an answer.
    pub(super) sent: bool,
    /// What the table has; `None` in a report of an earlier version.
    pub(super) checksum: Option<i64>,
}

/// The columns of [`StoredReport`], in the order of [`StoredReport::read`].
pub(super) const COLUMNS: &str =
    "id, count, state, acknowledged_ms, json, boot, uptime_s, sent, checksum";

impl StoredReport {
    pub(super) fn read(row: &Row<'_>) -> rusqlite::Result<Self> {
        let boot: Option<i64> = row.get(5)?;
        let uptime_s: Option<i64> = row.get(6)?;
        let made = boot.zip(uptime_s).map(|(boot, s)| Uptime {
            boot: boot.cast_unsigned(),
            s: s.cast_unsigned(),
        });
        Ok(Self {
            id: Uuid::from_bytes(row.get(0)?),
            count: row.get::<_, Option<i64>>(1)?.map(i64::cast_unsigned),
            state: row.get(2)?,
            acknowledged_ms: row.get(3)?,
            json: row.get(4)?,
            made,
            sent: row.get(7)?,
            checksum: row.get(8)?,
        })
    }

    /// The checksum of what never changes; the state is beside it in the table, in the upper half.
    fn content_checksum(&self) -> i64 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(self.id.as_bytes());
        hasher.update(&self.count.map(signed).unwrap_or(-1).to_le_bytes());
        let made = self.made.unwrap_or_default();
        hasher.update(&made.boot.to_le_bytes());
        hasher.update(&made.s.to_le_bytes());
        hasher.update(&self.json);
        hasher.finalize().into()
    }

    /// What the table is to have: a content that was damaged keeps the checksum that tells so.
    fn new_checksum(&self) -> Option<i64> {
        if self.state == REFUSED {
            return None;
        }
        let content = match self.checksum {
            Some(checksum) => checksum & CONTENT,
            None => self.content_checksum(),
        };
        Some(content | (self.state << 32))
    }

    /// True if the report is as it was written, as far as that can be known.
    pub(super) fn is_intact(&self) -> bool {
        match self.checksum {
            Some(checksum) if self.state != REFUSED => {
                checksum & CONTENT == self.content_checksum()
            }
            _ => true,
        }
    }

    /// Takes a state that is not the one that was written for that of a report that waits: a hub stores it only once.
    pub(super) fn mend_state(&mut self) {
        if self.checksum.is_some_and(|checksum| checksum >> 32 != self.state) {
            self.state = WAITING;
        }
    }
}

/// The part of a checksum that is about the content; 4294967295 in statements.
const CONTENT: i64 = 0xffff_ffff;

/// A report that waits no more.
#[derive(Clone, Copy, Debug)]
pub(super) struct Concluded {
    pub(super) id: Uuid,
    /// [`ACKNOWLEDGED`] or [`REFUSED`].
    pub(super) state: i64,
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
    /// Their checksum, never 0.
    fn checksum(self) -> u64 {
        let counts = [self.made.unwrap_or(0), self.lost, self.undeliverable];
        let bytes: Vec<u8> = counts.into_iter().flat_map(u64::to_le_bytes).collect();
        u64::from(crc32fast::hash(&bytes)) | 1 << 32
    }

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
    /// Reports written since the last checkpoint.
    pub(super) written: usize,
}

/// What waits, from the table.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Count {
    /// Reports that no hub has.
    pub(super) waiting: u64,
    /// Reports that a hub has lost.
    pub(super) again: u64,
    /// The lowest count of the waiting reports.
    pub(super) oldest: Option<u64>,
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
        if tables > 0 {
            check(&db)?;
            add_columns(&db)?;
        }
        Ok(Self {
            counters: Self::counters(&db)?,
            db,
            most_bytes,
            written: 0,
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
        let counters = Counters {
            made: Some(counter("made")?),
            lost: counter("lost")?,
            undeliverable: counter("undeliverable")?,
        };
        let checksum = counter("checksum")?;
        if checksum != 0 && checksum != counters.checksum() {
            return Err(TableError::Damaged("its counts are wrong".to_owned()));
        }
        Ok(counters)
    }

    /// Copies the log into the file, so that one damaged byte of the log costs few reports.
    pub(super) fn checkpoint(&mut self) -> Result<(), TableError> {
        self.db.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
        self.written = 0;
        Ok(())
    }

    /// The number of reports in the table whose counts are above `settled`, up to `made`.
    pub(super) fn count_between(&self, settled: u64, made: u64) -> Result<u64, TableError> {
        let text = "SELECT count(*) FROM report WHERE state BETWEEN 0 AND 3 AND count > ?1 AND count <= ?2";
        let bounds = params![signed(settled), signed(made)];
        let found: i64 = self.db.query_row(text, bounds, |row| row.get(0))?;
        Ok(found.cast_unsigned())
    }

    /// Notes that reports are about to be sent.
    pub(super) fn note_sent(&mut self, reports: &[Uuid]) -> Result<(), TableError> {
        let transaction = self.db.transaction()?;
        {
            let mut update =
                transaction.prepare_cached("UPDATE report SET sent = 1 WHERE id = ?")?;
            for id in reports {
                update.execute([id.as_bytes()])?;
            }
        }
        transaction.commit()?;
        Ok(())
    }

    /// Adds reports with their states, and deletes the oldest until there is room, acknowledged ones first. Returns the
    /// number of deleted reports that no hub has.
    pub(super) fn insert(&mut self, reports: &[StoredReport]) -> Result<u64, TableError> {
        let transaction = self.db.transaction()?;
        {
            let mut insert = transaction.prepare_cached(
                "INSERT INTO report (id, count, state, acknowledged_ms, json, boot, uptime_s, sent, checksum)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)
                 ON CONFLICT (id) DO UPDATE SET state = ?3, acknowledged_ms = ?4, sent = max(sent, ?8),
                     checksum = (checksum & 4294967295) | (?3 << 32)",
            )?;
            for report in reports {
                insert.execute(params![
                    report.id.as_bytes(),
                    report.count.map(signed),
                    report.state,
                    report.acknowledged_ms,
                    report.json,
                    report.made.map(|made| made.boot.cast_signed()),
                    report.made.map(|made| signed(made.s)),
                    report.sent,
                    report.new_checksum(),
                ])?;
            }
        }
        let mut lost = 0;
        let mut state = REFUSED;
        while state >= WAITING && used_bytes(&transaction)? > self.most_bytes {
            let oldest = "DELETE FROM report WHERE rowid IN \
                          (SELECT rowid FROM report WHERE state = ? ORDER BY count LIMIT 16)";
            let deleted = transaction.execute(oldest, [state])?;
            if deleted == 0 {
                state -= 1;
            } else if state == WAITING {
                lost += deleted as u64;
            }
        }
        let counters = Counters {
            lost: self.counters.lost + lost,
            ..self.counters
        };
        write_counters(&transaction, &counters)?;
        transaction.commit()?;
        self.counters = counters;
        self.written += reports.len();
        Ok(lost)
    }

    /// The reports up to that state, by state and then oldest first, at most `most`.
    pub(super) fn reports(
        &self,
        last_state: i64,
        most: usize,
    ) -> Result<Vec<StoredReport>, TableError> {
        let mut select = self.db.prepare_cached(&format!(
            "SELECT {COLUMNS} FROM report WHERE state <= ? ORDER BY state, count"
        ))?;
        let found = select.query_map([last_state], StoredReport::read)?;
        // Not by `LIMIT ?`: SQLite parses a statement again whenever such a limit is bound.
        Ok(found.take(most).collect::<Result<_, _>>()?)
    }

    /// Sets the states of concluded reports, acknowledged or refused, and sends those again whose running counts are in
    /// the ranges `missing`. Concluded reports are kept for `kept_ms` from then on, refused ones without their content.
    pub(super) fn conclude(
        &mut self,
        concluded: &[Concluded],
        missing: &[(u64, u64)],
        now_ms: i64,
        kept_ms: i64,
    ) -> Result<(), TableError> {
        let transaction = self.db.transaction()?;
        {
            let mut conclude = transaction.prepare_cached(
                "UPDATE report SET state = ?1, acknowledged_ms = ?2, json = iif(?1 = ?4, x'', json),
                     checksum = iif(?1 = ?4, NULL, (checksum & 4294967295) | (?1 << 32)) WHERE id = ?3",
            )?;
            for report in concluded {
                let id = report.id.as_bytes();
                conclude.execute(params![report.state, now_ms, id, REFUSED])?;
            }
            let mut again = transaction.prepare_cached(
                "UPDATE report SET state = ?1, checksum = (checksum & 4294967295) | (?1 << 32)
                 WHERE state = ?2 AND count BETWEEN ?3 AND ?4",
            )?;
            for (first, last) in missing {
                again.execute(params![AGAIN, ACKNOWLEDGED, signed(*first), signed(*last)])?;
            }
        }
        // Examines only the oldest, so the cost is limited by the number of deleted rows.
        {
            let mut forget = transaction.prepare_cached(
                "DELETE FROM report WHERE acknowledged_ms < ?1 AND rowid IN \
                 (SELECT rowid FROM report WHERE state >= ?2 ORDER BY state, count LIMIT 400)",
            )?;
            forget.execute(params![now_ms.saturating_sub(kept_ms), ACKNOWLEDGED])?;
        }
        write_counters(&transaction, &self.counters)?;
        transaction.commit()?;
        Ok(())
    }

    /// Counts what waits.
    pub(super) fn count(&self) -> Result<Count, TableError> {
        let text = "SELECT count(*), min(count) FROM report WHERE state = ?";
        let mut select = self.db.prepare_cached(text)?;
        let mut count = |state: i64| {
            select.query_row([state], |row| {
                let reports: i64 = row.get(0)?;
                let oldest: Option<i64> = row.get(1)?;
                Ok((reports.cast_unsigned(), oldest.map(i64::cast_unsigned)))
            })
        };
        let (waiting, oldest) = count(WAITING)?;
        let (again, _) = count(AGAIN)?;
        Ok(Count {
            waiting,
            again,
            oldest,
        })
    }
}

/// Finds damage that SQLite can find, in a file that is not large.
fn check(db: &Connection) -> Result<(), TableError> {
    let pragma = |name: &str| db.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    if pragma("page_count")? * pragma("page_size")? > CHECKED_BYTES {
        return Ok(());
    }
    let found: String = db.query_row("PRAGMA integrity_check(1)", [], |row| row.get(0))?;
    match found.as_str() {
        "ok" => Ok(()),
        _ => Err(TableError::Damaged(found)),
    }
}

/// Adds the columns that an earlier version lacks.
pub(super) fn add_columns(db: &Connection) -> Result<(), TableError> {
    for (column, kind) in ADDED {
        let text = "SELECT count(*) FROM pragma_table_info('report') WHERE name = ?";
        let there: i64 = db.query_row(text, [column], |row| row.get(0))?;
        if there == 0 {
            db.execute_batch(&format!("ALTER TABLE report ADD COLUMN {column} {kind}"))?;
        }
    }
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
        ("checksum", counters.checksum()),
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
