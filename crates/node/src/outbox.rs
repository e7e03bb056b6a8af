//! What must survive: clip reports that no hub has acknowledged, and settings changed while running.
//!
//! A report is kept and synced before anything is sent, under a number that its instance never gives twice, and is
//! removed only when a hub has it. While the disk cannot be written, reports wait in memory, as many as are
//! allowed, and are kept when it returns; without a state directory memory is all there is, and that is said.

mod config;
mod identity;
mod migrate;
mod store;
#[cfg(test)]
mod tests;

pub use config::OutboxConfig;

use albireo_wire::{ClipReport, OutboxStatus, ReportBatch, VERSION};
use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::{File, TryLockError};
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use store::{Instance, Store, StoreError};

/// The file in the state directory.
const FILE: &str = "node.db";

/// Time between two looks at a disk that failed.
const DISK_RETRY: Duration = Duration::from_secs(2);

/// A report whose energy is not known after this time is sent without.
const LONGEST_SETTLING: Duration = Duration::from_secs(30);

/// Uncompressed bytes of a batch at most: well below [`albireo_wire::LARGEST_BATCH_BYTES`], and compressed far
/// below what an uplink lets through.
const BATCH_BYTES: usize = 1 << 20;

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
    #[error("node.state_dir: {0}")]
    Foreign(String),
    /// The configuration names something that can never be a folder.
    #[error("node.state_dir {0} is a file, not a folder")]
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

/// A batch to be sent.
#[derive(Debug)]
pub(crate) struct Batch {
    /// Row of the instance.
    instance: i64,
    /// What goes over the wire.
    pub message: ReportBatch,
}

/// The outbox; clones are the same one. Every method may write and sync a file: away from async workers.
#[derive(Clone, Debug)]
pub struct Outbox(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    config: OutboxConfig,
    directory: Option<PathBuf>,
    machine: Option<String>,
    state: Mutex<State>,
    /// The counts as they were after the last change, for readers that must not wait for a disk.
    told: Mutex<OutboxCounts>,
    /// Told at every change that may concern the sender.
    changed: Condvar,
}

