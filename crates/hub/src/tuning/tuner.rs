//! Gives nodes their desired settings: stores them, notifies the nodes, and follows their reports.

use super::desired::{DesiredSettings, NodeSetting};
use super::member::Millis;
use super::outcome::Outcome;
use super::revision::Revision;
use super::run::milliseconds;
use crate::config::{LocalChange, TuningConfig};
use crate::presence::Fleet;
use crate::store::{EventRow, Store, StoreError};
use albireo_service::clock::unix_milliseconds;
use albireo_service::readiness::Part;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

/// Most times that a node is set back after one change, so that hub and node do not fight over a value for ever.
const SET_BACK_TIMES: u32 = 3;

/// The origin of the revision that sets a node back.
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
    pub(super) desired: Arc<DesiredSettings>,
    pub(super) config: TuningConfig,
    /// The name of this hub among several on one database.
    pub(super) driver: String,
    /// The highest revision that was read from the database. Those of this hub do not count: there may be lower
    /// revisions of other hubs that were not read yet.
    learned: AtomicU64,
    pub(super) runs: tokio::sync::Mutex<super::runs::DrivenRuns>,
}

/// Interval at which the nodes' reports are read.
const FOLLOW_EVERY: Duration = Duration::from_millis(250);
/// Checks of rollouts, trials and other hubs' revisions, and of drift and lost notices: once per this number of intervals.
const DRIVE_EVERY: u64 = 4;
const DRIFT_EVERY: u64 = 20;

/// Follows desired settings, rollouts and trials until `shutdown`. After an error of the database it tries again at the next interval.
/// Meanwhile the hub is degraded: it takes reports, and gives no settings.
pub(crate) async fn follow(tuner: Arc<Tuner>, part: Part, shutdown: CancellationToken) {
    let mut every = tokio::time::interval(FOLLOW_EVERY);
    every.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut is_failing = false;
    for round in 0_u64.. {
        tokio::select! {
            _ = every.tick() => {}
            () = shutdown.cancelled() => return,
        }
        let now = unix_milliseconds();
        let worked = async {
            tuner.follow(now).await?;
            if round.is_multiple_of(DRIVE_EVERY) {
                tuner.drive(now).await?;
                tuner.learn().await?;
            }
            if round.is_multiple_of(DRIFT_EVERY) {
                tuner.find_drift(now).await?;
                tuner.forget_strangers(now).await?;
            }
            Ok::<_, StoreError>(())
        };
        match worked.await {
            Ok(()) => {
                is_failing = false;
                part.works();
            }
            Err(error) if is_failing => tracing::debug!(%error, "settings cannot be followed"),
            Err(error) => {
                tracing::warn!(%error, "settings cannot be followed; trying again");
                part.degraded(format!("settings cannot be given or followed: {error}"));
                is_failing = true;
            }
        }
    }
}

