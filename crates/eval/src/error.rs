//! Defines the error type of the evaluation.

use albireo_vision::picture::PictureFileError;
use std::fmt::Display;
use std::path::Path;

/// An error message that names the problem, its place and a remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct EvalError(String);

impl EvalError {
    /// Creates an error with this text.
    pub fn new(text: impl Display) -> Self {
        Self(text.to_string())
    }

    /// Creates the error for a file or folder that cannot be read; `help` says what to do.
    pub(crate) fn read(path: &Path, error: impl Display, help: impl Display) -> Self {
        Self(format!("cannot read {}: {error}; {help}", path.display()))
    }

    /// Creates the error for a file or folder that cannot be written.
    pub(crate) fn write(path: &Path, error: impl Display) -> Self {
        Self(format!("cannot write {}: {error}", path.display()))
    }

    /// Creates the error for an invalid line of a text file; lines count from 1.
    pub(crate) fn line(path: &Path, line: u64, what: impl Display) -> Self {
        Self(format!("{}:{line}: {what}", path.display()))
    }

    /// Creates the error for invalid content that is not tied to a single line.
    pub(crate) fn content(path: &Path, what: impl Display) -> Self {
        Self(format!("{}: {what}", path.display()))
    }

    /// Creates the error for JSON that does not have the expected form.
    pub(crate) fn json(path: &Path, error: &serde_json::Error) -> Self {
        Self::line(path, error.line() as u64, error)
    }

    /// Puts `part`, which the error is about, before the message.
    pub(crate) fn context(self, part: impl Display) -> Self {
        Self(format!("{part}: {self}"))
    }
}

impl From<PictureFileError> for EvalError {
    fn from(error: PictureFileError) -> Self {
        Self::new(error)
    }
}
