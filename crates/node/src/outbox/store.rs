//! The file of what must survive: SQLite in the state directory, synced at each commit.

use super::identity;
use albireo_service::clock::unix_nanoseconds;
use rusqlite::{Connection, ErrorCode, OptionalExtension, params};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// "albi": other programs' files are not taken for this one's.
const APPLICATION_ID: i64 = 0x616c_6269;
const SCHEMA_VERSION: i64 = 1;

/// A wall clock before 2020 is one that was never set: no age is told by it.
const SANE_CLOCK_NS: u64 = 1_577_836_800_000_000_000;

const SCHEMA: &str = "
CREATE TABLE instance (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    machine TEXT,
    last INTEGER NOT NULL DEFAULT 0,
    lost INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE report (
    instance INTEGER NOT NULL REFERENCES instance(id),
    number INTEGER NOT NULL,
    kept_ns INTEGER NOT NULL,
    json BLOB NOT NULL,
    PRIMARY KEY (instance, number)
) STRICT, WITHOUT ROWID;
CREATE TABLE setting (name TEXT PRIMARY KEY, json TEXT NOT NULL) STRICT, WITHOUT ROWID;
";

/// Why the file cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StoreError {
    /// SQLite says no.
    #[error("{0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The file system says no.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Somebody else's file, or a later program's.
    #[error("{0}")]
    Foreign(String),
    /// The file is no longer where it was.
    #[error("the file is no longer there: the disk is gone, or somebody removed it")]
    Gone,
}

impl StoreError {
    /// Whether the contents are broken rather than the access to them.
    fn is_corruption(&self) -> bool {
        match self {
            Self::Sqlite(error) => matches!(
                error.sqlite_error_code(),
                Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase)
            ),
            _ => false,
        }
    }

    /// Whether the connection is still good: nothing was written, but what is there can be read.
    pub(super) fn leaves_file_readable(&self) -> bool {
        match self {
            Self::Sqlite(error) => matches!(
                error.sqlite_error_code(),
                Some(ErrorCode::DiskFull | ErrorCode::ReadOnly | ErrorCode::DatabaseBusy)
            ),
            _ => false,
        }
    }
}

/// Who numbers reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Instance {
    /// Row in the file; 0 for one that only memory knows.
    pub id: i64,
    /// 32 hexadecimal digits.
    pub name: String,
    /// Digest of the machine it is bound to.
    pub machine: Option<String>,
    /// Last number given.
    pub last: u64,
    /// Reports lost before they could be sent.
    pub lost: u64,
}

impl Instance {
    pub(super) fn new(machine: Option<String>) -> Self {
        Self {
            id: 0,
            name: identity::new_instance(),
            machine,
            last: 0,
            lost: 0,
        }
    }
}

/// Reports to be sent together.
#[derive(Debug)]
pub(super) struct Rows {
    pub instance: Instance,
    /// Number and JSON, in order.
    pub reports: Vec<(u64, Vec<u8>)>,
}

/// What waits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Waiting {
    pub reports: u64,
    pub bytes: u64,
}

/// The open file.
#[derive(Debug)]
pub(crate) struct Store {
    db: Connection,
    file: PathBuf,
    inode: (u64, u64),
    waiting: Waiting,
}

/// What was found at opening.
pub(super) struct Opened {
    pub store: Store,
    pub current: Instance,
    /// What to tell, if the file was not as it was left.
    pub notes: Vec<String>,
}

impl Store {
    /// Opens, or makes, the file. One that is corrupt is set aside and what can be read of it saved.
    ///
    /// # Errors
    /// [`StoreError`]: the disk cannot be used, or the file is not ours.
    pub(super) fn open(file: &Path, machine: Option<&str>) -> Result<Opened, StoreError> {
        let mut notes = Vec::new();
        let mut store = match Self::connect(file) {
            Ok(store) => store,
            Err(error) if error.is_corruption() => {
                let aside = set_aside(file)?;
                notes.push(format!(
                    "{} is damaged ({error}) and was set aside as {}",
                    file.display(),
                    aside.display()
                ));
                let mut store = Self::connect(file)?;
                let saved = store.salvage(&aside);
                notes.push(format!("{saved} reports were saved from the damaged file"));
                store.recount()?;
                // What was lost cannot be known, so that the numbers of before are not gone on with.
                store.begin_instance(Instance::new(machine.map(str::to_owned)), None)?;
                store
            }
            Err(error) => return Err(error),
        };
        let newest = store.newest_instance()?;
        let current = match newest {
            Some(instance) if instance.machine.as_deref() == machine => instance,
            Some(other) => {
                notes.push(format!(
                    "the state directory is another machine's: a new instance begins, what waits is still delivered \
                     as instance {}",
                    other.name
                ));
                store.begin_instance(Instance::new(machine.map(str::to_owned)), None)?
            }
            None => store.begin_instance(Instance::new(machine.map(str::to_owned)), None)?,
        };
        Ok(Opened {
            store,
            current,
            notes,
        })
    }

