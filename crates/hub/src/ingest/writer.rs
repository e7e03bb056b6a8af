//! The task that writes: it gathers what waits, commits it, and lets the answers go.

use super::commit::{Committed, Numbers, write};
use super::decode::{Batch, decode};
use super::plan::Outcome;
use super::{IngestCounters, Replies, Waiting, refusal};
use crate::config::{HistoryConfig, IngestConfig};
use crate::desired::Desires;
use crate::events::EventsChanged;
use crate::presence::Fleet;
use crate::readiness::Readiness;
use crate::store::retention::STEP;
use crate::store::{Store, StoreError, Writer};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{RefusalReason, ReportAnswer};
use std::collections::{HashSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio::time::sleep;

/// Time between two looks for what is too old, when nothing was found.
const RETENTION: Duration = Duration::from_secs(60);

/// What the task needs.
pub(crate) struct WriterSetup {
    pub(crate) config: IngestConfig,
    pub(crate) history: HistoryConfig,
    pub(crate) store: Store,
    pub(crate) replies: Replies,
    pub(crate) counters: Arc<IngestCounters>,
    pub(crate) readiness: Arc<Readiness>,
    pub(crate) fleet: Arc<Fleet>,
    pub(crate) desires: Arc<Desires>,
    pub(crate) events: EventsChanged,
}

/// The task.
pub(crate) struct IngestWriter {
    setup: WriterSetup,
    writer: Writer,
    numbers: Numbers,
    /// Read, and not written yet.
    ready: VecDeque<(Waiting, Batch)>,
    retention_due: Instant,
}

impl IngestWriter {
    pub(crate) fn new(setup: WriterSetup) -> Self {
        let writer = setup.store.writer();
        Self {
            setup,
            writer,
            numbers: Numbers::default(),
            ready: VecDeque::new(),
            retention_due: Instant::now(),
        }
    }

    /// Runs until the queue is closed and empty.
    pub(crate) async fn run(mut self, mut queue: mpsc::Receiver<Waiting>) {
        let pause = Duration::from_millis(self.setup.config.commit_ms);
        let mut open = true;
        while open || !self.ready.is_empty() {
            let begun = Instant::now();
            if self.ready.is_empty() {
                if queue.is_empty() {
                    self.setup.counters.in_hand(None);
                }
                // Presence is written also when no report comes.
                let idle = Duration::from_millis(250).max(pause);
                tokio::select! {
                    waiting = queue.recv() => match waiting {
                        Some(waiting) => self.read(waiting),
                        None => open = false,
                    },
                    () = sleep(idle) => {}
                }
            }
            open &= self.gather(&mut queue);
            self.commit().await;
            let rest = pause.saturating_sub(begun.elapsed());
            if open && !rest.is_zero() {
                sleep(rest).await;
            }
        }
        self.commit().await;
        self.writer.close().await;
    }

    /// Takes what waits, as much as one commit may have; whether more may come.
    fn gather(&mut self, queue: &mut mpsc::Receiver<Waiting>) -> bool {
        let mut reports: usize = self
            .ready
            .iter()
            .map(|(_, batch)| batch.reports.len())
            .sum();
        while reports < self.setup.config.commit_reports {
            match queue.try_recv() {
                Ok(waiting) => {
                    let before = self.ready.len();
                    self.read(waiting);
                    if self.ready.len() > before {
                        reports += self
                            .ready
                            .back()
                            .map_or(0, |(_, batch)| batch.reports.len());
                    }
                }
                Err(mpsc::error::TryRecvError::Empty) => return true,
                Err(mpsc::error::TryRecvError::Disconnected) => return false,
            }
        }
        true
    }

    fn read(&mut self, waiting: Waiting) {
        self.setup.counters.in_hand(Some(waiting.since));
        match decode(&waiting.node, &waiting.payload) {
            Ok(batch) => self.ready.push_back((waiting, batch)),
            Err(error) => {
                let reason = RefusalReason::Unreadable;
                self.setup.counters.refuse(reason);
                tracing::warn!(node = waiting.node, %error, "a batch cannot be read");
                self.setup
                    .fleet
                    .unreadable(&waiting.node, &error.to_string(), unix_milliseconds());
                let refusal = refusal(reason, error.to_string(), None);
                self.setup.replies.refuse(waiting.query, refusal);
            }
        }
    }

    /// Commits a group: batches of different instances, since a second one of the same depends on the first.
    async fn commit(&mut self) {
        let mut instances = HashSet::new();
        let (mut group, mut later) = (Vec::new(), VecDeque::new());
        for (waiting, batch) in self.ready.drain(..) {
            if instances.insert((batch.node.clone(), batch.instance.clone())) {
                group.push((waiting, batch));
            } else {
                later.push_back((waiting, batch));
            }
        }
        self.ready = later;
        let retention = self.retention_due <= Instant::now();
        if group.is_empty() && !retention && !self.setup.fleet.has_news() {
            return;
        }
        let (waiting, batches): (Vec<_>, Vec<_>) = group.into_iter().unzip();
        let done = self.transaction(&batches, retention).await;
        match done {
            Ok(committed) => {
                self.setup.readiness.release("database");
                self.acknowledge(waiting, &batches, committed);
            }
            Err(error) if !error.passes() && batches.len() > 1 => {
                tracing::error!(%error, "a group of batches is refused; each is tried alone");
                for (waiting, batch) in waiting.into_iter().zip(batches) {
                    let alone = [batch];
                    match self.transaction(&alone, false).await {
                        Ok(committed) => self.acknowledge(vec![waiting], &alone, committed),
                        Err(error) => self.refuse(vec![waiting], &error),
                    }
                }
            }
            Err(error) => {
                self.refuse(waiting, &error);
                if error.passes() {
                    self.setup.readiness.hold("database", &error.to_string());
                    sleep(Duration::from_millis(500)).await;
                }
            }
        }
    }

    async fn transaction(
        &mut self,
        batches: &[Batch],
        retention: bool,
    ) -> Result<Committed, StoreError> {
        let begun = Instant::now();
        let done = self.try_transaction(batches, retention).await;
        if done.is_ok() {
            self.setup.counters.committed_in(begun.elapsed());
        }
        if let Err(error) = &done {
            self.setup.counters.database_errors(1);
            tracing::error!(%error, batches = batches.len(), "nothing was committed");
            // What was handed out under this transaction means nothing any more.
            self.numbers.forget();
            self.writer.give_up().await;
        }
        done
    }

    async fn try_transaction(
        &mut self,
        batches: &[Batch],
        retention: bool,
    ) -> Result<Committed, StoreError> {
        let now_ms = unix_milliseconds();
        let mut writing = self.writer.begin().await?;
        let mut committed = write(
            &mut writing,
            &mut self.numbers,
            batches,
            &self.setup.history,
            now_ms,
        )
        .await?;
        let news = self.setup.fleet.take_news();
        let written = news.write(&mut writing, &mut self.numbers, now_ms).await;
        let mut deleted = 0;
        let ended = match written {
            Ok(events) => {
                committed.events |= events;
                let retained = if retention {
                    writing.retain(&self.setup.history, now_ms).await
                } else {
                    Ok(0)
                };
                match retained {
                    Ok(rows) => {
                        deleted = rows;
                        writing.commit().await
                    }
                    Err(error) => Err(error),
                }
            }
            Err(error) => Err(error),
        };
        if let Err(error) = ended {
            self.setup.fleet.give_back(news);
            return Err(error);
        }
        if retention {
            let more = deleted >= STEP.unsigned_abs();
            let pause = if more { Duration::ZERO } else { RETENTION };
            self.retention_due = Instant::now() + pause;
        }
        self.setup.counters.commits(1);
        Ok(committed)
    }

    fn acknowledge(&self, waiting: Vec<Waiting>, batches: &[Batch], committed: Committed) {
        let setup = &self.setup;
        let counters = &setup.counters;
        counters.clips(committed.clips);
        counters.again(committed.again);
        counters.set_aside(committed.set_aside);
        counters.missing(committed.missing);
        counters.conflicts(committed.conflicts);
        counters.clock_off(committed.clock_off);
        counters.frames(committed.frames);
        counters.frames_skipped(committed.skipped);
        counters.audit_frames(committed.audit.frames);
        counters.audit_missed(committed.audit.missed);
        counters.audit_detected(committed.audit.detected);
        counters.audit_shown(committed.audit.shown);
        counters.audit_paired(committed.audit.paired);
        counters.energy_uj(committed.energy_uj);
        if committed.events {
            setup.events.tell();
        }
        for batch in batches {
            setup.fleet.reported(&batch.node, unix_milliseconds());
        }
        for (place, at_ms, used) in committed.used {
            if let Some(batch) = batches.get(place) {
                setup.fleet.used(&batch.node, at_ms, used);
            }
        }
        for ((waiting, batch), outcome) in waiting.into_iter().zip(batches).zip(committed.outcomes)
        {
            match outcome {
                Outcome::Stored(number) => {
                    counters.batches(1);
                    counters.acknowledged_after(waiting.since.elapsed());
                    let mut desired = setup.desires.of(&batch.node);
                    desired.send_full_status = setup.fleet.needs_full_status(&batch.node);
                    let answer = ReportAnswer::new(number.unsigned_abs(), Some(desired));
                    setup.replies.answer(waiting.query, &answer);
                }
                Outcome::Conflict(reason) => {
                    tracing::warn!(node = batch.node, reason, "a batch is in conflict");
                    counters.refuse(RefusalReason::Conflict);
                    let refusal = refusal(RefusalReason::Conflict, reason, None);
                    setup.replies.refuse(waiting.query, refusal);
                }
            }
        }
    }

    fn refuse(&self, waiting: Vec<Waiting>, error: &StoreError) {
        let reason = RefusalReason::Unavailable;
        for waiting in waiting {
            self.setup.counters.refuse(reason);
            let retry = Some(self.setup.config.unavailable_retry_ms);
            let refusal = refusal(reason, error.to_string(), retry);
            self.setup.replies.refuse(waiting.query, refusal);
        }
    }
}
