//! Confidence-triggered detection: the detector runs when a prediction has strayed from the last detection.
//!
//! Y. Ding et al., "Confidence Trigger Detection: Accelerating Real-time Tracking-by-detection Systems", as implemented
//! in the published code of the Albireo paper: with Albireo's filter instead of DeepSORT's. For every object, the
//! squared Mahalanobis distance between its prediction and its own last detection is taken as a draw from χ² with four
//! degrees of freedom; the probability of a larger one is the confidence in the prediction. The detector runs when a
//! confidence is below the threshold, when there are no objects, and after [`CtdSettings::longest_skip`] frames without
//! it.
//!
//! An object that a detector frame misses is kept with its predicted box, as in DeepSORT; its frames are still `I`,
//! because the policy did not decide on a rescue.

use crate::objects::{Missed, ObjectState};
use crate::policy::progress::Progress;
use crate::policy::tracker::{Tracker, check_setting};
use crate::policy::{
    CallCause, Evidence, FrameHead, InvalidThreshold, Need, ObjectRecord, Outcome, Policy,
    PolicyConfig, PolicyConfigError, ThresholdSpec,
};
use serde::{Deserialize, Serialize};

/// The settings of the policy. All except the threshold are the published code's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CtdSettings {
    /// The detector runs when the confidence in a prediction is below this, above 0 and below 1.
    pub threshold: f64,
    /// Maximum number of consecutive frames without the detector, including lost ones.
    pub longest_skip: u32,
    /// A confirmed object is removed by a miss that raises its count of frames since its last detection above this.
    /// Each miss adds one to that count, as does each frame.
    pub lost_frames: u32,
}

impl Default for CtdSettings {
    fn default() -> Self {
        Self {
            threshold: Ctd::THRESHOLD.default,
            longest_skip: 8,
            lost_frames: 10,
        }
    }
}

/// The policy of confidence-triggered detection.
#[derive(Clone, Debug)]
pub struct Ctd {
    settings: CtdSettings,
    /// Largest squared distance of a trusted prediction.
    largest_distance: f64,
    tracker: Tracker,
    progress: Progress,
    /// Frames since the last detector answer.
    since_detector: u32,
}

impl Ctd {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "ctd";

    /// The confidence threshold. The default is the recommendation of Ding et al.
    pub const THRESHOLD: ThresholdSpec = ThresholdSpec {
        name: "threshold",
        meaning: "The detector is skipped while the confidence in every prediction is at least this: \
                  lower saves more energy, higher is more accurate",
        minimum: 1e-9,
        maximum: 1.0 - 1e-9,
        default: 0.30,
        useful_minimum: 0.05,
        useful_maximum: 0.99,
    };

    pub(in crate::policy) fn from_config(config: &PolicyConfig) -> Result<Self, PolicyConfigError> {
        let settings = config.ctd;
        let threshold = check_setting(Self::NAME, Self::THRESHOLD, settings.threshold)?;
        Ok(Self {
            settings,
            largest_distance: distance_with_confidence(threshold),
            tracker: Tracker::from_config(config),
            progress: Progress::default(),
            since_detector: 0,
        })
    }

    /// Returns the reason for a detector call, if there is one.
    fn cause(&self) -> Option<CallCause> {
        let objects = &self.tracker.objects;
        let strayed = |state: &ObjectState| {
            let gauge = state.filter.gauge(objects.model());
            gauge.squared_distance(state.detected) > self.largest_distance
        };
        if objects.states().is_empty() {
            Some(CallCause::NoObjects)
        } else if objects.states().iter().any(strayed) {
            Some(CallCause::Uncertain)
        } else if self.since_detector > self.settings.longest_skip {
            Some(CallCause::PeriodicCap)
        } else {
            None
        }
    }
}

/// Returns the squared Mahalanobis distance that a χ² variable with four degrees of freedom exceeds with the
/// probability `confidence`, above 0 and below 1.
///
/// With y = x/2 that probability is e^−y (1 + y). Newton's method on its logarithm, which is concave and decreasing:
/// from the second step on it approaches the root from above.
fn distance_with_confidence(confidence: f64) -> f64 {
    let logarithm = confidence.ln();
    // Near the root for a confidence near 1: for small y the logarithm of the probability is about −y²/2.
    let mut y = (-2.0 * logarithm).sqrt();
    for _ in 0..100 {
        let step = (y.ln_1p() - y - logarithm) * (1.0 + y) / y;
        y += step;
        if step.abs() <= 1e-15 * y {
            break;
        }
    }
    2.0 * y
}

impl Policy for Ctd {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        Some(Self::THRESHOLD)
    }

    fn threshold(&self) -> Option<f64> {
        Some(self.settings.threshold)
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.settings.threshold = Self::THRESHOLD.check(value)?;
        self.largest_distance = distance_with_confidence(value);
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        self.since_detector = self.since_detector.saturating_add(frame.step.max(1));
        self.progress = self.tracker.begin(frame, |_, _| {});
        let cause = self.cause();
        self.progress.call(cause)
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if let (Need::Detections, Evidence::Detections(detections)) = (self.progress.need, evidence)
        {
            let lost_frames = self.settings.lost_frames;
            self.tracker.observe(detections, |state| {
                // A miss counts like a frame, and before the object is judged: see `lost_frames`.
                state.since_update = state.since_update.saturating_add(1);
                if state.confirmed && state.since_update <= lost_frames {
                    Missed::Rescued
                } else {
                    Missed::Removed
                }
            });
            self.since_detector = 0;
            self.progress.detected();
        }
        Need::Nothing
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.tracker.finish(&self.progress, outcome);
    }

    fn reset(&mut self) {
        self.tracker.objects.clear();
        self.progress = Progress::default();
        self.since_detector = 0;
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
