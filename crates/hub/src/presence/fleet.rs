//! Keeps the states of all nodes in memory.

use super::entry::{NodeEntry, json_bytes};
use super::node::{NodeView, PresenceState};
use super::today::TodaysEnergy;
use crate::config::PresenceConfig;
use crate::store::row::beginning;
use albireo_service::clock::{DAY_MS, Now};
use albireo_service::readiness::Fault;
use albireo_wire::{Heartbeat, StatusMessage, check_node_name};
use parking_lot::{Mutex, RwLock};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Shortest time between two notices to a node.
const NOTIFY_EVERY: Duration = Duration::from_secs(5);
/// Most names in a warning.
const MOST_SHOWN: usize = 5;
/// Most nodes written in one transaction.
const MOST_WRITTEN: usize = 2000;
/// A fleet sends about this many heartbeats per second, as far as that is possible with the times below.
const HEARTBEATS_PER_S: usize = 200;
/// Shortest time between two heartbeats of a node, seconds: the time limits of `[presence]` are for this one.
const SHORTEST_HEARTBEAT_S: u32 = 30;
/// Longest time between two heartbeats of a node, seconds.
const LONGEST_HEARTBEAT_S: u32 = 120;

/// Most names that have sent a status and never a report; a status under a further name is dropped and counted. Without access
/// control anybody can invent names.
const MOST_STRANGERS: usize = 100_000;
/// Time after which such a name is forgotten if it is out of reach.
const STRANGER_MS: i64 = 7 * DAY_MS;
/// Bytes of full statuses that are kept: for all nodes together, and as many more for each node that has sent a report. A
/// status with eight cameras has about 4 kB.
const STATUS_BYTES: usize = 64 << 20;
const STATUS_BYTES_PER_NODE: usize = 16 << 10;

/// The time between two heartbeats of a node in a fleet of so many nodes, seconds.
fn heartbeat_s(nodes: usize) -> u32 {
    let wanted_s = (nodes / HEARTBEATS_PER_S) as u32;
    wanted_s.clamp(SHORTEST_HEARTBEAT_S, LONGEST_HEARTBEAT_S)
}

/// How many times longer than the shortest that is: the time limits grow with it.
fn slowdown(nodes: usize) -> f64 {
    f64::from(heartbeat_s(nodes)) / f64::from(SHORTEST_HEARTBEAT_S)
}

/// What a message says of its node.
enum News {
    /// Nothing: it is not of the known run, or a later one overtook it.
    Nothing,
    /// That the node lives; its row stays as it is.
    Alive,
    /// Something that has to be written into its row.
    Changed,
}

/// The statuses that were dropped.
pub(crate) struct DroppedStatuses {
    /// Under too many names that never sent a report.
    pub(crate) names: u64,
    /// Too large for the memory of all.
    pub(crate) memory: u64,
}

/// All nodes.
#[derive(Debug, Default)]
pub struct Fleet {
    config: PresenceConfig,
    nodes: RwLock<BTreeMap<String, NodeEntry>>,
    /// Nodes whose rows wait to be written.
    dirty: Mutex<BTreeSet<String>>,
    /// Sums over `nodes`, which change only with it.
    sums: Mutex<Sums>,
}

/// What limits the memory of a fleet.
#[derive(Debug, Default)]
struct Sums {
    /// Nodes of which no report was stored.
    strangers: usize,
    /// Nodes of which a report was stored.
    reporting: usize,
    /// Bytes of all full statuses.
    status_bytes: usize,
    /// Statuses under names beyond [`MOST_STRANGERS`].
    names_refused: u64,
    /// Full statuses beyond [`STATUS_BYTES`].
    statuses_refused: u64,
}

impl Sums {
    fn add(&mut self, entry: &NodeEntry) {
        self.status_bytes += entry.status_bytes;
        *self.count_of(entry) += 1;
    }

    fn remove(&mut self, entry: &NodeEntry) {
        self.status_bytes -= entry.status_bytes;
        *self.count_of(entry) -= 1;
    }

    /// The count of the nodes that are like this one.
    fn count_of(&mut self, entry: &NodeEntry) -> &mut usize {
        if entry.has_reported {
            &mut self.reporting
        } else {
            &mut self.strangers
        }
    }

