//! Holds the target of a node with a controller that moves the knob of all its cameras together.

#[cfg(test)]
mod tests;

use crate::state::board::{Board, Totals};
use crate::state::settings::Settings;
use albireo_core::audit::AuditSums;
use albireo_core::policy::Knob;
use albireo_core::target::{
    KnobRange, Measured, Target, TargetController, TargetError, TargetState,
};
use albireo_wire::{SettingSource, TargetReport, Threshold, VERSION};
use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Name of the setting in the state file.
const SETTING: &str = "target";

/// A knob that is off by less than this share stays: every change is announced and noted in the clip's report.
const LEAST_CHANGE: f64 = 0.02;

/// The target that the node holds by moving its threshold: the `[target]` section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetConfig {
    /// The target: `{ skip_rate = 0.5 }`. One at a time.
    pub hold: Option<Target>,
    /// Smallest value the knob is moved to; by default where accuracy costs little.
    pub least: Option<f64>,
    /// Largest value the knob is moved to; by default where accuracy costs little.
    pub most: Option<f64>,
}

/// As it is kept in the state file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Kept {
    target: Option<Target>,
    source: SettingSource,
    /// The knob's value when it was kept; the name is the policy's word for it.
    knob: Option<(String, f64)>,
    /// The target of the configuration then. Once that is edited it is the newer word, unless the hub's is there.
    configured: Option<Target>,
}

#[derive(Debug)]
struct State {
    controller: Option<TargetController>,
    source: SettingSource,
    last: Option<TargetState>,
    off: Option<String>,
}

/// The target of one node: who set it, and what survives a restart.
#[derive(Debug)]
pub(crate) struct NodeTarget {
    config: TargetConfig,
    policy: &'static str,
    knob: Option<Knob>,
    settings: Settings,
    /// Makes changes that are kept one at a time, so that the file is as the last one. Held while a disk is written: no
    /// async worker takes it.
    changing: Mutex<()>,
    /// Never held while a disk is written.
    state: Mutex<State>,
}

impl NodeTarget {
    /// With what the configuration says, or what was kept since. `begin` is the value of the knob that the controller
    /// begins at where none was kept.
    pub(crate) fn open(
        config: TargetConfig,
        policy: &'static str,
        knob: Option<Knob>,
        begin: Option<f64>,
        settings: Settings,
    ) -> Self {
        let kept: Option<Kept> = settings.get(SETTING);
        // Once the configuration is edited it is the newer word, except against the hub's.
        let kept =
            kept.filter(|kept| kept.configured == config.hold || kept.source == SettingSource::Hub);
        let (target, source, place) = match kept {
            Some(kept) => {
                let own = knob.map(|knob| knob.name);
                let place = kept.knob.filter(|(name, _)| Some(name.as_str()) == own);
                (kept.target, kept.source, place.map(|(_, value)| value))
            }
            None => (config.hold, SettingSource::Configuration, None),
        };
        let mut opened = Self {
            config,
            policy,
            knob,
            settings,
            changing: Mutex::default(),
            state: Mutex::new(State {
                controller: None,
                source,
                last: None,
                off: None,
            }),
        };
        match opened.controller(target, place.or(begin)) {
            Ok(controller) => opened.state.get_mut().controller = controller,
            Err(error) => {
                tracing::error!(?target, %error, "the target is not held");
                opened.state.get_mut().off = Some(error.to_string());
            }
        }
        opened
    }

    fn range(&self) -> Result<KnobRange, TargetError> {
        let TargetConfig { least, most, .. } = self.config;
        KnobRange::of(self.policy, self.knob.as_ref(), least, most)
    }

    fn controller(
        &self,
        target: Option<Target>,
        knob: Option<f64>,
    ) -> Result<Option<TargetController>, TargetError> {
        let Some(target) = target else {
            return Ok(None);
        };
        let range = self.range()?;
        TargetController::new(target, range, knob.unwrap_or(range.least)).map(Some)
    }

    /// Holds `target` from now on, beginning at the value `knob`; or nothing, and the knob stays. Writes a small file.
    ///
    /// # Errors
    /// [`TargetError`] when its value makes no sense or the policy has nothing to turn; nothing changes then.
    pub(crate) fn set(
        &self,
        target: Option<Target>,
        knob: Option<f64>,
        source: SettingSource,
    ) -> Result<(), TargetError> {
        let controller = self.controller(target, knob)?;
        let _changing = self.changing.lock();
        let mut state = self.state.lock();
        // The same again changes nothing: what the controller has learnt stays.
        let same = state.controller.as_ref().map(TargetController::target) == target;
        if !(same && target.is_some()) {
            let had_one = state.controller.is_some();
            state.last = None;
            state.off = match target {
                None if had_one => Some("it was switched off".to_owned()),
                None => state.off.take(),
                Some(_) => None,
            };
            state.controller = controller;
        }
        state.source = source;
        self.keep(state);
        match target {
            Some(target) => tracing::info!(%target, ?source, "target set"),
            None => tracing::info!(?source, "target switched off"),
        }
        Ok(())
    }

    /// Somebody turns the knob by hand: nothing is held any more. Writes a small file if anything was.
    pub(crate) fn turned_by_hand(&self, source: SettingSource) {
        let _changing = self.changing.lock();
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
        self.keep(state);
    }

    /// Lets the controller take a step; then `apply` gets the knob's value, before anybody can turn it by hand.
    fn step(&self, measured: &Measured, apply: impl FnOnce(f64)) {
        let mut state = self.state.lock();
        let Some(controller) = &mut state.controller else {
            return;
        };
        let before = controller.knob();
        let now = controller.step(measured);
        let first = state.last.is_none();
        state.last = Some(now);
        if first || now.knob != before {
            apply(now.knob);
        }
    }

    /// Says whether anything is held.
    pub(crate) fn is_on(&self) -> bool {
        self.state.lock().controller.is_some()
    }

    /// Returns its state.
    pub(crate) fn report(&self) -> TargetReport {
        let state = self.state.lock();
        let controller = state.controller.as_ref();
        let last = state.last;
        TargetReport {
            v: VERSION,
            target: controller.map(TargetController::target),
            source: state.source,
            off: state.off.clone(),
            range: controller.and_then(|_| self.range().ok()),
            threshold: (self.knob.as_ref())
                .zip(controller)
                .map(|(knob, controller)| Threshold::new(knob.name, controller.knob())),
            state: last,
            why: last.map(|last| last.status.as_str().to_owned()),
        }
    }

    /// Keeps the knob's value, so that a restart goes on from there. Writes a small file if anything is held.
    pub(crate) fn keep_place(&self) {
        let _changing = self.changing.lock();
        let state = self.state.lock();
        if state.controller.is_some() {
            self.keep(state);
        }
    }

    /// Writes what is held; gives the state back before that, as a disk may stall.
    fn keep(&self, state: MutexGuard<'_, State>) {
        let controller = state.controller.as_ref();
        let knob = self.knob.zip(controller);
        let kept = Kept {
            target: controller.map(TargetController::target),
            source: state.source,
            knob: knob.map(|(knob, controller)| (knob.name.to_owned(), controller.knob())),
            configured: self.config.hold,
        };
        drop(state);
        self.settings.set(SETTING, &kept);
    }
}

impl Board {
    /// Gives the controller what was counted in the last second, and the cameras the knob's new value.
    pub(crate) fn step_target(&self, since: &Totals, time: Duration) {
        let mut audit = AuditSums::default();
        for camera in &self.cameras {
            audit.merge(&camera.take_audit());
        }
        // While no detector answers, the load says nothing of the knob: it stays where it is.
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