    fn connect(file: &Path) -> Result<Self, StoreError> {
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder)?;
        }
        let db = Connection::open(file)?;
        db.busy_timeout(std::time::Duration::from_secs(2))?;
        let application: i64 = db.pragma_query_value(None, "application_id", |row| row.get(0))?;
        let version: i64 = db.pragma_query_value(None, "user_version", |row| row.get(0))?;
        let tables: i64 =
            db.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
        if tables > 0 && application != APPLICATION_ID {
            return Err(StoreError::Foreign(format!(
                "{} is another program's database: move it away, or choose another node.state_dir",
                file.display()
            )));
        }
        if version > SCHEMA_VERSION {
            return Err(StoreError::Foreign(format!(
                "{} was written by a later albireo (version {version}; this one knows {SCHEMA_VERSION})",
                file.display()
            )));
        }
        let mode: String =
            db.pragma_update_and_check(None, "journal_mode", "WAL", |row| row.get(0))?;
        if !mode.eq_ignore_ascii_case("wal") {
            return Err(StoreError::Foreign(format!(
                "{} is on a file system that cannot do write-ahead logging",
                file.display()
            )));
        }
        db.pragma_update(None, "synchronous", "FULL")?;
        db.pragma_update(None, "journal_size_limit", 4 << 20)?;
        if tables == 0 {
            db.execute_batch(&format!(
                "BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {SCHEMA_VERSION};
                 {SCHEMA} COMMIT;"
            ))?;
            // The name of a new file is safe only when its folder is synced.
            if let Some(folder) = file.parent() {
                fs::File::open(folder)?.sync_all()?;
            }
        }
        let sound: String = db.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
        if sound != "ok" {
            return Err(StoreError::Sqlite(rusqlite::Error::SqliteFailure(
                rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT),
                Some(sound),
            )));
        }
        let inode = inode(file)?;
        let mut store = Self {
            db,
            file: file.to_owned(),
            inode,
            waiting: Waiting::default(),
        };
        store.recount()?;
        // A disk that can be read and not written is told now, not when the first report is kept.
        store.db.execute_batch(
            "BEGIN IMMEDIATE; UPDATE instance SET last = last WHERE id = -1; COMMIT;",
        )?;
        Ok(store)
    }

    fn recount(&mut self) -> Result<(), StoreError> {
        let (reports, bytes): (u64, u64) = self.db.query_row(
            "SELECT count(*), coalesce(sum(length(json)), 0) FROM report",
            [],
            |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?)),
        )?;
        self.waiting = Waiting { reports, bytes };
        Ok(())
    }

    /// Copies what can be read of a damaged file; the number of reports.
    fn salvage(&mut self, aside: &Path) -> u64 {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_WRITE;
        let Ok(old) = Connection::open_with_flags(aside, flags) else {
            return 0;
        };
        let mut saved = 0;
        let mut copy = || -> rusqlite::Result<()> {
            let transaction = self.db.transaction()?;
            let mut instances =
                old.prepare("SELECT id, name, machine, last, lost FROM instance ORDER BY id")?;
            let mut rows = instances.query([])?;
            while let Some(row) = rows.next()? {
                transaction.execute(
                    "INSERT OR IGNORE INTO instance (id, name, machine, last, lost) VALUES (?, ?, ?, ?, ?)",
                    params![
                        row.get::<_, i64>(0)?,
                        row.get::<_, String>(1)?,
                        row.get::<_, Option<String>>(2)?,
                        row.get::<_, i64>(3)?,
                        row.get::<_, i64>(4)?
                    ],
                )?;
            }
            // From both ends, so that one broken page in the middle costs no more than it must.
            for order in ["ASC", "DESC"] {
                let Ok(mut reports) = old.prepare(&format!(
                    "SELECT instance, number, kept_ns, json FROM report ORDER BY instance {order}, number {order}"
                )) else {
                    continue;
                };
                let mut rows = reports.query([])?;
                while let Ok(Some(row)) = rows.next() {
                    let (Ok(instance), Ok(number), Ok(kept), Ok(json)) = (
                        row.get::<_, i64>(0),
                        row.get::<_, i64>(1),
                        row.get::<_, i64>(2),
                        row.get::<_, Vec<u8>>(3),
                    ) else {
                        continue;
                    };
                    saved += transaction.execute(
                        "INSERT OR IGNORE INTO report (instance, number, kept_ns, json) VALUES (?, ?, ?, ?)",
                        params![instance, number, kept, json],
                    )? as u64;
                }
            }
            if let Ok(mut settings) = old.prepare("SELECT name, json FROM setting") {
                let mut rows = settings.query([])?;
                while let Ok(Some(row)) = rows.next() {
                    transaction.execute(
                        "INSERT OR IGNORE INTO setting (name, json) VALUES (?, ?)",
                        params![row.get::<_, String>(0)?, row.get::<_, String>(1)?],
                    )?;
                }
            }
            transaction.commit()
        };
        if let Err(error) = copy() {
            tracing::warn!(%error, "the damaged state file could not be read to its end");
        }
        saved
    }

    fn newest_instance(&self) -> Result<Option<Instance>, StoreError> {
        let newest = self.db.query_row(
            "SELECT id, name, machine, last, lost FROM instance ORDER BY id DESC LIMIT 1",
            [],
            instance_of,
        );
        Ok(newest.optional()?)
    }

    /// Writes a new instance down; what waits under the one in row `from` is renumbered as its own.
    pub(super) fn begin_instance(
        &mut self,
        mut instance: Instance,
        from: Option<i64>,
    ) -> Result<Instance, StoreError> {
        let transaction = self.db.transaction()?;
        transaction.execute(
            "INSERT INTO instance (name, machine, last, lost) VALUES (?, ?, ?, ?)",
            params![
                instance.name,
                instance.machine,
                signed(instance.last),
                signed(instance.lost)
            ],
        )?;
        instance.id = transaction.last_insert_rowid();
        if let Some(from) = from {
            let moved = transaction.execute(
                "INSERT INTO report (instance, number, kept_ns, json)
                 SELECT ?1, ?2 + row_number() OVER (ORDER BY number), kept_ns, json FROM report WHERE instance = ?3",
                params![instance.id, signed(instance.last), from],
            )?;
            transaction.execute("DELETE FROM report WHERE instance = ?", [from])?;
            instance.last += moved as u64;
            transaction.execute(
                "UPDATE instance SET last = ? WHERE id = ?",
                params![signed(instance.last), instance.id],
            )?;
        }
        // An instance of before that nothing waits for any more is only history.
        transaction.execute(
            "DELETE FROM instance WHERE id < ?1 AND id NOT IN (SELECT instance FROM report)",
            [instance.id],
        )?;
        transaction.commit()?;
        Ok(instance)
    }

    /// Whether the file is still the one that was opened.
    pub(super) fn check(&self) -> Result<(), StoreError> {
        match inode(&self.file) {
            Ok(inode) if inode == self.inode => Ok(()),
            _ => Err(StoreError::Gone),
        }
    }

    /// Keeps reports, with the instance's numbers, in one synced transaction.
    pub(super) fn keep(
        &mut self,
        instance: &Instance,
        reports: &[(u64, Vec<u8>)],
    ) -> Result<(), StoreError> {
        self.check()?;
        let now = signed(unix_nanoseconds());
        let transaction = self.db.transaction()?;
        let mut added = Waiting::default();
        {
            let mut insert = transaction.prepare(
                "INSERT INTO report (instance, number, kept_ns, json) VALUES (?, ?, ?, ?)",
            )?;
            for (number, json) in reports {
                insert.execute(params![instance.id, signed(*number), now, json])?;
                added.reports += 1;
                added.bytes += json.len() as u64;
            }
        }
        transaction.execute(
            "UPDATE instance SET last = ?, lost = ? WHERE id = ?",
            params![signed(instance.last), signed(instance.lost), instance.id],
        )?;
        transaction.commit()?;
        self.waiting.reports += added.reports;
        self.waiting.bytes += added.bytes;
        Ok(())
    }

    /// Replaces reports that wait by what is known of them now.
    pub(super) fn replace(
        &mut self,
        instance: &Instance,
        reports: &[(u64, Vec<u8>)],
    ) -> Result<(), StoreError> {
        self.check()?;
        let transaction = self.db.transaction()?;
        let mut bytes = self.waiting.bytes;
        {
            let mut length = transaction
                .prepare("SELECT length(json) FROM report WHERE instance = ? AND number = ?")?;
            let mut update = transaction
                .prepare("UPDATE report SET json = ? WHERE instance = ? AND number = ?")?;
            for (number, json) in reports {
                let before = length
                    .query_row(params![instance.id, signed(*number)], |row| {
                        unsigned(row, 0)
                    })
                    .optional()?;
                if let Some(before) = before {
                    update.execute(params![json, instance.id, signed(*number)])?;
                    bytes = (bytes + json.len() as u64).saturating_sub(before);
                }
            }
        }
        transaction.commit()?;
        self.waiting.bytes = bytes;
        Ok(())
    }

    /// The oldest reports with numbers above `acknowledged` of their instance and below `before` of the current one.
    pub(super) fn rows(
        &self,
        most: usize,
        most_bytes: usize,
        acknowledged: &dyn Fn(i64) -> u64,
        current: i64,
        before: Option<u64>,
    ) -> Result<Option<Rows>, StoreError> {
        let mut instances = self.db.prepare(
            "SELECT id, name, machine, last, lost FROM instance
             WHERE id IN (SELECT DISTINCT instance FROM report) ORDER BY id",
        )?;
        let mut found = instances.query([])?;
        while let Some(row) = found.next()? {
            let instance = instance_of(row)?;
            let before = before
                .filter(|_| instance.id == current)
                .unwrap_or(u64::MAX);
            let mut reports = self.db.prepare(
                "SELECT number, json FROM report WHERE instance = ? AND number > ? AND number < ?
                 ORDER BY number LIMIT ?",
            )?;
            let mut rows = reports.query(params![
                instance.id,
                signed(acknowledged(instance.id)),
                signed(before),
                most as i64
            ])?;
            let (mut taken, mut bytes) = (Vec::new(), 0);
            while let Some(row) = rows.next()? {
                let json: Vec<u8> = row.get(1)?;
                bytes += json.len();
                if bytes > most_bytes && !taken.is_empty() {
                    break;
                }
                taken.push((row.get::<_, i64>(0)? as u64, json));
            }
            if !taken.is_empty() {
                return Ok(Some(Rows {
                    instance,
                    reports: taken,
                }));
            }
        }
        Ok(None)
    }

    /// Removes what a hub has.
    pub(super) fn remove(&mut self, instance: i64, upto: u64) -> Result<(), StoreError> {
        let transaction = self.db.transaction()?;
        let (reports, bytes): (u64, u64) = transaction.query_row(
            "SELECT count(*), coalesce(sum(length(json)), 0) FROM report WHERE instance = ? AND number <= ?",
            params![instance, signed(upto)],
            |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?)),
        )?;
        transaction.execute(
            "DELETE FROM report WHERE instance = ? AND number <= ?",
            params![instance, signed(upto)],
        )?;
        transaction.commit()?;
        self.waiting.reports = self.waiting.reports.saturating_sub(reports);
        self.waiting.bytes = self.waiting.bytes.saturating_sub(bytes);
        Ok(())
    }

    /// Removes single reports that cannot be read, counted as lost of their instance.
    pub(super) fn give_up(&mut self, instance: i64, numbers: &[u64]) -> Result<(), StoreError> {
        let transaction = self.db.transaction()?;
        for number in numbers {
            transaction.execute(
                "DELETE FROM report WHERE instance = ? AND number = ?",
                params![instance, signed(*number)],
            )?;
        }
        transaction.execute(
            "UPDATE instance SET lost = lost + ? WHERE id = ?",
            params![numbers.len() as i64, instance],
        )?;
        transaction.commit()?;
        self.recount()
    }

    /// Lets the oldest go until the bounds are kept; how many of each instance went.
    pub(super) fn trim(
        &mut self,
        most_bytes: u64,
        most_age_ns: u64,
    ) -> Result<Vec<(i64, u64)>, StoreError> {
        let now = unix_nanoseconds();
        let oldest = now.saturating_sub(most_age_ns);
        let aged: u64 = self.db.query_row(
            "SELECT count(*) FROM report WHERE kept_ns BETWEEN ? AND ?",
            params![signed(SANE_CLOCK_NS), signed(oldest)],
            |row| unsigned(row, 0),
        )?;
        if aged == 0 && self.waiting.bytes <= most_bytes {
            return Ok(Vec::new());
        }
        let transaction = self.db.transaction()?;
        let mut gone: Vec<(i64, u64)> = Vec::new();
        {
            let mut bytes = self.waiting.bytes;
            let mut oldest_first = transaction.prepare(
                "SELECT instance, number, kept_ns, length(json) FROM report ORDER BY instance, number",
            )?;
            let mut delete =
                transaction.prepare("DELETE FROM report WHERE instance = ? AND number = ?")?;
            let mut rows = oldest_first.query([])?;
            let mut chosen = Vec::new();
            while let Some(row) = rows.next()? {
                let (instance, number): (i64, i64) = (row.get(0)?, row.get(1)?);
                let kept = row.get::<_, i64>(2)? as u64;
                let aged = (SANE_CLOCK_NS..=oldest).contains(&kept);
                if bytes <= most_bytes && !aged {
                    if kept > oldest {
                        break;
                    }
                    continue;
                }
                bytes = bytes.saturating_sub(unsigned(row, 3)?);
                chosen.push((instance, number));
            }
            drop(rows);
            for (instance, number) in chosen {
                delete.execute(params![instance, number])?;
                match gone.last_mut() {
                    Some((last, count)) if *last == instance => *count += 1,
                    _ => gone.push((instance, 1)),
                }
            }
            for (instance, count) in &gone {
                transaction.execute(
                    "UPDATE instance SET lost = lost + ? WHERE id = ?",
                    params![signed(*count), instance],
                )?;
            }
        }
        transaction.commit()?;
        self.recount()?;
        Ok(gone)
    }

    /// What waits.
    pub(super) const fn waiting(&self) -> Waiting {
        self.waiting
    }

    /// Makes the file full: no more than `pages` more than it has.
    #[cfg(test)]
    pub(super) fn limit_pages(&self, pages: i64) {
        let now: i64 = self
            .db
            .pragma_query_value(None, "page_count", |row| row.get(0))
            .unwrap();
        self.db
            .query_row(
                &format!("PRAGMA max_page_count = {}", now + pages),
                [],
                |_| Ok(()),
            )
            .unwrap();
    }

    /// A setting kept under `name`, as JSON.
    pub(super) fn setting(&self, name: &str) -> Result<Option<String>, StoreError> {
        let found = self
            .db
            .query_row("SELECT json FROM setting WHERE name = ?", [name], |row| {
                row.get(0)
            })
            .optional()?;
        Ok(found)
    }

    /// Keeps a setting.
    pub(super) fn set(&mut self, name: &str, json: &str) -> Result<(), StoreError> {
        self.check()?;
        self.db.execute(
            "INSERT INTO setting (name, json) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET json = ?2",
            params![name, json],
        )?;
        Ok(())
    }
}

