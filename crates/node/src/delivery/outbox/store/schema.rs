//! How the file is opened, checked and laid out.

use super::salvage::set_aside;
use super::{Inode, Instance, Store, StoreError, Waiting, inode_of};
use rusqlite::Connection;
use std::fs;
use std::path::Path;

/// "albi": other programs' files are not taken for this one's.
const APPLICATION_ID: i64 = 0x616c_6269;
const SCHEMA_VERSION: i64 = 1;

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

/// What must be writable, and is told now rather than when the first report is kept. The index came later than the
/// first files; a program that does not know it keeps it up all the same.
const FIRST_WRITE: &str = "
BEGIN IMMEDIATE;
CREATE INDEX IF NOT EXISTS report_kept ON report (kept_ns);
UPDATE instance SET last = last WHERE id = -1;
COMMIT;";

/// What was found at opening.
pub(in crate::delivery::outbox) struct Opened {
    pub store: Store,
    pub current: Instance,
    /// What to tell, if the file was not as it was left.
    pub notes: Vec<String>,
    /// Why it can be read and not written now.
    pub failing: Option<StoreError>,
}

impl Store {
    /// Opens, or makes, the file. One that is corrupt is set aside and what can be read of it saved. The contents of the
    /// file `checked` are not checked again: that reads all of it.
    ///
    /// # Errors
    /// [`StoreError`]: the disk cannot be used, or the file is not ours.
    pub(in crate::delivery::outbox) fn open(
        file: &Path,
        machine: Option<&str>,
        checked: Option<Inode>,
    ) -> Result<Opened, StoreError> {
        let mut notes = Vec::new();
        let (mut store, failing) = match Self::connect(file, checked) {
            Ok(connected) => connected,
            Err(error) if error.is_corruption() => {
                let aside = set_aside(file)?;
                notes.push(format!(
                    "{} is damaged ({error}) and was set aside as {}",
                    file.display(),
                    aside.display()
                ));
                let (mut store, failing) = Self::connect(file, None)?;
                let saved = store.salvage(&aside);
                notes.push(format!("{saved} reports were saved from the damaged file"));
                store.recount()?;
                // What was lost cannot be known, so that the numbers of before are not gone on with.
                store.begin_instance(Instance::new(machine.map(str::to_owned)), None)?;
                (store, failing)
            }
            Err(error) => return Err(error),
        };
        let current = match store.newest_instance()? {
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
            failing,
        })
    }

    fn connect(
        file: &Path,
        checked: Option<Inode>,
    ) -> Result<(Self, Option<StoreError>), StoreError> {
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
                "{} was written by a later albireo (version {version}; this one knows {SCHEMA_VERSION}): run that one, \
                 or choose another node.state_dir",
                file.display()
            )));
        }
        let mode: String =
            db.pragma_update_and_check(None, "journal_mode", "WAL", |row| row.get(0))?;
        if !mode.eq_ignore_ascii_case("wal") {
            return Err(StoreError::Foreign(format!(
                "{} is on a file system that cannot do write-ahead logging: choose a node.state_dir on a local disk",
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
        let inode = inode_of(file)?;
        if checked != Some(inode) {
            let sound: String = db.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
            if sound != "ok" {
                return Err(StoreError::Sqlite(rusqlite::Error::SqliteFailure(
                    rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_CORRUPT),
                    Some(sound),
                )));
            }
        }
        let mut store = Self {
            db,
            file: file.to_owned(),
            inode,
            waiting: Waiting::default(),
        };
        store.recount()?;
        let failing = match store
            .db
            .execute_batch(FIRST_WRITE)
            .map_err(StoreError::from)
        {
            Ok(()) => None,
            Err(error) if error.leaves_file_readable() => {
                if !store.db.is_autocommit() {
                    store.db.execute_batch("ROLLBACK")?;
                }
                Some(error)
            }
            Err(error) => return Err(error),
        };
        Ok((store, failing))
    }
}
