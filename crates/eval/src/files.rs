//! Reads and writes files; every error names the path.

use serde::Serialize;
use std::path::{Path, PathBuf};

/// A file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// A file or folder cannot be opened or read.
    #[error("cannot read {}: {source}; {help}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
        /// What to do about it.
        help: String,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line of a text file is broken.
    #[error("{}:{line}: {what}", path.display())]
    Line {
        /// The broken file.
        path: PathBuf,
        /// Which line, from 1.
        line: u64,
        /// What is wrong and what was expected.
        what: String,
    },
    /// A file is broken in a way no single line shows.
    #[error("{}: {what}", path.display())]
    Content {
        /// The broken file.
        path: PathBuf,
        /// What is wrong and what was expected.
        what: String,
    },
}

impl FileError {
    pub(crate) fn read(path: &Path, source: std::io::Error, help: impl Into<String>) -> Self {
        Self::Read {
            path: path.to_owned(),
            source,
            help: help.into(),
        }
    }

    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write {
            path: path.to_owned(),
            source,
        }
    }

    pub(crate) fn line(path: &Path, line: u64, what: impl Into<String>) -> Self {
        Self::Line {
            path: path.to_owned(),
            line,
            what: what.into(),
        }
    }

    pub(crate) fn content(path: &Path, what: impl Into<String>) -> Self {
        Self::Content {
            path: path.to_owned(),
            what: what.into(),
        }
    }

    /// JSON of another form.
    pub(crate) fn json(path: &Path, error: &serde_json::Error) -> Self {
        Self::line(path, error.line() as u64, error.to_string())
    }
}

/// The text of a file; `help` says what to do when it is missing.
pub(crate) fn read_text(path: &Path, help: &str) -> Result<String, FileError> {
    std::fs::read_to_string(path).map_err(|error| FileError::read(path, error, help))
}

/// Writes a file and makes its folder.
///
/// # Errors
/// [`FileError::Write`] when that cannot be.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), FileError> {
    (path.parent())
        .map_or(Ok(()), std::fs::create_dir_all)
        .and_then(|()| std::fs::write(path, content))
        .map_err(|error| FileError::write(path, error))
}

/// Writes `value` as indented JSON.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), FileError> {
    let json = serde_json::to_vec_pretty(value);
    write(
        path,
        json.map_err(|error| FileError::content(path, error.to_string()))?,
    )
}

/// Writes rows of named cells as CSV; the names of the first are the header.
pub(crate) fn write_csv(
    path: &Path,
    rows: &[Vec<(&'static str, String)>],
) -> Result<(), FileError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let header = rows.first().map(|row| row.iter().map(|(name, _)| *name));
    let written = header
        .map_or(Ok(()), |header| writer.write_record(header))
        .and_then(|()| {
            let mut cells = rows.iter().map(|row| row.iter().map(|(_, cell)| cell));
            cells.try_for_each(|cells| writer.write_record(cells))
        });
    let text = written
        .map_err(|error| error.to_string())
        .and_then(|()| writer.into_inner().map_err(|error| error.to_string()));
    write(path, text.map_err(|what| FileError::content(path, what))?)
}