    /// Changes the size of one status; returns false if there is no room.
    fn replace_status(&mut self, before: usize, after: usize) -> bool {
        let room = STATUS_BYTES + self.reporting * STATUS_BYTES_PER_NODE;
        let bytes = self.status_bytes - before + after;
        let fits = after <= before || bytes <= room;
        if fits {
            self.status_bytes = bytes;
        } else {
            self.statuses_refused += 1;
        }
        fits
    }
}

impl Fleet {
    /// A fleet without nodes.
    pub fn new(config: &PresenceConfig) -> Self {
        Self {
            config: config.clone(),
            ..Self::default()
        }
    }

    /// Adds nodes that were read from the database. The time limits of a node that was online begin at `now`. A name of an
    /// earlier version that no node may have now is left out, with a warning: nobody could select it.
    pub fn remember(&self, nodes: Vec<NodeView>, now: Instant) {
        let mut known = self.nodes.write();
        let mut sums = self.sums.lock();
        let mut left_out = Vec::new();
        for node in nodes {
            let name = node.node.clone();
            if check_node_name(&name).is_err() {
                left_out.push(name);
                continue;
            }
            let entry = NodeEntry::remembered(node, now);
            sums.add(&entry);
            if let Some(before) = known.insert(name, entry) {
                sums.remove(&before);
            }
        }
        if !left_out.is_empty() {
            let shown = left_out.iter().take(MOST_SHOWN).map(|name| beginning(name));
            let first = shown.collect::<Vec<_>>().join(", ");
            tracing::warn!(
                nodes = left_out.len(),
                first,
                "nodes whose names no node may have any more are not listed; `albireo fleet forget NAME` forgets one"
            );
        }
    }

    /// Applies a status. Returns true if the node should be asked for a full status.
    pub fn apply_status(&self, node: &str, message: StatusMessage, now: Now) -> bool {
        let silent_s = self.config.silent_after_s * slowdown(self.nodes.read().len());
        self.heard(node, now, |entry| {
            let is_same_process =
                entry.run == Some(message.run) && message.started_ns <= entry.started_ns;
            if is_same_process {
                let is_later = entry.note_seq(message.seq);
                if !is_later {
                    return News::Nothing;
                }
            } else {
                let silent = Duration::from_secs_f64(silent_s);
                entry.another_run(&message, now.at, silent);
            }
            let mut news = News::Alive;
            if entry.node.revision != message.revision {
                news = News::Changed;
            }
            if let Some(full) = message.full {
                entry.needs_full = false;
                if entry.node.status.as_deref() != Some(&*full) {
                    let bytes = json_bytes(&full);
                    let fits = self.sums.lock().replace_status(entry.status_bytes, bytes);
                    if fits {
                        news = News::Changed;
                        entry.status_bytes = bytes;
                        entry.node.status = Some(Arc::from(full));
                    }
                }
            }
            entry.health = message.health;
            entry.node.revision = message.revision;
            entry.node.waiting = message.waiting;
            news
        })
    }

    /// Applies a heartbeat, which repeats the last status of its run except for its numbers. Returns true if the node
    /// should be asked for a full status.
    pub fn alive(&self, node: &str, heartbeat: Heartbeat, now: Now) -> bool {
        self.heard(node, now, |entry| {
            if entry.run != Some(heartbeat.run) {
                // The hub has just started, or messages were lost: the heartbeat is not of the known run.
                entry.needs_full = true;
                return News::Nothing;
            }
            let is_later = entry.note_seq(heartbeat.seq);
            if !is_later {
                return News::Nothing;
            }
            entry.node.waiting = heartbeat.waiting;
            News::Alive
        })
    }