#[derive(Debug)]
struct State {
    store: Option<Store>,
    lock: Option<File>,
    failing: Option<String>,
    retry_at: Instant,
    current: Instance,
    /// Reports of `current` that are not on disk, in order, above all that are.
    memory: VecDeque<(u64, Vec<u8>)>,
    /// Reports whose energy is not known yet.
    unsettled: BTreeMap<u64, Instant>,
    /// What a hub has of each instance and the disk could not forget.
    acknowledged: BTreeMap<i64, u64>,
    /// What waited on disk when it failed.
    waiting_on_disk: u64,
    settings: BTreeMap<String, String>,
    unwritten_settings: BTreeSet<String>,
    counts: OutboxCounts,
    /// Goes up when the sender should look.
    revision: u64,
}

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
        self.0.told.lock().clone()
    }

    /// Keeps reports whose energy is not known yet, in order, and gives them their numbers. They are not sent before
    /// [`settle`](Self::settle); should the node die in between, they are sent as they are.
    pub(crate) fn keep(&self, reports: &mut [ClipReport]) {
        let mut state = self.0.enter();
        let mut rows = Vec::with_capacity(reports.len());
        for report in reports.iter_mut() {
            state.current.last += 1;
            let number = state.current.last;
            report.report = number;
            state.unsettled.insert(number, Instant::now());
            state.counts.kept += 1;
            rows.push((number, to_json(report)));
        }
        self.0.store_rows(&mut state, rows);
        self.0.ring(&mut state);
    }

    /// Replaces kept reports by the same with their energy: from now on they are sent.
    pub(crate) fn settle(&self, reports: &[ClipReport]) {
        let mut state = self.0.enter();
        let state = &mut *state;
        let mut rows = Vec::with_capacity(reports.len());
        for report in reports {
            // After a new instance began meanwhile, the number is another's: it goes as it was kept.
            if state.unsettled.remove(&report.report).is_none() {
                continue;
            }
            match state.memory.iter_mut().find(|(n, _)| *n == report.report) {
                Some((_, json)) => *json = to_json(report),
                None => rows.push((report.report, to_json(report))),
            }
        }
        if !rows.is_empty()
            && let Some(store) = &mut state.store
            && let Err(error) = store.replace(&state.current, &rows)
        {
            state.fail(&error);
        }
        self.0.ring(state);
    }

    /// The oldest reports that can be sent.
    pub(crate) fn batch(&self, node: &str) -> Option<Batch> {
        let mut state = self.0.enter();
        self.0.look_after_disk(&mut state);
        let state = &mut *state;
        let now = Instant::now();
        state
            .unsettled
            .retain(|_, since| now.duration_since(*since) < LONGEST_SETTLING);
        let before = state.unsettled.keys().next().copied();
        let most = self.0.config.batch_reports.max(1);
        for _ in 0..8 {
            let found = match &state.store {
                None => None,
                Some(store) => {
                    let acknowledged =
                        |instance| state.acknowledged.get(&instance).copied().unwrap_or(0);
                    match store.rows(most, BATCH_BYTES, &acknowledged, state.current.id, before) {
                        Ok(rows) => rows,
                        Err(error) => {
                            state.fail(&error);
                            None
                        }
                    }
                }
            };
            let Some(rows) = found else { break };
            let (mut reports, mut unreadable) = (Vec::new(), Vec::new());
            for (number, json) in &rows.reports {
                match serde_json::from_slice::<ClipReport>(json) {
                    Ok(report) => reports.push(ClipReport {
                        report: *number,
                        ..report
                    }),
                    Err(error) => {
                        tracing::error!(number, %error, "a kept clip report cannot be read: lost");
                        unreadable.push(*number);
                    }
                }
            }
            if !unreadable.is_empty()
                && let Some(store) = &mut state.store
            {
                if rows.instance.id == state.current.id {
                    state.current.lost += unreadable.len() as u64;
                }
                if let Err(error) = store.give_up(rows.instance.id, &unreadable) {
                    state.fail(&error);
                }
            }
            if let Some(batch) = batch_of(node, &rows.instance, reports) {
                return Some(batch);
            }
        }
        // What is on disk and cannot be read has lower numbers: later ones must not overtake them.
        if state.waiting_on_disk > 0 && state.store.is_none() {
            return None;
        }
        let on_disk = state.store.as_ref().is_some_and(|store| {
            let acknowledged = |instance| state.acknowledged.get(&instance).copied().unwrap_or(0);
            store
                .rows(1, 1, &acknowledged, state.current.id, None)
                .is_ok_and(|rows| rows.is_some())
        });
        if on_disk {
            return None;
        }
        let reports = state
            .memory
            .iter()
            .take_while(|(number, _)| before.is_none_or(|before| *number < before))
            .take(most)
            .filter_map(|(_, json)| serde_json::from_slice(json).ok())
            .collect();
        batch_of(node, &state.current, reports)
    }

    /// Takes note of a hub's answer to `batch`.
    pub(crate) fn acknowledge(&self, batch: &Batch, stored: u64) -> Acknowledged {
        let mut state = self.0.enter();
        let state = &mut *state;
        let own = state.current.name == batch.message.instance;
        if own && stored > state.current.last {
            tracing::error!(
                instance = state.current.name,
                stored,
                last = state.current.last,
                "the hub has later reports than this node ever made: its state went back in time; a new instance begins"
            );
            self.0.begin_anew(state);
            self.0.ring(state);
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
        if batch.instance != 0 {
            let before = state.store.as_ref().map_or(0, |s| s.waiting().reports);
            state.acknowledged.insert(batch.instance, upto);
            if let Some(store) = &mut state.store {
                match store.remove(batch.instance, upto) {
                    Ok(()) => {
                        removed += before - store.waiting().reports;
                        state.acknowledged.remove(&batch.instance);
                    }
                    Err(error) => {
                        removed += batch.message.reports.len() as u64;
                        state.fail(&error);
                    }
                }
            }
        }
        state.counts.acknowledged += removed;
        Acknowledged::Removed(removed)
    }

    /// The hub has other reports under the numbers of `batch`: what waits under them gets a new instance. Whether it
    /// could be done now.
    pub(crate) fn conflict(&self, batch: &Batch) -> bool {
        let mut state = self.0.enter();
        let state = &mut *state;
        tracing::error!(
            instance = batch.message.instance,
            first = batch.message.first,
            "the hub has other reports under these numbers: the state went back in time, or another machine has a \
             copy of it; a new instance begins"
        );
        if state.current.name == batch.message.instance {
            self.0.begin_anew(state);
        } else {
            let Some(store) = state.store.as_mut().filter(|_| state.memory.is_empty()) else {
                return false;
            };
            let fresh = Instance::new(self.0.machine.clone());
            match store.begin_instance(fresh, Some(batch.instance)) {
                Ok(begun) => {
                    state.unsettled.clear();
                    state.acknowledged.remove(&batch.instance);
                    state.current = begun;
                }
                Err(error) => {
                    state.fail(&error);
                    return false;
                }
            }
        }
        self.0.ring(state);
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
                    state.fail(&error);
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
    /// returns.
    pub(crate) fn set<T: serde::Serialize>(&self, name: &str, setting: &T) -> bool {
        let Ok(json) = serde_json::to_string(setting) else {
            return false;
        };
        let mut state = self.0.enter();
        self.0.look_after_disk(&mut state);
        let state = &mut *state;
        state.settings.insert(name.to_owned(), json.clone());
        let written = match &mut state.store {
            Some(store) => store.set(name, &json),
            None => {
                state.unwritten_settings.insert(name.to_owned());
                return false;
            }
        };
        if let Err(error) = &written {
            state.unwritten_settings.insert(name.to_owned());
            state.fail(error);
        }
        written.is_ok()
    }

    /// Whether there is a directory to keep things in.
    pub(crate) fn has_directory(&self) -> bool {
        self.0.directory.is_some()
    }

    /// Whether settings changed now survive a restart.
    pub(crate) fn keeps_settings(&self) -> bool {
        self.counts().durable
    }

    /// Waits until something changed since `revision`, or `until`; the revision now.
    pub(crate) fn wait_for_change(&self, revision: u64, until: Instant) -> u64 {
        let mut state = self.0.state.lock();
        while state.revision == revision {
            if self.0.changed.wait_until(&mut state, until).timed_out() {
                break;
            }
        }
        state.revision
    }

    /// Makes the sender look.
    pub(crate) fn wake(&self) {
        self.0.ring(&mut self.0.state.lock());
    }
}

/// The state while it is worked on; what it counts is told at the end.
struct Entered<'a> {
    state: MutexGuard<'a, State>,
    shared: &'a Shared,
}

