//! What the outbox knows, behind one lock that is held while a disk is written.

use super::store::{Inode, Instance, Store, StoreError};
use super::{OutboxConfig, OutboxCounts, Ticket};
use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::ops::{Deref, DerefMut};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// First and longest time between two looks at a disk that failed.
pub(super) const DISK_RETRY: (Duration, Duration) =
    (Duration::from_secs(2), Duration::from_secs(30));

#[derive(Debug)]
pub(super) struct Shared {
    pub(super) config: OutboxConfig,
    pub(super) directory: Option<PathBuf>,
    pub(super) machine: Option<String>,
    pub(super) state: Mutex<State>,
    /// The counts as they were after the last change, for readers that must not wait for a disk.
    pub(super) published_counts: Mutex<OutboxCounts>,
    /// Goes up when the sender should look. A lock of its own: whoever wakes the sender must not wait for a disk.
    pub(super) revision: Mutex<u64>,
    pub(super) changed: Condvar,
}

#[derive(Debug)]
pub(super) struct State {
    /// The open file; kept while it can be read, also when it cannot be written.
    pub(super) store: Option<Store>,
    pub(super) lock: Option<File>,
    /// Why nothing can be kept on disk now.
    pub(super) failing: Option<String>,
    pub(super) retry_at: Instant,
    pub(super) retry_pause: Duration,
    /// The file whose contents were found sound.
    pub(super) checked: Option<Inode>,
    pub(super) current: Instance,
    /// Reports of `current` that are not on disk, in order, above all that are.
    pub(super) memory: VecDeque<(u64, Vec<u8>)>,
    /// Reports whose energy is not known yet.
    pub(super) unsettled: BTreeMap<Ticket, Unsettled>,
    pub(super) tickets: u64,
    /// Reports on disk, by instance and number, that have got their energy since the disk could be written last.
    pub(super) settled: BTreeMap<(String, u64), Vec<u8>>,
    /// Reports on disk, by instance and number, that cannot be read and are counted as lost.
    pub(super) unreadable: BTreeSet<(String, u64)>,
    /// What a hub has of each instance and the disk could not forget.
    pub(super) acknowledged: BTreeMap<String, Acknowledgement>,
    /// What waited on disk when it failed.
    pub(super) waiting_on_disk: u64,
    pub(super) settings: BTreeMap<String, String>,
    pub(super) unwritten_settings: BTreeSet<String>,
    /// Whether the file was open once, so that its settings are known.
    pub(super) settings_read: bool,
    /// Whether the file was first opened when the settings had been asked for already.
    pub(super) settings_returned: bool,
    pub(super) counts: OutboxCounts,
}

/// Where a report without its energy is.
#[derive(Debug)]
pub(super) struct Unsettled {
    pub(super) instance: String,
    pub(super) number: u64,
    pub(super) since: Instant,
}

/// What a hub has of an instance.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Acknowledgement {
    /// Everything up to this number.
    pub(super) upto: u64,
    /// How many reports on disk that are.
    pub(super) reports: u64,
}

/// The state while it is worked on; its counts are published at the end.
pub(super) struct Entered<'a> {
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
        *self.shared.published_counts.lock() = self.state.counts_now();
    }
}

impl Shared {
    pub(super) fn new(
        config: OutboxConfig,
        directory: Option<PathBuf>,
        machine: Option<String>,
    ) -> Self {
        Self {
            state: Mutex::new(State::new(Instance::new(machine.clone()))),
            config,
            directory,
            machine,
            published_counts: Mutex::default(),
            revision: Mutex::new(0),
            changed: Condvar::new(),
        }
    }

    pub(super) fn enter(&self) -> Entered<'_> {
        Entered {
            state: self.state.lock(),
            shared: self,
        }
    }

    /// Makes the sender look.
    pub(super) fn notify_waiters(&self) {
        *self.revision.lock() += 1;
        self.changed.notify_all();
    }

    /// A new instance for everything that waits under the present one.
    pub(super) fn begin_anew(&self, state: &mut State) {
        let before = state.current.name.clone();
        let mut fresh = match self.move_to_new_instance(state, &before) {
            Ok(moved) => moved,
            Err(error) => {
                state.fail_store(&error);
                Instance::new(self.machine.clone())
            }
        };
        let mut moved = BTreeMap::new();
        for (number, _) in &mut state.memory {
            fresh.last += 1;
            moved.insert(*number, fresh.last);
            *number = fresh.last;
        }
        state.renumber(&before, &fresh.name, &moved);
        state.current = fresh;
    }

    /// Writes a new instance down and renumbers what waits on disk under the instance `from` as its own.
    pub(super) fn move_to_new_instance(
        &self,
        state: &mut State,
        from: &str,
    ) -> Result<Instance, StoreError> {
        let fresh = Instance::new(self.machine.clone());
        let Some(store) = &mut state.store else {
            return Ok(fresh);
        };
        // What a hub has already must not be given a second number.
        if let Some(acknowledged) = state.acknowledged.get(from) {
            store.remove(from, acknowledged.upto)?;
            state.acknowledged.remove(from);
        }
        let of_it = |instance: &String| instance == from;
        let followed: Vec<u64> = (state.unsettled.values())
            .filter(|report| of_it(&report.instance))
            .map(|report| report.number)
            .chain(
                (state.settled.keys())
                    .chain(&state.unreadable)
                    .filter(|(instance, _)| of_it(instance))
                    .map(|(_, number)| *number),
            )
            .collect();
        let places = store.places(from, &followed)?;
        let begun = store.begin_instance(fresh, Some(from))?;
        state.renumber(from, &begun.name, &places);
        Ok(begun)
    }
}

