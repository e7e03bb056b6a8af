//! The states of all nodes, in memory.

use super::entry::{Entry, Run};
use super::news::News;
use super::settings::NodeSettings;
use super::state::{Limits, PresenceInput, PresenceState, Token, judge};
use super::today::{TodaysEnergy, Used, day_of};
use crate::config::PresenceConfig;
use crate::store::tables::{EventRow, NodeRow};
use crate::store::{Store, StoreError};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{Heartbeat, NodeStatus, StatusMessage, TargetStatus};
use parking_lot::{Mutex, RwLock};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use utoipa::ToSchema;

/// Most nodes written in one transaction.
const MOST_NEWS: usize = 2000;
/// Most notices that wait for the database; further ones are only counted.
const MOST_NOTICES: usize = 1000;

/// A node as it is shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NodeView {
    /// Its name.
    pub node: String,
    /// How it is.
    pub state: PresenceState,
    /// Since when, milliseconds since the Unix epoch.
    pub since_ms: i64,
    /// Why; empty when online.
    pub why: String,
    /// When the last status came, milliseconds since the Unix epoch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heard_ms: Option<i64>,
    /// Reports that wait in its outbox.
    pub waiting: u64,
    /// Revision of the desired value in force.
    pub revision: u64,
    /// What its clips of today (UTC) used and saved.
    pub today: TodaysEnergy,
    /// The last full status.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<NodeStatus>)]
    pub status: Option<serde_json::Value>,
}

/// What all nodes are counted by, beside their states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FleetTallies {
    /// Names that more than one node uses.
    pub twins: u64,
    /// Nodes that are heard and have not taken yet what is desired of them.
    pub behind: u64,
    /// Reports that wait in their outboxes, as far as they reported.
    pub waiting: u64,
    /// Nodes that are heard and hold a target, by its status, in the order of [`TargetStatus::ALL`].
    pub targets: [u64; TargetStatus::ALL.len()],
}

/// All nodes.
#[derive(Debug)]
pub struct Fleet {
    limits: Limits,
    nodes: RwLock<BTreeMap<Arc<str>, Entry>>,
    /// Nodes to be written.
    dirty: Mutex<VecDeque<Arc<str>>>,
    notices: Mutex<Vec<EventRow>>,
    /// Where the sweep goes on.
    swept: Mutex<Option<Arc<str>>>,
    statuses: AtomicU64,
}

impl Fleet {
    /// Nobody yet.
    pub fn new(config: &PresenceConfig) -> Self {
        let seconds = |s: f64| Duration::try_from_secs_f64(s).unwrap_or(Duration::MAX);
        Self {
            limits: Limits {
                silent: seconds(config.silent_after_s),
                offline: seconds(config.offline_after_s),
            },
            nodes: RwLock::default(),
            dirty: Mutex::default(),
            notices: Mutex::default(),
            swept: Mutex::default(),
            statuses: AtomicU64::new(0),
        }
    }

