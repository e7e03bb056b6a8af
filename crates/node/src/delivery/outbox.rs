//! Keeps clip reports until a hub has them.
//!
//! A report is written and synced once, before anything is sent, and goes on being kept for some days after a hub has
//! acknowledged it, for a hub that loses it. While the disk fails, reports wait in memory, as many as are allowed, and
//! are written when it returns; without a state directory they stay in memory, and the log says so.

mod config;
mod disk;
mod table;
#[cfg(test)]
pub(super) mod tests;
mod waiting;

pub use config::OutboxConfig;

use crate::state::settings::Settings;
use albireo_service::clock::Now;
use albireo_wire::{ClipReport, OutboxStatus, ReportAnswer, ReportBatch};
use disk::Disk;
pub(super) use disk::StateFile;
use parking_lot::Mutex;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use table::TableError;
use tokio::sync::Notify;
use waiting::Waiting;

/// Why the state directory cannot be used. Only what waiting does not mend: a disk that fails is no reason
/// not to start.
#[derive(Debug, thiserror::Error)]
pub enum OutboxError {
    /// Another node has it.
    #[error(
        "node.state_dir {0} is in use by another node: two nodes cannot share one; choose another, or stop the other node"
    )]
    Locked(PathBuf),
    /// Not our file.
    #[error("node.state_dir {0} cannot be used: {1}")]
    Foreign(PathBuf, String),
    /// The configuration names something that can never be a folder.
    #[error("node.state_dir {0} is a file, not a folder: name a folder, or move the file away")]
    NotAFolder(PathBuf),
    /// There is no memory.
    #[error("clip reports cannot be kept in memory: {0}")]
    Memory(String),
}

/// What the outbox has counted, and how it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OutboxCounts {
    /// Reports that no hub has, on disk and in memory.
    pub waiting: u64,
    /// Of these, reports that are in memory only.
    pub in_memory: u64,
    /// Reports that a hub lost, to be sent again.
    pub again: u64,
    /// Reports lost: there was no room for them.
    pub lost: u64,
    /// Reports that a hub refused for good, or that could not be read.
    pub undeliverable: u64,
    /// When reports were lost last, since the node started.
    pub last_loss: Option<Instant>,
    /// Reports taken in since the node started.
    pub kept: u64,
    /// Reports acknowledged since the node started.
    pub acknowledged: u64,
    /// How often the disk failed.
    pub disk_failures: u64,
    /// Why nothing can be kept on disk now.
    pub failing: Option<String>,
    /// Whether reports survive a power loss now.
    pub durable: bool,
}

impl OutboxCounts {
    /// The same for the status.
    pub fn status(&self) -> OutboxStatus {
        OutboxStatus {
            waiting: self.waiting,
            lost: self.lost,
            undeliverable: self.undeliverable,
            durable: self.durable,
        }
    }
}

/// The outbox; clones are the same one. Methods that may write and sync a file say so: to be called away from async
/// workers.
#[derive(Clone, Debug)]
pub struct Outbox {
    shared: Arc<Shared>,
    settings: Settings,
    directory: bool,
}

#[derive(Debug)]
struct Shared {
    /// Locked while a disk is read or written.
    waiting: Mutex<Waiting>,
    /// The counts as they were after the last change, for readers that must not wait for a disk.
    counts: Mutex<OutboxCounts>,
    changed: Notify,
}

impl Outbox {
    /// Opens the outbox in `directory`, or in memory without one. A disk that cannot be used now is tried again
    /// later. Reads and writes files.
    ///
    /// # Errors
    /// [`OutboxError`]: another node uses the directory, or what is there is not ours.
    pub fn open(config: &OutboxConfig, directory: Option<&Path>) -> Result<Self, OutboxError> {
        let Some(directory) = directory else {
            tracing::warn!(
                "no node.state_dir: clip reports wait in memory and are gone when the node stops"
            );
            return Self::in_memory();
        };
        if directory.is_file() {
            return Err(OutboxError::NotAFolder(directory.to_owned()));
        }
        let file = Box::new(StateFile::new(directory));
        Self::open_on(file, config, directory, Now::system())
    }

