//! Carries out orders: stores them, notifies the nodes, and follows their reports.

use super::desired::{Desires, Wanted};
use super::member::{Ask, ChangeNode, Millis, Outcome};
use super::run::milliseconds;
use super::tables::ChangeRow;
use crate::config::{LocalChange, TuningConfig};
use crate::presence::Fleet;
use crate::store::{EventRow, Store, StoreError};
use albireo_service::clock::unix_milliseconds;
use albireo_service::readiness::Part;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

/// Most times that a node is set back after one change, so that hub and node do not fight over a value for ever.
const SET_BACK_TIMES: u32 = 3;

/// The origin of the order that sets a node back.
const SET_BACK: &str = "drift";

/// The most by which a node's revision may exceed those of this database. A restored or empty database lacks revisions
/// that nodes have, but a node that reports nonsense must not use up the numbers.
const FARTHEST_AHEAD: u64 = 1 << 32;

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
    pub(crate) store: Store,
    pub(super) fleet: Arc<Fleet>,
    /// The desired settings that answers to nodes contain.
    pub(super) desires: Arc<Desires>,
    pub(super) config: TuningConfig,
    /// The name of this hub among several on one database.
    pub(super) driver: String,
    /// The highest revision that was read from the database. Orders of this hub do not count: there may be lower
    /// revisions of other hubs that were not read yet.
    learned: AtomicU64,
    pub(super) runs: tokio::sync::Mutex<super::runs::DrivenRuns>,
}

/// Interval at which the nodes' reports are read.
const LOOK: Duration = Duration::from_millis(250);
/// Checks of rollouts, trials and other hubs' orders, and of drift and lost notices: once per this number of intervals.
const DRIVE_EVERY: u64 = 4;
const DRIFT_EVERY: u64 = 20;

