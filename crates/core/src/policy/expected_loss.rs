//! The expected-loss policy: the detector runs when the boxes expected to be lost without it are worth a call.
//!
//! The paper's uncertainty τ is blind to the scene: with fixed noise it depends only on the pattern of updates, and
//! small boxes, which need tighter prediction, weigh no more than large ones. Here each object's covariance is scaled
//! by the accuracy of its past predictions (α), measured relative to its size, and converted into the probability π
//! that its predicted box misses. The decision combines all objects, each weighted by its score, and objects that may
//! have appeared unseen.
//!
//! | part | equations |
//! | --- | --- |
//! | the filter of one object: four axes of position and velocity, with perspective | [`motion`] |
//! | α, π, confidence and box of one object | [`object`] |
//! | matching: by overlap, then by Mahalanobis distance, both optimal | [`association`] |
//! | the expected velocity of a new object | [`velocity`] |
//! | the expected number of new objects since the last call | [`birth`] |
//! | boxes followed by optical flow, and their reliability | [`follow`] |
//! | the trigger of detector calls | below, and [`trigger`] |
//! | all constants | [`settings`] |
//!
//! On each frame, with T the frames since the last detector call, including this one,
//!
//! ```text
//! L = Σ m·miss^misses·π  +  birth·b·T          expected loss of this frame, in boxes
//! M = L + Σ (L − L_t)                          over the frames t skipped since the last call
//! g = M / max(N̄, least_crowd)
//! ```
//!
//! where m is an object's mean score, b the birth rate and N̄ a moving average of the summed confidence of the reported
//! boxes. The detector runs on the first frame, when g ≥ λ, and when T reaches
//! [`longest_pause`](ExpectedLossSettings::longest_pause).
//!
//! Why M: let a call cost λ·N̄ boxes. A pause of k skipped frames and one call costs `(L_1 + … + L_k + λN̄) / (k + 1)`
//! per frame. Skipping one more frame lowers this mean exactly if its loss is below the mean, which is
//! `(k + 1)·L − Σ L_t < λN̄`, that is `M < λN̄`. So λ is the price of a call, in frames' worth of all the boxes in
//! view; scenes that change fast get more calls, but fewer than a threshold on L would give them.
//!
//! Lost frames advance everything except the sums: a frame that never arrived cannot be answered badly.
//!
//! Under the names that end with `+flow`, boxes are followed in a small grey picture of each frame with objects
//! ([`follow`]); the result enters L and may save a call.

mod association;
mod birth;
mod follow;
mod motion;
mod object;
mod objects;
mod settings;
mod trigger;
mod velocity;

use super::{
    CallCause, Evidence, FrameHead, FrameState, GreyPicture, InvalidThreshold, Need, ObjectRecord,
    Outcome, Policy, PolicyConfigError, ThresholdSpec, tracker::check_setting,
};
use crate::detection::Detection;
use birth::BirthRate;
use follow::Follower;
use objects::Objects;
use settings::FLOW_WIDTH;
use settings::{CROWD_MEMORY, CROWD_PRIOR, FLOW_BIRTH_PRIOR, LEAST_CROWD};
pub use settings::{ExpectedLossSettings, InTracker, Pixels};
use trigger::Pause;
pub use trigger::Trigger;

/// Progress of the current frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ExpectedLossPhase {
    /// The screen was asked.
    AwaitsScreen,
    /// A grey picture was requested. Without it the detector is called if `due`.
    AwaitsPicture { due: bool, screened: bool },
    /// Detections were requested, after the screen's "not empty" or without its verdict.
    AwaitsDetections { screened: bool },
    /// The screen answered "empty".
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
    /// The optical flow, for policies that use it.
    follower: Option<Box<Follower>>,
    /// True if the detector has answered since the stream began.
    started: bool,
    progress: ExpectedLossPhase,
    /// The reason for the detector call on the current frame.
    cause: Option<CallCause>,
    /// L of the current frame.
    loss: f64,
    /// g of the current frame.
    weight: f64,
    tau_max: Option<f64>,
    active: usize,
    /// The state that [`Policy::rewind`] restores: a copy of this policy, kept for its buffers.
    saved: Option<Box<Self>>,
}

impl ExpectedLoss {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "expected-loss";
    /// The name of the policy with a detector call on one frame of N.
    pub const FIXED_SKIP_NAME: &'static str = "fixed-skip-in-tracker";
    /// The name of the policy with evenly spaced detector calls.
    pub const EVEN_SKIP_NAME: &'static str = "even-skip-in-tracker";
    /// The names of the three policies that follow boxes in pictures.
    pub(super) const FLOW_NAMES: [&'static str; 3] = [
        "expected-loss+flow",
        "fixed-skip-in-tracker+flow",
        "even-skip-in-tracker+flow",
    ];

