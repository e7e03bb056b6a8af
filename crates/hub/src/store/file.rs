//! Watches the file of an SQLite database: only one hub may use it, and it must stay where it is.

use super::StoreError;
use parking_lot::Mutex;
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Most links in a row that Linux follows.
const MOST_LINKS: usize = 40;

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

/// The path of a file without links, also where the file does not exist yet: as SQLite names what it keeps beside it.
pub(super) fn without_links(path: &Path) -> PathBuf {
    if let Ok(path) = fs::canonicalize(path) {
        return path;
    }
    let mut linked = path.to_owned();
    for _ in 0..MOST_LINKS {
        let Ok(target) = fs::read_link(&linked) else {
            break;
        };
        linked = folder_of(&linked).join(target);
    }
    match (fs::canonicalize(folder_of(&linked)), linked.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => linked,
    }
}

/// The folder of a file; a name alone is in the folder where the program runs.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Checks that a path can be that of a database of this hub alone.
///
/// # Errors
/// [`StoreError::Refused`] if it is a folder; [`StoreError::Unavailable`] while the file has a second name, under which another
/// hub could use it.
pub(super) fn check_alone(path: &Path) -> Result<(), StoreError> {
    let Ok(metadata) = fs::metadata(path) else {
        return Ok(());
    };
    let shown = path.display();
    if metadata.is_dir() {
        return Err(StoreError::Refused(format!(
            "{shown} is a folder, not a file: name a file in database.url"
        )));
    }
    if metadata.nlink() > 1 {
        return Err(StoreError::Unavailable(format!(
            "{shown} has a second name (a hard link), under which another hub could use it: remove that name, or use a copy \
             of the file"
        )));
    }
    Ok(())
}

/// Checks that a database file can be used on this machine: it is there or can be created, and can be written. Not for a process
/// that uses it: closing a second handle to the file would drop SQLite's own locks.
///
/// # Errors
/// Why not.
pub(super) fn check_here(path: &Path) -> Result<(), StoreError> {
    check_alone(path)?;
    let path = without_links(path);
    let folder = folder_of(&path);
    let unusable = |what: &Path, error: std::io::Error| {
        StoreError::Unavailable(format!("{} cannot be used: {error}", what.display()))
    };
    if !folder.is_dir() {
        return Err(StoreError::Unavailable(format!(
            "the folder {} does not exist: create it",
            folder.display()
        )));
    }
    if path.exists() {
        File::options()
            .append(true)
            .open(&path)
            .map_err(|error| unusable(&path, error))?;
    }
    // SQLite keeps files beside the database. An empty one can also be created on a full disk, where a hub starts and says so.
    let probe = folder.join(format!(".albireo-check-{}", std::process::id()));
    File::create(&probe).map_err(|error| unusable(folder, error))?;
    let _ = fs::remove_file(&probe);
    Ok(())
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
    /// When another hub uses it, under whatever name.
    pub(super) fn reserve(&self) -> Result<(), StoreError> {
        check_alone(&self.path)?;
        let mut path = without_links(&self.path).into_os_string();
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_file_is_reserved_for_one_hub_under_any_of_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("hub.db");
        let link = folder.path().join("link.db");
        // A link to a link to the file.
        symlink("link2.db", &link).unwrap();
        symlink("hub.db", folder.path().join("link2.db")).unwrap();
        let database = |path: &Path| DatabaseFile::new(path.to_str().unwrap());
        // Before the file exists, and after.
        for _ in 0..2 {
            let one = database(&file);
            one.reserve().unwrap();
            let refused = database(&link).reserve().unwrap_err().to_string();
            assert!(refused.contains("in use by another hub"), "{refused}");
            one.release();
            database(&link).reserve().unwrap();
            fs::write(&file, "").unwrap();
        }
        let hard = folder.path().join("hard.db");
        fs::hard_link(&file, &hard).unwrap();
        for path in [&file, &hard] {
            let refused = database(path).reserve().unwrap_err();
            assert!(refused.is_temporary(), "{refused}");
            assert!(refused.to_string().contains("hard link"), "{refused}");
        }
    }

    #[test]
    fn a_check_names_what_a_database_file_lacks() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("hub.db");
        assert!(check_here(&file).is_ok());
        assert!(!file.exists(), "it is not created");
        fs::write(&file, "").unwrap();
        assert!(check_here(&file).is_ok());
        let said = |path: &Path| check_here(path).unwrap_err().to_string();
        assert!(said(folder.path()).contains("is a folder, not a file"));
        let missing = folder.path().join("nowhere").join("hub.db");
        assert!(said(&missing).contains("does not exist: create it"));
        let below_a_file = file.join("hub.db");
        assert!(said(&below_a_file).contains("does not exist"));
    }
}
