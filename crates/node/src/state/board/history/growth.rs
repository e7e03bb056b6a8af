//! Learns from recorded frames how uncertainty grows between detector calls.

use super::PastFrame;

/// The number of ages recorded separately; beyond them, the growth follows the fit.
const AGES: usize = 64;
/// Without records, uncertainty is assumed to grow in proportion to time.
const USUAL_POWER: f64 = 1.0;

/// A past frame with its age: the number of frames since the last detector call before it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aged {
    pub frame: PastFrame,
    pub age: u32,
    /// The number of frames since the previous one: 1 if none was lost.
    pub step: u32,
}

/// The frames after the first call, with their ages. Ages before it are unknown.
pub(super) fn aged(frames: &[PastFrame]) -> Vec<Aged> {
    let mut aged = Vec::with_capacity(frames.len());
    let mut age: Option<u32> = None;
    let mut last: Option<u64> = None;
    for frame in frames {
        let gap = last.and_then(|last| frame.seq.checked_sub(last));
        // Large or backward jumps come from another stream.
        let step = gap
            .and_then(|gap| u32::try_from(gap).ok())
            .filter(|gap| (1..=300).contains(gap))
            .unwrap_or(1);
        last = Some(frame.seq);
        if let Some(before) = age {
            let now = before.saturating_add(step);
            aged.push(Aged {
                frame: *frame,
                age: now,
                step,
            });
            age = Some(now);
        }
        if frame.cause.is_some() && !frame.degraded {
            age = Some(0);
        }
    }
    aged
}

/// The logarithm of the growth of uncertainty, by age.
#[derive(Clone, Debug)]
pub(super) struct Growth {
    /// `logs[a]`: from the first frame after a call to the frame of age `a`.
    logs: [f64; AGES + 1],
    /// The power of the age with which uncertainty grows.
    power: f64,
}

impl Growth {
    /// The growth between successive frames of the same pause: the median, because objects that come and go make it
    /// jump. Steps are used because long pauses occur only with certain objects.
    pub(super) fn of(frames: &[Aged]) -> Self {
        let mut steps: Vec<Vec<f64>> = vec![Vec::new(); AGES + 1];
        for pair in frames.windows(2) {
            let [before, now] = pair else { continue };
            let follows = now.step == 1 && now.age == before.age + 1;
            if follows
                && let Some(first) = before.frame.tau_max
                && let Some(second) = now.frame.tau_max
                && first > 0.0
                && second > 0.0
                && let Some(steps) = steps.get_mut(now.age as usize)
            {
                steps.push(f64::from(second).ln() - f64::from(first).ln());
            }
        }
        let medians: Vec<_> = steps.iter_mut().map(|steps| Median::of(steps)).collect();
        // A power of the age grows by power · ln(a / (a − 1)) per step: fits the power by least squares.
        let mut above = 0.0;
        let mut below = 0.0;
        for (age, found) in medians.iter().enumerate().skip(2) {
            if let Some(median) = found {
                let x = log_step(age);
                above += median.weight * x * median.log;
                below += median.weight * x * x;
            }
        }
        let power = if below > 0.0 {
            (above / below).clamp(0.0, 4.0)
        } else {
            USUAL_POWER
        };
        let mut logs = [0.0; AGES + 1];
        let mut sum = 0.0;
        for (age, found) in medians.iter().enumerate().skip(2) {
            sum += match found {
                Some(median) => median.log,
                None => power * log_step(age),
            };
            logs[age] = sum;
        }
        Self { logs, power }
    }

    /// The logarithm of the growth from the first frame after a call to a frame of that age.
    pub(super) fn log(&self, age: u32) -> f64 {
        let age = age.max(1) as usize;
        if let Some(log) = self.logs.get(age) {
            return *log;
        }
        self.logs[AGES] + self.power * (age as f64 / AGES as f64).ln()
    }
}

fn log_step(age: usize) -> f64 {
    (age as f64 / (age as f64 - 1.0)).ln()
}

/// The median step of the logarithm at one age.
#[derive(Clone, Copy, Debug)]
struct Median {
    log: f64,
    /// The number of steps.
    weight: f64,
}

impl Median {
    /// `None` without a step.
    fn of(steps: &mut [f64]) -> Option<Self> {
        steps.sort_unstable_by(f64::total_cmp);
        Some(Self {
            log: *steps.get(steps.len() / 2)?,
            weight: steps.len() as f64,
        })
    }
}
