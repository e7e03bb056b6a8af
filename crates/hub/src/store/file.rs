//! Watches the file of an SQLite database: only one hub may use it, and it must stay where it is.

use super::StoreError;
use parking_lot::Mutex;
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// What a file keeps for as long as it exists, under any path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FileIdentity {
    device: u64,
    inode: u64,
}

/// The identity of the file at a path; `None` if there is none.
pub(super) fn identity(path: &Path) -> Option<FileIdentity> {
    let metadata = fs::metadata(path).ok()?;
    Some(FileIdentity {
        device: metadata.dev(),
        inode: metadata.ino(),
    })
}

/// The database file of a hub.
#[derive(Debug)]
pub(super) struct DatabaseFile {
    path: PathBuf,
    opened: OnceLock<FileIdentity>,
    lock: Mutex<Option<File>>,
}

impl DatabaseFile {
    pub(super) fn new(path: &str) -> Self {
        Self {
            path: path.into(),
            opened: OnceLock::new(),
            lock: Mutex::default(),
        }
    }

    /// Reserves the file for this hub, until [`release`](Self::release) or the end of the process.
    ///
    /// # Errors
    /// When another hub uses it.
    pub(super) fn reserve(&self) -> Result<(), StoreError> {
        let mut path = self.path.clone().into_os_string();
        path.push("-lock");
        // A file beside it: closing a second handle to the database itself would drop SQLite's own locks.
        let opened = File::options().create(true).truncate(false).write(true).open(path);
        // Where none can be created, the folder is read-only or absent, and opening the database says so.
        let Ok(file) = opened else { return Ok(()) };
        // Other errors are those of file systems without locks, where nothing can be reserved.
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            return Err(StoreError::Unavailable(format!(
                "{} is in use by another hub: stop that one, or use PostgreSQL, which several hubs can share",
                self.path.display()
            )));
        }
        *self.lock.lock() = Some(file);
        Ok(())
    }

    /// Lets another hub use the file.
    pub(super) fn release(&self) {
        *self.lock.lock() = None;
    }

    /// Notes that the file at the path is the one that was opened.
    pub(super) fn opened(&self) {
        if let Some(identity) = identity(&self.path) {
            let _ = self.opened.set(identity);
        }
    }

    /// Checks that the opened file is still at its path. A deleted file accepts rows as before, and loses them all.
    ///
    /// # Errors
    /// When it is not.
    pub(super) fn check(&self) -> Result<(), StoreError> {
        match self.opened.get() {
            Some(opened) if identity(&self.path) != Some(*opened) => Err(gone(&self.path)),
            _ => Ok(()),
        }
    }
}

/// The error of a file that was deleted or replaced.
pub(super) fn gone(path: &Path) -> StoreError {
    StoreError::Unavailable(format!(
        "{} was deleted or replaced while the hub ran: nothing is stored, and nodes keep their reports; put the file \
         back, or restart the hub, which creates a new one where there is none",
        path.display()
    ))
}
