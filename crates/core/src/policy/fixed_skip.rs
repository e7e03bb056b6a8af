//! The fixed-skip policy: the detector runs on every N-th frame, regardless of the scene.
//!
//! On the frames between, the paper's text repeats the boxes and confidences of the last detector frame; the published
//! code predicts with Albireo's filter and decays the confidence as Albireo does at u = 3e-4. There, an object that a
//! detector frame misses is removed at once.

use super::detector_boxes::DetectorBoxes;
use super::progress::Progress;
use super::tracker::{Tracker, check_setting};
use super::{
    CallCause, Evidence, FrameHead, InvalidThreshold, Need, ObjectRecord, Outcome, Policy,
    PolicyConfig, PolicyConfigError, Profile, ThresholdSpec,
};
use crate::objects::Missed;
use serde::{Deserialize, Serialize};

/// The boxes reported on a skipped frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkippedBoxes {
    /// The boxes of the last detector frame, unchanged (paper). No objects are kept.
    Reuse,
    /// The filters' predictions (published code).
    Predict,
}

impl SkippedBoxes {
    /// Returns the choice of `profile`.
    pub fn of(profile: Profile) -> Self {
        match profile {
            Profile::Paper => Self::Reuse,
            Profile::Reference => Self::Predict,
        }
    }
}

/// The settings of the policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FixedSkipSettings {
    /// The detector runs on one frame in this many. May be fractional.
    pub n: f64,
    /// The boxes reported between; by default, the profile's choice.
    pub skipped_boxes: Option<SkippedBoxes>,
}

impl Default for FixedSkipSettings {
    fn default() -> Self {
        Self {
            n: FixedSkip::THRESHOLD.default,
            skipped_boxes: None,
        }
    }
}

#[derive(Clone, Debug)]
enum LastBoxes {
    Boxes(DetectorBoxes),
    Objects(Box<Tracker>),
}

/// The fixed-skip policy.
#[derive(Clone, Debug)]
pub struct FixedSkip {
    n: f64,
    memory: LastBoxes,
    index: u64,
    progress: Progress,
    /// Index of the last frame for which the detector answered.
    last_answered: Option<u64>,
}

impl FixedSkip {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "fixed-skip";

    /// N. It may be fractional: the detector runs whenever the frame index has passed a multiple of it, which skips
    /// 1 − 1/N of all frames.
    pub const THRESHOLD: ThresholdSpec = ThresholdSpec {
        name: "n",
        meaning: "The detector runs on one frame in this many: higher saves more energy, lower is more \
                  accurate",
        minimum: 1.0,
        maximum: 1000.0,
        default: 2.0,
        useful_minimum: 1.0,
        useful_maximum: 30.0,
    };

    pub(super) fn from_config(config: &PolicyConfig) -> Result<Self, PolicyConfigError> {
        let settings = &config.fixed_skip;
        let usual = SkippedBoxes::of(config.profile);
        let skipped = settings.skipped_boxes.unwrap_or(usual);
        Ok(Self {
            n: check_setting("fixed_skip", Self::THRESHOLD, settings.n)?,
            memory: match skipped {
                SkippedBoxes::Reuse => LastBoxes::Boxes(DetectorBoxes::default()),
                SkippedBoxes::Predict => LastBoxes::Objects(Box::new(Tracker::from_config(config))),
            },
            index: 0,
            progress: Progress::default(),
            last_answered: None,
        })
    }

    /// True if a multiple of N lies between the last frame that the detector answered and frame `index`, inclusive. So
    /// if a due frame is lost or the detector fails on it, the next frame is due; a restarted index is also due.
    fn is_due(&self, index: u64) -> bool {
        self.last_answered.is_none_or(|last| self.period(last) != self.period(index))
    }

    fn period(&self, index: u64) -> f64 {
        (index as f64 / self.n).floor()
    }
}

impl Policy for FixedSkip {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn threshold_spec(&self) -> Option<ThresholdSpec> {
        Some(Self::THRESHOLD)
    }

    fn threshold(&self) -> Option<f64> {
        Some(self.n)
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.n = Self::THRESHOLD.check(value)?;
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        self.index = frame.index;
        self.progress = match &mut self.memory {
            LastBoxes::Boxes(_) => Progress::default(),
            LastBoxes::Objects(tracker) => tracker.begin(frame, |_, _| {}),
        };
        let is_due = self.is_due(frame.index);
        self.progress.call(is_due.then_some(CallCause::Schedule))
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if let (Need::Detections, Evidence::Detections(detections)) = (self.progress.need, evidence)
        {
            match &mut self.memory {
                LastBoxes::Boxes(boxes) => boxes.take(detections),
                LastBoxes::Objects(tracker) => tracker.observe(detections, |_| Missed::Removed),
            }
            self.last_answered = Some(self.index);
            self.progress.detected();
        }
        Need::Nothing
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        match &self.memory {
            LastBoxes::Objects(tracker) => tracker.finish(&self.progress, outcome),
            LastBoxes::Boxes(boxes) => boxes.finish(&self.progress, outcome),
        }
    }

    fn reset(&mut self) {
        match &mut self.memory {
            LastBoxes::Boxes(boxes) => boxes.clear(),
            LastBoxes::Objects(tracker) => tracker.objects.clear(),
        }
        self.progress = Progress::default();
        self.last_answered = None;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        if let LastBoxes::Objects(tracker) = &self.memory {
            tracker.visit(visit);
        }
    }

    fn rejected_detections(&self) -> u64 {
        match &self.memory {
            LastBoxes::Boxes(boxes) => boxes.rejected(),
            LastBoxes::Objects(tracker) => tracker.objects.rejected_detections(),
        }
    }
}

#[cfg(test)]
mod tests;
