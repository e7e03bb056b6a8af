//! Learns the watts that a running detector adds, from how the node's power follows the detector's use.
//!
//! Time is cut into pieces of at least two seconds, each from the end of one detector run to the end of another, so the
//! detector time of a piece is exact. The power and the detector share of a piece are taken as deviations from their
//! means over the last 20 seconds, which removes all slower changes of the machine's power. Their regression over the
//! last hour is the answer, once its standard error is small.

use crate::energy::totals::{History, Sum};
use std::time::Duration;
use tokio::time::Instant;

/// The shortest piece: long compared with the delay of meters.
const PIECE: Duration = Duration::from_secs(2);

/// The share of a piece that samples must cover.
const COVERED: f64 = 0.99;

/// Time constants of the means and of the regression, seconds.
const MEAN_S: f64 = 20.0;
const MEMORY_S: f64 = 3600.0;

/// The fewest pieces and the smallest standard deviation of the detector's share for an answer.
const FEWEST: f64 = 20.0;
const LEAST_DEVIATION: f64 = 0.01;

/// The largest standard error of an answer, relative to the answer.
const LARGEST_ERROR: f64 = 0.05;

/// Learns the watts that a running detector adds.
#[derive(Debug)]
pub(crate) struct DetectorWatts {
    shortest: Duration,
    /// Total detector time, seconds, and the end of the newest run.
    used_s: f64,
    last: Option<Instant>,
    /// The start of the current piece.
    begun: Option<Begun>,
    line: Line,
    known: Option<f64>,
}

/// The end of a run, at which a piece begins, with the detector's time and the node's total until then.
#[derive(Clone, Copy, Debug)]
struct Begun {
    at: Instant,
    used_s: f64,
    total: Sum,
}

impl DetectorWatts {
    /// Creates a learner for samples taken every `interval`.
    pub(crate) fn new(interval: Duration) -> Self {
        Self {
            shortest: PIECE.max(interval * 5),
            used_s: 0.0,
            last: None,
            begun: None,
            line: Line::default(),
            known: None,
        }
    }

    /// Records a call that ended at `end` and took `used`.
    pub(crate) fn called(&mut self, end: Instant, used: Duration) {
        self.used_s += used.as_secs_f64();
        self.last = self.last.max(Some(end));
    }

    /// Learns from the samples so far.
    pub(crate) fn learn(&mut self, history: &History) {
        let Some(end) = self.last else {
            return;
        };
        // The energy until the end of that run is known with the first sample after it.
        if history.newest() < Some(end) {
            return;
        }
        let total = history.at(end).total();
        if let Some(begun) = self.begun {
            let seconds = end.saturating_duration_since(begun.at).as_secs_f64();
            if seconds < self.shortest.as_secs_f64() {
                return;
            }
            let covered_s = total.seconds - begun.total.seconds;
            if covered_s >= COVERED * seconds {
                let share = (self.used_s - begun.used_s) / seconds;
                let watts = (total.joules - begun.total.joules) / covered_s;
                self.line.add(share, watts, seconds);
                self.known = self.line.slope().or(self.known);
            }
        }
        self.begun = Some(Begun {
            at: end,
            used_s: self.used_s,
            total,
        });
    }

    /// The watts that the detector adds while it runs; `None` until known.
    pub(crate) const fn watts(&self) -> Option<f64> {
        self.known
    }
}

/// A regression line through successive points.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    points: f64,
    means: Option<Means>,
    xx: f64,
    xy: f64,
    yy: f64,
}

/// The means of the recent points.
#[derive(Clone, Copy, Debug)]
struct Means {
    x: f64,
    y: f64,
}

impl Line {
    fn add(&mut self, x: f64, y: f64, seconds: f64) {
        let means = self.means.unwrap_or(Means { x, y });
        let dx = x - means.x;
        let dy = y - means.y;
        let part = 1.0 - (-seconds / MEAN_S).exp();
        self.means = Some(Means {
            x: means.x + part * dx,
            y: means.y + part * dy,
        });
        let keep = (-seconds / MEMORY_S).exp();
        for (sum, more) in [
            (&mut self.points, 1.0),
            (&mut self.xx, dx * dx),
            (&mut self.xy, dx * dy),
            (&mut self.yy, dy * dy),
        ] {
            *sum = *sum * keep + more;
        }
    }

    /// The slope, if it is known precisely enough.
    fn slope(&self) -> Option<f64> {
        if self.points < FEWEST || self.xx < self.points * LEAST_DEVIATION.powi(2) {
            return None;
        }
        let slope = self.xy / self.xx;
        // Two degrees of freedom are spent on the line itself.
        let residual = (self.yy - slope * self.xy).max(0.0) / (self.points - 2.0);
        let error = (residual / self.xx).sqrt();
        let is_known = slope > 0.0 && error <= LARGEST_ERROR * slope;
        if !is_known {
            return None;
        }
        Some(slope)
    }
}

#[cfg(test)]
mod tests;