    /// Updates a node's entry by `take`, which applies a message. Returns true if the node should be asked for a full status.
    fn heard(&self, node: &str, now: Now, take: impl FnOnce(&mut NodeEntry) -> News) -> bool {
        let mut nodes = self.nodes.write();
        let slowdown = slowdown(nodes.len());
        if !nodes.contains_key(node) {
            let mut sums = self.sums.lock();
            if sums.strangers >= MOST_STRANGERS {
                sums.names_refused += 1;
                return false;
            }
            let entry = NodeEntry::new(node, now.unix_ms);
            sums.add(&entry);
            nodes.insert(node.to_owned(), entry);
        }
        let Some(entry) = nodes.get_mut(node) else {
            return false;
        };
        let news = take(entry);
        if matches!(news, News::Alive | News::Changed) {
            entry.heard = Some(now.at);
            entry.node.heard_ms = Some(now.unix_ms);
            entry.token_gone = false;
            if matches!(news, News::Changed) {
                self.dirty.lock().insert(node.to_owned());
            }
            self.settle(entry, slowdown, now);
        }
        let is_due = match entry.notified {
            Some(notified) => now.at.saturating_duration_since(notified) >= NOTIFY_EVERY,
            None => true,
        };
        let is_to_be_asked = entry.needs_full && is_due;
        if is_to_be_asked {
            entry.notified = Some(now.at);
        }
        is_to_be_asked
    }

    /// Notes that a liveliness token appeared or disappeared, for the next [`sweep`](Self::sweep).
    pub(crate) fn token(&self, node: &str, is_present: bool) {
        if let Some(entry) = self.nodes.write().get_mut(node) {
            entry.token_gone = !is_present;
        }
    }

    /// Removes a node; its next status adds it again.
    pub(crate) fn forget(&self, node: &str) {
        if let Some(entry) = self.nodes.write().remove(node) {
            self.sums.lock().remove(&entry);
        }
    }

    /// Notes that a report of a node was stored. Adds the node if it has sent no status yet.
    pub(crate) fn reported(&self, node: &str, now_ms: i64) {
        let reads = self.nodes.read();
        if reads.get(node).is_some_and(|entry| entry.has_reported) {
            return;
        }
        drop(reads);
        let mut nodes = self.nodes.write();
        let mut sums = self.sums.lock();
        let mut entry = match nodes.remove(node) {
            Some(entry) => {
                sums.remove(&entry);
                entry
            }
            None => NodeEntry::new(node, now_ms),
        };
        entry.has_reported = true;
        // Its status may have been dropped, as that of a name that somebody invented.
        if entry.node.status.is_none() {
            entry.needs_full = true;
        }
        sums.add(&entry);
        nodes.insert(node.to_owned(), entry);
    }

    /// Up to `most` names that have sent nothing but statuses, and nothing for a week. A node with the label `expected` is no
    /// such name: somebody misses it.
    pub(crate) fn strangers(&self, most: usize, now_ms: i64) -> Vec<String> {
        let nodes = self.nodes.read();
        let is_stranger = |entry: &&NodeEntry| {
            let is_offline = entry.node.state == PresenceState::Offline;
            let is_old = now_ms.saturating_sub(entry.node.since_ms) >= STRANGER_MS;
            let is_expected = entry.node.labels().contains_key("expected");
            !entry.has_reported && is_offline && is_old && !is_expected
        };
        nodes
            .values()
            .filter(is_stranger)
            .take(most)
            .map(|entry| entry.node.node.clone())
            .collect()
    }

    /// The statuses that were dropped.
    pub(crate) fn dropped_statuses(&self) -> DroppedStatuses {
        let sums = self.sums.lock();
        DroppedStatuses {
            names: sums.names_refused,
            memory: sums.statuses_refused,
        }
    }

    /// The fault of the fleet, if names or statuses do not fit.
    pub(crate) fn fault(&self) -> Option<Fault> {
        let sums = self.sums.lock();
        let room = STATUS_BYTES + sums.reporting * STATUS_BYTES_PER_NODE;
        if sums.strangers >= MOST_STRANGERS {
            return Some(Fault::degraded(format!(
                "{MOST_STRANGERS} names have sent a status and never a report; further names are not shown until they send a \
                 report: let only certificates in, and forget the invented names"
            )));
        }
        if sums.statuses_refused == 0 || sums.status_bytes <= room - room / 8 {
            return None;
        }
        Some(Fault::degraded(
            "the full statuses of all nodes do not fit into memory, so some are not shown: look for invented names",
        ))
    }

    /// Sets the energy of the nodes' clips of today; a node that is absent used none.
    pub(super) fn set_today(&self, mut today: HashMap<String, TodaysEnergy>) {
        for (name, entry) in self.nodes.write().iter_mut() {
            entry.node.today = today.remove(name).unwrap_or_default();
        }
    }

