//! The way to the disk: opened, found failing, tried again, and brought what came meanwhile.

use super::state::{DISK_RETRY, Shared, State};
use super::store::{Store, StoreError};
use super::{FILE, OutboxError, migrate};
use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::Instant;

/// Why there is no file to write to.
pub(super) enum OpenFailure {
    /// Waiting does not mend it.
    Refused(OutboxError),
    /// It is tried again.
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
    /// Opens the file and brings what waits in memory to it. One that can be read and not written is taken all the
    /// same, for what waits in it.
    pub(super) fn open_store(
        &self,
        state: &mut State,
        directory: &Path,
    ) -> Result<(), OpenFailure> {
        std::fs::create_dir_all(directory).map_err(|error| OpenFailure::Disk(error.into()))?;
        if state.lock.is_none() {
            state.lock = Some(lock(directory)?);
        }
        let file = directory.join(FILE);
        let opened = Store::open(&file, self.machine.as_deref(), state.checked)?;
        for note in &opened.notes {
            state.counts.disk_failures += 1;
            tracing::error!("{note}");
        }
        state.checked = Some(opened.store.inode());
        // Numbers that were given while the disk was away stay their own instance's.
        if state.current.last == 0 || opened.current.name == state.current.name {
            let (last, lost) = (state.current.last, state.current.lost);
            state.current = opened.current;
            state.current.last = state.current.last.max(last);
            state.current.lost = state.current.lost.max(lost);
        }
        state.waiting_on_disk = 0;
        state.store = Some(opened.store);
        if !std::mem::replace(&mut state.settings_read, true) && state.failing.is_some() {
            // What was set meanwhile was set without knowing these: whoever did it looks again.
            state.settings.clear();
            state.unwritten_settings.clear();
            state.settings_returned = true;
        }
        match opened.failing {
            Some(error) => Err(error.into()),
            None => Ok(self
                .catch_up(state, directory)
                .inspect_err(|error| state.close_unless_readable(error))?),
        }
    }

    /// Brings to the open file what could not be written before. What is done is done, also when the rest fails.
    fn catch_up(&self, state: &mut State, directory: &Path) -> Result<(), StoreError> {
        let Some(mut store) = state.store.take() else {
            return Ok(());
        };
        let written = write_all(state, &mut store);
        if written.is_ok() {
            migrate::thresholds(&mut store, directory);
        }
        state.store = Some(store);
        written?;
        if let Some(reason) = state.failing.take() {
            tracing::info!(reason, "the state directory can be used again");
        }
        self.trim(state);
        Ok(())
    }

    /// Tries a disk that failed again, when it is time.
    pub(super) fn look_after_disk(&self, state: &mut State) {
        let Some(directory) = &self.directory else {
            return;
        };
        if state.failing.is_none() || Instant::now() < state.retry_at {
            return;
        }
        let tried = self.try_disk(state, directory);
        state.retry_pause = (state.retry_pause * 2).min(DISK_RETRY.1);
        state.retry_at = Instant::now() + state.retry_pause;
        match tried {
            Ok(()) => self.notify_waiters(),
            // Whatever can still be read stays open.
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

    fn try_disk(&self, state: &mut State, directory: &Path) -> Result<(), OpenFailure> {
        if let Some(store) = &state.store {
            let there = store.check();
            match there.and_then(|()| self.catch_up(state, directory)) {
                Ok(()) => return Ok(()),
                Err(error) if error.passes_by_itself() => return Err(error.into()),
                // A disk that was put in anew may need the file opened anew.
                Err(error) => state.fail_store(&error),
            }
        }
        self.open_store(state, directory)
    }

    /// Keeps reports on disk, or in memory while there is none.
    pub(super) fn store_rows(&self, state: &mut State, rows: Vec<(u64, Vec<u8>)>) {
        self.look_after_disk(state);
        if state.memory.is_empty()
            && state.failing.is_none()
            && let Some(store) = &mut state.store
        {
            match store.keep(&state.current, &rows) {
                Ok(()) => {
                    self.trim(state);
                    return;
                }
                Err(error) => state.fail_store(&error),
            }
        }
        state.memory.extend(rows);
        let mut gone = None;
        while state.memory.len() > self.config.memory_reports {
            gone = state.memory.pop_front().map(|(number, _)| number);
            state.lose(1);
            tracing::warn!(
                lost = state.current.lost,
                "clip report lost: too many wait in memory"
            );
        }
        if let Some(upto) = gone {
            let instance = &state.current.name;
            state
                .unsettled
                .retain(|_, report| report.instance != *instance || report.number > upto);
        }
    }

    /// Writes the energy of reports that are on disk, unless it is known that it cannot be written.
    pub(super) fn write_settled(&self, state: &mut State) {
        if state.settled.is_empty() || state.failing.is_some() {
            return;
        }
        let Some(store) = &mut state.store else {
            return;
        };
        match store.replace(&state.settled) {
            Ok(()) => state.settled.clear(),
            Err(error) => state.fail_store(&error),
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
                        state.lose(number);
                    }
                    state.counts.last_loss = Some(Instant::now());
                    tracing::warn!(
                        number,
                        "clip reports lost: the outbox is full or they are too old"
                    );
                }
            }
            Err(error) => state.fail_store(&error),
        }
    }
}

/// Takes the directory for this node alone.
fn lock(directory: &Path) -> Result<File, OpenFailure> {
    let lock = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(directory.join("lock"))
        .map_err(|error| OpenFailure::Disk(error.into()))?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(OpenFailure::Refused(OutboxError::Locked(
            directory.to_owned(),
        ))),
        Err(TryLockError::Error(error)) => Err(OpenFailure::Disk(error.into())),
    }
}

fn write_all(state: &mut State, store: &mut Store) -> Result<(), StoreError> {
    // Removals first: they make room.
    while let Some((instance, acknowledged)) = state.acknowledged.first_key_value() {
        store.remove(instance, acknowledged.upto)?;
        state.acknowledged.pop_first();
    }
    while let Some((instance, number)) = state.unreadable.first() {
        store.give_up(instance, &[*number])?;
        state.unreadable.pop_first();
    }
    state.current = store.with_row(state.current.clone())?;
    let waiting: Vec<_> = state.memory.iter().cloned().collect();
    store.keep(&state.current, &waiting)?;
    state.memory.clear();
    if !state.settled.is_empty() {
        store.replace(&state.settled)?;
        state.settled.clear();
    }
    while let Some(name) = state.unwritten_settings.first() {
        if let Some(json) = state.settings.get(name) {
            store.set(name, json)?;
        }
        state.unwritten_settings.pop_first();
    }
    Ok(())
}
