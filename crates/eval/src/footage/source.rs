//! The trait of everything that gives frames to replay.

use crate::error::EvalError;
use albireo_vision::picture::EncodedPicture;
use std::path::Path;

/// Ends a source from another thread: its pending and later [`FrameSource::next`] calls return soon.
pub type Stopper = Box<dyn FnOnce() + Send>;

/// A sequence of encoded pictures. It is driven on a thread of its own, so its calls may block.
pub trait FrameSource: Send {
    /// A short name, usable as a clip id: a file's stem.
    fn name(&self) -> &str;

    /// Frames per second of its own.
    fn rate(&self) -> f64;

    /// How many frames one pass has, where that is known beforehand.
    fn frames(&self) -> Option<u64>;

    /// The clip of the picture that came last, where the source has several: nothing moves on from one to the next.
    fn clip(&self) -> Option<&str> {
        None
    }

    /// The next picture; `None` at the end of the pass.
    ///
    /// # Errors
    /// When the source fails. It returns nothing more after that.
    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError>;

    /// Goes back to the first picture.
    ///
    /// # Errors
    /// When the source cannot be opened again.
    fn rewind(&mut self) -> Result<(), EvalError>;

    /// How to end a [`next`](Self::next) that waits for something outside, such as another program.
    fn stopper(&self) -> Option<Stopper> {
        None
    }
}

/// The name that the clip of a file or folder gets: its stem, or its parent's for the folder `img1`, in which
/// MOTChallenge keeps every sequence's pictures.
pub(crate) fn clip_name(path: &Path) -> String {
    let own = path.file_stem().unwrap_or_default();
    let parent = path.parent().and_then(Path::file_name);
    let stem = parent.filter(|_| own == "img1").unwrap_or(own);
    // A name that begins with a dot hides the files named after it.
    plain_name(stem.to_string_lossy().trim_start_matches('.'))
}

/// `text` as a name that is valid in a clip id.
pub(super) fn plain_name(text: &str) -> String {
    let name: String = text
        .chars()
        .take(100)
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') {
                c
            } else {
                '_'
            }
        })
        .collect();
    if name.is_empty() {
        "clip".to_owned()
    } else {
        name
    }
}
