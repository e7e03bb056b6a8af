//! What must survive: clip reports that no hub has acknowledged, and settings changed while running.
//!
//! A report is kept and synced before anything is sent, under a number that its instance never gives twice, and is
//! removed only when a hub has it. While the disk cannot be written, reports wait in memory, as many as are
//! allowed, and are kept when it returns; without a state directory memory is all there is, and that is said.

mod batch;
mod config;
mod disk;
mod identity;
mod migrate;
mod state;
mod store;
#[cfg(test)]
mod tests;

pub(crate) use batch::Batch;
pub use config::OutboxConfig;

use albireo_wire::{ClipReport, OutboxStatus};
use disk::OpenFailure;
use state::{Shared, State, Unsettled};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// The file in the state directory.
const FILE: &str = "node.db";

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
    #[error("node.state_dir cannot be used: {0}")]
    Foreign(String),
    /// The configuration names something that can never be a folder.
    #[error("node.state_dir {0} is a file, not a folder: name a folder, or move the file away")]
    NotAFolder(PathBuf),
}

/// What the outbox has counted since the node started, and how it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OutboxCounts {
    /// Reports that wait, on disk and in memory.
    pub waiting: u64,
    /// Of these, reports that are in memory only.
    pub in_memory: u64,
    /// Reports lost since the instance began.
    pub lost: u64,
    /// When reports were lost last, of any instance, since the node started.
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
            durable: self.durable,
        }
    }
}

/// What becomes of a batch that a hub has answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Acknowledged {
    /// So many reports are off the list.
    Removed(u64),
    /// The hub has stored less than the batch began with: nothing was acknowledged.
    Nothing,
    /// The hub knows later numbers than this node ever gave: the state went back in time, and a new instance
    /// has begun.
    NewInstance,
}

/// Stands for a kept report whose energy is to come, whatever number it has by then.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Ticket(u64);

/// The outbox; clones are the same one. Every method may write and sync a file, unless it says otherwise: away from
/// async workers.
#[derive(Clone, Debug)]
pub struct Outbox(Arc<Shared>);

impl Outbox {
    /// Opens the outbox in `directory`, or in memory without one. A disk that cannot be used now is tried again
    /// later.
    ///
    /// # Errors
    /// [`OutboxError`]: another node uses the directory, or what is there is not ours.
    pub fn open(config: &OutboxConfig, directory: Option<&Path>) -> Result<Self, OutboxError> {
        let machine = identity::machine_digest(&config.machine_id);
        let shared = Shared::new(config.clone(), directory.map(Path::to_owned), machine);
        let outbox = Self(Arc::new(shared));
        match directory {
            Some(directory) if directory.is_file() => {
                return Err(OutboxError::NotAFolder(directory.to_owned()));
            }
            Some(directory) => outbox.first_look(directory)?,
            None => tracing::warn!(
                "no node.state_dir: clip reports wait in memory and are gone when the node stops"
            ),
        }
        Ok(outbox)
    }

    /// One that keeps nothing on disk.
    pub fn in_memory() -> Self {
        Self(Arc::new(Shared::new(OutboxConfig::default(), None, None)))
    }

    fn first_look(&self, directory: &Path) -> Result<(), OutboxError> {
        let mut state = self.0.enter();
        match self.0.open_store(&mut state, directory) {
            Ok(()) => {
                migrate::spool(self.0.as_ref(), &mut state, directory);
                Ok(())
            }
            Err(OpenFailure::Refused(error)) => Err(error),
            Err(OpenFailure::Disk(error)) => {
                state.fail(&error);
                Ok(())
            }
        }
    }

    /// The instance that numbers reports now.
    pub(crate) fn instance(&self) -> String {
        self.0.state.lock().current.name.clone()
    }

    /// Digest of the machine's identity.
    pub(crate) fn machine(&self) -> Option<String> {
        self.0.machine.clone()
    }

    /// How it stands. Never waits for a disk.
    pub fn counts(&self) -> OutboxCounts {
        self.0.published_counts.lock().clone()
    }