    /// λ, the price of a detector call. At 0 the detector runs on every frame.
    pub const THRESHOLD: ThresholdSpec = Trigger::ExpectedLoss { lambda: 0.0 }.threshold_spec();

    /// Creates a policy with these settings and this trigger.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if the trigger's number is invalid.
    pub fn new(
        settings: ExpectedLossSettings,
        trigger: Trigger,
    ) -> Result<Self, PolicyConfigError> {
        let table = match trigger {
            Trigger::ExpectedLoss { .. } => "lambda",
            Trigger::FixedSkip { .. } | Trigger::Even { .. } => "in_tracker",
        };
        check_setting(table, trigger.threshold_spec(), trigger.value())?;
        Ok(Self {
            settings,
            trigger,
            objects: Objects::new(),
            births: BirthRate::new(),
            crowd: CROWD_PRIOR,
            pause: Pause::START,
            follower: (settings.pixels == Pixels::Flow).then(|| Box::new(Follower::new())),
            started: false,
            progress: ExpectedLossPhase::Skipped,
            cause: None,
            loss: 0.0,
            weight: 0.0,
            tau_max: None,
            active: 0,
            saved: None,
        })
    }

    /// Creates a policy with this trigger and this use of pixels.
    pub(super) fn boxed(
        trigger: Trigger,
        pixels: Pixels,
    ) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let settings = ExpectedLossSettings {
            pixels,
            ..ExpectedLossSettings::default()
        };
        Ok(Box::new(Self::new(settings, trigger)?))
    }

    /// The settings in use.
    pub fn settings(&self) -> &ExpectedLossSettings {
        &self.settings
    }

    /// g of the current frame, which is compared with λ.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Sums the expected losses of this frame without the detector.
    fn survey(&mut self) {
        self.objects.judge();
        let aspect = self.objects.aspect();
        let mut tau_max = f64::NEG_INFINITY;
        let mut loss = self.births.expected_loss(self.pause.frames);
        for object in self.objects.iter() {
            loss += object.expected_loss();
            tau_max = tau_max.max(object.tau(aspect));
        }
        self.loss = loss;
        self.weight = self.pause.weigh(loss, self.crowd.max(LEAST_CROWD));
        self.active = self.objects.len();
        self.tau_max = (self.active > 0).then_some(tau_max);
    }

    /// Returns the reason for a detector call at this weight of the losses.
    fn call_at(&self, weight: f64) -> Option<CallCause> {
        match self.started {
            false => Some(CallCause::Start),
            true => (self.pause).call(&self.trigger, self.settings.longest_pause, weight),
        }
    }

    /// Requests the picture if pictures are used, otherwise the detector.
    fn call(&mut self, screened: bool) -> Need {
        if self.follower.is_some() {
            return self.ask_for_picture(true, screened);
        }
        self.progress = ExpectedLossPhase::AwaitsDetections { screened };
        Need::Detections
    }

    fn ask_for_picture(&mut self, due: bool, screened: bool) -> Need {
        self.progress = ExpectedLossPhase::AwaitsPicture { due, screened };
        self.picture_need()
    }

    fn picture_need(&self) -> Need {
        Need::SmallGreyPicture { width: FLOW_WIDTH }
    }

    /// Follows the boxes into the picture and decides again. A call demanded by the screen is not revoked.
    fn look(&mut self, picture: GreyPicture<'_>, screened: bool) -> Need {
        let aspect = self.objects.aspect();
        if let Some(follower) = &mut self.follower {
            if !follower.has_looked() {
                self.births.expect(FLOW_BIRTH_PRIOR);
            }
            let objects = self.objects.as_mut_slice();
            follower.look(objects, aspect, picture);
        }
        self.survey();
        if !screened {
            self.cause = self.call_at(self.weight);
        }
        if self.cause.is_some() {
            self.progress = ExpectedLossPhase::AwaitsDetections { screened };
            Need::Detections
        } else {
            self.progress = ExpectedLossPhase::Skipped;
            Need::Nothing
        }
    }

    /// Copies the state of `other`, a copy of this policy, but not its settings and threshold.
    fn copy_from(&mut self, other: &Self) {
        let Self {
            settings: _,
            trigger: _,
            objects,
            births,
            crowd,
            pause,
            follower,
            started,
            progress,
            cause,
            loss,
            weight,
            tau_max,
            active,
            saved: _,
        } = other;
        self.objects.copy_from(objects);
        self.births = *births;
        self.crowd = *crowd;
        self.pause = *pause;
        if let (Some(own), Some(follower)) = (&mut self.follower, follower) {
            own.copy_from(follower);
        }
        self.started = *started;
        self.progress = *progress;
        self.cause = *cause;
        self.loss = *loss;
        self.weight = *weight;
        self.tau_max = *tau_max;
        self.active = *active;
    }

    fn take_detections(&mut self, detections: &[Detection]) {
        let born = self.objects.observe(self.settings.pixels, detections);
        self.births.count(born);
        self.pause.end();
        self.started = true;
    }
}

