//! The load targets: skip rate and power.
//!
//! All are brought to one measure, the logarithm of the load over the load wanted, whose answer to the knob hardly depends
//! on the scene: where a share `d` of frames takes the detector, a knob larger by a factor e takes about 0.22 off `d` (the
//! recorded sequences, `u` and `lambda` alike).

use super::{Lever, Measured, Target, TargetStatus, Verdict};
use std::collections::VecDeque;

/// Seconds over which the load is measured for the controller; longer where frames are few.
const WINDOW_S: f64 = 5.0;

/// Fewest frames in that time: with fewer, the share is mostly chance.
const WINDOW_FRAMES: u64 = 50;

/// Seconds over which the load is reported and compared with the target: the pauses between calls vary, so over five
/// seconds it fluctuates by about ten per cent by itself.
const REPORTED_S: f64 = 20.0;

/// Fewest frames of that time.
const REPORTED_FRAMES: u64 = 200;

/// Longest time that is looked back for frames, seconds.
const LONGEST_S: f64 = 60.0;

/// Time constant of the loop, seconds: slow beside the window, and settled after four of them.
const LOOP_S: f64 = 10.0;

/// Longest step, seconds: after a pause of the machine one old measurement does not turn the knob for all of it.
const LONGEST_STEP_S: f64 = 2.0;

/// What a knob larger by a factor e takes off the share of frames with the detector.
const STEEPNESS: f64 = 0.22;

/// Largest error that is acted on: a knob does not run away over one strange window.
const LARGEST_ERROR: f64 = 1.0;

/// Below this share of the load wanted, up or down, the knob rests.
const DEAD_BAND: f64 = 0.01;

/// Within this share of the target it is held.
const HELD: f64 = 0.05;

/// Seconds over which the answer of the power to the detector is learnt.
const MEMORY_S: f64 = 120.0;

#[derive(Clone, Debug)]
pub(super) struct LoadControl {
    target: Target,
    window: Window,
    reported: Window,
    power: PowerAnswer,
    /// Seconds at the end of the range that the target lies beyond.
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
        let status = |status| Verdict {
            actual: None,
            status,
            boxes: None,
        };
        let lately = self.window.load();
        let Some(share) = lately.share else {
            return status(if lately.seconds < WINDOW_S {
                TargetStatus::Measuring
            } else {
                TargetStatus::NoFrames
            });
        };
        if let Some(watts) = lately.watts {
            self.power.learn(share, watts, seconds);
        }
        let reported = self.reported.load().of(self.target);
        let Some((actual, (wanted, error))) = reported.zip(self.error(&lately)) else {
            return status(TargetStatus::NoPower);
        };
        if lately.seconds < WINDOW_S {
            return Verdict {
                actual: Some(actual),
                ..status(TargetStatus::Measuring)
            };
        }
        let error = error.clamp(-LARGEST_ERROR, LARGEST_ERROR);
        // Frames without the detector become rarer the slower the fewer there are left.
        // And what is measured over a longer time is acted on more slowly.
        let constant = LOOP_S.max(2.0 * lately.seconds);
        let gain = (share / STEEPNESS / constant).clamp(0.01, 0.35);
        if error.abs() > DEAD_BAND {
            lever.push(gain * error * seconds.min(LONGEST_STEP_S));
        }
        let is_held = (actual / wanted - 1.0).abs() <= HELD;
        // At an end for a moment says nothing: the window is still of the values before.
        let beyond = !is_held
            && ((error > 0.0 && lever.is_at_most()) || (error < 0.0 && lever.is_at_least()));
        self.beyond_s = if beyond { self.beyond_s + seconds } else { 0.0 };
        let end = if error > 0.0 {
            TargetStatus::CannotBeMet
        } else {
            TargetStatus::MoreThanKept
        };
        Verdict {
            actual: Some(actual),
            status: match is_held {
                true => TargetStatus::Held,
                false if self.beyond_s > WINDOW_S => end,
                false => TargetStatus::Moving,
            },
            boxes: None,
        }
    }

    /// What is wanted, and the logarithm of the load over the load wanted.
    fn error(&self, load: &Load) -> Option<(f64, f64)> {
        // A window without a single call is no load of nothing.
        const LEAST: f64 = 0.005;
        let ratio = |load: f64, wanted: f64| (load.max(LEAST * wanted) / wanted).ln();
        let share = load.share?.max(LEAST);
        Some(match self.target {
            Target::SkipRate(wanted) => (wanted, ratio(share, 1.0 - wanted)),
            Target::Watts(wanted) => {
                let watts = load.watts?;
                let wanted_share = share - (watts - wanted) / self.power.slope(watts);
                (wanted, ratio(share, wanted_share.clamp(LEAST, 2.0)))
            }
            // Not a load; it has its own rule.
            Target::Recall(_) => return None,
        })
    }
}

