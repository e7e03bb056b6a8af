//! Keeps clip reports until a hub has them.
//!
//! A report is written and synced once before it is sent, and kept for some days after a hub has acknowledged it, in
//! case the hub loses it. While the disk fails, reports wait in memory, up to a limit, and are written when the disk
//! works again; without a state directory they stay in memory, and the log reports it.

mod config;
mod disk;
mod salvage;
mod table;
#[cfg(test)]
pub(crate) mod tests;
mod waiting;

pub use config::OutboxConfig;
pub(crate) use waiting::BatchScope;

use crate::error::NodeError;
use albireo_service::clock::Now;
use albireo_service::readiness::Fault;
use albireo_wire::OutboxStatus;
use disk::{Disk, StateFile};
use parking_lot::Mutex;
use std::path::Path;
use std::time::{Duration, Instant};
pub(crate) use table::TableError;
use tokio::sync::Notify;
use waiting::Waiting;

/// The counts and the state of the outbox.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OutboxCounts {
    /// The counts in the status: reports that no hub has, that were lost for lack of room, and that a hub refused
    /// permanently or that could not be read; and whether reports survive a power loss now.
    pub status: OutboxStatus,
    /// Reports that a hub lost and that are sent again.
    pub again: u64,
    /// The time of the last loss since the start.
    pub last_loss: Option<Instant>,
    /// Reports added since the node started.
    pub kept: u64,
    /// Reports acknowledged since the node started.
    pub acknowledged: u64,
    /// Reports since the node started that a hub refused for good, or that could not be read.
    pub refused: u64,
    /// The time of the last of them.
    pub last_refusal: Option<Instant>,
    /// The number of disk failures.
    pub disk_failures: u64,
    /// The reason why nothing can be stored on disk now.
    pub failing: Option<String>,
}

/// The time for which clip reports that were lost, or that no hub will get, are shown.
const LOSS_SHOWN_FOR: Duration = Duration::from_secs(600);

impl OutboxCounts {
    /// The fault of the node that the counts show.
    pub(crate) fn fault(&self) -> Option<Fault> {
        let minutes = LOSS_SHOWN_FOR.as_secs() / 60;
        let is_shown = |at: Instant| at.elapsed() < LOSS_SHOWN_FOR;
        if self.last_loss.is_some_and(is_shown) {
            let reason = format!("clip reports were lost in the last {minutes} minutes");
            return Some(Fault::degraded(reason));
        }
        if self.failing.is_some() {
            let reason = "clip reports wait in memory and do not survive a power loss";
            return Some(Fault::degraded(reason));
        }
        if self.last_refusal.is_some_and(is_shown) {
            let reason = format!(
                "in the last {minutes} minutes there were clip reports that no hub will get, because one refused them or \
                 they cannot be read: {} since the start (the log says why)",
                self.refused
            );
            return Some(Fault::degraded(reason));
        }
        None
    }
}

/// Maximum file size, bytes. Reports that a hub has are deleted first, then the oldest waiting ones, as lost.
pub(crate) const MAX_BYTES: u64 = 256 << 20;

/// The outbox.
#[derive(Debug)]
pub struct Outbox {
    /// Locked while the disk is read or written.
    waiting: Mutex<Waiting>,
    /// The counts after the last change, for readers that must not wait for the disk.
    counts: Mutex<OutboxCounts>,
    changed: Notify,
}

impl Outbox {
    /// Opens the outbox in `directory`, or in memory without one. A disk that fails is tried again later. Reads and
    /// writes files.
    ///
    /// # Errors
    /// [`NodeError`] if another node uses the directory or its file is not ours; not if the disk fails.
    pub fn open(directory: Option<&Path>) -> Result<Self, NodeError> {
        let opened = match directory {
            None => Waiting::in_memory().map(Self::of),
            Some(directory) if directory.is_file() => Err(TableError::Unusable(
                "it is a file, not a folder: name a folder, or move the file away".to_owned(),
            )),
            Some(directory) => {
                let file = Box::new(StateFile::new(directory));
                Self::open_on(file, MAX_BYTES, Now::system())
            }
        };
        let shown = directory.unwrap_or(Path::new("")).display();
        opened.map_err(NodeError::of(format!(
            "node.state_dir {shown} cannot be used"
        )))
    }

    /// Opens the outbox on a disk.
    pub(crate) fn open_on(
        disk: Box<dyn Disk>,
        max_bytes: u64,
        now: Now,
    ) -> Result<Self, TableError> {
        let mut waiting = Waiting::on_disk(disk, max_bytes)?;
        match waiting.open(now) {
            Err(error @ TableError::Unusable(_)) => Err(error),
            // A failed disk is tried again.
            Ok(()) | Err(_) => Ok(Self::of(waiting)),
        }
    }

    fn of(waiting: Waiting) -> Self {
        Self {
            counts: Mutex::new(waiting.counts()),
            waiting: Mutex::new(waiting),
            changed: Notify::new(),
        }
    }

    /// Returns the counts without waiting for the disk.
    pub fn counts(&self) -> OutboxCounts {
        self.counts.lock().clone()
    }

    /// Returns when there was a change since the last call. For a single task; never waits for the disk.
    pub(crate) async fn changed(&self) {
        self.changed.notified().await;
    }

    /// Reads or changes the reports, and updates their counts. Reads and writes files: call it outside async workers.
    pub(crate) fn change<T>(&self, change: impl FnOnce(&mut Waiting) -> T) -> T {
        let mut waiting = self.waiting.lock();
        let changed = change(&mut waiting);
        *self.counts.lock() = waiting.counts();
        self.changed.notify_one();
        changed
    }
}