impl Policy for ExpectedLoss {
    fn name(&self) -> &'static str {
        let [priced, fixed, even] = match self.settings.pixels {
            Pixels::Off => [Self::NAME, Self::FIXED_SKIP_NAME, Self::EVEN_SKIP_NAME],
            Pixels::Flow => Self::FLOW_NAMES,
        };
        match self.trigger {
            Trigger::ExpectedLoss { .. } => priced,
            Trigger::FixedSkip { .. } => fixed,
            Trigger::Even { .. } => even,
        }
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        Some(self.trigger.threshold_spec())
    }

    fn threshold(&self) -> Option<f64> {
        Some(self.trigger.value())
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        let value = self.trigger.threshold_spec().check(value)?;
        self.trigger = self.trigger.with_value(value);
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        let step = frame.step.max(1);
        self.objects.set_picture(frame.picture);
        self.pause.advance(&self.trigger, step);
        self.births.fade(step);
        if self.pause.frames > self.settings.longest_blindness {
            self.objects.forget();
        } else {
            for _ in 0..step {
                self.objects.predict();
            }
        }
        self.survey();
        if let Some(follower) = &mut self.follower {
            follower.advance(step);
        }
        self.cause = self.call_at(self.weight);
        if self.cause.is_some() {
            if self.active == 0 {
                self.progress = ExpectedLossPhase::AwaitsScreen;
                return Need::Screen;
            }
            return self.call(false);
        }
        let follower = self.follower.as_deref();
        if self.active > 0 && follower.is_some_and(Follower::can_follow) {
            return self.ask_for_picture(false, false);
        }
        self.progress = ExpectedLossPhase::Skipped;
        Need::Nothing
    }

    fn pictures(&self) -> Option<Need> {
        self.follower.as_ref().map(|_| self.picture_need())
    }

    /// The screen can only save a call that is due: a screen that never reports "empty" changes no decision. If it is
    /// unavailable, the detector is requested, and the frame is `I`, not `E+I`. Evidence that was not requested counts
    /// as unavailable.
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
                self.call(screened)
            }
            (ExpectedLossPhase::AwaitsPicture { screened, .. }, Evidence::GreyPicture(picture)) => {
                self.look(picture, screened)
            }
            (
                ExpectedLossPhase::AwaitsPicture {
                    due: true,
                    screened,
                },
                _,
            ) => {
                self.progress = ExpectedLossPhase::AwaitsDetections { screened };
                Need::Detections
            }
            (ExpectedLossPhase::AwaitsPicture { .. }, _) => {
                self.progress = ExpectedLossPhase::Skipped;
                Need::Nothing
            }
            (
                ExpectedLossPhase::AwaitsDetections { screened },
                Evidence::Detections(detections),
            ) => {
                self.take_detections(detections);
                self.progress = ExpectedLossPhase::Detected { screened };
                Need::Nothing
            }
            // Unchanged, so that `finish` detects the missing detections.
            _ => Need::Nothing,
        }
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let detected = matches!(self.progress, ExpectedLossPhase::Detected { .. });
        outcome.boxes.clear();
        let report = (self.objects).report(detected, &mut outcome.boxes);
        self.crowd += (report.confidence - self.crowd) / CROWD_MEMORY;
        if !detected {
            self.pause.skip(self.loss);
        }
        if let Some(follower) = &mut self.follower {
            follower.remember(self.objects.as_mut_slice());
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
            ExpectedLossPhase::AwaitsScreen
                | ExpectedLossPhase::AwaitsPicture { due: true, .. }
                | ExpectedLossPhase::AwaitsDetections { .. }
        );
        outcome.cause = self.cause;
        outcome.tau_max = self.tau_max;
        outcome.active = self.active;
    }

    fn can_rewind(&self) -> bool {
        true
    }

    fn save(&mut self) {
        let mut saved = (self.saved.take()).unwrap_or_else(|| Box::new(self.clone()));
        saved.copy_from(self);
        self.saved = Some(saved);
    }

    fn rewind(&mut self) {
        if let Some(saved) = self.saved.take() {
            self.copy_from(&saved);
            self.saved = Some(saved);
        }
    }

    fn reset(&mut self) {
        self.objects.clear();
        self.births = BirthRate::new();
        self.crowd = CROWD_PRIOR;
        self.pause = Pause::START;
        if let Some(follower) = &mut self.follower {
            follower.clear();
        }
        self.started = false;
        self.progress = ExpectedLossPhase::Skipped;
        self.cause = None;
        self.tau_max = None;
        self.active = 0;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        let aspect = self.objects.aspect();
        for object in self.objects.iter() {
            visit(&object.record(aspect));
        }
    }

    fn rejected_detections(&self) -> u64 {
        self.objects.rejected_detections()
    }
}

#[cfg(test)]
mod tests;
