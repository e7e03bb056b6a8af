//! Holds a node's target with a controller that moves the threshold of all its cameras together.

#[cfg(test)]
mod tests;

use crate::state::board::{Board, CHANGES_PERIOD, NodePolicy, Totals};
use albireo_core::audit::AuditSums;
use albireo_core::policy::ThresholdSpec;
use albireo_core::target::{
    Measured, Target, TargetController, TargetError, TargetState, ThresholdRange,
};
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{SettingSource, TargetReport, Threshold, VERSION};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tracing::field::display;

/// Smaller relative changes of a threshold are skipped: every change is announced and recorded in the clip's report.
const LEAST_CHANGE: f64 = 0.02;

/// The target that the node holds by moving its threshold: the `[target]` section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetConfig {
    /// The target: `{ skip_rate = 0.5 }`. One at a time.
    pub hold: Option<Target>,
    /// Smallest value of the threshold; by default the lower end of [`ThresholdRange::of`].
    pub least: Option<f64>,
    /// Largest value of the threshold; by default its upper end.
    pub most: Option<f64>,
}

/// What is kept of a target over a restart, in the file a list of two.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(
    from = "(Option<Target>, Option<Threshold>)",
    into = "(Option<Target>, Option<Threshold>)"
)]
pub(crate) struct KeptTarget {
    target: Option<Target>,
    /// The threshold when it was kept.
    threshold: Option<Threshold>,
}

impl From<(Option<Target>, Option<Threshold>)> for KeptTarget {
    fn from((target, threshold): (Option<Target>, Option<Threshold>)) -> Self {
        Self { target, threshold }
    }
}

impl From<KeptTarget> for (Option<Target>, Option<Threshold>) {
    fn from(kept: KeptTarget) -> Self {
        (kept.target, kept.threshold)
    }
}

#[derive(Debug)]
struct Held {
    /// The range in which the threshold may move, or why there is none.
    range: Result<ThresholdRange, TargetError>,
    spec: Option<ThresholdSpec>,
    controller: Option<TargetController>,
    source: SettingSource,
    last: Option<TargetState>,
    off: Option<String>,
}

/// The target of one node, its source and its controller.
#[derive(Debug)]
pub(crate) struct NodeTarget {
    config: TargetConfig,
    /// The name of the threshold whose range is configured.
    ranged: Option<&'static str>,
    held: Mutex<Held>,
    /// Log lines about settings.
    changes: RateLimit,
}

impl NodeTarget {
    /// The target of a node with that policy. Holds nothing yet.
    pub(crate) fn new(config: &TargetConfig, policy: &NodePolicy) -> Self {
        let ranged = policy.spec.map(|spec| spec.name);
        Self {
            config: *config,
            ranged,
            held: Mutex::new(Held {
                range: range(config, ranged, policy),
                spec: policy.spec,
                controller: None,
                source: SettingSource::Configuration,
                last: None,
                off: None,
            }),
            changes: RateLimit::new(CHANGES_PERIOD),
        }
    }

    /// Holds the kept target, or the configured one, beginning at the kept threshold or at `first`. A target that cannot be held
    /// is logged, and its report says why.
    pub(crate) fn begin(&self, kept: Option<(KeptTarget, SettingSource)>, first: Option<f64>) {
        let mut held = self.held.lock();
        let Some((kept, source)) = kept else {
            held.begin(self.config.hold, first);
            held.source = SettingSource::Configuration;
            return;
        };
        // What was kept may be the threshold of another policy.
        let place = match (kept.threshold, held.spec) {
            (Some(threshold), Some(spec)) => threshold.value_of(&spec).ok(),
            _ => None,
        };
        held.begin(kept.target, place.or(first));
        held.source = source;
    }

    /// Holds the target under another policy, beginning at `threshold`. In between, `apply` puts that policy in force: the controller
    /// moves no threshold meanwhile. A target that cannot be held is logged, and its report says why.
    pub(crate) fn follow(&self, policy: &NodePolicy, threshold: Option<f64>, apply: impl FnOnce()) {
        let mut held = self.held.lock();
        held.range = range(&self.config, self.ranged, policy);
        held.spec = policy.spec;
        if let Some(target) = held.target() {
            held.begin(Some(target), threshold);
        }
        apply();
    }

    /// Holds `target` from now on, beginning at `threshold`; or none, and the threshold stays.
    ///
    /// # Errors
    /// [`TargetError`] if its value is invalid or the policy has no threshold; then nothing changes.
    pub(crate) fn set(
        &self,
        target: Option<Target>,
        threshold: Option<f64>,
        source: SettingSource,
    ) -> Result<(), TargetError> {
        let mut held = self.held.lock();
        let controller = held.controller(target, threshold)?;
        // Setting the same target again keeps what the controller has learnt.
        if target != held.target() {
            held.last = None;
            held.off = match target {
                Some(_) => None,
                None => Some("it was switched off".to_owned()),
            };
            held.controller = controller;
        }
        held.source = source;
        self.changes.log(|held_back| match target {
            Some(target) => {
                tracing::info!(%target, source = source.as_str(), held_back, "target set")
            }
            None => tracing::info!(source = source.as_str(), held_back, "target switched off"),
        });
        Ok(())
    }

