//! Errors of reading footage.

use albireo_vision::picture::{CutError, FrameFault, PictureFileError};
use std::path::PathBuf;

/// Why footage cannot be opened or read on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FootageError {
    /// There is nothing of that name.
    #[error("{0}: no such file or folder")]
    Missing(String),
    /// A camera's address is no file. It may hold a password and is not repeated.
    #[error(
        "a live camera is not footage: a node opens it as the `source` of a [[camera]], or `albireo publish` sends it to one"
    )]
    Address,
    /// A program is missing.
    #[error(
        "no `{program}` was found; install it with `apt-get install ffmpeg`, `dnf install ffmpeg` or `brew install ffmpeg`"
    )]
    NotInstalled {
        /// Its name.
        program: String,
    },
    /// A program cannot be started.
    #[error("`{program}` cannot be started: {error}")]
    NotStarted {
        /// Its name.
        program: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// `ffprobe` says something else than expected.
    #[error("{input}: ffprobe's answer is not understood: {source}")]
    Probe {
        /// The file.
        input: String,
        /// What is wrong with the answer.
        source: serde_json::Error,
    },
    /// The file has no video.
    #[error("{0}: there is no video in it")]
    NoVideo(String),
    /// Its frame rate is unknown.
    #[error("{0}: ffprobe reports no frame rate; give one with --rate")]
    NoRate(String),
    /// `ffmpeg` or `ffprobe` ended with an error.
    #[error("{input}: ffmpeg cannot read it: {reason}")]
    Failed {
        /// The file.
        input: String,
        /// What it said.
        reason: String,
    },
    /// What came out ends within a picture.
    #[error("{input}: ffmpeg's output is cut: {source}")]
    Cut {
        /// The source.
        input: String,
        /// Where.
        source: CutError,
    },
    /// A picture that no node would take.
    #[error("{input}: a frame cannot be sent: {source}")]
    Frame {
        /// The source.
        input: String,
        /// Why.
        source: FrameFault,
    },
    /// An archive of pictures cannot be read.
    #[error("{}: {source}", path.display())]
    Archive {
        /// The archive.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A picture of a folder cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureFileError),
}
