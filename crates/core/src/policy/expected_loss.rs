//! The expected-loss policy: the detector runs when the boxes that are expected to be lost without it
//! are worth a call.
//!
//! The paper's uncertainty τ is blind to the scene: with fixed noise it depends on the pattern of
//! updates alone, and small boxes, which need tighter prediction, weigh no more than large ones. Here
//! each object's covariance is scaled by how well its predictions turned out (α), measured against its
//! own size, and turned into the probability π that its predicted box misses. All objects together
//! decide, each weighed by its score, and so does what may have appeared unseen.
//!
//! | part | equations |
//! | --- | --- |
//! | the filter of one object: four axes of position and velocity, with perspective | [`motion`] |
//! | α, π, confidence and box of one object | [`object`] |
//! | matching: by overlap, then by Mahalanobis distance, both optimal | [`association`] |
//! | the velocity a new object should be expected to have | [`velocity`] |
//! | how much may have appeared since the last call | [`birth`] |
//! | when the detector is called | below, and [`trigger`] |
//! | every number | [`settings`] |
//!
//! On each frame, with T the frames since the last call of the detector, this one included,
//!
//! ```text
//! L = Σ m·miss^misses·π  +  birth·b·T          expected loss of this frame, in boxes
//! M = L + Σ (L − L_t)                          over the frames t skipped since the last call
//! g = M / max(N̄, least_crowd)
//! ```
//!
//! where m is an object's mean score, b the birth rate and N̄ a moving average of the summed confidence
//! of the reported boxes. The detector runs on the first frame, when g ≥ λ, and when T reaches
//! `longest_pause`.
//!
//! Why M: let a call cost λ·N̄ boxes. A pause of k skipped frames and one call costs
//! `(L_1 + … + L_k + λN̄) / (k + 1)` per frame. Skipping one frame more lowers this mean exactly if its
//! loss is below the mean, which is `(k + 1)·L − Σ L_t < λN̄`, that is `M < λN̄`. So λ is the price of a
//! call, in frames' worth of all the boxes in view; scenes that change fast are called more often, but
//! not as much more often as a threshold on L would have it. [`CallRule::Frame`] is that threshold.
//!
//! Lost frames advance everything but the sums: a frame that never came cannot be answered badly.

mod association;
mod birth;
mod motion;
mod object;
mod objects;
mod settings;
mod trigger;
mod velocity;

use super::{
    CallCause, Evidence, FrameHead, FrameState, Knob, KnobError, Need, ObjectRecord, Outcome,
    Policy, PolicyConfig, PolicyConfigError, config::with_overrides, tracker::check_setting,
};
use crate::detection::Detection;
use birth::BirthRate;
use objects::Objects;
pub use settings::{Call, Confidence, ExpectedLossSettings, Motion};
pub use settings::{CallRule, ExpectedLossAssociation, InTracker, Life, Surprise};
use trigger::Pause;
pub use trigger::Trigger;

/// How far the frame in hand has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ExpectedLossPhase {
    /// The screen was asked.
    AwaitsScreen,
    /// The detector was asked, after the screen said "not empty" or without its verdict.
    AwaitsDetections { screened: bool },
    /// The screen said "empty".
    Empty,
    /// The detector is not needed.
    Skipped,
    /// The detector answered.
    Detected { screened: bool },
}

/// The expected-loss policy, and the schedules that share its objects: see [`Trigger`].
#[derive(Clone, Debug)]
pub struct ExpectedLoss {
    settings: ExpectedLossSettings,
    trigger: Trigger,
    objects: Objects,
    births: BirthRate,
    /// N̄, the moving average of the summed confidence of reported boxes.
    crowd: f64,
    pause: Pause,
    /// Whether the detector has answered since the stream began.
    started: bool,
    progress: ExpectedLossPhase,
    /// Why the detector is called for the frame in hand.
    cause: Option<CallCause>,
    /// L of the frame in hand.
    loss: f64,
    /// g of the frame in hand.
    weight: f64,
    tau_max: Option<f64>,
    active: usize,
}

