//! Defines the trait for sources of frames.

use crate::error::EvalError;
use albireo_vision::picture::EncodedPicture;
use std::path::Path;

/// Ends a source, from any thread, when it is dropped: its pending and later [`FrameSource::next`] calls return soon.
pub struct Stopper(pub(super) Box<dyn Fn() + Send>);

impl Drop for Stopper {
    fn drop(&mut self) {
        (self.0)();
    }
}

/// A sequence of encoded pictures. It is driven on a thread of its own, so its calls may block.
pub trait FrameSource: Send {
    /// A short name, usable as a clip id: a file's stem.
    fn name(&self) -> &str;

    /// The source's own frames per second.
    fn rate(&self) -> f64;

    /// The number of frames of one pass, if it is known beforehand.
    fn frames(&self) -> Option<u64>;

    /// The clip of the last picture, if the source has several clips, which share no objects.
    fn clip(&self) -> Option<&str> {
        None
    }

    /// The name of the last picture, or of the video file it is from, if there are several files: [`next`](Self::next) then
    /// returns the pictures after one that cannot be read.
    fn picture_name(&self) -> Option<String> {
        None
    }

    /// When the last picture was recorded, nanoseconds since the Unix epoch, if that is known.
    fn time_ns(&self) -> Option<u64> {
        None
    }

    /// The next picture; `None` at the end of the pass.
    ///
    /// # Errors
    /// When the source fails. Unless its pictures have names, it returns nothing more after that.
    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError>;

    /// Goes back to the first picture.
    ///
    /// # Errors
    /// When the source cannot be opened again.
    fn rewind(&mut self) -> Result<(), EvalError>;

    /// Returns a way to end a pending [`next`](Self::next), if it can wait for something such as another program.
    fn stopper(&self) -> Option<Stopper> {
        None
    }
}

/// Names the clip of a file or folder after its stem, or after its parent for the folder `img1`, in which
/// MOTChallenge keeps the pictures of every sequence.
pub(crate) fn clip_name(path: &Path) -> String {
    let own = path.file_stem().unwrap_or_default();
    let parent = path.parent().and_then(Path::file_name);
    let stem = match parent {
        Some(parent) if own == "img1" => parent,
        _ => own,
    };
    // A leading dot would hide the files that are named after the clip.
    plain_name(stem.to_string_lossy().trim_start_matches('.'))
}

/// Converts `text` to a name that is valid as a clip id.
pub(super) fn plain_name(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let name: String = text.chars().take(100).collect();
    if name.is_empty() {
        return "clip".to_owned();
    }
    name.replace(|c: char| !is_plain(c), "_")
}