/// Follows orders, rollouts and trials until `shutdown`. After an error of the database it tries again at the next interval.
/// Meanwhile the hub is degraded: it takes reports, and gives no settings.
pub(crate) async fn follow(tuner: Arc<Tuner>, part: Part, shutdown: CancellationToken) {
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
                tuner.forget_strangers(now).await?;
            }
            Ok::<_, StoreError>(())
        };
        match worked.await {
            Ok(()) => {
                failing = false;
                part.works();
            }
            Err(error) if failing => tracing::debug!(%error, "orders cannot be followed"),
            Err(error) => {
                tracing::warn!(%error, "orders cannot be followed; trying again");
                part.degraded(format!("settings cannot be given or followed: {error}"));
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
        config: TuningConfig,
        driver: String,
    ) -> Result<Self, StoreError> {
        let tuner = Self {
            store,
            fleet,
            desires,
            config,
            driver,
            learned: AtomicU64::new(0),
            runs: tokio::sync::Mutex::default(),
        };
        tuner.learn().await?;
        Ok(tuner)
    }

    /// The reason that a node that reports `revision` gets no order; `None` if it can.
    pub(super) fn implausible(&self, revision: u64) -> Option<String> {
        let most = self.learned.load(Ordering::Relaxed).saturating_add(FARTHEST_AHEAD);
        (revision > most).then(|| {
            format!(
                "it reports revision {revision}, but no hub gave one above {most}: \
                 empty its state directory so that it accepts orders again"
            )
        })
    }

    /// Reads the desired settings that this hub does not know yet: all of them at first, then those of other hubs on the same
    /// database. Orders that are open are followed from now on.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn learn(&self) -> Result<(), StoreError> {
        let after = self.learned.load(Ordering::Relaxed);
        for wanted in self.store.desired_after(after).await? {
            let revision = wanted.at.ask.revision;
            self.learned.fetch_max(revision, Ordering::Relaxed);
            self.desires.set(wanted, true);
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
        let now = change.at_ms;
        let setting = change.setting;
        let is_set_back = change.origin == SET_BACK;
        // A restored database lacks the revisions given after its backup, and offline nodes may have them. So that none is given
        // twice, revisions start at the time, in seconds, and above those that the nodes report.
        let mut above = u64::try_from(now.div_euclid(1000)).unwrap_or(0);
        let mut asked = Vec::new();
        for node in nodes {
            let view = self.fleet.view(&node).unwrap_or_default();
            if self.implausible(view.revision).is_none() {
                above = above.max(view.revision);
            }
            let outcome = if view.is_reachable() {
                Outcome::Pending
            } else {
                Outcome::Waiting
            };
            asked.push(Wanted {
                setting,
                at: ChangeNode {
                    node,
                    from: view.setting(),
                    ask: Ask::new(0, now, outcome),
                },
                set_back: u32::from(is_set_back),
                drifted_ms: None,
            });
        }
        let written = self.store.write(move |writing| writing.order(change, asked, above));
        let mut revision = 0;
        for wanted in written.await? {
            revision = wanted.at.ask.revision;
            let node = wanted.at.node.clone();
            self.desires.set(wanted, is_set_back);
            self.desires.notify(&node);
        }
        Ok(revision)
    }

    /// Reads the reports of nodes with open orders.
    ///
    /// # Errors
    /// When the outcomes cannot be stored; the next call finds them again.
    pub async fn look(&self, now: Millis) -> Result<(), StoreError> {
        let patience = milliseconds(self.config.apply_within_s);
        let mut answered = Vec::new();
        for mut wanted in self.desires.list(|one| one.at.ask.outcome.is_open()) {
            if let Some(view) = self.fleet.view(&wanted.at.node)
                && wanted.at.ask.observe(&view, wanted.setting, patience, now)
            {
                answered.push(wanted);
            }
        }
        if !answered.is_empty() {
            let rows = answered.clone();
            let written = self.store.write(move |writing| writing.outcomes(&rows));
            written.await?;
        }
        for wanted in answered {
            self.desires.update(wanted);
        }
        Ok(())
    }

    /// Finds nodes that drifted: somebody changed them after they applied their desired setting. Sets them back if the
    /// configuration says so. Notifies nodes again that did not react to a notice.
    ///
    /// # Errors
    /// When the database cannot be written; the next call finds them again.
    pub async fn look_for_drift(&self, now: Millis) -> Result<(), StoreError> {
        let mut events = Vec::new();
        let mut drifted = Vec::new();
        for mut wanted in self.desires.list(|_| true) {
            let node = &wanted.at.node;
            let revision = wanted.at.ask.revision;
            if wanted.at.ask.outcome == Outcome::Pending {
                self.desires.notify(node);
            }
            let Some(view) = self.fleet.view(node) else {
                continue;
            };
            if view.status.is_some() && view.revision == revision && !view.has(wanted.setting) {
                if wanted.drifted_ms.is_none() {
                    let detail = serde_json::json!({
                        "revision": revision,
                        "desired": wanted.setting,
                        "in_force": view.setting(),
                    });
                    events.push(EventRow::of(now, "drift", node, detail));
                    wanted.drifted_ms = Some(now);
                }
                drifted.push(wanted);
            } else if wanted.drifted_ms.is_some() && view.revision >= revision {
                wanted.drifted_ms = None;
                self.desires.update(wanted);
            }
        }
        if !events.is_empty() {
            let written = self.store.write(move |writing| writing.insert_events(&events));
            written.await?;
        }
        // Only after the events are stored: after an error the next call finds the drift again.
        for wanted in &drifted {
            self.desires.update(wanted.clone());
        }
        if self.config.local_change == LocalChange::SetBack {
            drifted.retain(|wanted| wanted.set_back < SET_BACK_TIMES);
            drifted.sort_by_cached_key(|wanted| format!("{:?}", wanted.setting));
            for alike in drifted.chunk_by(|a, b| a.setting == b.setting) {
                let change = ChangeRow {
                    revision: 0,
                    at_ms: now,
                    who: "hub".to_owned(),
                    why: "changed at the node".to_owned(),
                    origin: SET_BACK.to_owned(),
                    selector: String::new(),
                    setting: alike[0].setting,
                };
                let nodes = alike.iter().map(|wanted| wanted.at.node.clone());
                self.order(change, nodes.collect()).await?;
            }
        }
        Ok(())
    }

    /// The nodes that have drifted.
    pub(crate) fn drift(&self) -> Vec<Drift> {
        let drift = |wanted: Wanted| {
            let view = self.fleet.view(&wanted.at.node)?;
            Some(Drift {
                since_ms: wanted.drifted_ms?,
                desired: wanted.setting,
                in_force: view.setting(),
                why: view.status.as_ref().and_then(|status| status.target_off.clone()),
                set_back: wanted.set_back,
                node: wanted.at.node,
            })
        };
        let drifted = self.desires.list(|one| one.drifted_ms.is_some());
        drifted.into_iter().filter_map(drift).collect()
    }
}