fn instance_of(row: &rusqlite::Row<'_>) -> rusqlite::Result<Instance> {
    Ok(Instance {
        id: row.get(0)?,
        name: row.get(1)?,
        machine: row.get(2)?,
        last: row.get::<_, i64>(3)? as u64,
        lost: row.get::<_, i64>(4)? as u64,
    })
}

/// SQLite's integers have a sign; numbers and times here stay far below 2^63.
fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// The other way.
fn unsigned(row: &rusqlite::Row<'_>, column: usize) -> rusqlite::Result<u64> {
    row.get::<_, i64>(column).map(i64::cast_unsigned)
}

fn inode(file: &Path) -> std::io::Result<(u64, u64)> {
    let metadata = fs::metadata(file)?;
    Ok((metadata.dev(), metadata.ino()))
}

/// Moves a damaged file and what belongs to it out of the way, under a name that is free.
fn set_aside(file: &Path) -> std::io::Result<PathBuf> {
    let named = |ending: &str| {
        let mut name = file.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    let free = (0..1000)
        .map(|number| named(&format!(".damaged-{number}")))
        .find(|aside| !aside.exists())
        .ok_or_else(|| std::io::Error::other("too many damaged files were set aside already"))?;
    fs::rename(file, &free)?;
    for ending in ["-wal", "-shm"] {
        let mut beside = free.as_os_str().to_owned();
        beside.push(ending);
        let _ = fs::rename(named(ending), PathBuf::from(beside));
    }
    Ok(free)
}
