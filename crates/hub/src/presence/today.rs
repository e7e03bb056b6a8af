//! What a node's clips of today used and saved, in memory, so that a fleet can be sorted by it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

const DAY_MS: i64 = 86_400_000;

/// The day of a time, counted from the Unix epoch: days of UTC, as the database's.
pub(crate) const fn day_of(ms: i64) -> i64 {
    ms.div_euclid(DAY_MS)
}

/// What a node's clips of today used. Measured and estimated energy are never added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TodaysEnergy {
    /// Joules read from a meter, also where it was read for a part of the time.
    pub measured_joules: f64,
    /// Joules computed from utilisation.
    pub estimated_joules: f64,
    /// Share of the frames that skipped the detector, 0 to 1; absent without a frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skip_rate: Option<f64>,
    /// Share of the detector's boxes on audited skipped frames that were shown, 0 to 1; absent without such a box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recall: Option<f64>,
}

/// The sums of one day, energy in whole microjoules.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Today {
    day: i64,
    measured_uj: i64,
    estimated_uj: i64,
    frames: u64,
    skipped: u64,
    detected: u64,
    paired: u64,
}

impl Today {
    /// Adds a clip filed under `day`; a day before the newest one is over.
    pub(super) fn add(&mut self, day: i64, used: Used) {
        if day > self.day {
            *self = Self {
                day,
                ..Self::default()
            };
        }
        if day == self.day {
            let sum = match used.estimated {
                true => &mut self.estimated_uj,
                false => &mut self.measured_uj,
            };
            *sum = sum.saturating_add(used.uj);
            self.frames = self.frames.saturating_add(used.frames);
            self.skipped = self.skipped.saturating_add(used.skipped);
            self.detected = self.detected.saturating_add(used.detected);
            self.paired = self.paired.saturating_add(used.paired);
        }
    }

    /// The sums, if they are of `day`.
    pub(super) fn energy(&self, day: i64) -> TodaysEnergy {
        if self.day != day {
            return TodaysEnergy::default();
        }
        let share = |part: u64, whole: u64| (whole > 0).then(|| part as f64 / whole as f64);
        TodaysEnergy {
            measured_joules: self.measured_uj as f64 / 1e6,
            estimated_joules: self.estimated_uj as f64 / 1e6,
            skip_rate: share(self.skipped, self.frames),
            recall: share(self.paired, self.detected),
        }
    }

    /// What nodes are sorted by: the larger of the two, for they are not added.
    pub(super) fn key(&self, day: i64) -> i64 {
        match self.day == day {
            true => self.measured_uj.max(self.estimated_uj),
            false => 0,
        }
    }
}

/// What a clip used and saved.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Used {
    /// Microjoules; 0 when not known.
    pub(crate) uj: i64,
    /// Computed and not read from a meter.
    pub(crate) estimated: bool,
    pub(crate) frames: u64,
    /// Frames that skipped the detector, degraded ones not among them.
    pub(crate) skipped: u64,
    /// Boxes of the detector on audited skipped frames.
    pub(crate) detected: u64,
    /// Those of them that were shown.
    pub(crate) paired: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_ends_at_midnight_and_qualities_are_not_added() {
        let used = |uj, estimated| Used {
            uj,
            estimated,
            frames: 10,
            skipped: 4,
            detected: 0,
            paired: 0,
        };
        let mut today = Today::default();
        today.add(7, used(3_000_000, false));
        today.add(7, used(1_000_000, false));
        today.add(7, used(9_000_000, true));
        // Late, and of a day that is over.
        today.add(6, used(5_000_000, false));
        let energy = today.energy(7);
        assert_eq!(
            (energy.measured_joules, energy.estimated_joules),
            (4.0, 9.0)
        );
        assert_eq!((energy.skip_rate, energy.recall), (Some(0.4), None));
        assert_eq!(today.key(7), 9_000_000);
        assert_eq!(
            (today.energy(8), today.key(8)),
            (TodaysEnergy::default(), 0)
        );
        today.add(8, used(1, false));
        assert_eq!((today.key(7), today.key(8)), (0, 1));
        assert_eq!(
            (day_of(-1), day_of(86_399_999), day_of(86_400_000)),
            (-1, 0, 1)
        );
    }
}
