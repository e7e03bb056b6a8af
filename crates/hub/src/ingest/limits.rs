//! Limits on what one node may send.

use crate::per_node::{PerNode, Place};
use crate::store::tables::EventRow;
use parking_lot::Mutex;
use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Batches of a node that may wait: it sends one after the other, and one may be on its way from before a restart.
const MOST_WAITING: u32 = 2;

/// What a batch costs at least, bytes: many small ones are no less work.
const LEAST_COST: usize = 1 << 10;

/// Longest time after which a node that has used up its allowance may come again.
const LONGEST_WAIT: Duration = Duration::from_secs(3600);

/// Refusals a second that a node is answered; further ones get no answer.
const REFUSALS_PER_S: f64 = 10.0;

/// Nodes whose share is followed.
const MOST_NODES: usize = 200_000;

/// Rows of senseless reports of a node that are kept a day; further ones are only counted.
const SET_ASIDE_PER_DAY: u32 = 100;

const DAY_S: f64 = 86_400.0;

/// Whether a batch is taken.
#[derive(Debug)]
pub(crate) enum Admission {
    /// It waits, in this place.
    Taken(Place),
    /// Not now: when to come again, and why. `None`: the node is not even answered.
    Later(Option<(Duration, &'static str)>),
}

/// What each node has used of what it may send.
#[derive(Debug)]
pub(crate) struct NodeLimits {
    /// Bytes of reports a day for each camera of a node.
    camera_bytes: f64,
    busy_retry: Duration,
    waiting: Arc<PerNode>,
    shares: Mutex<HashMap<String, Share>>,
}

#[derive(Debug)]
struct Share {
    /// Cameras of the node.
    cameras: f64,
    /// Bytes that it may still send; below zero until a batch that was taken is paid for.
    left: f64,
    /// Refusals that it may still be answered.
    refusals: f64,
    refilled_at: Instant,
}

impl Share {
    /// Adds what has become free since it was seen last.
    fn refill(&mut self, camera_bytes: f64, now: Instant) {
        let seconds = now
            .saturating_duration_since(self.refilled_at)
            .as_secs_f64();
        let most = camera_bytes * self.cameras;
        self.left = (self.left + most * seconds / DAY_S).min(most);
        self.refusals = (self.refusals + REFUSALS_PER_S * seconds).min(REFUSALS_PER_S);
        self.refilled_at = now;
    }

    /// Whether one more refusal is answered.
    fn may_be_told(&mut self) -> bool {
        let may = self.refusals >= 1.0;
        if may {
            self.refusals -= 1.0;
        }
        may
    }
}

impl NodeLimits {
    pub(crate) fn new(camera_bytes: u64, busy_retry: Duration) -> Arc<Self> {
        Arc::new(Self {
            camera_bytes: camera_bytes as f64,
            busy_retry,
            waiting: PerNode::new(MOST_WAITING),
            shares: Mutex::default(),
        })
    }

    /// Whether a batch of `node` may wait.
    pub(crate) fn admit(&self, node: &str, now: Instant) -> Admission {
        let mut shares = self.shares.lock();
        if shares.len() >= MOST_NODES && !shares.contains_key(node) {
            let camera_bytes = self.camera_bytes;
            shares.retain(|_, share| {
                share.refill(camera_bytes, now);
                share.left < camera_bytes * share.cameras
            });
            if shares.len() >= MOST_NODES {
                return Admission::Later(None);
            }
        }
        let share = self.share(&mut shares, node, now);
        let refused = if share.left <= 0.0 {
            let per_s = self.camera_bytes * share.cameras / DAY_S;
            let wait = (LEAST_COST as f64 - share.left) / per_s;
            let wait = Duration::try_from_secs_f64(wait).unwrap_or(LONGEST_WAIT);
            let wait = wait.clamp(self.busy_retry, LONGEST_WAIT.max(self.busy_retry));
            (wait, "the node has sent more than its share of today")
        } else if let Some(place) = self.waiting.place(node) {
            return Admission::Taken(place);
        } else {
            (self.busy_retry, "batches of this node wait already")
        };
        Admission::Later(share.may_be_told().then_some(refused))
    }

    /// Whether one more refusal of `node` is answered.
    pub(crate) fn may_refuse(&self, node: &str, now: Instant) -> bool {
        self.share(&mut self.shares.lock(), node, now).may_be_told()
    }

    /// The share of `node` as it is now.
    fn share<'s>(
        &self,
        shares: &'s mut HashMap<String, Share>,
        node: &str,
        now: Instant,
    ) -> &'s mut Share {
        let share = shares.entry(node.to_owned()).or_insert(Share {
            cameras: 1.0,
            left: self.camera_bytes,
            refusals: REFUSALS_PER_S,
            refilled_at: now,
        });
        share.refill(self.camera_bytes, now);
        share
    }