impl Tuner {
    /// Reads the desired settings from the database.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn open(
        store: Store,
        fleet: Arc<Fleet>,
        desired: Arc<DesiredSettings>,
        config: TuningConfig,
        driver: String,
    ) -> Result<Self, StoreError> {
        let tuner = Self {
            store,
            fleet,
            desired,
            config,
            driver,
            learned: AtomicU64::new(0),
            runs: tokio::sync::Mutex::default(),
        };
        tuner.learn().await?;
        Ok(tuner)
    }

    /// The reason that a node that reports `revision` is given no setting; `None` if it can.
    pub(super) fn implausible(&self, revision: u64) -> Option<String> {
        let most = self.learned.load(Ordering::Relaxed).saturating_add(FARTHEST_AHEAD);
        if revision <= most {
            return None;
        }
        Some(format!(
            "it reports revision {revision}, but no hub gave one above {most}: \
             empty its state directory so that it accepts settings again"
        ))
    }

    /// Reads the desired settings that this hub does not know yet: all of them at first, then those of other hubs on the same
    /// database. Those that are open are followed from now on.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn learn(&self) -> Result<(), StoreError> {
        let after = self.learned.load(Ordering::Relaxed);
        for desired in self.store.desired_after(after).await? {
            let revision = desired.given.revision;
            self.learned.fetch_max(revision, Ordering::Relaxed);
            self.desired.set_keeping_drift(desired);
        }
        Ok(())
    }

    /// Gives nodes a desired setting, and returns the number of its revision. When this returns, it is in the database, pulls
    /// are answered with it, and the nodes are notified.
    pub(super) async fn give(
        &self,
        revision: Revision,
        nodes: Vec<String>,
    ) -> Result<u64, StoreError> {
        let now = revision.at_ms;
        let is_set_back = revision.origin == SET_BACK;
        // A restored database lacks the revisions given after its backup, and offline nodes may have them. So that none is given
        // twice, revisions start at the time, in seconds, and above those that the nodes report.
        let mut above = u64::try_from(now.div_euclid(1000)).unwrap_or(0);
        let mut given = Vec::new();
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
            let from = view.setting();
            let mut desired = NodeSetting::new(node, revision.setting, from, outcome, now);
            desired.set_back = u32::from(is_set_back);
            given.push(desired);
        }
        let (number, given) =
            self.store.write(move |writing| writing.give(&revision, given, above)).await?;
        for desired in given {
            let node = desired.node.clone();
            if is_set_back {
                self.desired.set_keeping_drift(desired);
            } else {
                self.desired.set(desired);
            }
            self.desired.notify(&node);
        }
        Ok(number)
    }

    /// Follows the settings whose outcome is open, by what their nodes report.
    ///
    /// # Errors
    /// When the outcomes cannot be stored; the next call finds them again.
    pub async fn follow(&self, now: Millis) -> Result<(), StoreError> {
        let patience = milliseconds(self.config.apply_within_s);
        let mut answered = Vec::new();
        for mut desired in self.desired.list(|one| one.given.outcome.is_open()) {
            let Some(view) = self.fleet.view(&desired.node) else {
                continue;
            };
            let has_changed = desired.given.observe(&view, desired.setting, patience, now);
            if has_changed {
                answered.push(desired);
            }
        }
        if !answered.is_empty() {
            let rows = answered.clone();
            self.store.write(move |writing| writing.outcomes(&rows)).await?;
        }
        for desired in answered {
            self.desired.update(desired);
        }
        Ok(())
    }

    /// Finds nodes that drifted: somebody changed them after they applied their desired setting. Sets them back if the
    /// configuration says so. Notifies nodes again that did not react to a notice.
    ///
    /// # Errors
    /// When the database cannot be written; the next call finds them again.
    pub async fn find_drift(&self, now: Millis) -> Result<(), StoreError> {
        let mut events = Vec::new();
        let mut drifted = Vec::new();
        for mut desired in self.desired.list(|_| true) {
            let node = &desired.node;
            let revision = desired.given.revision;
            if desired.given.outcome == Outcome::Pending {
                self.desired.notify(node);
            }
            let Some(view) = self.fleet.view(node) else {
                continue;
            };
            if view.status.is_some() && view.revision == revision && !view.has(desired.setting) {
                if desired.drifted_ms.is_none() {
                    let detail = serde_json::json!({
                        "revision": revision,
                        "desired": desired.setting,
                        "in_force": view.setting(),
                    });
                    events.push(EventRow::of(now, "drift", node, detail));
                    desired.drifted_ms = Some(now);
                }
                drifted.push(desired);
            } else if desired.drifted_ms.is_some() && view.revision >= revision {
                desired.drifted_ms = None;
                self.desired.update(desired);
            }
        }
        if !events.is_empty() {
            self.store.write(move |writing| writing.insert_events(&events)).await?;
        }
        // Only after the events are stored: after an error the next call finds the drift again.
        for desired in &drifted {
            self.desired.update(desired.clone());
        }
        match self.config.local_change {
            LocalChange::SetBack => self.set_back(drifted, now).await,
            LocalChange::Wins => Ok(()),
        }
    }

    /// Sets drifted nodes back, under one revision for each setting.
    async fn set_back(&self, mut drifted: Vec<NodeSetting>, now: Millis) -> Result<(), StoreError> {
        drifted.retain(|desired| desired.set_back < SET_BACK_TIMES);
        drifted.sort_by_cached_key(|desired| format!("{:?}", desired.setting));
        for alike in drifted.chunk_by(|a, b| a.setting == b.setting) {
            let revision = Revision {
                number: None,
                at_ms: now,
                who: "hub".to_owned(),
                why: "changed at the node".to_owned(),
                origin: SET_BACK.to_owned(),
                selector: String::new(),
                setting: alike[0].setting,
                counts: BTreeMap::new(),
                nodes: Vec::new(),
            };
            let nodes = alike.iter().map(|desired| desired.node.clone()).collect();
            self.give(revision, nodes).await?;
        }
        Ok(())
    }

    /// The nodes that have drifted.
    pub(crate) fn drift(&self) -> Vec<Drift> {
        let drift = |desired: NodeSetting| {
            let view = self.fleet.view(&desired.node)?;
            Some(Drift {
                since_ms: desired.drifted_ms?,
                desired: desired.setting,
                in_force: view.setting(),
                why: view.status.as_ref().and_then(|status| status.target_off.clone()),
                set_back: desired.set_back,
                node: desired.node,
            })
        };
        let drifted = self.desired.list(|one| one.drifted_ms.is_some());
        drifted.into_iter().filter_map(drift).collect()
    }
}