    /// Opens the outbox on a disk.
    pub(super) fn open_on(
        disk: Box<dyn Disk>,
        config: &OutboxConfig,
        directory: &Path,
        now: Now,
    ) -> Result<Self, OutboxError> {
        let mut waiting = Self::waiting(Some(disk), config.max_bytes)?;
        match waiting.open(now) {
            Err(TableError::Locked) => return Err(OutboxError::Locked(directory.to_owned())),
            Err(TableError::Foreign(reason)) => {
                return Err(OutboxError::Foreign(directory.to_owned(), reason));
            }
            // A disk that fails is tried again.
            Ok(()) | Err(_) => {}
        }
        Ok(Self::of(waiting, Some(directory)))
    }

    /// One that keeps nothing on disk.
    pub(crate) fn in_memory() -> Result<Self, OutboxError> {
        Ok(Self::of(Self::waiting(None, 0)?, None))
    }

    fn waiting(disk: Option<Box<dyn Disk>>, most_bytes: u64) -> Result<Waiting, OutboxError> {
        Waiting::new(disk, most_bytes).map_err(|error| OutboxError::Memory(error.to_string()))
    }

    fn of(waiting: Waiting, directory: Option<&Path>) -> Self {
        let counts = waiting.counts();
        Self {
            shared: Arc::new(Shared {
                waiting: Mutex::new(waiting),
                counts: Mutex::new(counts),
                changed: Notify::new(),
            }),
            settings: Settings::open(directory),
            directory: directory.is_some(),
        }
    }

    /// How it is. Never waits for a disk.
    pub fn counts(&self) -> OutboxCounts {
        self.shared.counts.lock().clone()
    }

    /// Returns when reports were added since the last call. For one task alone; never waits for a disk.
    pub(crate) async fn changed(&self) {
        self.shared.changed.notified().await;
    }

    /// Keeps reports, in order, and gives them their running counts. Writes a file.
    pub(crate) fn insert(&self, reports: &mut [ClipReport], now: Now) {
        self.with(|waiting| waiting.insert(reports, now));
        self.shared.changed.notify_one();
    }

    /// The oldest reports to be sent, as reports of `node`; with those that a hub has lost if they go `again` now. Reads,
    /// and may write, a file.
    pub(crate) fn batch(&self, node: &str, again: bool, now: Now) -> Option<ReportBatch> {
        self.with(|waiting| waiting.batch(node, again, now))
    }

    /// Takes a hub's answer to `batch`; how many reports it has stored. Writes a file.
    pub(crate) fn answered(&self, batch: &ReportBatch, answer: &ReportAnswer, now: Now) -> u64 {
        self.with(|waiting| waiting.answered(batch, answer, now))
    }

    /// Tries a disk that failed again, when it is time. May write a file.
    pub(crate) fn retry_disk(&self, now: Now) {
        self.with(|waiting| waiting.retry_disk(now));
        self.settings.retry();
    }

    /// Works on the reports, and publishes their counts.
    fn with<T>(&self, work: impl FnOnce(&mut Waiting) -> T) -> T {
        let mut waiting = self.shared.waiting.lock();
        let done = work(&mut waiting);
        *self.shared.counts.lock() = waiting.counts();
        done
    }

    /// A setting kept under `name`.
    pub(crate) fn setting<T: serde::de::DeserializeOwned>(&self, name: &str) -> Option<T> {
        self.settings.get(name)
    }

    /// Keeps a setting; whether it survives a restart. Writes a file.
    pub(crate) fn set<T: serde::Serialize>(&self, name: &str, setting: &T) -> bool {
        self.settings.set(name, setting)
    }

    /// Whether there is a directory to keep things in.
    pub(crate) const fn has_directory(&self) -> bool {
        self.directory
    }

    /// Whether settings changed now survive a restart.
    pub(crate) fn keeps_settings(&self) -> bool {
        self.counts().durable
    }

    /// A disk that stalls until this is dropped, for reports and settings.
    #[cfg(test)]
    pub(crate) fn stall(&self) -> impl Sized {
        (self.shared.waiting.lock(), self.settings.stall())
    }

    /// Makes it time to try a disk that failed.
    #[cfg(test)]
    pub(crate) fn disk_is_due(&self) {
        self.shared.waiting.lock().retry_at = Instant::now();
    }
}
