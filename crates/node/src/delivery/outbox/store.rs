//! The file of what must survive: SQLite in the state directory, synced at each commit.

mod salvage;
mod schema;
mod trim;

use super::identity;
use albireo_service::clock::unix_nanoseconds;
use rusqlite::{Connection, ErrorCode, OptionalExtension, ffi, params};
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

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
    fn sqlite(&self) -> Option<&ffi::Error> {
        match self {
            Self::Sqlite(error) => error.sqlite_error(),
            _ => None,
        }
    }

    /// Whether the contents are broken rather than the access to them.
    pub(super) fn is_corruption(&self) -> bool {
        let code = self.sqlite().map(|error| error.code);
        matches!(
            code,
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase)
        )
    }

    /// Whether the connection is as good as a new one would be: it only has to wait.
    pub(super) fn passes_by_itself(&self) -> bool {
        let code = self.sqlite().map(|error| error.code);
        matches!(
            code,
            Some(ErrorCode::DiskFull | ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked)
        )
    }

    /// Whether the connection is still good: nothing was written, but what is there can be read.
    pub(super) fn leaves_file_readable(&self) -> bool {
        let Some(error) = self.sqlite() else {
            return false;
        };
        let only_writing = [
            ffi::SQLITE_IOERR_WRITE,
            ffi::SQLITE_IOERR_FSYNC,
            ffi::SQLITE_IOERR_DIR_FSYNC,
            ffi::SQLITE_IOERR_TRUNCATE,
        ];
        self.passes_by_itself()
            || (error.code == ErrorCode::ReadOnly
                && error.extended_code != ffi::SQLITE_READONLY_DBMOVED)
            || only_writing.contains(&error.extended_code)
    }
}

/// Which file it is, whatever its name: device and number.
pub(super) type Inode = (u64, u64);

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

/// Which reports are asked for.
pub(super) struct Wanted<'a> {
    /// Most reports.
    pub reports: usize,
    /// Most bytes, unless it is a single report.
    pub bytes: usize,
    /// Of the instance of that name, those above this number.
    pub above: &'a dyn Fn(&str) -> u64,
    /// Of the instance of that name, those below this number, if there is one.
    pub below: &'a dyn Fn(&str) -> Option<u64>,
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
    inode: Inode,
    waiting: Waiting,
}

