//! Opens the outbox file in the state directory.

use super::table::TableError;
use rusqlite::Connection;
use std::fmt::Debug;
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The file's name in the state directory.
pub(super) const FILE: &str = "node.db";

/// A place for the report table.
pub(crate) trait Disk: Debug + Send {
    /// Opens the file, or creates it.
    fn open(&mut self) -> Result<Connection, TableError>;

    /// Fails if the opened file is no longer at its path.
    fn check(&self) -> Result<(), TableError>;

    /// Moves a damaged file aside and returns its new path.
    fn set_aside(&mut self) -> std::io::Result<PathBuf>;
}

/// A file that only this node uses.
#[derive(Debug)]
pub(crate) struct StateFile {
    directory: PathBuf,
    file: PathBuf,
    lock: Option<File>,
    /// Device and inode number of the open file.
    opened: Option<(u64, u64)>,
}

impl StateFile {
    pub(crate) fn new(directory: &Path) -> Self {
        Self {
            directory: directory.to_owned(),
            file: directory.join(FILE),
            lock: None,
            opened: None,
        }
    }

    fn inode(&self) -> std::io::Result<(u64, u64)> {
        let metadata = fs::metadata(&self.file)?;
        Ok((metadata.dev(), metadata.ino()))
    }
}

impl Disk for StateFile {
    fn open(&mut self) -> Result<Connection, TableError> {
        fs::create_dir_all(&self.directory)?;
        if self.lock.is_none() {
            self.lock = Some(lock(&self.directory)?);
        }
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
        self.opened = Some(self.inode()?);
        Ok(db)
    }

    fn check(&self) -> Result<(), TableError> {
        match self.inode() {
            Ok(inode) if Some(inode) == self.opened => Ok(()),
            _ => Err(std::io::Error::other(
                "the file is no longer there: the disk was removed, or somebody deleted it",
            )
            .into()),
        }
    }

    fn set_aside(&mut self) -> std::io::Result<PathBuf> {
        let named = |ending: &str| self.directory.join(format!("{FILE}{ending}"));
        let aside = (0..1000)
            .map(|number| named(&format!(".damaged-{number}")))
            .find(|aside| !aside.exists())
            .ok_or_else(|| {
                std::io::Error::other("too many damaged files were set aside already")
            })?;
        fs::rename(&self.file, &aside)?;
        for ending in ["-wal", "-shm"] {
            let mut beside = aside.clone().into_os_string();
            beside.push(ending);
            let _ = fs::rename(named(ending), beside);
        }
        Ok(aside)
    }
}

/// Locks the directory for this node.
fn lock(directory: &Path) -> Result<File, TableError> {
    let lock = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(directory.join("lock"))?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(TableError::Unusable(
            "it is in use by another node: two nodes cannot share one; choose another, or stop the other node"
                .to_owned(),
        )),
        Err(TryLockError::Error(error)) => Err(error.into()),
    }
}