    /// Takes what the database remembers; the number of nodes. Who was heard then has until the silent limit from `now` on to be
    /// heard again.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn read(&self, store: &Store, now: Instant) -> Result<usize, StoreError> {
        let nodes = store.nodes().await?;
        let many = nodes.len();
        self.remember(nodes, now);
        Ok(many)
    }

    pub(super) fn remember(&self, nodes: Vec<NodeRow>, now: Instant) {
        let mut map = self.nodes.write();
        for node in nodes {
            let name: Arc<str> = node.name.as_str().into();
            map.insert(name, Entry::remembered(node, now));
        }
    }

    /// Takes a status; whether the node should be asked for a full status.
    pub fn apply_status(
        &self,
        node: &str,
        message: &StatusMessage,
        now: Instant,
        now_ms: i64,
    ) -> bool {
        self.statuses.fetch_add(1, Ordering::Relaxed);
        let mut nodes = self.nodes.write();
        let name: Arc<str> = match nodes.get_key_value(node) {
            Some((name, _)) => Arc::clone(name),
            None => node.into(),
        };
        let entry = nodes
            .entry(Arc::clone(&name))
            .or_insert_with(|| Entry::new(now_ms));
        let run = Run::of(message);
        let same = entry.run.as_ref() == Some(&run);
        if same && message.full.is_none() && !entry.needs_full && message.seq <= entry.seq {
            // Overtaken by a later one.
            return false;
        }
        let follows = same && entry.seq.checked_add(1) == Some(message.seq);
        if !same {
            entry.another_run(run, now, self.limits.silent);
        }
        let mut changed = entry.revision != message.revision;
        entry.heard = Some(now);
        entry.heard_ms = Some(now_ms);
        if entry.token == Token::Gone {
            entry.token = Token::Unknown;
        }
        entry.seq = message.seq;
        entry.waiting = message.waiting;
        entry.revision = message.revision;
        match &message.full {
            Some(full) => {
                entry.needs_full = false;
                changed |= entry.take_status(full);
            }
            None if !follows => entry.needs_full = true,
            None => {}
        }
        entry.health = message.health;
        if changed {
            self.mark(&name, entry);
        }
        self.settle(&name, entry, now, now_ms);
        entry.ask_for_all(now)
    }

    /// Takes a heartbeat; whether the node should be asked for a full status.
    pub fn alive(&self, node: &str, heartbeat: Heartbeat, now: Instant, now_ms: i64) -> bool {
        let known = self
            .nodes
            .read()
            .get(node)
            .and_then(|entry| entry.alive(heartbeat));
        if let Some(message) = known {
            return self.apply_status(node, &message, now, now_ms);
        }
        // Of a run that was not heard of: a hub that has just started, or messages that were lost.
        self.statuses.fetch_add(1, Ordering::Relaxed);
        let mut nodes = self.nodes.write();
        let entry = nodes
            .entry(node.into())
            .or_insert_with(|| Entry::new(now_ms));
        entry.needs_full = true;
        entry.ask_for_all(now)
    }

    /// Takes what happened to a liveliness token.
    pub(crate) fn token(&self, node: &str, present: bool, now: Instant, now_ms: i64) {
        let mut nodes = self.nodes.write();
        let Some(name) = nodes.get_key_value(node).map(|(name, _)| Arc::clone(name)) else {
            return;
        };
        if let Some(entry) = nodes.get_mut(&name) {
            entry.token = if present { Token::Present } else { Token::Gone };
            self.settle(&name, entry, now, now_ms);
        }
    }

    /// Drops a node, unless it is online or degraded: it would be back at once. Returns whether it was dropped.
    pub(crate) fn forget(&self, node: &str) -> bool {
        let mut nodes = self.nodes.write();
        if nodes.get(node).is_some_and(|entry| entry.state.is_heard()) {
            return false;
        }
        nodes.remove(node);
        true
    }

    /// Makes a node known that has sent reports and no status yet.
    pub(crate) fn reported(&self, node: &str, now_ms: i64) {
        if self.nodes.read().contains_key(node) {
            return;
        }
        let mut nodes = self.nodes.write();
        nodes
            .entry(node.into())
            .or_insert_with(|| Entry::new(now_ms));
    }

    /// Adds a clip filed under `at_ms` to what its node used and saved that day.
    pub(crate) fn used(&self, node: &str, at_ms: i64, used: Used) {
        let mut nodes = self.nodes.write();
        if let Some(entry) = nodes.get_mut(node) {
            entry.today.add(day_of(at_ms), used);
        }
    }

    /// Looks at a tenth of the nodes for those that time made silent or offline.
    pub fn sweep(&self, now: Instant, now_ms: i64) {
        let mut swept = self.swept.lock();
        let mut nodes = self.nodes.write();
        let most = nodes.len() / 10 + 1;
        // Behind the last one it begins again at the first.
        for from in [swept.take().map_or(Unbounded, Excluded), Unbounded] {
            let mut last = None;
            let range = nodes.range_mut::<Arc<str>, _>((from, Unbounded));
            for (name, entry) in range.take(most) {
                self.settle(name, entry, now, now_ms);
                last = Some(Arc::clone(name));
            }
            *swept = last;
            if swept.is_some() {
                break;
            }
        }
    }

    /// Gives every node that time more to be heard: the hub could hear none meanwhile.
    pub(crate) fn pass_over(&self, time: Duration) {
        for entry in self.nodes.write().values_mut() {
            entry.heard = entry.heard.map(|heard| heard + time);
        }
    }

    /// Judges, and notes a change.
    fn settle(&self, name: &Arc<str>, entry: &mut Entry, now: Instant, now_ms: i64) {
        if entry
            .identity
            .as_ref()
            .is_some_and(|(_, until)| *until <= now)
        {
            entry.identity = None;
        }
        let heard_ago = match (entry.heard, entry.heard_ms) {
            (Some(heard), _) => Some(now.saturating_duration_since(heard)),
            (None, None) => None,
            // Remembered as silent or offline, and not heard since: it stays so, but for the time that goes on.
            (None, Some(_)) if entry.state == PresenceState::Offline => return,
            (None, Some(heard_ms)) => {
                let ago = Duration::from_millis(u64::try_from(now_ms - heard_ms).unwrap_or(0));
                Some(ago.max(self.limits.silent))
            }
        };
        let facts = PresenceInput {
            heard_ago,
            token: entry.token,
            health: entry.health,
            reasons: &entry.reasons,
            identity: entry.identity.as_ref().map(|(why, _)| why.as_str()),
        };
        let (state, why) = judge(&facts, self.limits);
        if state != entry.state {
            entry.since_ms = now_ms;
        }
        if (state, why.as_str()) != (entry.state, entry.why.as_str()) {
            entry.state = state;
            entry.why = why;
            self.mark(name, entry);
        }
    }

    /// Puts a node on the list of those to be written, unless it is there.
    fn mark(&self, name: &Arc<str>, entry: &mut Entry) {
        if !std::mem::replace(&mut entry.dirty, true) {
            self.dirty.lock().push_back(Arc::clone(name));
        }
    }

    /// Whether a full status is missing.
    pub fn needs_full_status(&self, node: &str) -> bool {
        let nodes = self.nodes.read();
        nodes.get(node).is_some_and(|entry| entry.needs_full)
    }

    /// Notes a batch that cannot be read.
    pub(crate) fn unreadable(&self, node: &str, reason: &str, now_ms: i64) {
        let detail = json!({ "reason": reason });
        self.note(EventRow::new(now_ms, "refused", node, detail));
    }

    fn note(&self, notice: EventRow) {
        let mut notices = self.notices.lock();
        if notices.len() < MOST_NOTICES {
            notices.push(notice);
        }
    }

    /// Whether there is something to be written.
    pub(crate) fn has_news(&self) -> bool {
        !self.dirty.lock().is_empty() || !self.notices.lock().is_empty()
    }

    /// Takes what is to be written, at most as much as one transaction may have.
    pub fn take_news(&self) -> News {
        let names: Vec<Arc<str>> = {
            let mut dirty = self.dirty.lock();
            let count = dirty.len().min(MOST_NEWS);
            dirty.drain(..count).collect()
        };
        let mut nodes = self.nodes.write();
        let mut news = News::default();
        for name in names {
            // A node that was forgotten and came back is listed twice.
            if let Some(entry) = nodes.get_mut(&name).filter(|entry| entry.dirty) {
                entry.dirty = false;
                news.nodes.push(entry.row(&name));
            }
        }
        // Hubs on one database write in the same order, so that none waits for another that waits for it.
        news.nodes.sort_by(|a, b| a.name.cmp(&b.name));
        news.notices = std::mem::take(&mut *self.notices.lock());
        news
    }

    /// Takes back what was not written.
    pub fn give_back(&self, news: News) {
        let mut nodes = self.nodes.write();
        for node in news.nodes {
            let name: Arc<str> = node.name.into();
            if let Some(entry) = nodes.get_mut(&name) {
                entry.status_dirty |= node.status.is_some();
                self.mark(&name, entry);
            }
        }
        drop(nodes);
        for notice in news.notices {
            self.note(notice);
        }
    }

    /// How many nodes have each state, in the order of [`PresenceState::ALL`].
    pub(crate) fn by_state(&self) -> [u64; 4] {
        let mut counts = [0; 4];
        for entry in self.nodes.read().values() {
            for (count, state) in counts.iter_mut().zip(PresenceState::ALL) {
                *count += u64::from(entry.state == state);
            }
        }
        counts
    }

    /// Counts the nodes; `desired` is the revision desired of one.
    pub(crate) fn tallies(&self, desired: impl Fn(&str) -> u64) -> FleetTallies {
        let (now, mut tallies) = (Instant::now(), FleetTallies::default());
        for (name, entry) in self.nodes.read().iter() {
            let heard = entry.state.is_heard();
            let two = (entry.identity.as_ref()).is_some_and(|(_, until)| *until > now);
            tallies.twins += u64::from(two);
            tallies.behind += u64::from(heard && entry.revision < desired(name));
            tallies.waiting += entry.waiting;
            let target = (entry.reported.as_ref()).and_then(|reported| reported.target);
            let status = target.map(|target| target.status.unwrap_or(TargetStatus::Measuring));
            let place = (status.filter(|_| heard))
                .and_then(|at| TargetStatus::ALL.iter().position(|one| *one == at));
            if let Some(count) = place.and_then(|at| tallies.targets.get_mut(at)) {
                *count += 1;
            }
        }
        tallies
    }

    /// Status messages taken since the start.
    pub(crate) fn statuses(&self) -> u64 {
        self.statuses.load(Ordering::Relaxed)
    }

    /// One node.
    pub(crate) fn view(&self, node: &str) -> Option<NodeView> {
        let nodes = self.nodes.read();
        let day = day_of(unix_milliseconds());
        nodes.get(node).map(|entry| entry.view(node, day))
    }

    /// What is known of a node's settings.
    pub(crate) fn settings(&self, node: &str) -> Option<NodeSettings> {
        let nodes = self.nodes.read();
        let (name, entry) = nodes.get_key_value(node)?;
        Some(NodeSettings::of(name, entry))
    }

    /// The settings of all nodes, in the order of their names.
    pub(crate) fn all_settings(&self) -> Vec<NodeSettings> {
        let nodes = self.nodes.read();
        nodes
            .iter()
            .map(|(name, entry)| NodeSettings::of(name, entry))
            .collect()
    }

    /// Shows every node to `each`, in the order of their names.
    pub(crate) fn each(&self, mut each: impl FnMut(&Arc<str>, &Entry)) {
        for (name, entry) in self.nodes.read().iter() {
            each(name, entry);
        }
    }

    /// All names, in order.
    pub fn names(&self) -> Vec<Arc<str>> {
        self.nodes.read().keys().cloned().collect()
    }
}