impl Store {
    fn recount(&mut self) -> Result<(), StoreError> {
        let (reports, bytes): (u64, u64) = self.db.query_row(
            "SELECT count(*), coalesce(sum(length(json)), 0) FROM report",
            [],
            |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?)),
        )?;
        self.waiting = Waiting { reports, bytes };
        Ok(())
    }

    fn newest_instance(&self) -> Result<Option<Instance>, StoreError> {
        let newest = self.db.query_row(
            "SELECT id, name, machine, last, lost FROM instance ORDER BY id DESC LIMIT 1",
            [],
            instance_of,
        );
        Ok(newest.optional()?)
    }

    fn id_of(&self, instance: &str) -> Result<Option<i64>, StoreError> {
        let mut found = (self.db).prepare("SELECT id FROM instance WHERE name = ?")?;
        Ok(found.query_row([instance], |row| row.get(0)).optional()?)
    }

    /// The instance with its row in this file; written down if the file has none of its name.
    pub(super) fn with_row(&mut self, instance: Instance) -> Result<Instance, StoreError> {
        match self.id_of(&instance.name)? {
            Some(id) => Ok(Instance { id, ..instance }),
            None => self.begin_instance(instance, None),
        }
    }

    /// Writes a new instance down; what waits under the one called `from` is renumbered as its own.
    pub(super) fn begin_instance(
        &mut self,
        mut instance: Instance,
        from: Option<&str>,
    ) -> Result<Instance, StoreError> {
        let from = match from {
            Some(from) => self.id_of(from)?,
            None => None,
        };
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
            "DELETE FROM instance WHERE id < ?1
             AND NOT EXISTS (SELECT 1 FROM report WHERE report.instance = instance.id)",
            [instance.id],
        )?;
        transaction.commit()?;
        Ok(instance)
    }

    /// The places of the reports with `numbers` among those of an instance, from 1: what
    /// [`begin_instance`](Self::begin_instance) will number them in a new one. Numbers that do not wait have none.
    pub(super) fn places(
        &self,
        instance: &str,
        numbers: &[u64],
    ) -> Result<BTreeMap<u64, u64>, StoreError> {
        let mut places = BTreeMap::new();
        let Some(id) = self.id_of(instance)? else {
            return Ok(places);
        };
        let mut waits =
            (self.db).prepare("SELECT 1 FROM report WHERE instance = ? AND number = ?")?;
        let mut place =
            (self.db).prepare("SELECT count(*) FROM report WHERE instance = ? AND number <= ?")?;
        for number in numbers {
            let at = [id, signed(*number)];
            if waits.exists(at)? {
                places.insert(*number, place.query_row(at, |row| unsigned(row, 0))?);
            }
        }
        Ok(places)
    }

    /// Whether the file is still the one that was opened.
    pub(super) fn check(&self) -> Result<(), StoreError> {
        match inode_of(&self.file) {
            Ok(inode) if inode == self.inode => Ok(()),
            _ => Err(StoreError::Gone),
        }
    }

    /// Which file it is.
    pub(super) const fn inode(&self) -> Inode {
        self.inode
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

    /// Replaces reports that wait, by instance and number, by what is known of them now.
    pub(super) fn replace(
        &mut self,
        reports: &BTreeMap<(String, u64), Vec<u8>>,
    ) -> Result<(), StoreError> {
        self.check()?;
        let transaction = self.db.transaction()?;
        let mut bytes = self.waiting.bytes;
        {
            let mut found = transaction.prepare(
                "SELECT instance, length(json) FROM report
                 WHERE instance = (SELECT id FROM instance WHERE name = ?) AND number = ?",
            )?;
            let mut update = transaction
                .prepare("UPDATE report SET json = ? WHERE instance = ? AND number = ?")?;
            for ((instance, number), json) in reports {
                let before = found
                    .query_row(params![instance, signed(*number)], |row| {
                        Ok((row.get::<_, i64>(0)?, unsigned(row, 1)?))
                    })
                    .optional()?;
                if let Some((instance, before)) = before {
                    update.execute(params![json, instance, signed(*number)])?;
                    bytes = (bytes + json.len() as u64).saturating_sub(before);
                }
            }
        }
        transaction.commit()?;
        self.waiting.bytes = bytes;
        Ok(())
    }

    /// The oldest reports of those wanted: of one instance.
    pub(super) fn rows(&self, wanted: &Wanted<'_>) -> Result<Option<Rows>, StoreError> {
        let mut instances = self.db.prepare(
            "SELECT id, name, machine, last, lost FROM instance
             WHERE EXISTS (SELECT 1 FROM report WHERE report.instance = instance.id) ORDER BY id",
        )?;
        let mut found = instances.query([])?;
        while let Some(row) = found.next()? {
            let instance = instance_of(row)?;
            let mut reports = self.db.prepare(
                "SELECT number, json FROM report WHERE instance = ? AND number > ? AND number < ?
                 ORDER BY number LIMIT ?",
            )?;
            let mut rows = reports.query(params![
                instance.id,
                signed((wanted.above)(&instance.name)),
                signed((wanted.below)(&instance.name).unwrap_or(u64::MAX)),
                i64::try_from(wanted.reports).unwrap_or(i64::MAX)
            ])?;
            let (mut taken, mut bytes) = (Vec::new(), 0);
            while let Some(row) = rows.next()? {
                let json: Vec<u8> = row.get(1)?;
                bytes += json.len();
                if bytes > wanted.bytes && !taken.is_empty() {
                    break;
                }
                taken.push((unsigned(row, 0)?, json));
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

    /// Removes what a hub has of an instance.
    pub(super) fn remove(&mut self, instance: &str, upto: u64) -> Result<(), StoreError> {
        let Some(id) = self.id_of(instance)? else {
            return Ok(());
        };
        let transaction = self.db.transaction()?;
        let (reports, bytes): (u64, u64) = transaction.query_row(
            "SELECT count(*), coalesce(sum(length(json)), 0) FROM report WHERE instance = ? AND number <= ?",
            params![id, signed(upto)],
            |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?)),
        )?;
        transaction.execute(
            "DELETE FROM report WHERE instance = ? AND number <= ?",
            params![id, signed(upto)],
        )?;
        transaction.commit()?;
        self.waiting.reports = self.waiting.reports.saturating_sub(reports);
        self.waiting.bytes = self.waiting.bytes.saturating_sub(bytes);
        Ok(())
    }

    /// Removes single reports that cannot be read, counted as lost of their instance.
    pub(super) fn give_up(&mut self, instance: &str, numbers: &[u64]) -> Result<(), StoreError> {
        let Some(id) = self.id_of(instance)? else {
            return Ok(());
        };
        let transaction = self.db.transaction()?;
        let (mut gone, mut bytes) = (0, 0);
        {
            let mut delete = transaction.prepare(
                "DELETE FROM report WHERE instance = ? AND number = ? RETURNING length(json)",
            )?;
            for number in numbers {
                let deleted = delete
                    .query_row(params![id, signed(*number)], |row| unsigned(row, 0))
                    .optional()?;
                gone += u64::from(deleted.is_some());
                bytes += deleted.unwrap_or(0);
            }
        }
        transaction.execute(
            "UPDATE instance SET lost = lost + ? WHERE id = ?",
            params![signed(gone), id],
        )?;
        transaction.commit()?;
        self.waiting.reports = self.waiting.reports.saturating_sub(gone);
        self.waiting.bytes = self.waiting.bytes.saturating_sub(bytes);
        Ok(())
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

    /// Makes the file refuse writes, as a file system does that was remounted read-only.
    #[cfg(test)]
    pub(super) fn refuse_writes(&self) {
        self.db.pragma_update(None, "query_only", true).unwrap();
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
        last: unsigned(row, 3)?,
        lost: unsigned(row, 4)?,
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

fn inode_of(file: &Path) -> std::io::Result<Inode> {
    let metadata = fs::metadata(file)?;
    Ok((metadata.dev(), metadata.ino()))
}
