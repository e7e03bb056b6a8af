//! What a node used today, in memory, so that a fleet can be sorted by it.

use serde::Serialize;
use utoipa::ToSchema;

const DAY_MS: i64 = 86_400_000;

/// The day of a time, counted from the Unix epoch: days of UTC, as the database's.
pub(crate) const fn day_of(ms: i64) -> i64 {
    ms.div_euclid(DAY_MS)
}

/// What a node's clips of today used. Measured and estimated energy are never added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct TodaysEnergy {
    /// Joules read from a meter, also where it was read for a part of the time.
    pub measured_joules: f64,
    /// Joules computed from utilisation.
    pub estimated_joules: f64,
}

/// The sums of one day, in whole microjoules.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Today {
    day: i64,
    measured_uj: i64,
    estimated_uj: i64,
}

impl Today {
    /// Adds the energy of a clip filed under `day`; a day before the newest one is over.
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
        }
    }

    /// The sums, if they are of `day`.
    pub(super) fn energy(&self, day: i64) -> TodaysEnergy {
        let of_day = |uj: i64| {
            if self.day == day {
                uj as f64 / 1e6
            } else {
                0.0
            }
        };
        TodaysEnergy {
            measured_joules: of_day(self.measured_uj),
            estimated_joules: of_day(self.estimated_uj),
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

/// The energy of a clip.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Used {
    /// Microjoules.
    pub(crate) uj: i64,
    /// Computed and not read from a meter.
    pub(crate) estimated: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_ends_at_midnight_and_qualities_are_not_added() {
        let used = |uj, estimated| Used { uj, estimated };
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
