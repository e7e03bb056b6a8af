//! The policy in force: what others need to know of it, and its switch while the node runs.

use super::camera::CameraBoard;
use super::savings::{Savings, Totals};
use super::threshold::InForce;
use super::{Board, CHANGES_PERIOD};
use albireo_core::policy::{PolicyConfig, PolicyConfigError, Profile, ThresholdSpec};
use albireo_service::clock::unix_milliseconds;
use albireo_service::rate_limit::RateLimit;
use albireo_wire::SettingSource;
use std::sync::Arc;
use tokio::sync::watch;

static CHANGES: RateLimit = RateLimit::new(CHANGES_PERIOD);

/// A policy, from which each camera builds its own.
#[derive(Debug)]
pub(crate) struct NodePolicy {
    /// Builds it.
    pub(crate) config: PolicyConfig,
    /// Its name.
    pub(crate) name: &'static str,
    /// Its threshold, if it has one.
    pub(crate) spec: Option<ThresholdSpec>,
    /// The value of its threshold in the configuration, or its default.
    pub(crate) threshold: Option<f64>,
    /// True if it takes a pause on an empty road.
    pub(crate) takes_pause: bool,
    /// True if it can take back a frame's answer, which answering at once needs.
    pub(crate) can_rewind: bool,
    /// The most frames it lets pass without the detector while objects are tracked.
    pub(super) longest_pause: Option<u32>,
}

impl NodePolicy {
    /// The policy of a configuration.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if no policy can be built from it.
    pub(crate) fn new(config: PolicyConfig) -> Result<Self, PolicyConfigError> {
        let policy = config.build()?;
        Ok(Self {
            name: policy.name(),
            spec: policy.threshold_spec(),
            threshold: policy.threshold(),
            takes_pause: policy.takes_pause(),
            can_rewind: policy.can_rewind(),
            longest_pause: policy.longest_pause(),
            config,
        })
    }

    /// The same settings under another policy.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if there is no policy of this name, or one of its settings is invalid.
    pub(crate) fn named(&self, name: &str) -> Result<Self, PolicyConfigError> {
        Self::new(PolicyConfig {
            name: name.to_owned(),
            ..self.config.clone()
        })
    }

    /// True if its threshold is a `u` that is independent of the picture size, as with the filter of the profile `paper`.
    /// The published code's `u` depends on the size, so its equivalent of this one is another value.
    pub(super) fn has_sizeless_u(&self) -> bool {
        self.config.profile == Profile::Paper && self.spec.is_some_and(|spec| spec.name == "u")
    }
}

/// The counts of the node when its policy was switched.
#[derive(Debug)]
pub(super) struct Switched {
    at_ms: i64,
    before: Totals,
}

impl Board {
    /// The policy in force from each camera's next frame on.
    pub(crate) fn policy(&self) -> Arc<NodePolicy> {
        Arc::clone(&self.policy.lock())
    }

    /// The configured policy.
    pub(crate) fn configured_policy(&self) -> &Arc<NodePolicy> {
        &self.configured_policy
    }

    /// Puts a policy in force: each camera follows at its next frame, with the threshold that is configured for this policy, and
    /// a target is held from there. Call it before the first frame, or use [`switch_policy`](Self::switch_policy).
    pub(crate) fn set_policy(&self, policy: NodePolicy) {
        let policy = Arc::new(policy);
        *self.policy.lock() = Arc::clone(&policy);
        // The target moves one value for all cameras, and begins with the first one's.
        let first = self.cameras.first().and_then(|camera| camera.configured_under(&policy));
        // The controller moves nothing in between: its value may be that of another threshold.
        self.target.follow(&policy, first, || {
            for camera in &self.cameras {
                camera.set_policy(&policy);
            }
        });
    }

    /// Switches the policy while frames may come, and counts the savings of the policy from here on.
    pub(crate) fn switch_policy(&self, policy: NodePolicy) {
        let before = self.policy().name;
        let now = policy.name;
        self.set_policy(policy);
        *self.switched.lock() = Some(Switched {
            at_ms: unix_milliseconds(),
            before: self.totals(self.power()),
        });
        CHANGES.log(|held_back| tracing::info!(before, now, held_back, "policy changed"));
    }

    /// The savings since the policy was switched; `None` if it never was.
    pub(crate) fn savings_of_policy(&self) -> Option<Savings> {
        let now = self.totals(self.power());
        let switched = self.switched.lock();
        let Switched { at_ms, before } = switched.as_ref()?;
        Some(now.since(before).savings(*at_ms))
    }
}

impl CameraBoard {
    /// The policy and its threshold, for the camera's loop, which reads them before each frame.
    pub(crate) fn watch_in_force(&self) -> watch::Receiver<InForce> {
        self.in_force.subscribe()
    }

    /// The threshold that is configured for a policy. The camera's own value is for the configured policy's threshold.
    pub(super) fn configured_under(&self, policy: &NodePolicy) -> Option<f64> {
        if let (Some(own), Some(spec)) = (self.own, policy.spec)
            && let Ok(value) = own.value_of(&spec)
        {
            return Some(value);
        }
        policy.threshold
    }

    fn set_policy(&self, policy: &Arc<NodePolicy>) {
        let threshold = self.configured_under(policy);
        *self.set_by.lock() = SettingSource::Configuration;
        self.in_force.send_modify(|in_force| {
            *in_force = InForce {
                policy: Arc::clone(policy),
                threshold,
            };
            // Within the change, so that announcements have the order of the changes.
            if let Some(threshold) = in_force.named() {
                self.announce(threshold);
            }
        });
        self.policy_begins();
    }

    /// Forgets what was observed under another policy. Counts since the start stay.
    pub(crate) fn policy_begins(&self) {
        self.history.lock().policy_begins();
        self.counts.lock().policy_begins();
    }
}
