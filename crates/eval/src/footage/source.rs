//! Defines the trait for sources of frames.

use crate::error::EvalError;
use albireo_vision::picture::EncodedPicture;
use std::ffi::OsStr;
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

    /// The bytes of the encoded pictures of one pass, if they are known without reading them.
    fn bytes(&self) -> Option<u64> {
        None
    }

    /// The clip of the last picture, if the source has several clips, which share no objects.
    fn clip(&self) -> Option<&str> {
        None
    }

    /// The name of the last picture, or of the video file it is from, if there are several files: [`next`](Self::next)
    /// then returns the pictures after one that cannot be read.
    fn picture_name(&self) -> Option<String> {
        None
    }

    /// The names of the files of all pictures of one pass, in order; none if its pictures are no files.
    fn file_names(&self) -> Vec<String> {
        Vec::new()
    }

    /// When the last picture was recorded, nanoseconds since the Unix epoch, if that is known.
    fn time_ns(&self) -> Option<u64> {
        None
    }

    /// What is to be said of the pass that has ended, in words: what is missing of it, and what was made of its times.
    fn remarks(&self) -> Vec<String> {
        Vec::new()
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

/// Names the clip of a file after its stem, and that of a folder as [`folder_name`] does.
pub(crate) fn clip_name(path: &Path) -> String {
    if path.is_dir() {
        return folder_name(path);
    }
    visible_name(path.file_stem().unwrap_or_default())
}

/// Names the clip of a folder after it, or after its parent for the folder `img1`, in which MOTChallenge keeps the
/// pictures of every sequence.
pub(super) fn folder_name(folder: &Path) -> String {
    let own = folder.file_name().unwrap_or_default();
    let parent = folder.parent().and_then(Path::file_name);
    match parent {
        Some(parent) if own == "img1" => visible_name(parent),
        _ => visible_name(own),
    }
}

/// Converts a name without its leading dots, which would hide the files that are named after the clip.
fn visible_name(name: &OsStr) -> String {
    plain_name(name.to_string_lossy().trim_start_matches('.'))
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

/// Returns `name`, or if it is taken, the first of `name-2`, `name-3`, … that is not.
pub(crate) fn unused_name(name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let mut unused = name.to_owned();
    let mut number = 1;
    while is_taken(&unused) {
        number += 1;
        unused = format!("{name}-{number}");
    }
    unused
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dot_ends_the_name_of_a_file_and_is_part_of_a_folders() {
        let folder = tempfile::tempdir().unwrap();
        let mut names = Vec::new();
        for camera in ["cam.front", "cam.rear"] {
            let path = folder.path().join(camera);
            std::fs::create_dir(&path).unwrap();
            names.push(clip_name(&path));
        }
        assert_eq!(names, ["cam.front", "cam.rear"]);
        assert_eq!(clip_name(Path::new("some/drive.mp4")), "drive");
    }

    #[test]
    fn the_dot_of_a_hidden_file_is_no_part_of_its_clips_name() {
        assert_eq!(clip_name(Path::new("some/.drive.mp4")), "drive");
    }

    #[test]
    fn a_name_that_is_taken_gets_a_number() {
        let taken = ["a", "a-2"];
        let is_taken = |name: &str| taken.contains(&name);
        assert_eq!(unused_name("a", is_taken), "a-3");
        assert_eq!(unused_name("b", is_taken), "b");
    }
}
