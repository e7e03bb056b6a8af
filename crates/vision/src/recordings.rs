//! Video files as dashcams and action cameras write them: minutes or chapters in one folder. They are put in order and
//! joined to drives, with the time at which each began; what a power cut left unreadable is told.

mod kind;
mod name;
mod probe;

use crate::picture::is_hidden;
use glob::MatchOptions;
pub use kind::FileKind;
use name::{FileName, Letter};
use probe::{VideoFacts, probe};
pub use probe::{check_is_video, check_is_whole, for_ffmpeg, frame_rate};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Endings of video files.
const ENDINGS: [&str; 12] = [
    "mp4", "mov", "avi", "mkv", "ts", "m4v", "mts", "m2ts", "mpg", "mpeg", "3gp", "webm",
];

/// Two files with more time between them belong to two drives: names have whole seconds, and cameras lose up to a few
/// between files.
const GAP: Duration = Duration::from_secs(5);

/// Patterns match `.mp4` and `.MP4` alike, and neither hidden files nor, by a `*`, files in folders below.
const MATCHING: MatchOptions = MatchOptions {
    case_sensitive: false,
    require_literal_separator: true,
    require_literal_leading_dot: true,
};

/// True if `text` names several files: a folder, or a pattern with `*`, `?` or `[…]` that is no file itself.
pub fn are_several(text: &str) -> bool {
    let path = Path::new(text);
    path.is_dir() || (text.contains(['*', '?', '[']) && !path.exists())
}

/// True for the name of a video file that is not hidden, unless a folder has this name.
pub fn is_video_file(path: &Path) -> bool {
    let ending = path.extension().and_then(OsStr::to_str).unwrap_or_default();
    let has_known_ending = ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known));
    has_known_ending && !is_hidden(path) && !path.is_dir()
}

/// The video files that a folder or a pattern names, in the order in which they were recorded: by the times in their names,
/// else by their names, of which numbers count as numbers, and GoPro's chapters follow each other.
///
/// # Errors
/// In words, if there are none, or if they come from several cameras, such as front and rear.
pub fn video_files(text: &str) -> Result<Vec<PathBuf>, String> {
    let mut files = listed(text)?;
    files.retain(|file| is_video_file(file));
    if files.is_empty() {
        return Err(nothing(text));
    }
    let letter = if differ_in_a_letter(&files) {
        Letter::IsMark
    } else {
        Letter::IsMarkBehindTime
    };
    let mut named: Vec<(FileName, PathBuf)> =
        files.into_iter().map(|file| (FileName::read(&file, letter), file)).collect();
    check_one_camera(text, &named)?;
    named.sort_by(|(one, one_file), (other, other_file)| {
        one.order.cmp(&other.order).then_with(|| one_file.cmp(other_file))
    });
    if named.iter().all(|(name, _)| name.time.is_some()) {
        // A stable sort: files of one time stay in the order of their names.
        named.sort_by_key(|(name, _)| name.time);
    }
    Ok(named.into_iter().map(|(_, file)| file).collect())
}

/// True if names differ only in a last letter behind a number, and the letters are those of cameras, the front among
/// them: `FILE0001F`, `FILE0001R`. Others count with letters, `scene1a` to `scene1f`.
fn differ_in_a_letter(files: &[PathBuf]) -> bool {
    let mut letters: BTreeMap<String, Vec<u8>> = BTreeMap::new();
    for file in files {
        if let Some(numbered) = name::numbered(file) {
            letters.entry(numbered.before).or_default().push(numbered.letter);
        }
    }
    letters.values().any(|letters| {
        let of_cameras = letters.iter().all(|letter| b"frbi".contains(letter));
        let differ = letters.iter().any(|letter| *letter != b'f');
        of_cameras && differ && letters.contains(&b'f')
    })
}

/// What is in a folder.
fn inside(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)?;
    Ok(entries.flatten().map(|entry| entry.path()).collect())
}

/// The files in a folder, or those that a pattern matches.
fn listed(text: &str) -> Result<Vec<PathBuf>, String> {
    let path = Path::new(text);
    if path.is_dir() {
        return inside(path).map_err(|error| format!("{text}: {error}"));
    }
    let matched = glob::glob_with(text, MATCHING)
        .map_err(|error| format!("{text}: the pattern cannot be read: {error}"))?;
    Ok(matched.flatten().collect())
}

/// Says that there is no video, and where there are some.
fn nothing(text: &str) -> String {
    let path = Path::new(text);
    if !path.is_dir() {
        return format!("{text}: no video file has such a name");
    }
    let mut below = inside(path).unwrap_or_default();
    below.retain(|folder| folder.is_dir());
    below.sort();
    let has_videos = |folder: &&PathBuf| {
        let files = inside(folder).unwrap_or_default();
        files.iter().any(|file| is_video_file(file))
    };
    match below.iter().find(has_videos) {
        Some(folder) => format!(
            "{text}: no video files in it; there are some in {}",
            folder.display()
        ),
        None => format!("{text}: no video files in it"),
    }
}

