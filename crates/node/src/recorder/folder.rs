//! The folder of recordings: their names, their sum, and which of them go.

use crate::state_files::not_created;
use albireo_recording::{EXTENSION, Mended, RecordingError, is_recording, mend};
use std::fs::{DirBuilder, read_dir, remove_file};
use std::io::{ErrorKind, Result as IoResult};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// A folder that the node itself creates is its user's alone: the pictures show people.
const OWNER_ONLY: u32 = 0o700;

/// The folder, and how much may be in it.
#[derive(Debug)]
pub(super) struct Folder {
    path: PathBuf,
    max_bytes: u64,
    keep: Duration,
}

/// What is in the folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FolderContent {
    pub recordings: u64,
    pub bytes: u64,
}

/// A recording in the folder.
struct Recording {
    path: PathBuf,
    bytes: u64,
    changed: SystemTime,
}

impl Folder {
    pub(super) fn new(path: &Path, max_bytes: u64, keep: Duration) -> Self {
        Self {
            path: path.to_owned(),
            max_bytes,
            keep,
        }
    }

    /// Creates the folder if it is missing.
    pub(super) fn create(&self) -> IoResult<()> {
        let created = DirBuilder::new().recursive(true).mode(OWNER_ONLY).create(&self.path);
        created.map_err(|error| not_created(&self.path, &error))
    }

    /// Gives the recordings that were cut by a power failure their end.
    pub(super) fn mend(&self) -> Result<(), RecordingError> {
        for recording in self.recordings()? {
            let file = recording.path.display();
            match mend(&recording.path) {
                Ok(Mended::Whole) => {}
                Ok(Mended::Mended { messages }) => {
                    tracing::info!(%file, messages, "a recording that was cut has an end again");
                }
                Ok(Mended::Removed) => {
                    tracing::info!(%file, "an empty recording was removed");
                }
                Err(error) => tracing::warn!(%file, %error, "a cut recording stays without an end"),
            }
        }
        Ok(())
    }

    /// The path of a new recording of a camera, named for this time.
    pub(super) fn new_path(&self, camera: &str, now: SystemTime) -> PathBuf {
        let time = humantime::format_rfc3339_millis(now).to_string().replace(':', "");
        self.path.join(format!("{time}_{camera}.{EXTENSION}"))
    }

    /// Deletes what is too old, and then the oldest until what is there fits; never an `open` one, for which there is room
    /// until it has `largest` bytes. Returns what is left.
    pub(super) fn tidy(
        &self,
        open: &[&Path],
        largest: u64,
        now: SystemTime,
    ) -> IoResult<FolderContent> {
        let mut recordings = self.recordings()?;
        // The oldest first; of the same age in the order of names.
        recordings
            .sort_by(|one, other| (one.changed, &one.path).cmp(&(other.changed, &other.path)));
        let mut left = FolderContent {
            recordings: recordings.len() as u64,
            bytes: recordings.iter().map(|recording| recording.bytes).sum(),
        };
        let is_open = |recording: &&Recording| open.contains(&&*recording.path);
        let growth = |recording: &Recording| largest.saturating_sub(recording.bytes);
        let room: u64 = recordings.iter().filter(is_open).map(growth).sum();
        for recording in recordings.iter().filter(|recording| !is_open(recording)) {
            let age = now.duration_since(recording.changed).unwrap_or_default();
            if age <= self.keep && left.bytes + room <= self.max_bytes {
                continue;
            }
            match remove_file(&recording.path) {
                Ok(()) => {}
                // Somebody has deleted it meanwhile.
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
            left.recordings -= 1;
            left.bytes -= recording.bytes;
            let file = recording.path.display();
            tracing::debug!(%file, "an old recording was deleted");
        }
        Ok(left)
    }

    /// The recordings in the folder, by their names: nothing else is touched.
    fn recordings(&self) -> IoResult<Vec<Recording>> {
        let mut recordings = Vec::new();
        for entry in read_dir(&self.path)? {
            let entry = entry?;
            let metadata = match entry.metadata() {
                Ok(metadata) => metadata,
                // Somebody has deleted it meanwhile.
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                Err(error) => return Err(error),
            };
            if metadata.is_file() && is_own(&entry.file_name().to_string_lossy()) {
                recordings.push(Recording {
                    path: entry.path(),
                    bytes: metadata.len(),
                    changed: metadata.modified()?,
                });
            }
        }
        Ok(recordings)
    }
}

/// True for a name that [`Folder::new_path`] gives.
fn is_own(name: &str) -> bool {
    let Some((time, camera)) = name.split_once("Z_") else {
        return false;
    };
    let is_time = |(index, byte): (usize, u8)| match index {
        4 | 7 => byte == b'-',
        10 => byte == b'T',
        17 => byte == b'.',
        _ => byte.is_ascii_digit(),
    };
    time.len() == "2026-11-28T110850.123".len()
        && time.bytes().enumerate().all(is_time)
        && is_recording(Path::new(camera))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{File, write};

    const DAY: Duration = Duration::from_secs(86_400);

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_oldest_recordings_go_first_and_nothing_else_goes() {
        let place = tempfile::tempdir().unwrap();
        let folder = Folder::new(place.path(), 2500, 10 * DAY);
        let now = SystemTime::now();
        let mut paths = Vec::new();
        for age in [20, 3, 2, 1] {
            let at = now - DAY * age;
            let path = folder.new_path("front", at);
            write(&path, [0; 1000]).unwrap();
            File::options().write(true).open(&path).unwrap().set_modified(at).unwrap();
            paths.push(path);
        }
        // Not a recording of the node, however old.
        for other in ["holiday.mcap", "2026-11-28T110850.123Z_front.txt"] {
            write(place.path().join(other), [0; 1000]).unwrap();
        }
        let left = folder.tidy(&[&paths[1]], 1400, now).unwrap();
        assert_eq!(left.recordings, 2);
        assert_eq!(left.bytes, 2000);
        let kept = names(place.path());
        assert_eq!(kept.len(), 4, "{kept:?}");
        assert!(!paths[0].exists(), "it is too old");
        assert!(paths[1].exists(), "it is open");
        assert!(!paths[2].exists(), "the oldest of the others goes");
        assert!(paths[3].exists(), "there is room for it");
    }
}
