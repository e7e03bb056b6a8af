//! Counts what the hub receives and stores.

use super::outcomes::Outcomes;
use crate::per_node::Place;
use albireo_wire::RefusalReason;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::ops::AddAssign;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::Semaphore;

/// The number of times over which a percentile is taken.
const KEPT: usize = 4096;

/// Most batches that may wait, and most compressed bytes of them; a further batch is answered "busy" immediately.
const MOST_BATCHES: usize = 4096;
const MOST_BYTES: usize = 32 << 20;

/// A batch that arrives while the batches being written have waited longer than this is answered "busy". This is well
/// below the time that nodes wait for an answer: a node sends a batch again that is answered later.
const BUSY_AFTER: Duration = Duration::from_secs(3);

macro_rules! counts {
    ($($name:ident $help:literal $($metric:literal)?;)+) => {
        /// The counters of what the hub receives and stores.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct IngestCounts {
            $(#[doc = $help] pub $name: u64,)+
        }

        impl AddAssign for IngestCounts {
            fn add_assign(&mut self, more: Self) {
                $(self.$name = self.$name.saturating_add(more.$name);)+
            }
        }

        impl IngestCounts {
            /// Name, help and value of the counters that are metrics.
            pub(crate) fn named(&self) -> impl Iterator<Item = (&'static str, &'static str, u64)> {
                [$($(($metric, $help, self.$name),)?)+].into_iter()
            }
        }
    };
}

counts! {
    batches "Batches acknowledged" "albireo_hub_batches_total";
    clips "Clips written" "albireo_hub_clips_total";
    again "Reports that were stored already" "albireo_hub_reports_again_total";
    set_aside "Invalid reports" "albireo_hub_reports_set_aside_total";
    missing "Reports found missing by the running counts of nodes" "albireo_hub_reports_missing_total";
    too_old "Reports refused because they are older than the identities that are kept" "albireo_hub_reports_too_old_total";
    resets "Running counts that restarted: the node's state was new, older or a copy" "albireo_hub_count_resets_total";
    clock_off "Clips of nodes whose clock is wrong" "albireo_hub_clock_off_total";
    commits "Commits" "albireo_hub_commits_total";
    frames "Frames of the clips written" "albireo_hub_frames_total";
    frames_skipped "Frames of the clips written that skipped the detector" "albireo_hub_frames_skipped_total";
    database_errors "Transactions that failed" "albireo_hub_database_errors_total";
    answers_lost "Answers that could not be sent" "albireo_hub_answers_lost_total";
    statuses "Status messages received" "albireo_hub_statuses_total";
    statuses_unreadable "Status messages that cannot be read, are too large, or came under a wrong name" "albireo_hub_statuses_unreadable_total";
    pulls "Pulls of nodes for their desired setting" "albireo_hub_pulls_total";
    audit_frames "Skipped frames that were drawn and compared by the audit, in the clips written";
    audit_missed "Skipped frames that were drawn while the detector was too busy";
    audit_detected "Boxes that the detector found in the compared frames";
    audit_shown "Boxes that were shown in the compared frames";
    audit_paired "Pairs of a detected and a shown box";
    energy_uj "Energy of the clips written that have a figure, microjoules";
    refused_busy "Batches refused because too many were waiting, or their node had used up its share";
    refused_unavailable "Batches refused because the database could not be written";
    refused_unreadable "Batches refused because they cannot be read";
}

/// The counters and times since the hub started.
#[derive(Debug)]
pub struct IngestCounters {
    counts: Mutex<IngestCounts>,
    /// Whether reports are stored.
    pub(crate) outcomes: Outcomes,
    /// Times from a batch's arrival to its acknowledgement.
    pub(crate) acknowledged_after: Ages,
    /// Times that transactions took.
    pub(crate) committed_in: Ages,
    /// The free places for batches, and for their compressed bytes.
    batches: Arc<Semaphore>,
    bytes: Arc<Semaphore>,
    writing_since: Mutex<Option<Instant>>,
}

impl Default for IngestCounters {
    fn default() -> Self {
        Self {
            counts: Mutex::default(),
            outcomes: Outcomes::default(),
            acknowledged_after: Ages::default(),
            committed_in: Ages::default(),
            batches: Arc::new(Semaphore::new(MOST_BATCHES)),
            bytes: Arc::new(Semaphore::new(MOST_BYTES)),
            writing_since: Mutex::default(),
        }
    }
}

impl IngestCounters {
    /// The counts now.
    pub fn counts(&self) -> IngestCounts {
        *self.counts.lock()
    }

    /// The number of batches that are not answered yet.
    pub fn queued(&self) -> usize {
        MOST_BATCHES - self.batches.available_permits()
    }

    /// The compressed bytes of these batches.
    pub(crate) fn queued_bytes(&self) -> usize {
        MOST_BYTES - self.bytes.available_permits()
    }

    /// Adds to the counts.
    pub(crate) fn count(&self, add: impl FnOnce(&mut IngestCounts)) {
        add(&mut self.counts.lock());
    }

    pub(crate) fn refuse(&self, reason: RefusalReason) {
        let mut counts = self.counts.lock();
        match reason {
            RefusalReason::Busy => counts.refused_busy += 1,
            RefusalReason::Unavailable => counts.refused_unavailable += 1,
            RefusalReason::Unreadable => counts.refused_unreadable += 1,
        }
    }

    /// Notes when the batch being written arrived; `None` once all are written.
    pub(crate) fn writing(&self, since: Option<Instant>) {
        *self.writing_since.lock() = since;
    }

    /// Takes the places of one more batch: itself and its bytes. Returns `None` if there is no place, or if the batch being
    /// written has waited so long that another would be answered too late.
    pub(crate) fn queue(&self, bytes: usize) -> Option<[Place; 2]> {
        if let Some(since) = *self.writing_since.lock()
            && since.elapsed() > BUSY_AFTER
        {
            return None;
        }
        let batch = Arc::clone(&self.batches).try_acquire_owned().ok()?;
        let room = Arc::clone(&self.bytes).try_acquire_many_owned(bytes as u32).ok()?;
        Some([batch, room])
    }
}

/// The most recent times of one kind.
#[derive(Debug, Default)]
pub(crate) struct Ages(Mutex<VecDeque<Duration>>);

impl Ages {
    pub(crate) fn add(&self, age: Duration) {
        let mut ages = self.0.lock();
        if ages.len() == KEPT {
            ages.pop_front();
        }
        ages.push_back(age);
    }

    /// Their 99th percentile, seconds; 0 if there are none.
    pub(crate) fn p99_s(&self) -> f64 {
        let mut ages: Vec<Duration> = self.0.lock().iter().copied().collect();
        if ages.is_empty() {
            return 0.0;
        }
        let place = (ages.len() * 99).div_ceil(100).saturating_sub(1);
        let (_, p99, _) = ages.select_nth_unstable(place);
        p99.as_secs_f64()
    }
}