    /// Takes what a batch of `node` costs from its share.
    pub(crate) fn charge(&self, node: &str, bytes: usize) {
        if let Some(share) = self.shares.lock().get_mut(node) {
            share.left -= bytes.max(LEAST_COST) as f64;
        }
    }

    /// Notes how many cameras a node has; each new one brings its share.
    pub(crate) fn has_cameras(&self, node: &str, cameras: usize) {
        if let Some(share) = self.shares.lock().get_mut(node) {
            let more = cameras as f64 - share.cameras;
            if more > 0.0 {
                share.cameras += more;
                share.left += more * self.camera_bytes;
            }
        }
    }
}

/// Events and rows of senseless reports that are written for a node: one event of a kind a minute, some rows a day.
#[derive(Debug, Default)]
pub(crate) struct EventLimits {
    minute: i64,
    events: HashSet<(String, &'static str)>,
    day: i64,
    set_aside: HashMap<String, u32>,
}

impl EventLimits {
    /// Adds an event of a node, unless there was one of its kind in this minute.
    pub(crate) fn event(
        &mut self,
        events: &mut Vec<EventRow>,
        at_ms: i64,
        kind: &'static str,
        node: &str,
        detail: serde_json::Value,
    ) {
        if self.is_first(node, kind, at_ms) {
            events.push(EventRow::new(at_ms, kind, node, detail));
        }
    }

    /// Whether it is the first event of its kind of a node in this minute.
    pub(crate) fn is_first(&mut self, node: &str, kind: &'static str, at_ms: i64) -> bool {
        let minute = at_ms.div_euclid(60_000);
        if std::mem::replace(&mut self.minute, minute) != minute {
            self.events.clear();
        }
        self.events.insert((node.to_owned(), kind))
    }

    /// Whether a row of a senseless report of `node` is to be kept.
    pub(crate) fn may_set_aside(&mut self, node: &str, at_ms: i64) -> bool {
        let day = at_ms.div_euclid(86_400_000);
        if std::mem::replace(&mut self.day, day) != day {
            self.set_aside.clear();
        }
        let kept = self.set_aside.entry(node.to_owned()).or_default();
        *kept += 1;
        *kept <= SET_ASIDE_PER_DAY
    }
}

/// Whether the hub's clock may be believed when it says that something is too old. One that jumped, or that was already off
/// at the start, deletes nothing: nodes know the time too.
#[derive(Debug)]
pub(crate) struct ClockCheck {
    began: Instant,
    began_ms: i64,
    /// Nodes heard last, and whether their clock agrees with the hub's.
    votes: VecDeque<(String, bool)>,
}

/// Nodes whose clocks are compared.
const CLOCKS: usize = 64;

impl ClockCheck {
    pub(crate) fn new(now: Instant, now_ms: i64) -> Self {
        Self {
            began: now,
            began_ms: now_ms,
            votes: VecDeque::new(),
        }
    }

    /// Takes note of a node's clock.
    pub(crate) fn note(&mut self, node: &str, agrees: bool) {
        self.votes.retain(|(name, _)| name != node);
        self.votes.push_back((node.to_owned(), agrees));
        if self.votes.len() > CLOCKS {
            self.votes.pop_front();
        }
    }

