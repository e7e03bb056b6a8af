//! Holds a node's target with a controller that moves the threshold of all its cameras together.

#[cfg(test)]
mod tests;

use crate::state::board::{Board, CHANGES_PERIOD, Totals};
use albireo_core::audit::AuditSums;
use albireo_core::policy::{Policy, ThresholdSpec};
use albireo_core::target::{
    Measured, Target, TargetController, TargetError, TargetState, ThresholdRange,
};
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{SettingSource, TargetReport, Threshold, VERSION};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::time::Duration;

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

/// The target, and the threshold when it was kept.
pub(crate) type KeptTarget = (Option<Target>, Option<Threshold>);

#[derive(Debug)]
struct Held {
    controller: Option<TargetController>,
    source: SettingSource,
    last: Option<TargetState>,
    off: Option<String>,
}

/// The target of one node, its source and its controller.
#[derive(Debug)]
pub(crate) struct NodeTarget {
    configured: Option<Target>,
    /// The range in which the threshold may move, or why there is none.
    range: Result<ThresholdRange, TargetError>,
    spec: Option<ThresholdSpec>,
    /// The threshold with which the controller begins without a kept one.
    first_threshold: Option<f64>,
    held: Mutex<Held>,
    /// Log lines about settings.
    changes: RateLimit,
}

impl NodeTarget {
    /// The target of a node with that policy, which begins with `first_threshold`. Holds nothing yet.
    pub(crate) fn new(
        config: &TargetConfig,
        policy: &dyn Policy,
        first_threshold: Option<f64>,
    ) -> Self {
        let spec = policy.threshold_spec();
        Self {
            configured: config.hold,
            range: ThresholdRange::of(policy.name(), spec.as_ref(), config.least, config.most),
            spec,
            first_threshold,
            held: Mutex::new(Held {
                controller: None,
                source: SettingSource::Configuration,
                last: None,
                off: None,
            }),
            changes: RateLimit::new(CHANGES_PERIOD),
        }
    }

    /// Holds the kept target, or the configured one. A target that cannot be held is logged, and its report says why.
    pub(crate) fn begin(&self, kept: Option<(KeptTarget, SettingSource)>) {
        let configured = ((self.configured, None), SettingSource::Configuration);
        let ((target, threshold), source) = kept.unwrap_or(configured);
        let place = threshold.zip(self.spec).and_then(|(kept, spec)| kept.value_of(&spec).ok());
        let (controller, off) = match self.controller(target, place.or(self.first_threshold)) {
            Ok(controller) => (controller, None),
            Err(error) => {
                tracing::error!(?target, %error, "the target is not held");
                (None, Some(error.to_string()))
            }
        };
        *self.held.lock() = Held {
            controller,
            source,
            last: None,
            off,
        };
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
        let controller = self.controller(target, threshold)?;
        let mut held = self.held.lock();
        // Setting the same target again keeps what the controller has learnt.
        if target != held.controller.as_ref().map(TargetController::target) {
            held.last = None;
            held.off = target.is_none().then(|| "it was switched off".to_owned());
            held.controller = controller;
        }
        held.source = source;
        self.changes.log(|held_back| match target {
            Some(target) => tracing::info!(%target, ?source, held_back, "target set"),
            None => tracing::info!(?source, held_back, "target switched off"),
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
        let first = held.last.is_none();
        held.last = Some(now);
        if first || now.threshold != before {
            apply(now.threshold);
        }
    }

    /// True if a target is held.
    pub(crate) fn is_on(&self) -> bool {
        self.held.lock().controller.is_some()
    }

    /// The state of the target.
    pub(crate) fn report(&self) -> TargetReport {
        let held = self.held.lock();
        let controller = held.controller.as_ref();
        let last = held.last;
        TargetReport {
            v: VERSION,
            target: controller.map(TargetController::target),
            source: held.source,
            off: held.off.clone(),
            range: controller.and_then(|_| self.range.clone().ok()),
            threshold: self.threshold(&held),
            state: last,
            why: last.map(|last| last.status.as_str().to_owned()),
        }
    }

    /// What is to be kept of it for a restart, and its source.
    pub(crate) fn kept(&self) -> (KeptTarget, SettingSource) {
        let held = self.held.lock();
        let target = held.controller.as_ref().map(TargetController::target);
        ((target, self.threshold(&held)), held.source)
    }

    /// The configured target.
    pub(crate) fn configured(&self) -> Option<Target> {
        self.configured
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
    fn threshold(&self, held: &Held) -> Option<Threshold> {
        let (spec, controller) = self.spec.as_ref().zip(held.controller.as_ref())?;
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
                let near = camera
                    .threshold()
                    .is_some_and(|there| (value / there).ln().abs() < LEAST_CHANGE);
                if !near {
                    camera.move_threshold(value);
                }
            }
        });
    }
}
