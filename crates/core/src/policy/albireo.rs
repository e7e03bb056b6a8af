//! The paper's policy: the detector runs when an object's uncertainty becomes too large.
//!
//! Each frame first advances every object's filter. Without active objects, the empty-scene screen is asked, and unless
//! it reports "empty", the detector. With objects, the detector runs if any τ reaches the threshold `u`, any object's
//! age reaches T_max, or the periodic cap is due; otherwise the predicted boxes are the answer.

use super::Ablation;
use super::albireo_settings::{AlbireoSettings, PeriodicCap};
use super::progress::Progress;
use super::tracker::{Tracker, check_setting};
use super::{
    CallCause, Evidence, FrameHead, InvalidThreshold, Need, ObjectRecord, Outcome, Policy,
    PolicyConfig, PolicyConfigError, ThresholdSpec,
};
use crate::detection::Detection;
use crate::objects::Missed;

/// The Albireo policy.
#[derive(Clone, Debug)]
pub struct Albireo {
    name: &'static str,
    tracker: Tracker,
    u: f64,
    /// The share of `u` by which τ may fall short of it on a frame that joins a run.
    join: f64,
    progress: Progress,
    /// Index of the current frame.
    index: u64,
    /// Frames since the last detector answer.
    since_detector: u32,
    /// Index of the last frame that finished with all requested evidence.
    last_complete: Option<u64>,
    /// The state that [`Policy::rewind`] restores: a copy of this policy, kept for its buffers.
    saved: Option<Box<Self>>,
}

impl Albireo {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "albireo";

    /// The threshold. τ is a sum of variances of shares of the picture: at 1 an object's position is unknown, and below
    /// 1e-9 the detector runs on every frame. The useful range is from the smallest τ of a predicted frame to τ after
    /// six frames of prediction since a detection; the paper goes to 1e-3, two frames.
    pub const THRESHOLD: ThresholdSpec = ThresholdSpec {
        name: "u",
        meaning: "The detector is skipped while every object's uncertainty is below this: higher saves \
                  more energy, lower is more accurate",
        minimum: 1e-9,
        maximum: 1.0,
        default: 3e-4,
        useful_minimum: 1.5e-4,
        useful_maximum: 1e-2,
    };

    /// Creates a policy with these settings and this threshold.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if the threshold is invalid.
    pub fn new(settings: AlbireoSettings, u: f64) -> Result<Self, PolicyConfigError> {
        let u = check_setting(Self::THRESHOLD.name, Self::THRESHOLD, u)?;
        Ok(Self {
            name: Self::NAME,
            tracker: Tracker::new(settings, u),
            u,
            join: 0.0,
            progress: Progress::default(),
            index: 0,
            since_detector: 0,
            last_complete: None,
            saved: None,
        })
    }

    pub(super) fn from_config(config: &PolicyConfig) -> Result<Self, PolicyConfigError> {
        Self::new(AlbireoSettings::of(config.profile), config.u)
    }

    /// Creates a policy without some of its parts, under the name of the ablation.
    pub(super) fn ablated(
        ablation: Ablation,
        config: &PolicyConfig,
    ) -> Result<Self, PolicyConfigError> {
        let mut settings = AlbireoSettings::of(config.profile);
        ablation.apply(&mut settings);
        let mut policy = Self::new(settings, config.u)?;
        policy.name = ablation.name();
        Ok(policy)
    }

    /// Copies the state of `other`, a copy of this policy, but not its settings and threshold.
    fn copy_from(&mut self, other: &Self) {
        self.tracker.copy_from(&other.tracker);
        self.progress = other.progress;
        self.index = other.index;
        self.since_detector = other.since_detector;
        self.last_complete = other.last_complete;
    }

    fn periodic_cap_is_due(&self) -> bool {
        let cap = self.tracker.settings.periodic_cap;
        match self.tracker.settings.periodic_cap_counts {
            PeriodicCap::SinceDetector => self.since_detector >= cap,
            PeriodicCap::FrameIndex => {
                let cap = u64::from(cap);
                // True if a multiple of the cap fell into the gap since the last complete frame.
                let in_gap = self.last_complete.is_some_and(|last| last / cap < self.index / cap);
                self.index.is_multiple_of(cap) || in_gap
            }
        }
    }

