//! Inference rate adapted to the scene: the faster the objects move, the more often the detector runs.
//!
//! After C. Contoli, L. Calisti, G. Di Fabrizio, N. Kania, A. Bogliolo and E. Lattanzi, "A power-aware vision-based
//! virtual sensor for real-time edge computing" (Journal of Real-Time Image Processing 21:103, 2024): a manager of
//! inference power lowers the rate of the detector while what is tracked hardly moves, and raises it in lively scenes.
//!
//! Liberties. Only the paper's abstract and introduction were at hand, so the rule that sets the rate is ours, the
//! simplest that does what they say. After each call of the detector the speed of the scene is
//!
//! ```text
//! v = mean over the objects of (|Δcentre| in box sides + |Δ ln side|) / frames since the object's last detection
//! ```
//!
//! where an object that appeared or was lost since the call before counts as moved by its own size. The next call comes
//! after `drift / v̄` frames, with v̄ a moving average of v: when objects have moved by `drift` of their size. The paper
//! does not look at the frames between at all; here they get predicted boxes, from the filter and the matching that
//! the other baselines have, for a frame without an answer would lose against every one of them. An object that the
//! detector misses is gone at once, as SORT, which the paper builds on, does by default.

use crate::detection::{Detection, ObjectId};
use crate::geometry::BoundingBox;
use crate::objects::Missed;
use crate::policy::tracker::{Tracker, check_ranges, check_setting};
use crate::policy::{
    CallCause, Evidence, FrameHead, FrameState, Knob, KnobError, Need, ObjectRecord, Outcome,
    Policy, PolicyConfig, PolicyConfigError,
};
use serde::{Deserialize, Serialize};

/// The settings of the policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AdaptiveRateSettings {
    /// How far an object may move between two calls of the detector, in sizes of its box.
    pub drift: f64,
    /// Most frames from one call to the next.
    pub longest_interval: u32,
    /// Weight of the last call's speed against the average before it, above 0 and at most 1.
    pub newest_weight: f64,
}

impl Default for AdaptiveRateSettings {
    fn default() -> Self {
        Self {
            drift: AdaptiveRate::KNOB.default,
            longest_interval: 15,
            newest_weight: 0.5,
        }
    }
}

/// Progress of the current frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AdaptiveRatePhase {
    AwaitsDetections,
    Decided(FrameState),
}

/// What is remembered of an object for the next call.
#[derive(Clone, Copy, Debug)]
struct Last {
    id: ObjectId,
    detected: BoundingBox,
    /// Frames since that detection.
    frames: u32,
}

/// The policy of the adaptive rate.
#[derive(Clone, Debug)]
pub struct AdaptiveRate {
    settings: AdaptiveRateSettings,
    tracker: Tracker,
    progress: AdaptiveRatePhase,
    /// Why the detector is called for the current frame.
    cause: Option<CallCause>,
    /// Frames since the detector last answered, the current frame included; `None` before its first answer.
    since_call: Option<u32>,
    /// v̄; `None` until the second answer.
    speed: Option<f64>,
    /// The objects before the current answer, oldest first. The buffer is kept.
    before: Vec<Last>,
}

impl AdaptiveRate {
    /// The name in configuration and reports.
    pub const NAME: &'static str = "adaptive-rate";

    /// The displacement that is let pass.
    pub const KNOB: Knob = Knob {
        name: "drift",
        meaning: "The detector is called when objects have moved by so many of their own sizes: higher saves \
                  more energy, lower is more accurate",
        minimum: 0.0,
        maximum: 100.0,
        default: 0.3,
        useful_minimum: 0.02,
        useful_maximum: 3.0,
    };