    /// Whether most of the nodes agree with the hub's clock, or it has run for a day without a step.
    pub(crate) fn is_believed(&mut self, now: Instant, now_ms: i64) -> bool {
        const DAY: Duration = Duration::from_secs(86_400);
        let ran = now.saturating_duration_since(self.began);
        let expected = i64::try_from(ran.as_millis()).unwrap_or(i64::MAX);
        let stepped = now_ms
            .saturating_sub(self.began_ms)
            .saturating_sub(expected);
        if stepped.saturating_abs() > 86_400_000 {
            *self = Self::new(now, now_ms);
            return false;
        }
        let agree = self.votes.iter().filter(|(_, agrees)| *agrees).count();
        agree * 2 > self.votes.len() || ran >= DAY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MB: u64 = 1_000_000;

    fn limits() -> Arc<NodeLimits> {
        NodeLimits::new(10 * MB, Duration::from_secs(2))
    }

    fn taken(admission: Admission) -> Place {
        match admission {
            Admission::Taken(place) => place,
            Admission::Later(why) => panic!("{why:?}"),
        }
    }

    #[test]
    fn two_batches_of_a_node_may_wait_and_one_more_is_told_to_come_again() {
        let (limits, now) = (limits(), Instant::now());
        let first = taken(limits.admit("a", now));
        let _second = taken(limits.admit("a", now));
        assert!(matches!(limits.admit("a", now), Admission::Later(Some(_))));
        let _other = taken(limits.admit("b", now));
        drop(first);
        taken(limits.admit("a", now));
    }

    #[test]
    fn above_its_allowance_a_node_waits_and_a_backlog_of_weeks_drains_whole() {
        let (limits, start) = (limits(), Instant::now());
        // Three weeks of one camera, five megabytes a day, and what is made meanwhile.
        let day = Duration::from_secs(86_400);
        let (mut backlog, mut now, mut requests) = (3 * 7 * 5 * MB, start, 0);
        let mut made = now;
        while backlog > 0 {
            assert!(now < start + day * 40, "{backlog} left");
            requests += 1;
            match limits.admit("a", now) {
                Admission::Taken(place) => {
                    let batch = backlog.min(MB);
                    limits.charge(place.node(), batch as usize);
                    backlog -= batch;
                }
                Admission::Later(why) => now += why.unwrap().0,
            }
            while now >= made + Duration::from_secs(3456) {
                made += Duration::from_secs(3456);
                backlog += 5 * MB / 25;
            }
        }
        let days = (now - start).as_secs_f64() / DAY_S;
        assert!(
            (15.0..25.0).contains(&days),
            "{days} days, asked {requests} times"
        );
        // Another is not held up by it, and each camera has a share of its own.
        taken(limits.admit("b", now));
        limits.has_cameras("a", 4);
        taken(limits.admit("a", now));
    }

    #[test]
    fn many_small_batches_cost_more_than_their_bytes() {
        let (limits, now) = (limits(), Instant::now());
        let batches = (0..100_000).take_while(|_| match limits.admit("a", now) {
            Admission::Taken(place) => {
                limits.charge(place.node(), 10);
                true
            }
            Admission::Later(_) => false,
        });
        assert!(batches.count() < 11_000);
    }

    #[test]
    fn refusals_are_told_ten_times_a_second() {
        let (limits, now) = (limits(), Instant::now());
        let _waiting: Vec<_> = (0..2).map(|_| taken(limits.admit("a", now))).collect();
        let wait = |now| {
            let all = (0..1000).map(|_| limits.admit("a", now));
            all.filter(|one| matches!(one, Admission::Later(Some(_))))
                .count()
        };
        assert_eq!(wait(now), 10);
        assert_eq!(wait(now + Duration::from_secs(1)), 10);
    }

    #[test]
    fn a_clock_that_jumps_or_that_nodes_deny_is_not_believed() {
        let (start, start_ms) = (Instant::now(), 1_795_000_000_000);
        let hour = |hours: u64| start + Duration::from_secs(3600 * hours);
        let ms = |hours: i64| start_ms + 3_600_000 * hours;
        let mut clock = ClockCheck::new(start, start_ms);
        assert!(!clock.is_believed(hour(1), ms(1)), "nobody says so yet");
        clock.note("a", true);
        clock.note("b", false);
        clock.note("c", true);
        clock.note("c", true);
        assert!(clock.is_believed(hour(1), ms(1)));
        // A hundred days ahead at once.
        assert!(!clock.is_believed(hour(2), ms(2 + 2400)));
        clock.note("a", false);
        assert!(!clock.is_believed(hour(3), ms(3 + 2400)));
        assert!(!clock.is_believed(hour(4), ms(4)), "and back");
        // Where no node's clock is right, a day without a step decides.
        clock.note("a", false);
        assert!(clock.is_believed(hour(29), ms(29)));
    }
}
