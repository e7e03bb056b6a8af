//! Carries out orders: stores them, notifies the nodes, and follows their reports.

use super::member::{Ask, ChangeNode, Millis, Outcome};
use super::run::milliseconds;
use crate::config::{LocalChange, TuningConfig};
use crate::desired::{DesiredValue, Desires};
use crate::presence::{Fleet, NodeView, Notifier};
use crate::store::{ChangeRow, DesiredRow, EventRow, Store, StoreError};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::DesiredSetting;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

/// Time after which a node that did not react to a notice is notified again.
const NOTIFY_AGAIN_MS: Millis = 5_000;

/// Most times that a node is set back after one change, so that hub and node do not fight over a value for ever.
const SET_BACK_TIMES: u32 = 3;

/// The origin of the order that sets a node back.
const SET_BACK: &str = "drift";

/// The most by which a node's revision may exceed those of this database. A restored or empty database lacks revisions
/// that nodes have, but a node that reports nonsense must not use up the numbers.
const FARTHEST_AHEAD: u64 = 1 << 32;

/// The last order to a node.
#[derive(Clone, Debug)]
struct OpenOrder {
    at: ChangeNode,
    setting: DesiredSetting,
    notified_ms: Millis,
    /// How often the node was set back since the last order by somebody else.
    set_back: u32,
}

/// A node that applied its desired setting, and has another one now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Drift {
    /// The node.
    pub node: String,
    /// When the hub noticed, milliseconds since the Unix epoch.
    pub since_ms: Millis,
    /// The desired setting: a threshold or a target.
    pub desired: DesiredSetting,
    /// The setting in force; absent if the cameras differ.
    pub in_force: Option<DesiredSetting>,
    /// The node's reason why it no longer holds its target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// How often it was set back.
    pub set_back: u32,
}

/// Tunes the fleet.
#[derive(Debug)]
pub struct Tuner {
    pub(super) store: Store,
    pub(super) fleet: Arc<Fleet>,
    /// The desired settings that answers to nodes contain.
    pub(super) desires: Arc<Desires>,
    notifier: Notifier,
    pub(super) config: TuningConfig,
    /// The name of this hub among several on one database.
    pub(super) driver: String,
    /// The highest revision that was read from the database. Orders of this hub do not count: there may be lower
    /// revisions of other hubs that were not read yet.
    learned: AtomicU64,
    /// The last order to each node, as far as this hub knows.
    open: Mutex<HashMap<String, OpenOrder>>,
    /// The nodes that drifted, with the time at which the hub noticed.
    drifted_ms: Mutex<BTreeMap<String, Millis>>,
    /// Signals that the nodes' reports were read.
    pub(super) looked: Notify,
    pub(super) runs: tokio::sync::Mutex<super::runs::Runs>,
}

/// Interval at which the nodes' reports are read.
const LOOK: Duration = Duration::from_millis(250);
/// Checks of rollouts, trials and other hubs' orders, and of drift: once per this number of intervals.
const DRIVE_EVERY: u64 = 4;
const DRIFT_EVERY: u64 = 20;

/// Follows orders, rollouts and trials until `shutdown`. After an error of the database it tries again at the next interval.
pub(crate) async fn follow(tuner: Arc<Tuner>, shutdown: CancellationToken) {
    let mut every = tokio::time::interval(LOOK);
    every.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut failing = false;
    for look in 0_u64.. {
        tokio::select! {
            _ = every.tick() => {}
            () = shutdown.cancelled() => return,
        }
        let now = unix_milliseconds();
        let worked = async {
            tuner.look(now).await?;
            if look.is_multiple_of(DRIVE_EVERY) {
                tuner.drive(now).await?;
                tuner.learn().await?;
            }
            if look.is_multiple_of(DRIFT_EVERY) {
                tuner.look_for_drift(now).await?;
            }
            Ok::<_, StoreError>(())
        };
        match worked.await {
            Ok(()) => failing = false,
            Err(error) if failing => tracing::debug!(%error, "orders cannot be followed"),
            Err(error) => {
                tracing::warn!(%error, "orders cannot be followed; trying again");
                failing = true;
            }
        }
    }
}