    /// True if a frame without a cause of its own is near enough to a call to join a run.
    fn joins(&self) -> bool {
        let enough = (1.0 - self.join) * self.u;
        self.join > 0.0 && self.progress.tau_max.is_some_and(|tau| tau >= enough)
    }

    fn take_detections(&mut self, detections: &[Detection]) -> Need {
        self.since_detector = 0;
        let life_cycle = self.tracker.settings.objects.life_cycle;
        let mut rescued = false;
        self.tracker.observe(detections, |state| {
            let fate = life_cycle.missed(state);
            rescued |= fate == Missed::Rescued;
            fate
        });
        if rescued {
            self.progress.detected_with_rescue()
        } else {
            self.progress.detected()
        }
    }
}

impl Policy for Albireo {
    fn name(&self) -> &'static str {
        self.name
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        Some(Self::THRESHOLD)
    }

    fn threshold(&self) -> Option<f64> {
        Some(self.u)
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.u = Self::THRESHOLD.check(value)?;
        Ok(())
    }

    fn set_join(&mut self, share: f64) {
        self.join = share;
    }

    /// Tentative objects are active, as in the published code; the paper does not say otherwise.
    fn begin(&mut self, frame: FrameHead) -> Need {
        let AlbireoSettings {
            skip_at_equality,
            t_max,
            asks_screen,
            ..
        } = self.tracker.settings;
        let u = self.u;
        self.index = frame.index;
        // A camera that counts no lost frames may give a step of 0.
        self.since_detector = self.since_detector.saturating_add(frame.step.max(1));
        self.tracker.u = u;
        let mut cause = None;
        self.progress = self.tracker.begin(frame, |state, tau| {
            // A τ that is not a number is not certain.
            let certain = tau < u || (skip_at_equality && tau == u);
            // Of the causes of several objects the strongest is told: uncertain, then a new object, then the cap.
            cause = match cause {
                Some(CallCause::Uncertain) => cause,
                _ if !certain && state.confirmed => Some(CallCause::Uncertain),
                _ if !certain => Some(CallCause::NewObject),
                None if state.since_infer >= t_max => Some(CallCause::ObjectCap),
                _ => cause,
            };
        });
        if self.progress.active == 0 {
            cause = Some(CallCause::NoObjects);
        } else if cause.is_none() && self.periodic_cap_is_due() {
            cause = Some(CallCause::PeriodicCap);
        } else if cause.is_none() && self.joins() {
            cause = Some(CallCause::Joined);
        }
        let need = self.progress.call(cause);
        if self.progress.active == 0 && asks_screen {
            // The cause stays: it is told if the screen passes the frame on to the detector.
            return self.progress.ask(Need::Screen);
        }
        need
    }

    /// If the screen is unavailable, the detector is requested, and the frame is `I`, not `E+I`. Evidence that was not
    /// requested counts as unavailable.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        match (self.progress.need, evidence) {
            (Need::Screen, evidence) => self.progress.take_verdict(evidence, Need::Detections),
            (Need::Detections, Evidence::Detections(found)) => self.take_detections(found),
            // The need stays, so that `finish` sees that detections are missing.
            _ => Need::Nothing,
        }
    }

    fn longest_pause(&self) -> Option<u32> {
        let settings = &self.tracker.settings;
        Some(settings.t_max.min(settings.periodic_cap))
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.tracker.finish(&self.progress, outcome);
        if !outcome.degraded {
            self.last_complete = Some(self.index);
        }
    }

    fn takes_pause(&self) -> bool {
        self.tracker.settings.asks_screen
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
        self.tracker.objects.clear();
        self.progress = Progress::default();
        self.since_detector = 0;
        self.last_complete = None;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        self.tracker.visit(visit);
    }

    fn rejected_detections(&self) -> u64 {
        self.tracker.objects.rejected_detections()
    }
}

#[cfg(test)]
mod tests;
