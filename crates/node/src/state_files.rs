//! What all parts need that keep files in a folder of the node.

use std::fs::{self, Metadata};
use std::io::{Error, ErrorKind, Result};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Tells a file from another one at the same path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FileId {
    device: u64,
    inode: u64,
}

impl FileId {
    /// The file with this metadata.
    pub(crate) fn of(metadata: &Metadata) -> Self {
        Self {
            device: metadata.dev(),
            inode: metadata.ino(),
        }
    }

    /// The file that is at `path` now; `None` if there is none.
    pub(crate) fn at(path: &Path) -> Result<Option<Self>> {
        match fs::metadata(path) {
            Ok(metadata) => Ok(Some(Self::of(&metadata))),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }
}

/// Creates the state directory where there is none.
pub(crate) fn create_directory(directory: &Path) -> Result<()> {
    fs::create_dir_all(directory).map_err(|error| not_created(directory, &error))
}

/// Why a folder cannot be created or used: the system calls a link to nowhere a file that exists.
pub(crate) fn reason(folder: &Path, error: &Error) -> String {
    if folder.is_symlink() && !folder.exists() {
        "it is a link to a place that is not there".to_owned()
    } else {
        error.to_string()
    }
}

/// The error of a folder that cannot be created, with its name.
pub(crate) fn not_created(folder: &Path, error: &Error) -> Error {
    let shown = folder.display();
    let reason = reason(folder, error);
    Error::new(error.kind(), format!("{shown} cannot be created: {reason}"))
}
