//! Sums the savings since the start and today, without a list: memory does not grow with the node's run time.
//!
//! A day is a UTC day, so that it is the same for every node of a fleet and no clock change makes it 23 hours long. A
//! node that began today counts from its start.

use super::PowerSnapshot;
use albireo_service::clock::DAY_MS;
use albireo_wire::{EnergyQuality, FULL_COVERAGE};
use serde::Serialize;
use utoipa::ToSchema;

/// Energy of the whole node over a time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct EnergyUsed {
    /// The quality of the joules: partial if the meter had gaps.
    pub quality: EnergyQuality,
    /// Joules, over the time that samples cover.
    pub joules: f64,
    /// That time, seconds.
    pub covered_s: f64,
    /// Estimated energy that the avoided calls would have cost, joules: the time they would have run, at most the idle time
    /// of the one detector, times the watts that a running detector adds on this machine. Null while those are not known.
    pub saved_joules_estimated: Option<f64>,
}

/// Savings over a time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Savings {
    /// The beginning of the time, milliseconds since the Unix epoch: the node's start, or midnight UTC if that is later.
    pub since_ms: i64,
    /// Frames processed.
    pub frames: u64,
    /// Avoided calls of the detector: frames answered without it, except degraded ones.
    pub avoided_calls: u64,
    /// Frames answered from prediction because the detector was not available.
    pub degraded_frames: u64,
    /// Energy of the node; null without a figure.
    pub energy: Option<EnergyUsed>,
}

/// The counts of the node since its start, all cameras together, or the difference of two such counts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    /// Frames processed.
    pub frames: u64,
    /// Frames that skipped the detector.
    pub skipped: u64,
    /// Frames for which the detector was not available.
    pub degraded: u64,
    /// Detector time used for them, microseconds.
    pub detector_us: u64,
    /// Energy.
    pub power: PowerSnapshot,
}

impl Totals {
    /// The counts since `before`.
    pub(crate) fn since(self, before: &Self) -> Self {
        Self {
            frames: self.frames.saturating_sub(before.frames),
            skipped: self.skipped.saturating_sub(before.skipped),
            degraded: self.degraded.saturating_sub(before.degraded),
            detector_us: self.detector_us.saturating_sub(before.detector_us),
            power: self.power.since(&before.power),
        }
    }

    /// The savings in this time, which began at `since_ms`.
    pub(super) fn savings(&self, since_ms: i64) -> Savings {
        Savings {
            since_ms,
            frames: self.frames,
            avoided_calls: self.skipped,
            degraded_frames: self.degraded,
            energy: self.energy_used(),
        }
    }

    /// The energy in this time; `None` without a figure.
    fn energy_used(&self) -> Option<EnergyUsed> {
        let power = &self.power;
        let (joules, covered_s) = power.energy("total")?;
        let has_gaps = covered_s < FULL_COVERAGE * power.sampled_s;
        let quality = match power.meter_quality {
            EnergyQuality::Measured if has_gaps => EnergyQuality::Partial,
            quality => quality,
        };
        let saved = |watts: f64| watts * power.saved_detector_s;
        Some(EnergyUsed {
            quality,
            joules,
            covered_s,
            saved_joules_estimated: power.detector_watts.map(saved),
        })
    }
}

/// The current day.
#[derive(Debug)]
pub(super) struct Today {
    /// The start of the day, or of the node if later.
    pub since_ms: i64,
    /// The counts before it.
    pub before: Totals,
}

impl Today {
    /// Begins a new day if one has begun. Call it at least once per second, so the first frames of a day count for it.
    pub(super) fn turn(&mut self, now_ms: i64, so_far: impl FnOnce() -> Totals) {
        let day = now_ms.div_euclid(DAY_MS);
        if day != self.since_ms.div_euclid(DAY_MS) {
            *self = Self {
                since_ms: day * DAY_MS,
                before: so_far(),
            };
        }
    }
}

#[cfg(test)]
mod tests;
