//! Limits what one node may send.

use crate::per_node::{PerNode, Place};
use albireo_service::clock::DAY_MS;
use albireo_service::config::DAY_S;
use parking_lot::Mutex;
use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

/// Most batches of a node that may wait: it sends one at a time, and one may be left from before a restart.
const MOST_WAITING: usize = 2;

/// The lowest charge for a batch, bytes: many small batches are as much work as few large ones.
const LEAST_COST: usize = 1 << 10;

/// The time after which a node that is answered "busy" may retry.
pub(super) const BUSY_RETRY: Duration = Duration::from_secs(2);

/// The longest wait for a node that has used up its share.
const LONGEST_WAIT: Duration = Duration::from_secs(3600);

/// Most entries that are written about a node; further ones are only counted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EntryRate {
    /// Most entries of one kind in each span of time.
    pub(super) most: u32,
    /// The length of a span, milliseconds.
    span_ms: i64,
}

/// Most events of a node and kind.
pub(super) const EVENTS: EntryRate = EntryRate {
    most: 1,
    span_ms: 60_000,
};
/// Most events of a node's state, which changes often where the connection is bad.
pub(super) const PRESENCE: EntryRate = EntryRate {
    most: 60,
    span_ms: 3_600_000,
};
/// Most invalid reports of a node that are kept.
pub(super) const SET_ASIDE: EntryRate = EntryRate {
    most: 100,
    span_ms: DAY_MS,
};

/// The share of each node: the bytes that it may still send.
#[derive(Debug)]
pub(crate) struct NodeLimits {
    /// Bytes of reports per day and camera.
    camera_bytes: f64,
    waiting: PerNode,
    shares: Mutex<HashMap<String, Share>>,
}

#[derive(Debug)]
struct Share {
    /// The number of the node's cameras.
    cameras: f64,
    /// Bytes that it may still send; may be negative after a large batch.
    left: f64,
    refilled_at: Instant,
}

/// The reason that a batch has no place now.
#[derive(Debug)]
pub(crate) struct Busy {
    pub(crate) why: &'static str,
    /// The time to wait before the next attempt.
    pub(crate) retry_after: Duration,
}

impl NodeLimits {
    pub(crate) fn new(camera_bytes: u64) -> Self {
        Self {
            camera_bytes: camera_bytes as f64,
            waiting: PerNode::new(MOST_WAITING),
            shares: Mutex::default(),
        }
    }

    /// Takes a place for a batch of `node`.
    ///
    /// # Errors
    /// When the node has used up its share, or has batches waiting already.
    pub(crate) fn admit(&self, node: &str, now: Instant) -> Result<Place, Busy> {
        let mut shares = self.shares.lock();
        let share = shares.entry(node.to_owned()).or_insert(Share {
            cameras: 1.0,
            left: self.camera_bytes,
            refilled_at: now,
        });
        let most = self.camera_bytes * share.cameras;
        let passed = now - share.refilled_at;
        share.left = (share.left + most * passed.as_secs_f64() / DAY_S).min(most);
        share.refilled_at = now;
        if share.left <= 0.0 {
            let wait_s = (LEAST_COST as f64 - share.left) * DAY_S / most;
            let wait = Duration::try_from_secs_f64(wait_s).unwrap_or(LONGEST_WAIT);
            return Err(Busy {
                why: "the node has used up its share for today",
                retry_after: wait.clamp(BUSY_RETRY, LONGEST_WAIT),
            });
        }
        self.waiting.place(node).ok_or(Busy {
            why: "batches of this node are waiting already",
            retry_after: BUSY_RETRY,
        })
    }

    /// Charges a batch to the share of `node`.
    pub(crate) fn charge(&self, node: &str, bytes: usize) {
        if let Some(share) = self.shares.lock().get_mut(node) {
            share.left -= bytes.max(LEAST_COST) as f64;
        }
    }

