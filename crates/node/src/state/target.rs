//! Holds a node's target with a controller that moves the threshold of all its cameras together.

#[cfg(test)]
mod tests;

use crate::config::NodeConfig;
use crate::state::board::{Board, Totals};
use crate::state::settings::{Settings, Values};
use albireo_core::audit::AuditSums;
use albireo_core::policy::{Policy, ThresholdSpec};
use albireo_core::target::{
    Measured, Target, TargetController, TargetError, TargetState, ThresholdRange,
};
use albireo_wire::{SettingSource, TargetReport, Threshold, VERSION};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The name of the setting in the state file.
const SETTING: &str = "target";

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
type Kept = (Option<Target>, Option<Threshold>);

#[derive(Debug)]
struct State {
    controller: Option<TargetController>,
    source: SettingSource,
    last: Option<TargetState>,
    off: Option<String>,
}

/// The target of one node: its source, and the part that survives a restart.
#[derive(Debug)]
pub(crate) struct NodeTarget {
    configured: Option<Target>,
    /// The range in which the threshold may move, or why there is none.
    range: Result<ThresholdRange, TargetError>,
    spec: Option<ThresholdSpec>,
    state: Mutex<State>,
}

impl NodeTarget {
    /// Starts with the configured or the later kept target. Without a kept value, the controller begins with the
    /// threshold of the first camera.
    pub(crate) fn open(config: &NodeConfig, policy: &dyn Policy, settings: &Settings) -> Self {
        let (target, spec) = (config.target, policy.threshold_spec());
        let kept = settings.kept::<Kept, _>(SETTING, &target.hold);
        let ((held, threshold), source) =
            kept.unwrap_or(((target.hold, None), SettingSource::Configuration));
        let place = (threshold.zip(spec)).and_then(|(kept, spec)| kept.value_of(&spec).ok());
        let begin = config.cameras.first().and_then(|camera| camera.threshold);
        let begin = place.or(begin).or_else(|| policy.threshold());
        let range = ThresholdRange::of(policy.name(), spec.as_ref(), target.least, target.most);
        let (controller, off) = match controller(&range, held, begin) {
            Ok(controller) => (controller, None),
            Err(error) => {
                tracing::error!(target = ?held, %error, "the target is not held");
                (None, Some(error.to_string()))
            }
        };
        Self {
            configured: target.hold,
            range,
            spec,
            state: Mutex::new(State {
                controller,
                source,
                last: None,
                off,
            }),
        }
    }

    /// Holds `target` from now on, beginning at `threshold`; or none, and the threshold stays. Sets what `kept` is to have
    /// of it.
    ///
    /// # Errors
    /// [`TargetError`] if its value is invalid or the policy has no threshold; then nothing changes.
    pub(crate) fn set(
        &self,
        target: Option<Target>,
        threshold: Option<f64>,
        source: SettingSource,
        kept: &mut Values,
    ) -> Result<(), TargetError> {
        let controller = controller(&self.range, target, threshold)?;
        let mut state = self.state.lock();
        // Setting the same target again keeps what the controller has learnt.
        if target != state.controller.as_ref().map(TargetController::target) {
            state.last = None;
            state.off = target.is_none().then(|| "it was switched off".to_owned());
            state.controller = controller;
        }
        state.source = source;
        self.keep(&state, kept);
        match target {
            Some(target) => tracing::info!(%target, ?source, "target set"),
            None => tracing::info!(?source, "target switched off"),
        }
        Ok(())
    }

    /// Ends the target, if there is one, because somebody turns the threshold by hand.
    pub(crate) fn turned_by_hand(&self, source: SettingSource, kept: &mut Values) {
        let mut state = self.state.lock();
        let Some(controller) = state.controller.take() else {
            return;
        };
        let by = match source {
            SettingSource::Hub => "the hub",
            SettingSource::Local | SettingSource::Configuration => "hand",
        };
        let off = format!("the threshold was set by {by}");
        tracing::info!(target = %controller.target(), "target switched off: {off}");
        state.off = Some(off);
        state.last = None;
        state.source = source;
        self.keep(&state, kept);
    }

    /// Runs a step of the controller; then `apply` gets the threshold's value, before anybody can turn it by hand.
    fn step(&self, measured: &Measured, apply: impl FnOnce(f64)) {
        let mut state = self.state.lock();
        let Some(controller) = &mut state.controller else {
            return;
        };
        let before = controller.threshold();
        let now = controller.step(measured);
        let first = state.last.is_none();
        state.last = Some(now);
        if first || now.threshold != before {
            apply(now.threshold);
        }
    }

    /// True if a target is held.
    pub(crate) fn is_on(&self) -> bool {
        self.state.lock().controller.is_some()
    }

    /// The state of the target.
    pub(crate) fn report(&self) -> TargetReport {
        let state = self.state.lock();
        let controller = state.controller.as_ref();
        let last = state.last;
        TargetReport {
            v: VERSION,
            target: controller.map(TargetController::target),
            source: state.source,
            off: state.off.clone(),
            range: controller.and_then(|_| self.range.clone().ok()),
            threshold: self.threshold(&state),
            state: last,
            why: last.map(|last| last.status.as_str().to_owned()),
        }
    }

    fn keep(&self, state: &State, kept: &mut Values) {
        let target = state.controller.as_ref().map(TargetController::target);
        let setting: Kept = (target, self.threshold(state));
        kept.keep(SETTING, setting, state.source, self.configured);
    }

    /// The threshold that the controller wants.
    fn threshold(&self, state: &State) -> Option<Threshold> {
        let (spec, controller) = self.spec.as_ref().zip(state.controller.as_ref())?;
        Some(Threshold::new(spec.name, controller.threshold()))
    }
}

/// A controller that holds `target`, beginning at `threshold`.
fn controller(
    range: &Result<ThresholdRange, TargetError>,
    target: Option<Target>,
    threshold: Option<f64>,
) -> Result<Option<TargetController>, TargetError> {
    let Some(target) = target else {
        return Ok(None);
    };
    let range = range.clone()?;
    TargetController::new(target, range, threshold.unwrap_or(range.least)).map(Some)
}

impl Board {
    /// Keeps the threshold's value while a target is held, so that a restart continues from there. Writes a small file.
    pub(crate) fn keep_place(&self) {
        if self.target.is_on() {
            let target = &self.target;
            (self.settings).change(|kept| target.keep(&target.state.lock(), kept));
        }
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
            watts: (since.power.energy("total")).map(|(joules, seconds)| joules / seconds),
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
