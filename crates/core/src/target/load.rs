//! The load targets: skip rate and power.
//!
//! Both are controlled by one quantity, the logarithm of the load over the wanted load, whose response to the threshold
//! hardly depends on the scene: if a share `d` of frames uses the detector, a threshold larger by a factor e reduces
//! `d` by about 0.22 (the recorded sequences, `u` and `lambda` alike).

use super::{Lever, Measured, Target, TargetStatus, Verdict};
use std::collections::VecDeque;

/// Seconds over which the load is measured for the controller; longer if frames are few.
const WINDOW_S: f64 = 5.0;

/// Minimum number of frames in that time: with fewer, the share is mostly chance.
const WINDOW_FRAMES: u64 = 50;

/// Seconds over which the load is reported and compared with the target: the pauses between calls vary, so over five
/// seconds it fluctuates by about ten per cent.
const REPORTED_S: f64 = 20.0;

/// Minimum number of frames in that time.
const REPORTED_FRAMES: u64 = 200;

/// Maximum length of a window with few frames, seconds.
const LONGEST_S: f64 = 60.0;

/// Time constant of the loop, seconds: slow compared with the window, and settled after four of them.
const LOOP_S: f64 = 10.0;

/// Longest step, seconds: after a pause of the machine, one old measurement does not move the threshold for all of it.
const LONGEST_STEP_S: f64 = 2.0;

/// Reduction of the share of frames with the detector for a threshold larger by a factor e.
const STEEPNESS: f64 = 0.22;

/// Largest error that the controller uses, so that the threshold does not run away after one unusual window.
const LARGEST_ERROR: f64 = 1.0;

/// The threshold does not move for an error up to this share of the wanted load.
const DEAD_BAND: f64 = 0.01;

/// The target counts as held within this share of it.
const HELD: f64 = 0.05;

/// Seconds over which the power's response to the detector is learnt.
const MEMORY_S: f64 = 120.0;

#[derive(Clone, Debug)]
pub(super) struct LoadControl {
    target: Target,
    window: Window,
    reported: Window,
    power: PowerAnswer,
    /// Time for which the target has been beyond the end of the range, seconds.
    beyond_s: f64,
}

impl LoadControl {
    pub(super) fn new(target: Target) -> Self {
        Self {
            target,
            window: Window::new(WINDOW_S, WINDOW_FRAMES),
            reported: Window::new(REPORTED_S, REPORTED_FRAMES),
            power: PowerAnswer::default(),
            beyond_s: 0.0,
        }
    }

    pub(super) fn step(&mut self, measured: &Measured, seconds: f64, lever: &mut Lever) -> Verdict {
        if seconds > 0.0 {
            for window in [&mut self.window, &mut self.reported] {
                window.add(measured);
            }
        }
        let nothing_measured = |status| Verdict {
            actual: None,
            status,
            boxes: None,
        };
        let lately = self.window.load();
        let Some(share) = lately.share else {
            let status = if lately.seconds < WINDOW_S {
                TargetStatus::Measuring
            } else {
                TargetStatus::NoFrames
            };
            return nothing_measured(status);
        };
        if let Some(watts) = lately.watts {
            self.power.learn(share, watts, seconds);
        }
        let reported = self.reported.load().value_for(self.target);
        let (Some(actual), Some(error)) = (reported, self.error(&lately)) else {
            return nothing_measured(TargetStatus::NoPower);
        };
        if lately.seconds < WINDOW_S {
            return Verdict {
                actual: Some(actual),
                ..nothing_measured(TargetStatus::Measuring)
            };
        }
        let error = error.clamp(-LARGEST_ERROR, LARGEST_ERROR);
        // A step of the threshold changes the logarithm of the share by `STEEPNESS / share`, so the gain grows with the
        // share, within limits: it still moves if hardly any frame calls, and does not overshoot if all do. A longer
        // window slows the controller down.
        let constant = LOOP_S.max(2.0 * lately.seconds);
        let gain = (share / STEEPNESS / constant).clamp(0.01, 0.35);
        if error.abs() > DEAD_BAND {
            lever.push(gain * error * seconds.min(LONGEST_STEP_S));
        }
        let is_held = (actual / self.target.value() - 1.0).abs() <= HELD;
        // The status waits at an end, because the window still contains earlier threshold values.
        let is_at_end = if error > 0.0 {
            lever.is_at_most()
        } else {
            error < 0.0 && lever.is_at_least()
        };
        if is_at_end && !is_held {
            self.beyond_s += seconds;
        } else {
            self.beyond_s = 0.0;
        }
        let status = if is_held {
            TargetStatus::Held
        } else if self.beyond_s <= WINDOW_S {
            TargetStatus::Moving
        } else if error > 0.0 {
            TargetStatus::CannotBeMet
        } else {
            TargetStatus::MoreThanKept
        };
        Verdict {
            actual: Some(actual),
            status,
            boxes: None,
        }
    }

