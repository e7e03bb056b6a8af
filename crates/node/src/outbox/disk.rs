//! Opens the outbox file in the state directory.

use super::table::TableError;
use crate::state_files::{FileId, create_directory};
use rusqlite::Connection;
use std::fmt::Debug;
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The file's name in the state directory.
pub(super) const FILE: &str = "node.db";

/// The name of the file with the counts.
pub(super) const WITNESS: &str = "node.count";

/// The name of the file that a node locks.
pub(super) const LOCK: &str = "lock";

/// A place for the report table.
pub(crate) trait Disk: Debug + Send {
    /// Opens the file, or creates it.
    fn open(&mut self) -> Result<Connection, TableError>;

    /// Fails if the opened file is no longer at its path, or another node could lock the directory.
    fn check(&self) -> Result<(), TableError>;

    /// Moves a damaged file aside and returns its new path.
    fn set_aside(&mut self) -> std::io::Result<PathBuf>;

    /// What was last testified, if it can be read.
    fn witness(&self) -> Option<Witness>;

    /// Notes the counts beside the file, for the case that the file loses what was written last. Not synced: it survives the
    /// end of the process, and after a power cut it is at most older than the file.
    fn testify(&self, witness: Witness);
}

/// What the counts of the file must at least be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Witness {
    pub(super) made: u64,
    pub(super) lost: u64,
    pub(super) undeliverable: u64,
    /// No report up to this count waits.
    pub(super) settled: u64,
}

impl Witness {
    /// A line of a fixed length, with a checksum.
    fn line(self) -> String {
        let Self {
            made,
            lost,
            undeliverable,
            settled,
        } = self;
        let counts = format!("{made:020} {lost:020} {undeliverable:020} {settled:020}");
        format!("{counts} {:08x}\n", crc32fast::hash(counts.as_bytes()))
    }

    fn read(line: &str) -> Option<Self> {
        let counts: Option<Vec<u64>> =
            line.split(' ').take(4).map(|count| count.parse().ok()).collect();
        let [made, lost, undeliverable, settled] = counts?.try_into().ok()?;
        let witness = Self {
            made,
            lost,
            undeliverable,
            settled,
        };
        (witness.line() == line).then_some(witness)
    }
}

/// A file that only this node uses.
#[derive(Debug)]
pub(crate) struct StateFile {
    directory: PathBuf,
    file: PathBuf,
    lock: Option<DirectoryLock>,
    witness: Option<File>,
    opened: Option<FileId>,
}

impl StateFile {
    pub(crate) fn new(directory: &Path) -> Self {
        Self {
            directory: directory.to_owned(),
            file: directory.join(FILE),
            lock: None,
            witness: None,
            opened: None,
        }
    }
}

impl Disk for StateFile {
    fn open(&mut self) -> Result<Connection, TableError> {
        create_directory(&self.directory)?;
        let is_locked = self.lock.as_ref().is_some_and(DirectoryLock::is_in_place);
        if !is_locked {
            // First, because this lock would refuse a second one on the same file.
            self.lock = None;
            self.lock = Some(DirectoryLock::take(&self.directory)?);
        }
        self.witness = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(self.directory.join(WITNESS))
            .ok();
        let is_new = !self.file.exists();
        let db = Connection::open(&self.file)?;
        db.busy_timeout(Duration::from_secs(2))?;
        let mode: String =
            db.pragma_update_and_check(None, "journal_mode", "WAL", |row| row.get(0))?;
        if !mode.eq_ignore_ascii_case("wal") {
            return Err(TableError::Unusable(
                "its file system does not support write-ahead logging: choose a node.state_dir on a local disk"
                    .to_owned(),
            ));
        }
        db.pragma_update(None, "synchronous", "FULL")?;
        db.pragma_update(None, "journal_size_limit", 4 << 20)?;
        if is_new {
            // The name of a new file is durable only once its folder is synced.
            File::open(&self.directory)?.sync_all()?;
        }
        self.opened = FileId::at(&self.file)?;
        Ok(db)
    }

    fn check(&self) -> Result<(), TableError> {
        let gone = |name: &str| -> Result<(), TableError> {
            let reason = format!(
                "the file {name} is no longer there: the disk was removed, or somebody deleted it"
            );
            Err(std::io::Error::other(reason).into())
        };
        match FileId::at(&self.file) {
            Ok(id @ Some(_)) if id == self.opened => {}
            _ => return gone(FILE),
        }
        if !self.lock.as_ref().is_some_and(DirectoryLock::is_in_place) {
            return gone(LOCK);
        }
        Ok(())
    }

    fn set_aside(&mut self) -> std::io::Result<PathBuf> {
        let named = |ending: &str| self.directory.join(format!("{FILE}{ending}"));
        let mut names = (0..1000).map(|number| named(&format!(".damaged-{number}")));
        let Some(aside) = names.find(|aside| !aside.exists()) else {
            let reason = "too many damaged files were set aside already";
            return Err(std::io::Error::other(reason));
        };
        fs::rename(&self.file, &aside)?;
        for ending in ["-wal", "-shm"] {
            let mut beside = aside.clone().into_os_string();
            beside.push(ending);
            let _ = fs::rename(named(ending), beside);
        }
        Ok(aside)
    }

    fn witness(&self) -> Option<Witness> {
        let line = fs::read_to_string(self.directory.join(WITNESS)).ok()?;
        Witness::read(&line)
    }

    fn testify(&self, witness: Witness) {
        if let Some(file) = &self.witness {
            // The file of reports is the first witness: the second one may be missing.
            let _ = file.write_all_at(witness.line().as_bytes(), 0);
        }
    }
}

/// The lock that keeps other nodes out of the directory.
#[derive(Debug)]
struct DirectoryLock {
    path: PathBuf,
    /// The locked file, which somebody may have removed from the path.
    id: FileId,
    /// Locked while it is open.
    _file: File,
}

impl DirectoryLock {
    /// Locks the directory for this node.
    fn take(directory: &Path) -> Result<Self, TableError> {
        let path = directory.join(LOCK);
        let file = File::options().create(true).truncate(false).write(true).open(&path)?;
        match file.try_lock() {
            Ok(()) => Ok(Self {
                path,
                id: FileId::of(&file.metadata()?),
                _file: file,
            }),
            Err(TryLockError::WouldBlock) => Err(TableError::Unusable(
                "it is in use by another node: two nodes cannot share one; choose another, or stop the other node"
                    .to_owned(),
            )),
            Err(TryLockError::Error(error)) => Err(error.into()),
        }
    }

    /// True if another node that tries to lock the directory finds this lock.
    fn is_in_place(&self) -> bool {
        FileId::at(&self.path).is_ok_and(|id| id == Some(self.id))
    }
}
