//! What ingest counts.

use albireo_wire::RefusalReason;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Ages of acknowledgements and commits that the percentiles are of.
const KEPT: usize = 4096;

macro_rules! counters {
    ($($(#[$meta:meta])* $name:ident,)+) => {
        /// Counters of ingest, since the hub started.
        #[derive(Debug, Default)]
        pub struct IngestCounters {
            $($name: AtomicU64,)+
            acknowledged_after: Ages,
            committed_in: Ages,
            queued: AtomicU64,
            in_hand_since: Mutex<Option<Instant>>,
            queued_bytes: AtomicU64,
        }

        /// Where the counters stand.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct IngestSnapshot {
            $($(#[$meta])* pub $name: u64,)+
            /// 99th percentile of the time from a batch's arrival to its acknowledgement, seconds, of the last ones;
            /// 0 before the first.
            pub acknowledged_after_p99_s: f64,
            /// 99th percentile of the time a transaction took, seconds, of the last ones.
            pub committed_in_p99_s: f64,
            /// Batches that came and are not answered yet.
            pub queued: u64,
            /// Their compressed bytes.
            pub queued_bytes: u64,
        }

        impl IngestCounters {
            $(pub(crate) fn $name(&self, more: u64) {
                self.$name.fetch_add(more, Ordering::Relaxed);
            })+

            /// Where they stand.
            pub fn snapshot(&self) -> IngestSnapshot {
                IngestSnapshot {
                    $($name: self.$name.load(Ordering::Relaxed),)+
                    acknowledged_after_p99_s: self.acknowledged_after.p99().as_secs_f64(),
                    committed_in_p99_s: self.committed_in.p99().as_secs_f64(),
                    queued: self.queued.load(Ordering::Relaxed),
                    queued_bytes: self.queued_bytes.load(Ordering::Relaxed),
                }
            }
        }
    };
}

counters! {
    /// Batches acknowledged.
    batches,
    /// Clips written.
    clips,
    /// Reports that were there already.
    again,
    /// Reports set aside.
    set_aside,
    /// Reports refused because they are too old.
    too_old,
    /// Counts found missing.
    missing,
    /// Counts that began anew: the state of a node was made anew, went back or was copied.
    resets,
    /// Clips of a node whose clock is off.
    clock_off,
    /// Frames of the clips written.
    frames,
    /// Those of them that skipped the detector.
    frames_skipped,
    /// Skipped frames that were drawn and compared by the audit, in the clips written.
    audit_frames,
    /// Those that were drawn and that the detector had no time for.
    audit_missed,
    /// Boxes that the detector found in them.
    audit_detected,
    /// Boxes that had been shown in them.
    audit_shown,
    /// Pairs of both.
    audit_paired,
    /// Energy of the clips written that have a figure, microjoules.
    energy_uj,
    /// Batches refused because too many wait, or their node has sent more than its share.
    refused_busy,
    /// Batches refused because the database could not be written.
    refused_unavailable,
    /// Batches refused because they cannot be read.
    refused_unreadable,
    /// Commits.
    commits,
    /// Transactions that failed.
    database_errors,
    /// Answers that could not be handed over or sent.
    answers_lost,
}

impl IngestCounters {
    pub(crate) fn refuse(&self, reason: RefusalReason) {
        match reason {
            RefusalReason::Busy => self.refused_busy(1),
            RefusalReason::Unavailable => self.refused_unavailable(1),
            RefusalReason::Unreadable => self.refused_unreadable(1),
        }
    }

    pub(crate) fn acknowledged_after(&self, age: Duration) {
        self.acknowledged_after.add(age);
    }

    pub(crate) fn committed_in(&self, took: Duration) {
        self.committed_in.add(took);
    }

    /// When the batch came that was taken from the queue last; nothing once all is written.
    pub(crate) fn in_hand(&self, since: Option<Instant>) {
        *self.in_hand_since.lock() = since;
    }

    /// How long what is being written has waited: a batch that comes now waits as long at least, where as many come as
    /// before.
    pub(crate) fn waited(&self) -> Duration {
        let since = *self.in_hand_since.lock();
        since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    /// Compressed bytes of the batches that wait.
    pub(crate) fn queued_bytes(&self) -> u64 {
        self.queued_bytes.load(Ordering::Relaxed)
    }

    /// Counts a batch among those that wait, until what is returned is dropped.
    pub(crate) fn queue(self: &Arc<Self>, bytes: usize) -> Queued {
        let bytes = bytes as u64;
        self.queued.fetch_add(1, Ordering::Relaxed);
        self.queued_bytes.fetch_add(bytes, Ordering::Relaxed);
        Queued {
            counters: Arc::clone(self),
            bytes,
        }
    }
}

/// A batch's place among those that wait.
#[derive(Debug)]
pub(crate) struct Queued {
    counters: Arc<IngestCounters>,
    bytes: u64,
}

impl Drop for Queued {
    fn drop(&mut self) {
        self.counters.queued.fetch_sub(1, Ordering::Relaxed);
        self.counters
            .queued_bytes
            .fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// The last times of something.
#[derive(Debug, Default)]
struct Ages(Mutex<VecDeque<Duration>>);

impl Ages {
    fn add(&self, age: Duration) {
        let mut ages = self.0.lock();
        if ages.len() == KEPT {
            ages.pop_front();
        }
        ages.push_back(age);
    }

    fn p99(&self) -> Duration {
        let mut ages: Vec<Duration> = self.0.lock().iter().copied().collect();
        if ages.is_empty() {
            return Duration::ZERO;
        }
        let place = (ages.len() * 99).div_ceil(100).saturating_sub(1);
        *ages.select_nth_unstable(place).1
    }
}
