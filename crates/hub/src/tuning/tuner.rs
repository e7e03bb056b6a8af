//! Carries orders out: keeps them in the database, notifies the nodes, and follows what the nodes report.

use super::members::{Millis, Observation, Outcome};
use crate::config::TuningConfig;
use crate::desired::{DesiredValue, Desires};
use crate::presence::{Fleet, NodeSettings, Notifier};
use crate::setting::is_applied;
use crate::store::tables::EventRow;
use crate::store::{OrderNodeRow, OrderRow, Store, StoreError};
use albireo_wire::DesiredSetting;
use albireo_wire::Threshold;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use tokio::sync::mpsc;
use utoipa::ToSchema;

/// How long after a notice that was not followed a node is notified again.
const NOTIFY_AGAIN_MS: Millis = 5_000;

/// How far beyond this database's revisions a node's may be. A database that was restored or is empty knows none of the
/// revisions that nodes have; a node that reports nonsense must not use them up.
const FARTHEST_AHEAD: u64 = 1 << 32;

/// What is desired, and the nodes that are to have it again with what each has now.
type SetBack = (DesiredSetting, Vec<(String, Option<DesiredSetting>)>);

/// What an order came to at one node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OutcomeLine {
    /// The node.
    pub node: String,
    /// `applied`, `refused`, `waiting` (out of reach: applied on its return), `timed_out`, `pending`, `superseded`; `unchanged` where it
    /// has the value already, `would_change` in a dry run.
    pub outcome: String,
    /// Its setting before, if that was known: a threshold or a target.
    pub from: Option<DesiredSetting>,
    /// What was ordered: a threshold or a target.
    pub to: DesiredSetting,
    /// Why, where there is something to say.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub detail: String,
}

impl OutcomeLine {
    /// Whether nothing more is to come for the node within a request.
    pub(crate) fn is_final(&self) -> bool {
        self.outcome != "pending"
    }
}

/// A value or a target for some nodes.
#[derive(Clone, Debug)]
pub(crate) struct NewOrder {
    pub(crate) setting: DesiredSetting,
    /// The nodes, with what they have.
    pub(crate) nodes: Vec<(String, Option<DesiredSetting>)>,
    pub(crate) who: String,
    pub(crate) why: String,
    /// `hand`, `rollout 3`, `trial 4`, `drift`.
    pub(crate) origin: String,
    pub(crate) selector: String,
}

/// An order that a node has not answered finally.
#[derive(Clone, Debug)]
struct OpenOrder {
    revision: u64,
    setting: DesiredSetting,
    from: Option<DesiredSetting>,
    asked_ms: Millis,
    notified_ms: Millis,
    outcome: Outcome,
}

impl OpenOrder {
    /// Its row with that outcome at `node`.
    fn row(&self, node: &str, outcome: &str, at_ms: Millis, detail: String) -> OrderNodeRow {
        OrderNodeRow {
            revision: i64::try_from(self.revision).unwrap_or(i64::MAX),
            node: node.to_owned(),
            setting_before: self.from,
            outcome: outcome.to_owned(),
            at_ms,
            detail,
        }
    }
}

/// A node that took what is desired of it and has something else now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Drift {
    /// The node.
    pub node: String,
    /// Since when the hub knows, milliseconds since the Unix epoch.
    pub since_ms: Millis,
    /// What is desired: a threshold or a target.
    pub desired: DesiredSetting,
    /// What it has; absent where the cameras differ.
    pub in_force: Option<DesiredSetting>,
    /// Why it holds its target no more, in its own words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// How often it was set back.
    pub set_back: u32,
}