    /// Ends the target, if there is one, because `source` sets the threshold. Returns true if there was one.
    pub(crate) fn threshold_was_set(&self, source: SettingSource) -> bool {
        let mut held = self.held.lock();
        let Some(controller) = held.controller.take() else {
            return false;
        };
        let by = match source {
            SettingSource::Hub => "the hub",
            SettingSource::Local | SettingSource::Configuration => "hand",
        };
        let off = format!("the threshold was set by {by}");
        let target = controller.target();
        self.changes.log(|held_back| {
            tracing::info!(%target, held_back, "target switched off: {off}");
        });
        held.off = Some(off);
        held.last = None;
        held.source = source;
        true
    }

    /// Runs a step of the controller; then `apply` gets the threshold's value, before anybody can turn it by hand.
    fn step(&self, measured: &Measured, apply: impl FnOnce(f64)) {
        let mut held = self.held.lock();
        let Some(controller) = &mut held.controller else {
            return;
        };
        let before = controller.threshold();
        let now = controller.step(measured);
        let is_first = held.last.is_none();
        held.last = Some(now);
        if is_first || now.threshold != before {
            apply(now.threshold);
        }
    }

    /// Why no target is held, if the policy allows none.
    pub(crate) fn not_under_this_policy(&self) -> Option<String> {
        let held = self.held.lock();
        match held.range {
            Ok(_) => None,
            Err(_) => held.off.clone(),
        }
    }

    /// True if a target is held.
    pub(crate) fn is_on(&self) -> bool {
        self.held.lock().controller.is_some()
    }

    /// The state of the target.
    pub(crate) fn report(&self) -> TargetReport {
        let held = self.held.lock();
        let last = held.last;
        let range = if held.controller.is_some() {
            held.range.clone().ok()
        } else {
            None
        };
        TargetReport {
            v: VERSION,
            target: held.target(),
            source: held.source,
            off: held.off.clone(),
            range,
            threshold: held.threshold(),
            state: last,
            why: last.map(|last| last.status.as_str().to_owned()),
        }
    }

    /// What is to be kept of it for a restart, and its source.
    pub(crate) fn kept(&self) -> (KeptTarget, SettingSource) {
        let held = self.held.lock();
        let kept = KeptTarget {
            target: held.target(),
            threshold: held.threshold(),
        };
        (kept, held.source)
    }

    /// The configured target.
    pub(crate) fn configured(&self) -> Option<Target> {
        self.config.hold
    }
}

/// The range in which a controller moves the threshold of `policy`. The configured ends are for the threshold named `ranged`.
fn range(
    config: &TargetConfig,
    ranged: Option<&'static str>,
    policy: &NodePolicy,
) -> Result<ThresholdRange, TargetError> {
    let (least, most) = if policy.spec.map(|spec| spec.name) == ranged {
        (config.least, config.most)
    } else {
        (None, None)
    };
    ThresholdRange::of(policy.name, policy.spec.as_ref(), least, most)
}

impl Held {
    fn target(&self) -> Option<Target> {
        self.controller.as_ref().map(TargetController::target)
    }

    /// Begins to hold `target` at `threshold`; if it cannot be held, logs and notes why.
    fn begin(&mut self, target: Option<Target>, threshold: Option<f64>) {
        let controller = self.controller(target, threshold);
        self.off = controller.as_ref().err().map(ToString::to_string);
        if let Some(error) = &self.off {
            let target = target.map(display);
            tracing::error!(target, error, "the target is not held");
        }
        self.controller = controller.unwrap_or_default();
        self.last = None;
    }

    /// A controller that holds `target`, beginning at `threshold`; none without a target.
    fn controller(
        &self,
        target: Option<Target>,
        threshold: Option<f64>,
    ) -> Result<Option<TargetController>, TargetError> {
        let Some(target) = target else {
            return Ok(None);
        };
        let range = self.range.clone()?;
        TargetController::new(target, range, threshold.unwrap_or(range.least)).map(Some)
    }

    /// The threshold that the controller wants.
    fn threshold(&self) -> Option<Threshold> {
        let spec = self.spec.as_ref()?;
        let controller = self.controller.as_ref()?;
        Some(Threshold::new(spec.name, controller.threshold()))
    }
}

impl Board {
    /// Holds `target` from now on, beginning at the threshold of the first camera; or none.
    ///
    /// # Errors
    /// [`TargetError`] if it cannot be held; then nothing changes.
    pub(crate) fn set_target(
        &self,
        target: Option<Target>,
        source: SettingSource,
    ) -> Result<(), TargetError> {
        let threshold = self.cameras.first().and_then(|camera| camera.threshold());
        self.target.set(target, threshold, source)
    }

    /// Passes the counts of the last second to the controller, and the threshold's new value to the cameras.
    pub(crate) fn step_target(&self, since: &Totals, time: Duration) {
        let mut audit = AuditSums::default();
        for camera in &self.cameras {
            audit.merge(&camera.take_audit());
        }
        // While the detector does not answer, the load does not depend on the threshold, which stays.
        if since.degraded > 0 && since.detector_us == 0 {
            return;
        }
        let measured = Measured {
            seconds: time.as_secs_f64(),
            frames: since.frames,
            skipped: since.skipped,
            watts: since.power.energy("total").map(|(joules, seconds)| joules / seconds),
            audit,
        };
        self.target.step(&measured, |value| {
            for camera in &self.cameras {
                if let Some(present) = camera.threshold()
                    && (value / present).ln().abs() < LEAST_CHANGE
                {
                    continue;
                }
                camera.move_threshold(value);
            }
        });
    }
}