    /// Finds the nodes that have become silent or offline.
    pub fn sweep(&self, now: Now) {
        let mut nodes = self.nodes.write();
        let slowdown = slowdown(nodes.len());
        for entry in nodes.values_mut() {
            self.settle(entry, slowdown, now);
        }
    }

    /// Extends the time limits of every node by `time`, during which the hub could receive nothing. The loss of all
    /// liveliness tokens at once says nothing about the nodes.
    pub(crate) fn pass_over(&self, time: Duration) {
        for entry in self.nodes.write().values_mut() {
            entry.token_gone = false;
            entry.heard = entry.heard.map(|heard| heard + time);
        }
    }

    /// The time between two heartbeats of a node, seconds.
    pub(crate) fn heartbeat_s(&self) -> u32 {
        heartbeat_s(self.nodes.read().len())
    }

    /// Judges a node's state, and notes a change.
    fn settle(&self, entry: &mut NodeEntry, slowdown: f64, now: Now) {
        let silent_s = self.config.silent_after_s * slowdown;
        if let Some(twin) = &entry.twin
            && twin.until <= now.at
        {
            entry.twin = None;
        }
        let heard_ago = match (entry.heard, entry.node.heard_ms) {
            (Some(heard), _) => Some(now.at.saturating_duration_since(heard)),
            (None, None) => None,
            // It was silent or offline when the hub started, and has sent nothing since: a silent node can become
            // offline.
            (None, Some(_)) if entry.node.state == PresenceState::Offline => return,
            (None, Some(heard_ms)) => {
                let ago = Duration::from_millis((now.unix_ms - heard_ms).max(0).unsigned_abs());
                Some(ago.max(Duration::from_secs_f64(silent_s)))
            }
        };
        let offline_s = self.config.offline_after_s * slowdown;
        let (state, why) = entry.judge(heard_ago, silent_s, offline_s);
        let node = &mut entry.node;
        if state != node.state {
            node.since_ms = now.unix_ms;
        }
        if state != node.state || why != node.why {
            node.state = state;
            node.why = why;
            self.dirty.lock().insert(node.node.clone());
        }
    }

    /// True if the node's full status is missing.
    pub fn needs_full_status(&self, node: &str) -> bool {
        let nodes = self.nodes.read();
        nodes.get(node).is_some_and(|entry| entry.needs_full)
    }

    /// Takes the nodes whose rows wait to be written, at most as many as one transaction may have.
    pub fn take_dirty(&self) -> Vec<NodeView> {
        let nodes = self.nodes.read();
        let mut dirty = self.dirty.lock();
        let mut taken = Vec::new();
        while taken.len() < MOST_WRITTEN
            && let Some(name) = dirty.pop_first()
        {
            // A node that was forgotten since then has no entry.
            if let Some(entry) = nodes.get(&name) {
                taken.push(entry.node.clone());
            }
        }
        taken
    }

    /// Queues nodes again that were not written.
    pub fn give_back(&self, nodes: Vec<NodeView>) {
        let names = nodes.into_iter().map(|node| node.node);
        self.dirty.lock().extend(names);
    }

    /// The number of nodes in each state, also where it is 0.
    pub(crate) fn by_state(&self) -> BTreeMap<PresenceState, u64> {
        let mut counts = BTreeMap::from(PresenceState::ALL.map(|state| (state, 0)));
        self.each(|node| *counts.entry(node.state).or_default() += 1);
        counts
    }

    /// The number of names that more than one node uses.
    pub(crate) fn twins(&self) -> usize {
        let nodes = self.nodes.read();
        nodes.values().filter(|entry| entry.twin.is_some()).count()
    }

    /// One node.
    pub(crate) fn view(&self, node: &str) -> Option<NodeView> {
        let nodes = self.nodes.read();
        nodes.get(node).map(|entry| entry.node.clone())
    }

    /// The nodes for which `is_wanted` is true, in the order of their names.
    pub(crate) fn views(&self, is_wanted: impl Fn(&NodeView) -> bool) -> Vec<NodeView> {
        self.nodes
            .read()
            .values()
            .map(|entry| &entry.node)
            .filter(|node| is_wanted(node))
            .cloned()
            .collect()
    }

    /// Calls `each` for every node, in the order of their names.
    pub(crate) fn each(&self, mut each: impl FnMut(&NodeView)) {
        for entry in self.nodes.read().values() {
            each(&entry.node);
        }
    }
}
