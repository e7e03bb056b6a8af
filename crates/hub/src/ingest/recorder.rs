//! Writes groups of batches, each in one transaction, and builds their answers. It starts no thread and reads no clock.

use super::counters::IngestCounts;
use super::decode::Batch;
use super::group::Group;
use super::limits::{ClockCheck, EVENTS, EntryLimit, PRESENCE, SET_ASIDE};
use super::outcomes::Written;
use super::retention::{DeleteOld, retain};
use crate::config::HistoryConfig;
use crate::presence::NodeView;
use crate::store::row::beginning;
use crate::store::{Access, Database, EventRow, Store, StoreError};
use albireo_service::clock::Now;
use albireo_wire::ReportAnswer;
use serde_json::json;
use std::time::{Duration, Instant};

/// Interval between two searches for old rows, after one that found none.
const RETENTION: Duration = Duration::from_secs(60);

/// Most events of unreadable batches that wait for the database; further ones are dropped.
const MOST_EVENTS: usize = 1000;

/// Stores batches in a database.
pub struct Recorder {
    store: Store,
    database: Option<Box<dyn Database>>,
    history: HistoryConfig,
    /// Deletes old rows of other rooms' tables.
    delete_more: Option<DeleteOld>,
    /// Events of unreadable batches, which the next commit writes.
    events: Vec<EventRow>,
    event_limit: EntryLimit,
    presence_limit: EntryLimit,
    aside_limit: EntryLimit,
    clock: ClockCheck,
    retention_due: Instant,
    /// True if the next transaction writes a row in any case.
    proves_writing: bool,
}

/// The result of a commit.
#[derive(Debug, Default)]
pub struct Recorded {
    /// The answer to each batch, in order.
    pub answers: Vec<ReportAnswer>,
    /// The number of cameras of each batch's node, as far as they count for its share, in order.
    pub(crate) cameras: Vec<usize>,
    /// The additions to the counters.
    pub(crate) counts: IngestCounts,
    /// What is now stored for certain: a report or the row of a proof. Rows written at every commit say nothing of it.
    pub(super) written: Written,
}

impl Recorder {
    /// Creates a recorder, which connects at its first use.
    pub fn new(store: &Store, history: &HistoryConfig, now: Now) -> Self {
        Self {
            store: store.clone(),
            database: None,
            history: history.clone(),
            delete_more: None,
            events: Vec::new(),
            event_limit: EntryLimit::new(EVENTS),
            presence_limit: EntryLimit::new(PRESENCE),
            aside_limit: EntryLimit::new(SET_ASIDE),
            clock: ClockCheck::new(now.at, now.unix_ms),
            retention_due: now.at,
            proves_writing: false,
        }
    }

    /// Deletes old rows of other tables, too, when it deletes its own: it knows whether the clock may be believed.
    pub(crate) fn also_deletes(self, delete: DeleteOld) -> Self {
        Self {
            delete_more: Some(delete),
            ..self
        }
    }

    /// Lets the next transaction write a row in any case: it then shows whether the database accepts a commit.
    pub(super) fn prove_writing(&mut self) {
        self.proves_writing = true;
    }

    /// Notes that a batch of a node cannot be read.
    pub(super) fn unreadable(&mut self, node: &str, reason: &str, now_ms: i64) {
        if self.events.len() < MOST_EVENTS && self.event_limit.allows(node, "refused", now_ms) {
            let reason = beginning(reason);
            tracing::warn!(node, reason, "a batch cannot be read");
            let detail = json!({ "reason": reason });
            self.events.push(EventRow::of(now_ms, "refused", node, detail));
        }
    }

    /// Stores batches, and the states of `nodes`, in one transaction. If it is time, first deletes some old rows.
    ///
    /// # Errors
    /// When the database refuses the transaction: then nothing is stored.
    pub fn record(
        &mut self,
        batches: &[Batch],
        nodes: &[NodeView],
        now: Now,
    ) -> Result<Recorded, StoreError> {
        if self.retention_due <= now.at {
            let has_more = match self.retain(now) {
                Ok(has_more) => has_more,
                Err(error) => {
                    tracing::warn!(%error, "old rows were not deleted; trying again in a minute");
                    false
                }
            };
            let pause = if has_more { Duration::ZERO } else { RETENTION };
            self.retention_due = now.at + pause;
        }
        for limit in self.limits() {
            limit.begin();
        }
        let recorded = self.transact(batches, nodes, now);
        if recorded.is_err() {
            for limit in self.limits() {
                limit.take_back();
            }
        }
        recorded
    }

    fn limits(&mut self) -> [&mut EntryLimit; 3] {
        [
            &mut self.event_limit,
            &mut self.presence_limit,
            &mut self.aside_limit,
        ]
    }

    /// Writes everything in one transaction. After an error the connection is dropped, which rolls it back.
    fn transact(
        &mut self,
        batches: &[Batch],
        nodes: &[NodeView],
        now: Now,
    ) -> Result<Recorded, StoreError> {
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        database.begin()?;
        // What nodes newly say of themselves becomes events.
        let mut events = database.write_nodes(nodes)?;
        events.retain(|event| {
            let node = event.node.as_deref().unwrap_or_default();
            self.presence_limit.allows(node, "node", now.unix_ms)
        });
        events.extend_from_slice(&self.events);
        let mut recorded = if batches.is_empty() {
            Recorded::default()
        } else {
            self.write(&mut *database, batches, now.unix_ms, &mut events)?
        };
        database.insert_events(&events)?;
        if self.proves_writing {
            database.prove_writing(now.unix_ms)?;
        }
        database.commit()?;
        recorded.written = if recorded.counts.clips > 0 {
            Written::Reports
        } else if self.proves_writing {
            Written::Rows
        } else {
            Written::Nothing
        };
        self.proves_writing = false;
        self.database = Some(database);
        self.events.clear();
        for batch in batches {
            self.clock.note(&batch.node, batch.clocks_agree);
        }
        Ok(recorded)
    }

    /// Deletes some old rows. Returns true if there are more.
    fn retain(&mut self, now: Now) -> Result<bool, StoreError> {
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        let is_believed = self.clock.judge(now.at, now.unix_ms);
        let has_more = retain(
            &mut *database,
            &self.history,
            self.delete_more,
            now.unix_ms,
            is_believed,
        )?;
        self.database = Some(database);
        Ok(has_more)
    }

    /// Writes `batches` into the transaction: identities of reports, clips, sums, counts, and invalid reports.
    fn write(
        &mut self,
        database: &mut dyn Database,
        batches: &[Batch],
        now_ms: i64,
        events: &mut Vec<EventRow>,
    ) -> Result<Recorded, StoreError> {
        let mut group = Group::load(database, batches, now_ms)?;
        let mut recorded = Recorded::default();
        for batch in batches {
            let result = group.add(database, batch, &mut self.aside_limit)?;
            for event in result.events {
                if self.event_limit.allows(&batch.node, event.kind, now_ms) {
                    events.push(EventRow::of(now_ms, event.kind, &batch.node, event.detail));
                }
            }
            recorded.counts += result.counts;
            recorded.answers.push(result.answer);
            recorded.cameras.push(group.cameras_of(batch));
        }
        group.write(database)?;
        Ok(recorded)
    }
}
