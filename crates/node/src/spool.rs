//! Clip reports that nobody has taken yet, kept in files: one JSON file a report, written whole before it
//! has its name, so that a crash leaves no half report.

use albireo_wire::ClipReport;
use std::io;
use std::path::{Path, PathBuf};

/// Reports kept at most; beyond it the oldest goes, so that a hub that is away for months does not fill
/// the disk of a small board. At 40 s a clip this is 23 days of one camera.
const CAPACITY: usize = 50_000;

/// A folder of one camera's reports that wait.
#[derive(Debug)]
pub(crate) struct Spool {
    folder: PathBuf,
    dropped: u64,
}

impl Spool {
    /// Opens, and makes, the folder of `camera` under `clip-reports` in `state_dir`.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub(crate) fn open(state_dir: &Path, camera: &str) -> io::Result<Self> {
        let folder = state_dir.join("clip-reports").join(camera);
        std::fs::create_dir_all(&folder)?;
        Ok(Self { folder, dropped: 0 })
    }

    /// Keeps a report.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(crate) fn keep(&mut self, report: &ClipReport) -> io::Result<()> {
        let waiting = self.waiting()?;
        if waiting.len() >= CAPACITY
            && let Some(oldest) = waiting.first()
        {
            std::fs::remove_file(oldest)?;
            self.dropped += 1;
            tracing::warn!(
                dropped = self.dropped,
                "clip report spool full: oldest report dropped"
            );
        }
        // Names sort by time; the report's number keeps two clips of one start apart.
        let name = format!("{:020}-{:08}.json", report.started_ns, report.report);
        let part = self.folder.join(format!("{name}.part"));
        std::fs::write(&part, serde_json::to_vec(report)?)?;
        std::fs::rename(part, self.folder.join(name))
    }

    /// The files that wait, oldest first.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub(crate) fn waiting(&self) -> io::Result<Vec<PathBuf>> {
        let mut files = std::fs::read_dir(&self.folder)?
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<io::Result<Vec<_>>>()?;
        files.retain(|file| {
            file.extension()
                .is_some_and(|extension| extension == "json")
        });
        files.sort();
        Ok(files)
    }

    /// Reads a file of [`waiting`](Self::waiting). A file that is not a report is put aside under the
    /// ending `.broken`, logged, and `None`.
    ///
    /// # Errors
    /// When it cannot be read or put aside.
    pub(crate) fn read(&self, file: &Path) -> io::Result<Option<ClipReport>> {
        match serde_json::from_slice(&std::fs::read(file)?) {
            Ok(report) => Ok(Some(report)),
            Err(error) => {
                tracing::error!(file = %file.display(), %error, "not a clip report; put aside");
                std::fs::rename(file, file.with_extension("broken"))?;
                Ok(None)
            }
        }
    }

    /// Forgets a report that was delivered.
    ///
    /// # Errors
    /// When the file cannot be removed.
    pub(crate) fn delivered(&self, file: &Path) -> io::Result<()> {
        std::fs::remove_file(file)
    }
}
