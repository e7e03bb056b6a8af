//! Stores batches of reports, each group in one transaction, and makes their answers. No thread, no network, no clock.

use super::commit::{Committed, Numbers, write};
use super::decode::Batch;
use super::limits::{ClockCheck, EventLimits};
use crate::config::HistoryConfig;
use crate::presence::News;
use crate::store::retention::retain;
use crate::store::{Access, Database, Store, StoreError};
use albireo_service::clock::Now;
use albireo_wire::ReportAnswer;
use std::time::{Duration, Instant};
use uuid::Uuid;

/// Interval of looking for what is too old, when nothing was found.
const RETENTION: Duration = Duration::from_secs(60);

/// Stores batches in a database.
pub struct Recorder {
    store: Store,
    database: Option<Box<dyn Database>>,
    /// That of the database; known once a first transaction has succeeded.
    identity: Option<Uuid>,
    history: HistoryConfig,
    numbers: Numbers,
    event_limits: EventLimits,
    clock: ClockCheck,
    retention_due: Instant,
}

/// What was committed.
#[derive(Debug)]
pub struct Recorded {
    /// The answer to each batch, in order. There is none before the commit.
    pub answers: Vec<ReportAnswer>,
    pub(crate) committed: Committed,
}

impl Recorder {
    /// Connects at the first use.
    pub fn new(store: &Store, history: &HistoryConfig, now: Now) -> Self {
        Self {
            store: store.clone(),
            database: None,
            identity: None,
            history: history.clone(),
            numbers: Numbers::default(),
            event_limits: EventLimits::default(),
            clock: ClockCheck::new(now.at, now.unix_ms),
            retention_due: now.at,
        }
    }

    /// Whether a transaction has succeeded.
    pub(crate) const fn is_proven(&self) -> bool {
        self.identity.is_some()
    }

    /// Whether it is time to look for what is too old.
    pub fn retention_is_due(&self, now: Instant) -> bool {
        self.retention_due <= now
    }

    /// Stores these batches and `news` in one transaction, and before it deletes some of what is too old if `retention` is
    /// due.
    ///
    /// # Errors
    /// When the database refuses it: then nothing was stored.
    pub fn record(
        &mut self,
        batches: &[Batch],
        news: &News,
        retention: bool,
        now: Now,
    ) -> Result<Recorded, StoreError> {
        if retention {
            let more = self.retain(now).unwrap_or_else(|error| {
                tracing::warn!(%error, "old rows were not deleted; the next try is in a minute");
                false
            });
            let pause = if more { Duration::ZERO } else { RETENTION };
            self.retention_due = now.at + pause;
        }
        let recorded = self.transaction(batches, news, now);
        if recorded.is_err() {
            // What was handed out under this transaction means nothing any more.
            self.numbers.forget();
        }
        recorded
    }

    /// Deletes some of what is too old, and returns whether there is more.
    fn retain(&mut self, now: Now) -> Result<bool, StoreError> {
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        let is_believed = self.clock.is_believed(now.at, now.unix_ms);
        let more = retain(&mut *database, &self.history, now.unix_ms, is_believed)?;
        self.database = Some(database);
        Ok(more)
    }

    fn transaction(
        &mut self,
        batches: &[Batch],
        news: &News,
        now: Now,
    ) -> Result<Recorded, StoreError> {
        // Dropped after an error, which rolls back what it began.
        let mut database = self.store.connect(Access::Write, self.database.take())?;
        let identity = match self.identity {
            Some(identity) => identity,
            None => database.identity()?,
        };
        database.begin()?;
        let (numbers, limits) = (&mut self.numbers, &mut self.event_limits);
        let mut events = news.write(&mut *database, now.unix_ms)?;
        let mut committed = write(&mut *database, numbers, limits, batches, now.unix_ms)?;
        events.append(&mut committed.events);
        database.events(&events)?;
        database.commit()?;
        self.database = Some(database);
        self.identity = Some(identity);
        for batch in batches {
            self.clock.note(&batch.node, batch.clocks_agree);
        }
        committed.events = events;
        let answers = (committed.outcomes.iter_mut())
            .map(|outcome| ReportAnswer {
                refused: std::mem::take(&mut outcome.refused),
                missing: std::mem::take(&mut outcome.wanted),
                ..ReportAnswer::new(identity)
            })
            .collect();
        Ok(Recorded { answers, committed })
    }
}