/// Tunes the fleet.
pub struct Tuner {
    pub(super) store: Store,
    pub(super) fleet: Arc<Fleet>,
    /// Where pulls and acknowledgements are answered from.
    desires: Arc<Desires>,
    notifier: Notifier,
    pub(super) config: TuningConfig,
    /// This hub among several on one database.
    pub(super) driver: String,
    /// Highest revision that was read from the database: what this hub orders itself says nothing of the others'.
    learned: AtomicI64,
    open: Mutex<HashMap<String, OpenOrder>>,
    followers: Mutex<HashMap<u64, mpsc::UnboundedSender<OutcomeLine>>>,
    drift: Mutex<BTreeMap<String, Drift>>,
    pub(super) runs: tokio::sync::Mutex<super::runs::Runs>,
}

impl std::fmt::Debug for Tuner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tuner").finish_non_exhaustive()
    }
}

pub(crate) fn text(knob: Threshold) -> String {
    knob.value.to_string()
}

impl Tuner {
    /// Reads what is desired and what is open from the database.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn open(
        store: Store,
        fleet: Arc<Fleet>,
        desires: Arc<Desires>,
        notifier: Notifier,
        config: TuningConfig,
        driver: String,
        now: Millis,
    ) -> Result<Self, StoreError> {
        let tuner = Self {
            store,
            fleet,
            desires,
            notifier,
            config,
            driver,
            learned: AtomicI64::new(0),
            open: Mutex::default(),
            followers: Mutex::default(),
            drift: Mutex::default(),
            runs: tokio::sync::Mutex::default(),
        };
        tuner.learn().await?;
        for row in tuner.store.open_order_nodes().await? {
            let revision = row.revision.unsigned_abs();
            let Some(desired) = tuner
                .desires
                .get(&row.node)
                .filter(|d| d.revision == revision)
            else {
                continue;
            };
            let order = OpenOrder {
                revision,
                setting: desired.setting,
                from: row.setting_before,
                // Its time begins again: no hub listened meanwhile.
                asked_ms: now,
                notified_ms: 0,
                outcome: Outcome::Pending,
            };
            tuner.open.lock().insert(row.node, order);
        }
        Ok(tuner)
    }

    /// Makes a setting the desired one, unless one of a higher revision is.
    fn desire(&self, node: &str, revision: u64, setting: DesiredSetting) {
        let value = DesiredValue { revision, setting };
        self.desires.set(node, value);
    }

    /// The database.
    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    /// What is desired of a node.
    pub(super) fn desired_value(&self, node: &str) -> Option<DesiredValue> {
        self.desires.get(node)
    }

    /// Why nothing can be ordered of a node that reports `revision`, if nothing can.
    pub(super) fn implausible(&self, revision: u64) -> Option<String> {
        let known = self.learned.load(Ordering::Relaxed).unsigned_abs();
        let most = known.saturating_add(FARTHEST_AHEAD);
        (revision > most).then(|| {
            format!(
                "it reports revision {revision}, and no hub gave one above {most}: \
                 empty its state directory, then it takes orders again"
            )
        })
    }

    /// The highest revision that these nodes report: they take only what is above it.
    fn reported<'a>(&self, nodes: impl Iterator<Item = &'a String>) -> i64 {
        let highest = nodes
            .filter_map(|node| self.fleet.settings(node))
            .map(|facts| facts.revision)
            .filter(|revision| self.implausible(*revision).is_none())
            .max();
        i64::try_from(highest.unwrap_or(0)).unwrap_or(i64::MAX)
    }

    /// Takes what other hubs on the same database have ordered.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn learn(&self) -> Result<(), StoreError> {
        let after = self.learned.load(Ordering::Relaxed);
        for (node, revision, setting) in self.store.desired_after(after).await? {
            self.desire(&node, revision.unsigned_abs(), setting);
            self.learned.fetch_max(revision, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Orders a value or a target: when this returns it is in the database, pulls are answered with it, and the nodes were
    /// notified. `follower` gets what the nodes report.
    pub(crate) async fn order(
        &self,
        order: NewOrder,
        follower: Option<mpsc::UnboundedSender<OutcomeLine>>,
        now: Millis,
    ) -> Result<u64, StoreError> {
        let open = |revision, from| OpenOrder {
            revision,
            setting: order.setting,
            from,
            asked_ms: now,
            notified_ms: now,
            outcome: Outcome::Pending,
        };
        let reachable = |node: &str| {
            self.fleet
                .settings(node)
                .is_some_and(|facts| facts.reachable)
        };
        // A restored database does not know what it ordered after its backup, nor what a node has that is away: so that none of
        // those revisions is given again, they begin at the time, in seconds.
        let above =
            (self.reported(order.nodes.iter().map(|(node, _)| node))).max(now.div_euclid(1000));
        let mut row = OrderRow {
            revision: 0,
            at_ms: now,
            who: order.who.clone(),
            why: order.why.clone(),
            origin: order.origin.clone(),
            selector: order.selector.clone(),
            setting: order.setting,
        };
        let mut nodes: Vec<_> = (order.nodes.iter())
            .map(|(node, from)| {
                let outcome = if reachable(node) {
                    "pending"
                } else {
                    "waiting"
                };
                open(0, *from).row(node, outcome, now, String::new())
            })
            .collect();
        let written = self.store.write(move |writing| {
            row.revision = writing.next_revision(above)?;
            for node in &mut nodes {
                node.revision = row.revision;
            }
            writing.order(&row, &nodes)?;
            Ok(row.revision.unsigned_abs())
        });
        let revision = written.await?;
        if let Some(follower) = follower {
            let mut followers = self.followers.lock();
            followers.retain(|_, follower| !follower.is_closed());
            followers.insert(revision, follower);
        }
        for (node, from) in &order.nodes {
            self.desire(node, revision, order.setting);
            let before = (self.open.lock()).insert(node.clone(), open(revision, *from));
            if let Some(before) = before {
                self.send_outcome(&before, node, "superseded", String::new());
            }
            self.drift.lock().remove(node);
            self.notifier.notify(node, revision);
        }
        Ok(revision)
    }

    /// Forgets in memory what was ordered of a node.
    pub(super) fn stop_following(&self, node: &str) {
        self.desires.remove(node);
        self.drift.lock().remove(node);
        let order = self.open.lock().remove(node);
        if let Some(order) = order {
            self.send_outcome(&order, node, "missed", "the node was forgotten".to_owned());
        }
    }

    fn send_outcome(&self, order: &OpenOrder, node: &str, outcome: &str, detail: String) {
        let mut followers = self.followers.lock();
        if let Some(follower) = followers.get(&order.revision) {
            let line = OutcomeLine {
                node: node.to_owned(),
                outcome: outcome.to_owned(),
                from: order.from,
                to: order.setting,
                detail,
            };
            if follower.send(line).is_err() {
                followers.remove(&order.revision);
            }
        }
    }

    /// Looks at what the nodes with open orders have reported.
    ///
    /// # Errors
    /// When the outcomes cannot be kept; they are then found again at the next look.
    pub async fn look(&self, now: Millis) -> Result<(), StoreError> {
        let patience = super::rollout::seconds(self.config.apply_within_s);
        let mut rows = Vec::new();
        let mut changed: Vec<(String, OpenOrder)> = Vec::new();
        {
            let open = self.open.lock();
            for (node, order) in open.iter() {
                let Some(facts) = self.fleet.settings(node) else {
                    continue;
                };
                let mut order = order.clone();
                let observed = Observation::from(&facts);
                let next = order.outcome.next(
                    &observed,
                    order.setting,
                    order.revision,
                    &mut order.asked_ms,
                    patience,
                    now,
                );
                if next == Outcome::Pending
                    && observed.reachable
                    && now - order.notified_ms >= NOTIFY_AGAIN_MS
                {
                    order.notified_ms = now;
                    self.notifier.notify(node, order.revision);
                    changed.push((node.clone(), order.clone()));
                }
                if next != order.outcome {
                    rows.push(order.row(node, next.name(), now, next.detail()));
                    order.outcome = next;
                    changed.push((node.clone(), order));
                }
            }
        }
        if !rows.is_empty() {
            (self.store)
                .write(move |writing| writing.outcomes(&rows))
                .await?;
        }
        for (node, order) in changed {
            {
                let mut open = self.open.lock();
                let still = open
                    .get(&node)
                    .is_some_and(|present| present.revision == order.revision);
                if !still {
                    continue;
                }
                match order.outcome {
                    Outcome::Applied { .. } | Outcome::Refused { .. } => open.remove(&node),
                    _ => open.insert(node.clone(), order.clone()),
                };
            }
            self.send_outcome(&order, &node, order.outcome.name(), order.outcome.detail());
        }
        Ok(())
    }

    /// Looks for nodes that were changed after they took what is desired; sets them back where the configuration says
    /// so.
    ///
    /// # Errors
    /// When the database cannot be written: they are found again at the next look.
    pub async fn look_for_drift(&self, now: Millis) -> Result<(), StoreError> {
        let mut back: HashMap<String, SetBack> = HashMap::new();
        let (mut events, mut found) = (Vec::new(), Vec::new());
        for (node, desired) in self.desires.all() {
            let Some(facts) = self.fleet.settings(&node) else {
                continue;
            };
            if !drifted(&facts, desired) {
                // One that was set back stays listed until it has taken the value again.
                if facts.revision >= desired.revision {
                    self.drift.lock().remove(&node);
                }
                continue;
            }
            let mut drift = self.drift.lock();
            let known = drift.get_mut(&node).map(|entry| {
                entry.in_force = facts.setting();
                entry.why = facts.target_off();
                entry.set_back
            });
            if known.is_none() {
                events.push(drift_event(&node, desired, &facts, now));
                found.push(Drift {
                    node: node.clone(),
                    since_ms: now,
                    desired: desired.setting,
                    in_force: facts.setting(),
                    why: facts.target_off(),
                    set_back: 0,
                });
            }
            let set_back = known.unwrap_or(0);
            if self.config.local_change.is_set_back() && set_back < self.config.set_back_times {
                let group = back.entry(desired.setting.to_string());
                group
                    .or_insert_with(|| (desired.setting, Vec::new()))
                    .1
                    .push((node, facts.setting()));
            }
        }
        if !events.is_empty() {
            (self.store)
                .write(move |writing| writing.events(&events))
                .await?;
        }
        // Known is only what is in the history: after an error it is found again.
        (self.drift.lock()).extend(found.into_iter().map(|entry| (entry.node.clone(), entry)));
        for (setting, nodes) in back.into_values() {
            let counts: Vec<_> = (nodes.iter())
                .filter_map(|(node, _)| self.drift.lock().get(node).cloned())
                .map(|entry| Drift {
                    set_back: entry.set_back + 1,
                    ..entry
                })
                .collect();
            let order = NewOrder {
                setting,
                nodes,
                who: "hub".to_owned(),
                why: "changed at the node".to_owned(),
                origin: "drift".to_owned(),
                selector: String::new(),
            };
            self.order(order, None, now).await?;
            // Ordering forgets the drift; how often a node was set back must be known the next time.
            let mut drift = self.drift.lock();
            drift.extend(counts.into_iter().map(|entry| (entry.node.clone(), entry)));
        }
        Ok(())
    }

    /// The nodes that have drifted.
    pub(crate) fn drift(&self) -> Vec<Drift> {
        self.drift.lock().values().cloned().collect()
    }
}

/// A change at the node, for the history.
fn drift_event(node: &str, desired: DesiredValue, facts: &NodeSettings, now: Millis) -> EventRow {
    let detail = serde_json::json!({
        "revision": desired.revision,
        "desired": desired.setting,
        "in_force": facts.setting(),
    });
    EventRow::new(now, "drift", node, detail)
}

/// Whether a node has taken what is desired and has something else now.
fn drifted(facts: &NodeSettings, desired: DesiredValue) -> bool {
    facts.is_known()
        && facts.revision == desired.revision
        && !is_applied(desired.setting, facts.threshold(), facts.target())
}
