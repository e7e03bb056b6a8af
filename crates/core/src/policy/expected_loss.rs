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

use super::progress::Progress;
use super::{
    CallCause, Evidence, FrameHead, FrameState, GreyPicture, InvalidThreshold, Need, ObjectRecord,
    Outcome, Policy, PolicyConfigError, ThresholdSpec, tracker::check_setting,
};
use crate::detection::Detection;
use birth::BirthRate;
use follow::Follower;
use objects::Objects;
use settings::{CROWD_MEMORY, CROWD_PRIOR, FLOW_BIRTH_PRIOR, FLOW_WIDTH, LEAST_CROWD};
pub use settings::{ExpectedLossSettings, InTracker, Pixels};
use trigger::Pause;
pub use trigger::Trigger;

/// The picture in which boxes are followed.
const PICTURE: Need = Need::SmallGreyPicture { width: FLOW_WIDTH };

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
    /// The share of λ by which g may fall short of it on a frame that joins a run.
    join: f64,
    /// L of the current frame.
    loss: f64,
    /// g of the current frame.
    weight: f64,
    progress: Progress,
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
            objects: Objects::default(),
            births: BirthRate::default(),
            crowd: CROWD_PRIOR,
            pause: Pause::default(),
            follower: (settings.pixels == Pixels::Flow).then(Box::default),
            started: false,
            join: 0.0,
            loss: 0.0,
            weight: 0.0,
            progress: Progress::default(),
            saved: None,
        })
    }

    /// Creates a policy with this trigger and this use of pixels.
    pub(super) fn with(trigger: Trigger, pixels: Pixels) -> Result<Self, PolicyConfigError> {
        let settings = ExpectedLossSettings {
            pixels,
            ..ExpectedLossSettings::default()
        };
        Self::new(settings, trigger)
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
        self.progress.active = self.objects.len();
        self.progress.tau_max = (self.progress.active > 0).then_some(tau_max);
    }

    /// Returns the reason for a detector call at this weight of the losses.
    fn call_at(&self, weight: f64) -> Option<CallCause> {
        if !self.started {
            return Some(CallCause::Start);
        }
        let due = self.pause.call(&self.trigger, self.settings.longest_pause, weight);
        if due.is_none() && self.joins(weight) {
            return Some(CallCause::Joined);
        }
        due
    }

    /// True if a frame that needs no call is near enough to one, at this weight of the losses, to join a run.
    fn joins(&self, weight: f64) -> bool {
        let Trigger::ExpectedLoss { lambda } = self.trigger else {
            return false;
        };
        let enough = (1.0 - self.join) * lambda;
        self.join > 0.0 && self.progress.active > 0 && weight >= enough
    }

    /// Follows the boxes into the picture and decides again. A call demanded by the screen is not revoked.
    fn follow_boxes(&mut self, picture: GreyPicture<'_>) -> Need {
        let aspect = self.objects.aspect();
        if let Some(follower) = &mut self.follower {
            let had_followed = follower.has_followed();
            let objects = self.objects.as_mut_slice();
            follower.follow_all(objects, aspect, picture);
            // Not with a picture that cannot be used, of which there may be many before the first that can.
            if follower.has_followed() && !had_followed {
                self.births.expect(FLOW_BIRTH_PRIOR);
            }
        }
        self.survey();
        let cause = if self.progress.screened {
            self.progress.cause
        } else {
            self.call_at(self.weight)
        };
        self.progress.call(cause)
    }

    /// Copies the state of `other`, a copy of this policy, but not its settings and threshold.
    fn copy_from(&mut self, other: &Self) {
        self.objects.copy_from(&other.objects);
        if let (Some(own), Some(follower)) = (&mut self.follower, &other.follower) {
            own.copy_from(follower);
        }
        *self = Self {
            settings: self.settings,
            trigger: self.trigger,
            join: self.join,
            objects: std::mem::take(&mut self.objects),
            follower: self.follower.take(),
            saved: self.saved.take(),
            ..*other
        };
    }

    fn take_detections(&mut self, detections: &[Detection]) -> Need {
        let born = self.objects.observe(self.settings.pixels, detections);
        self.births.count(born);
        self.pause.end();
        self.started = true;
        self.progress.detected()
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

    fn set_join(&mut self, share: f64) {
        self.join = share;
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
        self.progress = Progress::default();
        self.survey();
        if let Some(follower) = &mut self.follower {
            follower.advance(step);
        }
        let need = self.progress.call(self.call_at(self.weight));
        let is_due = need == Need::Detections;
        if is_due && self.progress.active == 0 {
            return self.progress.ask(Need::Screen);
        }
        match &self.follower {
            Some(follower) if is_due || (self.progress.active > 0 && follower.can_follow()) => {
                self.progress.ask(PICTURE)
            }
            _ => need,
        }
    }

    fn pictures(&self) -> Option<Need> {
        self.follower.as_ref().map(|_| PICTURE)
    }

    /// The screen can only save a call that is due: a screen that never reports "empty" changes no decision. If it is
    /// unavailable, the next evidence is requested (with optical flow the picture, else the detections), and the frame is
    /// `I`, not `E+I`. Evidence that was not requested counts as unavailable.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress.need, evidence) {
            (Need::Screen, evidence) => {
                let next = self.pictures().unwrap_or(Need::Detections);
                self.progress.take_verdict(evidence, next)
            }
            (PICTURE, Evidence::GreyPicture(picture)) => self.follow_boxes(picture),
            (PICTURE, _) => self.progress.call(self.progress.cause),
            (Need::Detections, Evidence::Detections(found)) => self.take_detections(found),
            // Unchanged, so that `finish` detects the missing detections.
            _ => Need::Nothing,
        }
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.progress.finish(outcome);
        let detected = !outcome.state.is_skipped();
        let report = self.objects.report(detected, &mut outcome.boxes);
        if outcome.state == FrameState::I && report.rescued {
            outcome.state = FrameState::AI;
        }
        self.crowd += (report.confidence - self.crowd) / CROWD_MEMORY;
        if !detected {
            self.pause.skip(self.loss);
        }
        if let Some(follower) = &mut self.follower {
            follower.remember(self.objects.as_mut_slice());
        }
    }

    fn can_rewind(&self) -> bool {
        true
    }

    fn save(&mut self) {
        let mut saved = self.saved.take().unwrap_or_else(|| Box::new(self.clone()));
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
        if let Some(follower) = &mut self.follower {
            follower.clear();
        }
        self.births = BirthRate::default();
        self.crowd = CROWD_PRIOR;
        self.pause = Pause::default();
        self.started = false;
        self.progress = Progress::default();
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
