//! The node's target: who set it, and what survives a restart.

use crate::delivery::outbox::Outbox;
use albireo_core::policy::Knob;
use albireo_core::target::{
    KnobRange, Measured, Target, TargetController, TargetError, TargetState,
};
use albireo_wire::{SettingSource, TargetReport, Threshold, VERSION};
use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};

/// Name of the setting in the state file.
const SETTING: &str = "target";

/// What a node's target is made from.
#[derive(Clone, Debug, Default)]
pub struct TargetSetup {
    /// The policy's name.
    pub policy: &'static str,
    /// Its knob.
    pub knob: Option<Knob>,
    /// What the configuration wants to be held.
    pub configured: Option<Target>,
    /// Ends of the range that are configured.
    pub range: (Option<f64>, Option<f64>),
}

/// As it is kept in the state file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Kept {
    target: Option<Target>,
    source: SettingSource,
    /// The knob's value when it was kept; the name is the policy's word for it.
    knob: Option<(String, f64)>,
    /// What the configuration said then: once that is edited it is the newer word, unless the hub's is there.
    configured: Option<Target>,
}

#[derive(Debug)]
struct State {
    controller: Option<TargetController>,
    source: SettingSource,
    last: Option<TargetState>,
    off: Option<String>,
}

/// The target of one node.
#[derive(Debug)]
pub struct NodeTarget {
    setup: TargetSetup,
    outbox: Outbox,
    /// Makes changes that are kept one at a time, so that the file is as the last one. Held while a disk is written: no
    /// async worker takes it.
    changing: Mutex<()>,
    /// Never held while a disk is written.
    state: Mutex<State>,
}

impl NodeTarget {
    /// With what the configuration says, or what was kept since. `knob` is the value that the controller begins at where
    /// none was kept.
    pub(crate) fn open(setup: TargetSetup, outbox: Outbox, knob: Option<f64>) -> Self {
        let opened = Self {
            setup,
            outbox,
            changing: Mutex::default(),
            state: Mutex::new(State {
                controller: None,
                source: SettingSource::Configuration,
                last: None,
                off: None,
            }),
        };
        let mut state = opened.state.lock();
        // Once the configuration is edited it is the newer word, except against the hub's.
        let kept: Option<Kept> = opened.outbox.setting(SETTING);
        let kept = kept.filter(|kept| {
            kept.configured == opened.setup.configured || kept.source == SettingSource::Hub
        });
        match kept {
            Some(kept) => {
                let own = opened.setup.knob.map(|knob| knob.name);
                let value = kept.knob.filter(|(name, _)| Some(name.as_str()) == own);
                state.source = kept.source;
                opened.begin(
                    &mut state,
                    kept.target,
                    value.map(|(_, value)| value).or(knob),
                );
            }
            None => opened.begin(&mut state, opened.setup.configured, knob),
        }
        drop(state);
        opened
    }

    fn begin(&self, state: &mut State, target: Option<Target>, knob: Option<f64>) {
        state.controller = None;
        state.last = None;
        let Some(target) = target else {
            return;
        };
        match self.controller(target, knob) {
            Ok(controller) => state.controller = Some(controller),
            Err(error) => {
                tracing::error!(%target, %error, "the target is not held");
                state.off = Some(error.to_string());
            }
        }
    }

    fn range(&self) -> Result<KnobRange, TargetError> {
        let (least, most) = self.setup.range;
        KnobRange::of(self.setup.policy, self.setup.knob.as_ref(), least, most)
    }

    fn controller(
        &self,
        target: Target,
        knob: Option<f64>,
    ) -> Result<TargetController, TargetError> {
        let range = self.range()?;
        TargetController::new(target, range, knob.unwrap_or(range.least))
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
        let controller = target
            .map(|target| self.controller(target, knob))
            .transpose()?;
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
    pub(crate) fn step(&self, measured: &Measured, apply: impl FnOnce(f64)) {
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

    /// Whether anything is held.
    pub(crate) fn is_on(&self) -> bool {
        self.state.lock().controller.is_some()
    }

    /// Its state.
    pub fn report(&self) -> TargetReport {
        let state = self.state.lock();
        let controller = state.controller.as_ref();
        let last = state.last;
        TargetReport {
            v: VERSION,
            target: controller.map(TargetController::target),
            source: state.source,
            off: state.off.clone(),
            range: controller.and_then(|_| self.range().ok()),
            threshold: (self.setup.knob.as_ref())
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
        let knob = self.setup.knob.zip(controller);
        let kept = Kept {
            target: controller.map(TargetController::target),
            source: state.source,
            knob: knob.map(|(knob, controller)| (knob.name.to_owned(), controller.knob())),
            configured: self.setup.configured,
        };
        drop(state);
        if !self.outbox.set(SETTING, &kept) && self.outbox.has_directory() {
            tracing::warn!("target changed but not kept: it will not survive a restart");
        }
    }
}