impl Tuner {
    /// Reads the desired settings and the open orders from the database.
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
            learned: AtomicU64::new(0),
            open: Mutex::default(),
            drifted_ms: Mutex::default(),
            looked: Notify::new(),
            runs: tokio::sync::Mutex::default(),
        };
        tuner.learn().await?;
        for mut at in tuner.store.open_order_nodes().await? {
            let revision = at.ask.revision;
            let desired = tuner.desires.get(&at.node);
            if let Some(desired) = desired.filter(|desired| desired.revision == revision) {
                // Its time limit begins again, because no hub was listening.
                at.ask = Ask::new(revision, now, Outcome::Pending);
                let order = OpenOrder {
                    at,
                    setting: desired.setting,
                    notified_ms: 0,
                    set_back: 0,
                };
                (tuner.open.lock()).insert(order.at.node.clone(), order);
            }
        }
        Ok(tuner)
    }

    /// The reason that a node that reports `revision` gets no order; `None` if it can.
    pub(super) fn implausible(&self, revision: u64) -> Option<String> {
        let most = (self.learned.load(Ordering::Relaxed)).saturating_add(FARTHEST_AHEAD);
        (revision > most).then(|| {
            format!(
                "it reports revision {revision}, but no hub gave one above {most}: \
                 empty its state directory so that it accepts orders again"
            )
        })
    }

    /// Reads the orders of other hubs on the same database.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn learn(&self) -> Result<(), StoreError> {
        let after = self.learned.load(Ordering::Relaxed);
        for DesiredRow { node, value } in self.store.desired_after(after).await? {
            self.desires.set(&node, value);
            self.learned.fetch_max(value.revision, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Orders a setting for nodes. When this returns, the order is in the database, pulls are answered with it, and the
    /// nodes are notified.
    pub(super) async fn order(
        &self,
        change: ChangeRow,
        nodes: Vec<String>,
    ) -> Result<u64, StoreError> {
        let (now, setting) = (change.at_ms, change.setting);
        // A restored database lacks the revisions given after its backup, and offline nodes may have them. So that none is given
        // twice, revisions start at the time, in seconds, and above those that the nodes report.
        let mut above = u64::try_from(now.div_euclid(1000)).unwrap_or(0);
        let mut orders = Vec::new();
        for node in nodes {
            let view = self.fleet.view(&node);
            let reported = view.as_ref().map_or(0, |view| view.revision);
            if self.implausible(reported).is_none() {
                above = above.max(reported);
            }
            let from = view.as_ref().and_then(NodeView::setting);
            let outcome = match view.is_some_and(|view| view.is_reachable()) {
                true => Outcome::Pending,
                false => Outcome::Waiting,
            };
            let set_back = match change.origin == SET_BACK {
                true => self.set_back_times(&node) + 1,
                false => 0,
            };
            let ask = Ask::new(0, now, outcome);
            orders.push(OpenOrder {
                at: ChangeNode { node, from, ask },
                setting,
                notified_ms: now,
                set_back,
            });
        }
        let rows = orders.iter().map(|order| order.at.clone()).collect();
        let above = i64::try_from(above).unwrap_or(i64::MAX);
        let written = (self.store).write(move |writing| writing.order(&change, rows, above));
        let revision = written.await?.unsigned_abs();
        for mut order in orders {
            order.at.ask.revision = revision;
            let node = order.at.node.clone();
            self.desires.set(&node, DesiredValue { revision, setting });
            // A node that is set back stays listed until it has the value again.
            if order.set_back == 0 {
                self.drifted_ms.lock().remove(&node);
            }
            let _ = self.notifier.try_send((node.clone(), revision));
            self.open.lock().insert(node, order);
        }
        Ok(revision)
    }

    /// Drops the orders to a node from memory.
    pub(super) fn stop_following(&self, node: &str) {
        self.desires.remove(node);
        self.drifted_ms.lock().remove(node);
        self.open.lock().remove(node);
    }

    /// How often a node was set back since the last order by somebody else, as far as this hub knows.
    fn set_back_times(&self, node: &str) -> u32 {
        self.open.lock().get(node).map_or(0, |order| order.set_back)
    }

    /// Updates the outcome of an order of `revision`.
    pub(super) fn update(&self, line: &mut ChangeNode, revision: u64) {
        match self.open.lock().get(&line.node) {
            Some(order) if order.at.ask.revision == revision => {
                line.ask = order.at.ask.clone();
            }
            Some(_) => line.ask.outcome = Outcome::Superseded,
            None => {
                line.ask.outcome = Outcome::Missed;
                line.ask.detail = "the node was forgotten".to_owned();
            }
        }
    }

    /// Reads the reports of nodes with open orders.
    ///
    /// # Errors
    /// When the outcomes cannot be stored; the next call finds them again.
    pub async fn look(&self, now: Millis) -> Result<(), StoreError> {
        let patience = milliseconds(self.config.apply_within_s);
        let mut answered = Vec::new();
        for (node, order) in self.open.lock().iter_mut() {
            if matches!(order.at.ask.outcome, Outcome::Applied | Outcome::Refused) {
                continue;
            }
            let Some(view) = self.fleet.view(node) else {
                continue;
            };
            let mut next = order.clone();
            if (next.at.ask).observe(&view, order.setting, patience, now) {
                answered.push(next);
            } else if order.at.ask.outcome == Outcome::Pending
                && now - order.notified_ms >= NOTIFY_AGAIN_MS
            {
                order.notified_ms = now;
                let notice = (node.clone(), order.at.ask.revision);
                let _ = self.notifier.try_send(notice);
            }
        }
        if !answered.is_empty() {
            let rows: Vec<_> = answered.iter().map(|order| order.at.clone()).collect();
            let written = (self.store).write(move |writing| writing.outcomes(&rows));
            written.await?;
        }
        for order in answered {
            if let Some(present) = self.open.lock().get_mut(&order.at.node)
                && present.at.ask.revision == order.at.ask.revision
            {
                *present = order;
            }
        }
        self.looked.notify_waiters();
        Ok(())
    }

    /// Finds nodes that drifted: somebody changed them after they applied their desired setting. Sets them back if the
    /// configuration says so.
    ///
    /// # Errors
    /// When the database cannot be written; the next call finds them again.
    pub async fn look_for_drift(&self, now: Millis) -> Result<(), StoreError> {
        let (mut events, mut found) = (Vec::new(), Vec::new());
        for (node, desired) in self.desires.all() {
            let Some(view) = self.fleet.view(&node) else {
                continue;
            };
            let drifted =
                view.is_known() && view.revision == desired.revision && !view.has(desired.setting);
            if !drifted {
                if view.revision >= desired.revision {
                    self.drifted_ms.lock().remove(&node);
                }
                continue;
            }
            if !self.drifted_ms.lock().contains_key(&node) {
                let detail = serde_json::json!({
                    "revision": desired.revision,
                    "desired": desired.setting,
                    "in_force": view.setting(),
                });
                events.push(EventRow::new(now, "drift", &node, detail));
            }
            found.push((node, desired.setting));
        }
        if !events.is_empty() {
            (self.store)
                .write(move |writing| writing.insert("events", &events, ""))
                .await?;
        }
        // Only after the events are stored: after an error the next call finds the drift again.
        for (node, _) in &found {
            self.drifted_ms.lock().entry(node.clone()).or_insert(now);
        }
        if self.config.local_change == LocalChange::SetBack {
            found.retain(|(node, _)| self.set_back_times(node) < SET_BACK_TIMES);
            found.sort_by_cached_key(|(_, desired)| format!("{desired:?}"));
            for alike in found.chunk_by(|a, b| a.1 == b.1) {
                let change = ChangeRow {
                    revision: 0,
                    at_ms: now,
                    who: "hub".to_owned(),
                    why: "changed at the node".to_owned(),
                    origin: SET_BACK.to_owned(),
                    selector: String::new(),
                    setting: alike[0].1,
                };
                let nodes = alike.iter().map(|(node, _)| node.clone());
                self.order(change, nodes.collect()).await?;
            }
        }
        Ok(())
    }

    /// The nodes that have drifted.
    pub(crate) fn drift(&self) -> Vec<Drift> {
        let nodes = self.drifted_ms.lock().clone();
        let drift = |(node, since_ms): (String, Millis)| {
            let view = self.fleet.view(&node)?;
            Some(Drift {
                since_ms,
                desired: self.desires.get(&node)?.setting,
                in_force: view.setting(),
                why: view.target_off(),
                set_back: self.set_back_times(&node),
                node,
            })
        };
        nodes.into_iter().filter_map(drift).collect()
    }
}