    /// Keeps reports whose energy is not known yet, in order, and gives them their numbers. They are not sent before
    /// [`settle`](Self::settle), or before that has taken too long; should the node die in between, they are sent as
    /// they are.
    pub(crate) fn keep(&self, reports: &mut [ClipReport]) -> Vec<Ticket> {
        let mut state = self.0.enter();
        let mut rows = Vec::with_capacity(reports.len());
        let mut tickets = Vec::with_capacity(reports.len());
        for report in reports.iter_mut() {
            state.current.last += 1;
            let number = state.current.last;
            report.report = number;
            state.tickets += 1;
            let (ticket, instance) = (Ticket(state.tickets), state.current.name.clone());
            let since = Instant::now();
            state.unsettled.insert(
                ticket,
                Unsettled {
                    instance,
                    number,
                    since,
                },
            );
            tickets.push(ticket);
            state.counts.kept += 1;
            rows.push((number, to_json(report)));
        }
        self.0.store_rows(&mut state, rows);
        self.0.notify_waiters();
        tickets
    }

    /// Replaces kept reports by the same with their energy: from now on they are sent. They get the numbers they have
    /// now: since they were kept a new instance may have begun.
    pub(crate) fn settle(&self, tickets: &[Ticket], reports: &mut [ClipReport]) {
        let mut state = self.0.enter();
        let state = &mut *state;
        for (ticket, report) in tickets.iter().zip(reports) {
            // Sent without it, or lost.
            let Some(place) = state.unsettled.remove(ticket) else {
                continue;
            };
            report.report = place.number;
            let in_memory = if place.instance == state.current.name {
                state
                    .memory
                    .binary_search_by_key(&place.number, |(number, _)| *number)
                    .ok()
            } else {
                None
            };
            match in_memory.and_then(|at| state.memory.get_mut(at)) {
                Some((_, json)) => *json = to_json(report),
                None => {
                    let place = (place.instance, place.number);
                    state.settled.insert(place, to_json(report));
                }
            }
        }
        self.0.write_settled(state);
        self.0.notify_waiters();
    }

    /// Tries a disk that failed again, when it is time.
    pub(crate) fn look_after_disk(&self) {
        self.0.look_after_disk(&mut self.0.enter());
    }

    /// The oldest reports that can be sent.
    pub(crate) fn batch(&self, node: &str) -> Option<Batch> {
        let mut state = self.0.enter();
        self.0.look_after_disk(&mut state);
        self.0.next_batch(&mut state, node)
    }

    /// Takes note of a hub's answer to `batch`.
    pub(crate) fn acknowledge(&self, batch: &Batch, stored: u64) -> Acknowledged {
        let mut state = self.0.enter();
        let state = &mut *state;
        let instance = &batch.message.instance;
        let own = state.current.name == *instance;
        if own && stored > state.current.last {
            tracing::error!(
                instance,
                stored,
                last = state.current.last,
                "the hub has later reports than this node ever made: its state went back in time; a new instance begins"
            );
            self.0.begin_anew(state);
            self.0.notify_waiters();
            return Acknowledged::NewInstance;
        }
        if stored < batch.message.first {
            return Acknowledged::Nothing;
        }
        // An old instance has no later numbers than those of its last batch.
        let upto = stored.min(if own {
            state.current.last
        } else {
            batch.message.last
        });
        let mut removed = 0;
        while own
            && state
                .memory
                .front()
                .is_some_and(|(number, _)| *number <= upto)
        {
            state.memory.pop_front();
            removed += 1;
        }
        let unreadable = state.forget(instance, upto);
        if self.0.directory.is_some() {
            let reports = batch.message.reports.iter();
            let in_batch = reports.filter(|report| report.report <= upto).count() as u64;
            let on_disk = in_batch.saturating_sub(removed) + unreadable;
            removed += remove(state, instance, upto, on_disk);
        }
        state.counts.acknowledged += removed;
        Acknowledged::Removed(removed)
    }