impl Deref for Entered<'_> {
    type Target = State;

    fn deref(&self) -> &State {
        &self.state
    }
}

impl DerefMut for Entered<'_> {
    fn deref_mut(&mut self) -> &mut State {
        &mut self.state
    }
}

impl Drop for Entered<'_> {
    fn drop(&mut self) {
        *self.shared.told.lock() = self.state.counts_now();
    }
}

enum OpenFailure {
    Refused(OutboxError),
    Disk(StoreError),
}

impl From<StoreError> for OpenFailure {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Foreign(reason) => Self::Refused(OutboxError::Foreign(reason)),
            other => Self::Disk(other),
        }
    }
}

impl Shared {
    fn new(config: OutboxConfig, directory: Option<PathBuf>, machine: Option<String>) -> Self {
        Self {
            state: Mutex::new(State {
                store: None,
                lock: None,
                failing: None,
                retry_at: Instant::now(),
                current: Instance::new(machine.clone()),
                memory: VecDeque::new(),
                unsettled: BTreeMap::new(),
                acknowledged: BTreeMap::new(),
                waiting_on_disk: 0,
                settings: BTreeMap::new(),
                unwritten_settings: BTreeSet::new(),
                counts: OutboxCounts::default(),
                revision: 0,
            }),
            config,
            directory,
            machine,
            told: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    fn enter(&self) -> Entered<'_> {
        Entered {
            state: self.state.lock(),
            shared: self,
        }
    }

    fn ring(&self, state: &mut State) {
        state.revision += 1;
        self.changed.notify_all();
    }

    /// Opens the file and brings what waits in memory to it.
    fn open_store(&self, state: &mut State, directory: &Path) -> Result<(), OpenFailure> {
        std::fs::create_dir_all(directory).map_err(|error| OpenFailure::Disk(error.into()))?;
        if state.lock.is_none() {
            let lock = File::options()
                .create(true)
                .truncate(false)
                .write(true)
                .open(directory.join("lock"))
                .map_err(|error| OpenFailure::Disk(error.into()))?;
            match lock.try_lock() {
                Ok(()) => state.lock = Some(lock),
                Err(TryLockError::WouldBlock) => {
                    return Err(OpenFailure::Refused(OutboxError::Locked(
                        directory.to_owned(),
                    )));
                }
                Err(TryLockError::Error(error)) => return Err(OpenFailure::Disk(error.into())),
            }
        }
        let opened = Store::open(&directory.join(FILE), self.machine.as_deref())?;
        for note in &opened.notes {
            state.counts.disk_failures += 1;
            tracing::error!("{note}");
        }
        let mut store = opened.store;
        if opened.current.name != state.current.name {
            if state.current.last == 0 {
                state.current = opened.current;
            } else {
                // Numbers were given while the disk was away: they stay their own instance's.
                state.current = store.begin_instance(state.current.clone(), None)?;
            }
        } else {
            state.current.id = opened.current.id;
        }
        for (instance, upto) in std::mem::take(&mut state.acknowledged) {
            store.remove(instance, upto)?;
        }
        let waiting: Vec<_> = state.memory.iter().cloned().collect();
        store.keep(&state.current, &waiting)?;
        state.memory.clear();
        for name in std::mem::take(&mut state.unwritten_settings) {
            if let Some(json) = state.settings.get(&name)
                && let Err(error) = store.set(&name, json)
            {
                state.unwritten_settings.insert(name);
                return Err(error.into());
            }
        }
        migrate::thresholds(&mut store, directory);
        state.waiting_on_disk = 0;
        state.store = Some(store);
        if let Some(reason) = state.failing.take() {
            tracing::info!(reason, "the state directory can be used again");
        }
        Ok(())
    }

    /// Tries a disk that failed again, when it is time.
    fn look_after_disk(&self, state: &mut State) {
        let Some(directory) = &self.directory else {
            return;
        };
        if state.failing.is_none() || Instant::now() < state.retry_at {
            return;
        }
        state.retry_at = Instant::now() + DISK_RETRY;
        // Opened anew in any case: the file may be another one than before.
        if let Some(store) = state.store.take() {
            state.waiting_on_disk = store.waiting().reports;
        }
        match self.open_store(state, directory) {
            Ok(()) => self.ring(state),
            Err(OpenFailure::Disk(error)) => state.fail(&error),
            Err(OpenFailure::Refused(error)) => {
                let reason = error.to_string();
                if state.failing.as_deref() != Some(&reason) {
                    tracing::error!("{reason}");
                }
                state.failing = Some(reason);
            }
        }
    }

    /// Keeps reports on disk, or in memory while there is none.
    fn store_rows(&self, state: &mut State, rows: Vec<(u64, Vec<u8>)>) {
        self.look_after_disk(state);
        if state.memory.is_empty()
            && let Some(store) = &mut state.store
            && state.failing.is_none()
        {
            match store.keep(&state.current, &rows) {
                Ok(()) => {
                    self.trim(state);
                    return;
                }
                Err(error) => state.fail(&error),
            }
        }
        state.memory.extend(rows);
        while state.memory.len() > self.config.memory_reports {
            state.memory.pop_front();
            state.current.lost += 1;
            tracing::warn!(
                lost = state.current.lost,
                "clip report lost: too many wait in memory"
            );
        }
    }

    fn trim(&self, state: &mut State) {
        let Some(store) = &mut state.store else {
            return;
        };
        let age = u64::from(self.config.max_age_days).saturating_mul(86_400_000_000_000);
        match store.trim(self.config.max_bytes, age) {
            Ok(gone) => {
                for (instance, number) in gone {
                    if instance == state.current.id {
                        state.current.lost += number;
                    }
                    tracing::warn!(
                        number,
                        "clip reports lost: the outbox is full or they are too old"
                    );
                }
            }
            Err(error) => state.fail(&error),
        }
    }

    /// A new instance for everything that waits under the present one.
    fn begin_anew(&self, state: &mut State) {
        let before = state.current.clone();
        let mut fresh = Instance::new(self.machine.clone());
        state.unsettled.clear();
        if let Some(store) = &mut state.store {
            match store.begin_instance(fresh.clone(), Some(before.id)) {
                Ok(begun) => fresh = begun,
                Err(error) => state.fail(&error),
            }
        }
        for (number, json) in &mut state.memory {
            fresh.last += 1;
            *number = fresh.last;
            if let Ok(report) = serde_json::from_slice::<ClipReport>(json) {
                *json = to_json(&ClipReport {
                    report: fresh.last,
                    ..report
                });
            }
        }
        state.acknowledged.remove(&before.id);
        state.current = fresh;
    }
}

impl State {
    fn counts_now(&self) -> OutboxCounts {
        let on_disk = self
            .store
            .as_ref()
            .map_or(self.waiting_on_disk, |store| store.waiting().reports);
        OutboxCounts {
            waiting: on_disk + self.memory.len() as u64,
            in_memory: self.memory.len() as u64,
            lost: self.current.lost,
            failing: self.failing.clone(),
            durable: self.store.is_some() && self.failing.is_none(),
            ..self.counts.clone()
        }
    }

    fn fail(&mut self, error: &StoreError) {
        let reason = format!("the state directory cannot be used: {error}");
        if self.failing.as_deref() != Some(reason.as_str()) {
            tracing::error!("{reason}; clip reports wait in memory");
        }
        if self.failing.is_none() {
            self.retry_at = Instant::now() + DISK_RETRY;
        }
        self.counts.disk_failures += 1;
        self.failing = Some(reason);
        if !error.leaves_file_readable()
            && let Some(store) = self.store.take()
        {
            self.waiting_on_disk = store.waiting().reports;
        }
    }
}

fn batch_of(node: &str, instance: &Instance, reports: Vec<ClipReport>) -> Option<Batch> {
    let (first, last) = (reports.first()?.report, reports.last()?.report);
    Some(Batch {
        instance: instance.id,
        message: ReportBatch {
            v: VERSION,
            node: node.to_owned(),
            instance: instance.name.clone(),
            machine: instance.machine.clone(),
            first,
            last,
            lost: instance.lost,
            reports,
        },
    })
}

fn to_json(report: &ClipReport) -> Vec<u8> {
    // A report holds numbers and text: writing it cannot fail. An empty row would be counted as lost.
    serde_json::to_vec(report).unwrap_or_default()
}