    /// Notes the number of a node's cameras; each new one adds a camera's share.
    pub(crate) fn note_cameras(&self, node: &str, cameras: usize) {
        if let Some(share) = self.shares.lock().get_mut(node) {
            let more = cameras as f64 - share.cameras;
            if more > 0.0 {
                share.cameras += more;
                share.left += more * self.camera_bytes;
            }
        }
    }
}

/// Limits what is written about each node.
#[derive(Debug)]
pub(crate) struct EntryLimit {
    rate: EntryRate,
    /// The number of the present span of time since the Unix epoch.
    span: i64,
    /// The entries in it, by node and kind.
    counts: HashMap<(String, &'static str), u32>,
    /// Those counted since the last [`begin`](Self::begin).
    since_begin: Vec<(String, &'static str)>,
}

impl EntryLimit {
    pub(crate) fn new(rate: EntryRate) -> Self {
        Self {
            rate,
            span: 0,
            counts: HashMap::new(),
            since_begin: Vec::new(),
        }
    }

    /// Begins a transaction.
    pub(crate) fn begin(&mut self) {
        self.since_begin.clear();
    }

    /// The transaction was rolled back: what was counted in it was not written, and is not counted.
    pub(crate) fn take_back(&mut self) {
        for entry in self.since_begin.drain(..) {
            if let Some(count) = self.counts.get_mut(&entry) {
                *count = count.saturating_sub(1);
            }
        }
    }

    /// Counts one more entry of a node, and returns true if it may be written.
    pub(crate) fn allows(&mut self, node: &str, kind: &'static str, at_ms: i64) -> bool {
        let span = at_ms.div_euclid(self.rate.span_ms);
        if self.span != span {
            self.span = span;
            self.counts.clear();
        }
        let entry = (node.to_owned(), kind);
        self.since_begin.push(entry.clone());
        let count = self.counts.entry(entry).or_default();
        *count = count.saturating_add(1);
        *count <= self.rate.most
    }
}

/// Decides whether the hub may trust its clock to delete old rows. A clock that jumped, or that was wrong from the
/// start, must delete nothing, so the clocks of the nodes are compared with it.
#[derive(Debug)]
pub(crate) struct ClockCheck {
    began: Instant,
    began_ms: i64,
    /// The most recent nodes, one vote each.
    votes: VecDeque<Vote>,
}

/// What a node's clock says about the hub's.
#[derive(Debug)]
struct Vote {
    node: String,
    agrees: bool,
}

/// The number of nodes whose clocks are compared.
const CLOCKS: usize = 64;

impl ClockCheck {
    pub(crate) fn new(now: Instant, now_ms: i64) -> Self {
        Self {
            began: now,
            began_ms: now_ms,
            votes: VecDeque::new(),
        }
    }

    /// Notes whether a node's clock agrees.
    pub(crate) fn note(&mut self, node: &str, agrees: bool) {
        self.votes.retain(|vote| vote.node != node);
        self.votes.push_back(Vote {
            node: node.to_owned(),
            agrees,
        });
        if self.votes.len() > CLOCKS {
            self.votes.pop_front();
        }
    }

    /// True if most nodes agree with the hub's clock, or if it has run for a day without a jump of more than a day. Such a
    /// jump starts that day again, and what the nodes said before it is forgotten.
    pub(crate) fn judge(&mut self, now: Instant, now_ms: i64) -> bool {
        let ran = i64::try_from((now - self.began).as_millis()).unwrap_or(i64::MAX);
        let expected = self.began_ms.saturating_add(ran);
        if now_ms.saturating_sub(expected).saturating_abs() > DAY_MS {
            *self = Self::new(now, now_ms);
            return false;
        }
        let agree = self.votes.iter().filter(|vote| vote.agrees).count();
        agree * 2 > self.votes.len() || ran >= DAY_MS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MB: u64 = 1_000_000;
    const DAY: Duration = Duration::from_secs(86_400);

    fn limits() -> NodeLimits {
        NodeLimits::new(10 * MB)
    }

    #[test]
    fn what_was_rolled_back_is_not_counted() {
        let mut limit = EntryLimit::new(EVENTS);
        let at_ms = 1000;
        limit.begin();
        assert!(limit.allows("car-1", "gap", at_ms));
        limit.take_back();
        limit.begin();
        assert!(limit.allows("car-1", "gap", at_ms));
        // That one was committed: a later transaction that is rolled back does not take it back.
        limit.begin();
        limit.take_back();
        assert!(!limit.allows("car-1", "gap", at_ms), "one a minute");
    }

    #[test]
    fn two_batches_of_a_node_may_wait_and_a_third_is_asked_to_retry() {
        let limits = limits();
        let now = Instant::now();
        let first = limits.admit("a", now).unwrap();
        let _second = limits.admit("a", now).unwrap();
        assert!(limits.admit("a", now).is_err());
        let _other = limits.admit("b", now).unwrap();
        drop(first);
        drop(limits.admit("a", now).unwrap());
    }

    #[test]
    fn above_its_allowance_a_node_waits_and_a_backlog_of_weeks_drains_completely() {
        // One camera makes half of its allowance, a little at a time, and has three weeks of reports to send.
        const MADE_PER_DAY: u64 = 5 * MB;
        const TIMES_PER_DAY: u64 = 25;
        let between = DAY / TIMES_PER_DAY as u32;
        let limits = limits();
        let start = Instant::now();
        let mut backlog = 3 * 7 * MADE_PER_DAY;
        let mut now = start;
        let mut requests = 0;
        let mut last_made = now;
        while backlog > 0 {
            assert!(now < start + DAY * 40, "{backlog} left");
            requests += 1;
            match limits.admit("a", now) {
                Ok(_place) => {
                    let batch = backlog.min(MB);
                    limits.charge("a", batch as usize);
                    backlog -= batch;
                }
                Err(busy) => now += busy.retry_after,
            }
            while now >= last_made + between {
                last_made += between;
                backlog += MADE_PER_DAY / TIMES_PER_DAY;
            }
        }
        let days = (now - start).as_secs_f64() / DAY_S;
        assert!(
            (15.0..25.0).contains(&days),
            "{days} days, asked {requests} times"
        );
        // Another node is not held up by it, and each camera has a share of its own.
        drop(limits.admit("b", now).unwrap());
        limits.note_cameras("a", 4);
        drop(limits.admit("a", now).unwrap());
    }

    #[test]
    fn many_small_batches_cost_more_than_their_bytes() {
        let limits = limits();
        let now = Instant::now();
        let mut batches = 0;
        while batches < 100_000 && limits.admit("a", now).is_ok() {
            limits.charge("a", 10);
            batches += 1;
        }
        // The share would hold a million batches of ten bytes.
        assert!((9_000..11_000).contains(&batches), "{batches}");
    }

    #[test]
    fn a_clock_that_jumps_or_disagrees_with_the_nodes_is_not_trusted() {
        let start = Instant::now();
        let start_ms = 1_795_000_000_000;
        let hour = |hours: u64| start + Duration::from_secs(3600 * hours);
        let ms = |hours: i64| start_ms + 3_600_000 * hours;
        let mut clock = ClockCheck::new(start, start_ms);
        assert!(!clock.judge(hour(1), ms(1)), "nobody says so yet");
        clock.note("a", true);
        clock.note("b", false);
        clock.note("c", true);
        clock.note("c", true);
        assert!(clock.judge(hour(1), ms(1)));
        // A hundred days ahead at once.
        assert!(!clock.judge(hour(2), ms(2 + 2400)));
        clock.note("a", false);
        assert!(!clock.judge(hour(3), ms(3 + 2400)));
        assert!(!clock.judge(hour(4), ms(4)), "and back");
        // Where no node's clock is right, a day without a step decides.
        clock.note("a", false);
        assert!(clock.judge(hour(29), ms(29)));
    }
}
