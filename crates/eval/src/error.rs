//! The error of the evaluation.

use albireo_vision::picture::PictureFileError;
use std::fmt::Display;
use std::path::Path;

/// What is wrong, where, and what to do about it, in words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct EvalError(String);

impl EvalError {
    /// An error with that text.
    pub fn new(text: impl Display) -> Self {
        Self(text.to_string())
    }

    /// A file or folder that cannot be opened or read.
    pub(crate) fn read(path: &Path, error: impl Display, help: impl Display) -> Self {
        Self(format!("cannot read {}: {error}; {help}", path.display()))
    }

    /// A file or folder that cannot be written.
    pub(crate) fn write(path: &Path, error: impl Display) -> Self {
        Self(format!("cannot write {}: {error}", path.display()))
    }

    /// A line of a text file, from 1, that is broken.
    pub(crate) fn line(path: &Path, line: u64, what: impl Display) -> Self {
        Self(format!("{}:{line}: {what}", path.display()))
    }

    /// A file that is broken in a way no single line shows.
    pub(crate) fn content(path: &Path, what: impl Display) -> Self {
        Self(format!("{}: {what}", path.display()))
    }

    /// JSON of another form.
    pub(crate) fn json(path: &Path, error: &serde_json::Error) -> Self {
        Self::line(path, error.line() as u64, error)
    }

    /// The same error, of a part of the whole.
    pub(crate) fn of(self, part: impl Display) -> Self {
        Self(format!("{part}: {self}"))
    }
}

impl From<PictureFileError> for EvalError {
    fn from(error: PictureFileError) -> Self {
        Self::new(error)
    }
}