impl State {
    fn new(current: Instance) -> Self {
        Self {
            store: None,
            lock: None,
            failing: None,
            retry_at: Instant::now(),
            retry_pause: DISK_RETRY.0,
            checked: None,
            current,
            memory: VecDeque::new(),
            unsettled: BTreeMap::new(),
            tickets: 0,
            settled: BTreeMap::new(),
            unreadable: BTreeSet::new(),
            acknowledged: BTreeMap::new(),
            waiting_on_disk: 0,
            settings: BTreeMap::new(),
            unwritten_settings: BTreeSet::new(),
            settings_read: false,
            settings_returned: false,
            counts: OutboxCounts::default(),
        }
    }

    /// The number up to which a hub has the reports of an instance and the disk could not forget them.
    pub(super) fn acknowledged_upto(&self, instance: &str) -> u64 {
        self.acknowledged.get(instance).map_or(0, |a| a.upto)
    }

    /// Reports on disk that no hub has acknowledged.
    pub(super) fn unsent_on_disk(&self) -> u64 {
        let on_disk = self
            .store
            .as_ref()
            .map_or(self.waiting_on_disk, |store| store.waiting().reports);
        let acknowledged: u64 = self.acknowledged.values().map(|a| a.reports).sum();
        let unreadable = self.unreadable.len() as u64;
        on_disk.saturating_sub(acknowledged + unreadable)
    }

    /// Follows reports that have got other numbers under another instance.
    pub(super) fn renumber(&mut self, from: &str, to: &str, moved: &BTreeMap<u64, u64>) {
        for report in self.unsettled.values_mut() {
            if report.instance == from
                && let Some(number) = moved.get(&report.number)
            {
                report.instance = to.to_owned();
                report.number = *number;
            }
        }
        let follow = |(instance, number): (String, u64)| match moved.get(&number) {
            Some(number) if instance == from => (to.to_owned(), *number),
            _ => (instance, number),
        };
        self.settled = std::mem::take(&mut self.settled)
            .into_iter()
            .map(|(place, json)| (follow(place), json))
            .collect();
        self.unreadable = std::mem::take(&mut self.unreadable)
            .into_iter()
            .map(follow)
            .collect();
    }

    /// Forgets what was still to be done about reports that are gone; how many of them could not be read.
    pub(super) fn forget(&mut self, instance: &str, upto: u64) -> u64 {
        let gone = |of: &str, number: u64| of == instance && number <= upto;
        self.unsettled
            .retain(|_, report| !gone(&report.instance, report.number));
        self.settled.retain(|(of, number), _| !gone(of, *number));
        let before = self.unreadable.len();
        self.unreadable.retain(|(of, number)| !gone(of, *number));
        (before - self.unreadable.len()) as u64
    }

    /// Counts reports of the present instance as lost.
    pub(super) fn lose(&mut self, reports: u64) {
        if reports > 0 {
            self.current.lost += reports;
            self.counts.last_loss = Some(Instant::now());
        }
    }

    pub(super) fn counts_now(&self) -> OutboxCounts {
        OutboxCounts {
            waiting: self.unsent_on_disk() + self.memory.len() as u64,
            in_memory: self.memory.len() as u64,
            lost: self.current.lost,
            failing: self.failing.clone(),
            durable: self.store.is_some() && self.failing.is_none(),
            ..self.counts.clone()
        }
    }

    /// Takes note that nothing can be kept on disk.
    pub(super) fn fail(&mut self, error: &StoreError) {
        if error.is_corruption() {
            self.checked = None;
        }
        let reason = format!("the state directory cannot be used: {error}");
        if self.failing.as_deref() != Some(reason.as_str()) {
            tracing::error!("{reason}; clip reports wait in memory");
        }
        if self.failing.is_none() {
            self.retry_pause = DISK_RETRY.0;
            self.retry_at = Instant::now() + self.retry_pause;
        }
        self.counts.disk_failures += 1;
        self.failing = Some(reason);
    }

    /// As [`fail`](Self::fail), where the open file failed: it is closed unless it can still be read.
    pub(super) fn fail_store(&mut self, error: &StoreError) {
        self.fail(error);
        self.close_unless_readable(error);
    }

    /// Closes the file after an error that leaves nothing to be read.
    pub(super) fn close_unless_readable(&mut self, error: &StoreError) {
        if !error.leaves_file_readable()
            && let Some(store) = self.store.take()
        {
            self.waiting_on_disk = store.waiting().reports;
        }
    }
}