    /// Returns the logarithm of the load over the wanted load.
    fn error(&self, load: &Load) -> Option<f64> {
        // A window without a detector call does not mean a load of zero.
        const LEAST: f64 = 0.005;
        let ratio = |load: f64, wanted: f64| (load.max(LEAST * wanted) / wanted).ln();
        let share = load.share?.max(LEAST);
        match self.target {
            Target::SkipRate(wanted) => Some(ratio(share, 1.0 - wanted)),
            Target::Watts(wanted) => {
                let watts = load.watts?;
                let wanted_share = share - (watts - wanted) / self.power.slope(watts);
                Some(ratio(share, wanted_share.clamp(LEAST, 2.0)))
            }
            // Not a load; it has its own rule.
            Target::Recall(_) => None,
        }
    }
}

/// A sliding window over the last measurements.
#[derive(Clone, Debug)]
struct Window {
    /// Its least length, seconds, and its least number of frames.
    length: f64,
    frames: u64,
    steps: VecDeque<Measured>,
}

/// The load over a window.
#[derive(Clone, Copy, Debug)]
struct Load {
    seconds: f64,
    /// Share of frames with the detector; `None` without frames.
    share: Option<f64>,
    watts: Option<f64>,
}

impl Window {
    /// Creates a window of at least this length and number of frames.
    const fn new(length: f64, frames: u64) -> Self {
        Self {
            length,
            frames,
            steps: VecDeque::new(),
        }
    }

    fn add(&mut self, measured: &Measured) {
        self.steps.push_back(measured.clone());
        let mut length: f64 = self.steps.iter().map(|step| step.seconds).sum();
        let mut frames: u64 = self.steps.iter().map(|step| step.frames).sum();
        // The oldest goes if what remains is long enough without it.
        while let Some(first) = self.steps.front()
            && length - first.seconds >= self.length
            && (frames - first.frames >= self.frames || length > LONGEST_S)
        {
            length -= first.seconds;
            frames -= first.frames;
            self.steps.pop_front();
        }
    }

    fn load(&self) -> Load {
        let mut seconds = 0.0;
        let mut frames = 0;
        let mut skipped = 0;
        let mut covered_s = 0.0;
        let mut joules = 0.0;
        for step in &self.steps {
            seconds += step.seconds;
            frames += step.frames;
            skipped += step.skipped;
            if let Some(watts) = step.watts
                && watts.is_finite()
            {
                covered_s += step.seconds;
                joules += watts * step.seconds;
            }
        }
        let has_power = covered_s > 0.0 && joules > 0.0;
        Load {
            seconds,
            share: (frames > 0).then(|| 1.0 - skipped.min(frames) as f64 / frames as f64),
            watts: has_power.then(|| joules / covered_s),
        }
    }
}

impl Load {
    /// Returns the measured value for a target.
    fn value_for(&self, target: Target) -> Option<f64> {
        match target {
            Target::SkipRate(_) => self.share.map(|share| 1.0 - share),
            Target::Watts(_) => self.watts,
            Target::Recall(_) => None,
        }
    }
}

/// The response of the node's power to the share of frames with the detector: a straight line through the measurements,
/// with exponential forgetting. Until both have varied together, half of the power is assumed to be the detector's.
#[derive(Clone, Copy, Debug, Default)]
struct PowerAnswer {
    weight: f64,
    share: f64,
    watts: f64,
    variance: f64,
    covariance: f64,
}

impl PowerAnswer {
    /// Variance of the share at which the measurements weigh as much as the assumption.
    const GRANTED: f64 = 2e-3;

    fn learn(&mut self, share: f64, watts: f64, seconds: f64) {
        let keep = (-seconds / MEMORY_S).exp();
        let weight = self.weight * keep + seconds;
        if weight <= 0.0 {
            return;
        }
        let part = seconds / weight;
        let share_off = share - self.share;
        let watts_off = watts - self.watts;
        let old = 1.0 - part;
        self.variance = old * (self.variance + part * share_off * share_off);
        self.covariance = old * (self.covariance + part * share_off * watts_off);
        self.share += part * share_off;
        self.watts += part * watts_off;
        self.weight = weight;
    }

    /// Returns the watts that the detector adds on all frames compared with none.
    fn slope(&self, watts: f64) -> f64 {
        let granted = 0.5 * watts;
        let slope = (self.covariance + granted * Self::GRANTED) / (self.variance + Self::GRANTED);
        // Beyond these limits it is noise: a detector that adds a tenth of the power cannot hold a target of watts, and
        // none adds three times the power of the whole node.
        slope.clamp(0.1 * watts, 3.0 * watts)
    }
}