    pub(in crate::policy) fn from_config(
        config: &PolicyConfig,
    ) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let settings = config.adaptive_rate;
        let table = "adaptive_rate";
        check_setting(table, Self::KNOB, settings.drift)?;
        let wrong = |reason| PolicyConfigError::Setting { table, reason };
        check_ranges(
            "a number",
            [("newest_weight", settings.newest_weight, 0.001, 1.0)],
        )
        .map_err(wrong)?;
        check_ranges(
            "a whole number",
            [("longest_interval", settings.longest_interval, 1, 1000)],
        )
        .map_err(wrong)?;
        Ok(Box::new(Self {
            settings,
            tracker: Tracker::from_config(config),
            progress: AdaptiveRatePhase::Decided(FrameState::P),
            cause: None,
            since_call: None,
            speed: None,
            before: Vec::new(),
        }))
    }

    /// Frames from one call to the next at the present speed.
    fn interval(&self) -> f64 {
        let longest = f64::from(self.settings.longest_interval);
        match self.speed {
            // The scene's speed is unknown before the second answer: the detector runs again at once.
            None => 1.0,
            Some(speed) if speed > 0.0 => (self.settings.drift / speed).clamp(1.0, longest),
            Some(_) => longest,
        }
    }

    fn take_detections(&mut self, detections: &[Detection]) {
        self.before.clear();
        let states = self.tracker.objects.states().iter();
        self.before.extend(states.map(|state| Last {
            id: state.id,
            detected: state.detected,
            frames: state.since_update.max(1),
        }));
        self.tracker.observe(detections, |_| Missed::Removed);
        if let Some(pause) = self.since_call {
            let speed = self.scene_speed(f64::from(pause.max(1)));
            let weight = self.settings.newest_weight;
            self.speed = Some(match self.speed {
                Some(before) => before + weight * (speed - before),
                None => speed,
            });
        }
        self.since_call = Some(0);
    }

    /// v of the current answer, `pause` frames after the one before.
    fn scene_speed(&self, pause: f64) -> f64 {
        // Objects are kept in order of their numbers, so both lists are walked once.
        let mut before = self.before.iter().peekable();
        let (mut sum, mut count) = (0.0, 0_u32);
        for state in self.tracker.objects.states() {
            while before.next_if(|last| last.id < state.id).is_some() {
                // Lost.
                sum += 1.0 / pause;
                count += 1;
            }
            sum += match before.next_if(|last| last.id == state.id) {
                Some(last) => {
                    let moved = displacement(last.detected, state.detected);
                    // Faster than its own size a frame it is as good as another object.
                    (moved / f64::from(last.frames)).min(1.0)
                }
                None => 1.0 / pause,
            };
            count += 1;
        }
        let lost = before.count() as f64;
        sum += lost / pause;
        let count = f64::from(count) + lost;
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// How far a box moved and how much it grew, in its own sizes.
fn displacement(from: BoundingBox, to: BoundingBox) -> f64 {
    let x = (to.center_x - from.center_x) / from.width;
    let y = (to.center_y - from.center_y) / from.height;
    let growth = ((to.width / from.width).ln().abs() + (to.height / from.height).ln().abs()) / 2.0;
    x.hypot(y) + growth
}

impl Policy for AdaptiveRate {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn knob(&self) -> Option<Knob> {
        Some(Self::KNOB)
    }

    fn knob_value(&self) -> Option<f64> {
        Some(self.settings.drift)
    }

    fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        self.settings.drift = Self::KNOB.check(value)?;
        Ok(())
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        self.tracker.begin(frame);
        self.since_call = self
            .since_call
            .map(|frames| frames.saturating_add(frame.step.max(1)));
        self.cause = match self.since_call {
            None => Some(CallCause::Start),
            Some(frames) if f64::from(frames) >= self.interval().floor() => {
                Some(CallCause::Schedule)
            }
            Some(_) => None,
        };
        if self.cause.is_some() {
            self.progress = AdaptiveRatePhase::AwaitsDetections;
            Need::Detections
        } else {
            self.progress = AdaptiveRatePhase::Decided(FrameState::P);
            Need::Nothing
        }
    }

    /// A detector that fails is called again on the next frame.
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if let (AdaptiveRatePhase::AwaitsDetections, Evidence::Detections(detections)) =
            (self.progress, evidence)
        {
            self.take_detections(detections);
            self.progress = AdaptiveRatePhase::Decided(FrameState::I);
        }
        Need::Nothing
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        let (state, degraded) = match self.progress {
            AdaptiveRatePhase::Decided(state) => (state, false),
            AdaptiveRatePhase::AwaitsDetections => (FrameState::P, true),
        };
        outcome.clear(state, degraded);
        outcome.cause = self.cause;
        self.tracker.finish(state, outcome);
    }

    fn reset(&mut self) {
        self.tracker.clear();
        self.progress = AdaptiveRatePhase::Decided(FrameState::P);
        self.cause = None;
        self.since_call = None;
        self.speed = None;
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