impl ExpectedLoss {
    /// The name in configuration and reports.
    pub const NAME: &'static str = Trigger::ExpectedLoss { lambda: 0.0 }.policy_name();
    /// The name with a detector call on one frame of N.
    pub const FIXED_SKIP_NAME: &'static str = Trigger::FixedSkip { n: 1.0 }.policy_name();
    /// The name with evenly spaced detector calls.
    pub const EVEN_SKIP_NAME: &'static str = Trigger::Even { skip_rate: 0.0 }.policy_name();

    /// λ, the price of a detector call. At 0 every frame runs the detector.
    pub const KNOB: Knob = Trigger::ExpectedLoss { lambda: 0.0 }.knob();

    /// A policy with these settings and trigger.
    ///
    /// # Errors
    /// [`PolicyConfigError`] when a setting or the trigger's number cannot be used.
    pub fn new(
        settings: ExpectedLossSettings,
        trigger: Trigger,
    ) -> Result<Self, PolicyConfigError> {
        settings.check().map_err(wrong_setting)?;
        let table = match trigger {
            Trigger::ExpectedLoss { .. } => "lambda",
            Trigger::FixedSkip { .. } | Trigger::Even { .. } => "in_tracker",
        };
        check_setting(table, trigger.knob(), trigger.value())?;
        Ok(Self {
            settings,
            trigger,
            objects: Objects::new(),
            births: BirthRate::new(&settings.call),
            crowd: settings.call.crowd_prior,
            pause: Pause::START,
            started: false,
            progress: ExpectedLossPhase::Skipped,
            cause: None,
            loss: 0.0,
            weight: 0.0,
            tau_max: None,
            active: 0,
        })
    }

    pub(super) fn from_config(config: &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let lambda = config.lambda;
        Self::boxed(config, Trigger::ExpectedLoss { lambda })
    }

    pub(super) fn fixed_skip(config: &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let n = config.in_tracker.n;
        Self::boxed(config, Trigger::FixedSkip { n })
    }

    pub(super) fn even_skip(config: &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let skip_rate = config.in_tracker.skip_rate;
        Self::boxed(config, Trigger::Even { skip_rate })
    }

    fn boxed(
        config: &PolicyConfig,
        trigger: Trigger,
    ) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let settings = with_overrides(&ExpectedLossSettings::default(), &config.expected_loss)
            .map_err(wrong_setting)?;
        Ok(Box::new(Self::new(settings, trigger)?))
    }

    /// The settings in force.
    pub fn settings(&self) -> &ExpectedLossSettings {
        &self.settings
    }

    /// g of the frame in hand: what is compared with λ.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Sums up what would be lost on this frame without the detector.
    fn survey(&mut self) {
        let call = &self.settings.call;
        self.objects.judge();
        let aspect = self.objects.aspect();
        let mut tau_max = f64::NEG_INFINITY;
        let mut loss = self.births.expected_loss(call, self.pause.frames);
        for object in self.objects.iter() {
            loss += object.expected_loss(call.miss);
            tau_max = tau_max.max(object.tau(aspect));
        }
        self.loss = loss;
        let crowd = self.crowd.max(call.least_crowd);
        self.weight = self.pause.weigh(call.rule, loss, crowd);
        self.active = self.objects.len();
        self.tau_max = (self.active > 0).then_some(tau_max);
    }

    fn take_detections(&mut self, detections: &[Detection]) {
        let born = self.objects.observe(&self.settings, detections);
        self.births.count(born);
        self.pause.end();
        self.started = true;
    }
}

fn wrong_setting(reason: String) -> PolicyConfigError {
    PolicyConfigError::Setting {
        table: "expected_loss",
        reason,
    }
}

