//! Writes whole files or none, and private ones so that only their owner reads them.

use super::AuthorityError;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

pub(super) fn read(file: &Path) -> Result<String, AuthorityError> {
    fs::read_to_string(file).map_err(at(file))
}

pub(super) fn create_folder(folder: &Path) -> Result<(), AuthorityError> {
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o750)
        .create(folder)
        .map_err(at(folder))
}

/// What only the owner may read.
pub(super) fn write_private(file: &Path, text: &str) -> Result<(), AuthorityError> {
    write(file, text, 0o600)
}

/// Writes a file that anybody may read, whole or not at all, and synced.
///
/// # Errors
/// When it cannot be written, with its name.
pub fn write_public(file: &Path, text: &str) -> Result<(), AuthorityError> {
    write(file, text, 0o644)
}

fn write(file: &Path, text: &str, mode: u32) -> Result<(), AuthorityError> {
    let mut beside = file.as_os_str().to_owned();
    beside.push(".new");
    let beside = Path::new(&beside);
    let written = || -> std::io::Result<()> {
        // What an interrupted run left behind may have another mode.
        match fs::remove_file(beside) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut new = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(mode)
            .open(beside)?;
        new.write_all(text.as_bytes())?;
        new.sync_all()?;
        fs::rename(beside, file)
    };
    written().map_err(at(file))
}

fn at(file: &Path) -> impl FnOnce(std::io::Error) -> AuthorityError + '_ {
    move |source| AuthorityError::File {
        file: file.to_owned(),
        source,
    }
}