    /// The hub has other reports under the numbers of `batch`: what waits under them gets a new instance. Whether it
    /// could be done now.
    pub(crate) fn conflict(&self, batch: &Batch) -> bool {
        let mut state = self.0.enter();
        let state = &mut *state;
        let instance = &batch.message.instance;
        tracing::error!(
            instance,
            first = batch.message.first,
            "the hub has other reports under these numbers: the state went back in time, or another machine has a \
             copy of it; a new instance begins"
        );
        if state.current.name == *instance {
            self.0.begin_anew(state);
        } else {
            if state.store.is_none() || !state.memory.is_empty() {
                return false;
            }
            match self.0.move_to_new_instance(state, instance) {
                Ok(begun) => state.current = begun,
                Err(error) => {
                    state.fail_store(&error);
                    return false;
                }
            }
        }
        self.0.notify_waiters();
        true
    }

    /// A setting kept under `name`.
    pub(crate) fn setting<T: serde::de::DeserializeOwned>(&self, name: &str) -> Option<T> {
        let mut state = self.0.enter();
        let state = &mut *state;
        if !state.settings.contains_key(name) {
            let store = state.store.as_ref()?;
            match store.setting(name) {
                Ok(found) => {
                    state.settings.insert(name.to_owned(), found?);
                }
                Err(error) => {
                    state.fail_store(&error);
                    return None;
                }
            }
        }
        match serde_json::from_str(state.settings.get(name)?) {
            Ok(setting) => Some(setting),
            Err(error) => {
                tracing::warn!(name, %error, "a kept setting cannot be read and is not used");
                None
            }
        }
    }

    /// Keeps a setting; whether it survives a restart. One that cannot be written now is written when the disk
    /// returns, unless nothing could be read of it yet: then whoever set it is asked by
    /// [`settings_returned`](Self::settings_returned) to compare first.
    pub(crate) fn set<T: serde::Serialize>(&self, name: &str, setting: &T) -> bool {
        let Ok(json) = serde_json::to_string(setting) else {
            return false;
        };
        let mut state = self.0.enter();
        self.0.look_after_disk(&mut state);
        let state = &mut *state;
        if state.settings_returned {
            return false;
        }
        state.settings.insert(name.to_owned(), json.clone());
        if state.failing.is_none()
            && let Some(store) = &mut state.store
        {
            match store.set(name, &json) {
                Ok(()) => return true,
                Err(error) => state.fail_store(&error),
            }
        }
        state.unwritten_settings.insert(name.to_owned());
        false
    }

    /// Whether the settings that an earlier run kept can be read since the last call, and could not when they were
    /// asked for.
    pub(crate) fn settings_returned(&self) -> bool {
        std::mem::take(&mut self.0.state.lock().settings_returned)
    }

    /// Whether there is a directory to keep things in.
    pub(crate) fn has_directory(&self) -> bool {
        self.0.directory.is_some()
    }

    /// Whether settings changed now survive a restart.
    pub(crate) fn keeps_settings(&self) -> bool {
        self.counts().durable
    }

    /// Waits until something changed since `revision`, or `until`; the revision now. Never waits for a disk.
    pub(crate) fn wait_for_change(&self, revision: u64, until: Instant) -> u64 {
        let mut now = self.0.revision.lock();
        while *now == revision {
            if self.0.changed.wait_until(&mut now, until).timed_out() {
                break;
            }
        }
        *now
    }

    /// Makes the sender look. Never waits for a disk.
    pub(crate) fn wake(&self) {
        self.0.notify_waiters();
    }

    /// Makes it time to try a disk that failed.
    #[cfg(test)]
    pub(crate) fn disk_is_due(&self) {
        self.0.state.lock().retry_at = Instant::now();
    }
}

/// Removes from the disk what a hub has, or notes it where that cannot be done now: then `expected` reports. How many
/// went.
fn remove(state: &mut State, instance: &str, upto: u64, expected: u64) -> u64 {
    if state.failing.is_none()
        && let Some(store) = &mut state.store
    {
        let before = store.waiting().reports;
        match store.remove(instance, upto) {
            Ok(()) => return before - store.waiting().reports,
            Err(error) => state.fail_store(&error),
        }
    }
    let noted = state.acknowledged.entry(instance.to_owned()).or_default();
    noted.upto = noted.upto.max(upto);
    noted.reports += expected;
    expected
}

fn to_json(report: &ClipReport) -> Vec<u8> {
    // A report holds numbers and text: writing it cannot fail. An empty row would be counted as lost.
    serde_json::to_vec(report).unwrap_or_default()
}