impl Policy for ExpectedLoss {
    fn name(&self) -> &'static str {
        self.trigger.policy_name()
    }

    fn knob(&self) -> Option<Knob> {
        Some(self.trigger.knob())
    }

    fn knob_value(&self) -> Option<f64> {
        Some(self.trigger.value())
    }

    fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        let value = self.trigger.knob().check(value)?;
        self.trigger = self.trigger.with_value(value);
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        let step = frame.step.max(1);
        self.objects.set_picture(frame.picture);
        self.pause.advance(&self.trigger, step);
        self.births.fade(&self.settings.call, step);
        if self.pause.frames > self.settings.life.longest_blindness {
            self.objects.forget();
        } else {
            for _ in 0..step {
                self.objects.predict(&self.settings);
            }
        }
        self.survey();
        self.cause = match self.started {
            false => Some(CallCause::Start),
            true => (self.pause).call(&self.trigger, &self.settings.call, self.weight),
        };
        let (progress, need) = if self.cause.is_none() {
            (ExpectedLossPhase::Skipped, Need::Nothing)
        } else if self.active == 0 && self.settings.call.ask_screen_when_empty {
            (ExpectedLossPhase::AwaitsScreen, Need::Screen)
        } else {
            let progress = ExpectedLossPhase::AwaitsDetections { screened: false };
            (progress, Need::Detections)
        };
        self.progress = progress;
        need
    }

    /// The screen can only spare a call that is due: one that never says "empty" changes no decision. If
    /// it is unavailable the detector is asked, and the frame is `I`, not `E+I`. Evidence of a kind not
    /// asked for counts as unavailable.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress, evidence) {
            (ExpectedLossPhase::AwaitsScreen, Evidence::Screen { empty: true }) => {
                self.progress = ExpectedLossPhase::Empty;
                self.cause = None;
                Need::Nothing
            }
            (ExpectedLossPhase::AwaitsScreen, evidence) => {
                let screened = matches!(evidence, Evidence::Screen { .. });
                if screened {
                    self.cause = Some(CallCause::Screen);
                }
                self.progress = ExpectedLossPhase::AwaitsDetections { screened };
                Need::Detections
            }
            (
                ExpectedLossPhase::AwaitsDetections { screened },
                Evidence::Detections(detections),
            ) => {
                self.take_detections(detections);
                self.progress = ExpectedLossPhase::Detected { screened };
                Need::Nothing
            }
            // Left as it is: `finish` sees that the detections never came.
            _ => Need::Nothing,
        }
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let detected = matches!(self.progress, ExpectedLossPhase::Detected { .. });
        outcome.boxes.clear();
        let report = (self.objects).report(&self.settings, detected, &mut outcome.boxes);
        self.crowd += (report.confidence - self.crowd) / self.settings.call.crowd_memory;
        if !detected {
            self.pause.skip(self.loss);
        }
        outcome.state = match self.progress {
            ExpectedLossPhase::Empty => FrameState::E,
            ExpectedLossPhase::Detected { screened: true } => FrameState::EI,
            ExpectedLossPhase::Detected { .. } if report.rescued => FrameState::AI,
            ExpectedLossPhase::Detected { .. } => FrameState::I,
            _ => FrameState::P,
        };
        outcome.degraded = matches!(
            self.progress,
            ExpectedLossPhase::AwaitsScreen | ExpectedLossPhase::AwaitsDetections { .. }
        );
        outcome.cause = self.cause;
        outcome.tau_max = self.tau_max;
        outcome.active = self.active;
    }

    fn reset(&mut self) {
        self.objects.clear();
        self.births = BirthRate::new(&self.settings.call);
        self.crowd = self.settings.call.crowd_prior;
        self.pause = Pause::START;
        self.started = false;
        self.progress = ExpectedLossPhase::Skipped;
        self.cause = None;
        self.tau_max = None;
        self.active = 0;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        let aspect = self.objects.aspect();
        for object in self.objects.iter() {
            visit(&object.record(&self.settings, aspect));
        }
    }

    fn rejected_detections(&self) -> u64 {
        self.objects.rejected_detections()
    }
}

#[cfg(test)]
mod tests;