/// The last seconds.
#[derive(Clone, Debug)]
struct Window {
    length: f64,
    frames: u64,
    seconds: VecDeque<Measured>,
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
    /// Of at least that length and that many frames.
    const fn new(length: f64, frames: u64) -> Self {
        Self {
            length,
            frames,
            seconds: VecDeque::new(),
        }
    }

    fn add(&mut self, measured: &Measured) {
        self.seconds.push_back(measured.clone());
        let mut length: f64 = self.seconds.iter().map(|one| one.seconds).sum();
        let mut frames: u64 = self.seconds.iter().map(|one| one.frames).sum();
        while let Some(first) = self.seconds.front()
            && length - first.seconds >= self.length
            && (frames - first.frames >= self.frames || length > LONGEST_S)
        {
            length -= first.seconds;
            frames -= first.frames;
            self.seconds.pop_front();
        }
    }

    fn load(&self) -> Load {
        let seconds: f64 = self.seconds.iter().map(|one| one.seconds).sum();
        let frames: u64 = self.seconds.iter().map(|one| one.frames).sum();
        let skipped: u64 = self.seconds.iter().map(|one| one.skipped).sum();
        let known = (self.seconds.iter()).filter_map(|one| {
            let watts = one.watts.filter(|watts| watts.is_finite())?;
            Some((one.seconds, watts))
        });
        let (covered, joules) = known.fold((0.0, 0.0), |(time, joules), (seconds, watts)| {
            (time + seconds, joules + watts * seconds)
        });
        Load {
            seconds,
            share: (frames > 0).then(|| 1.0 - skipped.min(frames) as f64 / frames as f64),
            watts: (covered > 0.0 && joules > 0.0).then(|| joules / covered),
        }
    }
}

impl Load {
    /// The measured value for a target.
    fn of(&self, target: Target) -> Option<f64> {
        match target {
            Target::SkipRate(_) => self.share.map(|share| 1.0 - share),
            Target::Watts(_) => self.watts,
            Target::Recall(_) => None,
        }
    }
}

/// How the node's power answers to the share of frames with the detector: a straight line through what was measured, that
/// forgets. Before the two have moved together, half of the power is taken to be the detector's.
#[derive(Clone, Copy, Debug, Default)]
struct PowerAnswer {
    weight: f64,
    share: f64,
    watts: f64,
    variance: f64,
    covariance: f64,
}

impl PowerAnswer {
    /// Variance of the share from which what was measured counts as much as what was taken for granted.
    const GRANTED: f64 = 2e-3;

    fn learn(&mut self, share: f64, watts: f64, seconds: f64) {
        let keep = (-seconds / MEMORY_S).exp();
        let weight = self.weight * keep + seconds;
        if weight <= 0.0 {
            return;
        }
        let part = seconds / weight;
        let (share_off, watts_off) = (share - self.share, watts - self.watts);
        let old = 1.0 - part;
        self.variance = old * (self.variance + part * share_off * share_off);
        self.covariance = old * (self.covariance + part * share_off * watts_off);
        self.share += part * share_off;
        self.watts += part * watts_off;
        self.weight = weight;
    }

    /// Watts that all frames with the detector cost more than none.
    fn slope(&self, watts: f64) -> f64 {
        let granted = 0.5 * watts;
        let slope = (self.covariance + granted * Self::GRANTED) / (self.variance + Self::GRANTED);
        slope.clamp(0.1 * watts, 3.0 * watts)
    }
}