/// The files of one camera.
struct View<'a> {
    count: usize,
    /// What the name of the first says.
    name: &'a FileName,
    first: &'a Path,
}

impl View<'_> {
    /// The pattern that chooses these files by the mark in their names.
    fn pattern(&self) -> PathBuf {
        let folder = self.first.parent().unwrap_or_else(|| Path::new(""));
        let ending = self.first.extension().unwrap_or_default().display();
        folder.join(format!("*{}.{ending}", self.name.mark))
    }
}

/// Checks that all files come from one camera.
fn check_one_camera(text: &str, files: &[(FileName, PathBuf)]) -> Result<(), String> {
    let mut views: BTreeMap<&str, View<'_>> = BTreeMap::new();
    for (name, first) in files {
        let view = views.entry(&name.view).or_insert(View {
            count: 0,
            name,
            first,
        });
        view.count += 1;
    }
    if views.len() < 2 {
        return Ok(());
    }
    let mut shown = Vec::new();
    for (place, View { count, first, .. }) in &views {
        let file = first.file_name().unwrap_or_default().display();
        let called = if place.is_empty() { "other" } else { *place };
        shown.push(format!("{count} {called} ({file})"));
    }
    let marked = views.values().find(|view| !view.name.view.is_empty());
    let example = match marked {
        Some(view) => format!(", such as {}", view.pattern().display()),
        None => String::new(),
    };
    Err(format!(
        "{text}: these are files of several cameras: {}. Each is a camera of its own: choose one by a pattern{example}",
        shown.join(", ")
    ))
}

/// A file that is left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PassedOver {
    /// The file.
    pub path: PathBuf,
    /// Why it cannot be played.
    pub reason: String,
}

impl fmt::Display for PassedOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.reason)
    }
}

/// A file that can be played.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// When it begins, nanoseconds since the Unix epoch: by its name, in the time zone of this machine, else by its
    /// `creation_time`.
    pub started_ns: Option<u64>,
    /// Its length.
    pub length: Duration,
    /// Its frames per second, if it says them.
    pub rate: Option<f64>,
    /// The name of its drive: the stem of the drive's first file.
    pub drive: Arc<str>,
    /// True if a drive begins with it.
    pub begins_drive: bool,
}

/// Joins video files to drives: files without a gap between them. Looks at each file when it is its turn, with `ffprobe`.
#[derive(Clone, Debug)]
pub struct Drives {
    files: std::vec::IntoIter<PathBuf>,
    ffprobe: PathBuf,
    before: Option<Before>,
    /// True if a file between the last one and the next was passed over.
    has_hole: bool,
}

/// The file before.
#[derive(Clone, Debug)]
struct Before {
    name: FileName,
    /// When it ends.
    ended_ns: Option<u64>,
    drive: Arc<str>,
}

impl Drives {
    /// Creates the drives of files in their order; `ffprobe` is the program.
    pub fn new(files: Vec<PathBuf>, ffprobe: PathBuf) -> Self {
        Self {
            files: files.into_iter(),
            ffprobe,
            before: None,
            has_hole: false,
        }
    }

    /// Joins the next file to the drive of the one before, or begins a drive with it.
    fn join(&mut self, path: PathBuf, probed: VideoFacts) -> Recording {
        let name = FileName::of(&path);
        let before = self.before.take();
        // A chapter begins where the one before it ends.
        let as_chapter = match &before {
            Some(before) if name.continues(&before.name) => before.ended_ns,
            _ => None,
        };
        let started_ns = as_chapter.or_else(|| name.started_ns()).or(probed.created_ns);
        let follows = |before: &Before| match (before.ended_ns, started_ns) {
            (Some(ended), Some(started)) => started <= ended.saturating_add(GAP.as_nanos() as u64),
            // Without times nothing but a hole shows that something is missing.
            _ => !self.has_hole,
        };
        let continued = before.filter(follows);
        let begins_drive = continued.is_none();
        let drive = match continued {
            Some(before) => before.drive,
            None => path.file_stem().unwrap_or_default().to_string_lossy().into(),
        };
        let length_ns = probed.length.as_nanos() as u64;
        self.has_hole = false;
        self.before = Some(Before {
            name,
            ended_ns: started_ns.map(|started| started.saturating_add(length_ns)),
            drive: Arc::clone(&drive),
        });
        Recording {
            path,
            started_ns,
            length: probed.length,
            rate: probed.rate,
            drive,
            begins_drive,
        }
    }
}

impl Iterator for Drives {
    type Item = Result<Recording, PassedOver>;

    fn next(&mut self) -> Option<Self::Item> {
        let path = self.files.next()?;
        match probe(&path, &self.ffprobe) {
            Ok(probed) => Some(Ok(self.join(path, probed))),
            Err(reason) => {
                self.has_hole = true;
                Some(Err(PassedOver { path, reason }))
            }
        }
    }
}

#[cfg(test)]
mod tests;
