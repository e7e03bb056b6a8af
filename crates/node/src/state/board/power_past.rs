//! Power over the last hour, in pieces as those of the cameras: a ring whose memory is taken at the start.

use super::PowerSnapshot;
use super::history::{SLOT_S, SLOTS};
use albireo_power::Domain;
use albireo_wire::EnergyQuality;
use std::collections::VecDeque;
use std::time::Duration;

/// Mean power of a piece by domain, in the order of [`Domain::ALL`]; NaN where there is none.
type Watts = [f32; Domain::ALL.len()];

/// A piece of the last hour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PowerSlot {
    /// Its number, counted from the node's start.
    pub slot: u64,
    /// How far to trust it: the worst during the piece.
    pub quality: EnergyQuality,
    watts: Watts,
}

impl PowerSlot {
    /// Domains and mean watts.
    pub(crate) fn watts(&self) -> impl Iterator<Item = (&'static str, f32)> {
        let known = Domain::ALL.into_iter().zip(self.watts);
        known
            .filter(|(_, watts)| !watts.is_nan())
            .map(|(domain, watts)| (domain.as_str(), watts))
    }
}

/// Joules and covered seconds so far, by domain.
#[derive(Clone, Copy, Debug, Default)]
struct SoFar([(f64, f64); Domain::ALL.len()]);

impl SoFar {
    fn of(power: &PowerSnapshot) -> Self {
        Self(Domain::ALL.map(|domain| {
            let of = |sums: &std::collections::BTreeMap<String, f64>| {
                sums.get(domain.as_str()).copied().unwrap_or_default()
            };
            (of(&power.joules), of(&power.covered_s))
        }))
    }

    /// Mean power since `before`: joules over the time that samples cover, and never over the rest.
    fn since(&self, before: &Self) -> Watts {
        let mut watts = [f32::NAN; Domain::ALL.len()];
        for ((place, now), before) in watts.iter_mut().zip(&self.0).zip(&before.0) {
            let (joules, seconds) = (now.0 - before.0, now.1 - before.1);
            if seconds > 0.0 {
                *place = (joules / seconds) as f32;
            }
        }
        watts
    }
}

/// The hour.
#[derive(Debug)]
pub(super) struct PowerPast {
    slots: VecDeque<PowerSlot>,
    open: u64,
    quality: EnergyQuality,
    before: SoFar,
    now: SoFar,
}

impl Default for PowerPast {
    fn default() -> Self {
        Self {
            slots: VecDeque::with_capacity(SLOTS),
            open: 0,
            quality: EnergyQuality::Measured,
            before: SoFar::default(),
            now: SoFar::default(),
        }
    }
}

impl PowerPast {
    /// Takes the figures as they stand `at` that time after the node's start.
    pub(super) fn add(&mut self, power: &PowerSnapshot, at: Duration) {
        let slot = at.as_secs() / SLOT_S;
        if slot != self.open {
            let ended = self.ended();
            if self.slots.len() == SLOTS {
                self.slots.pop_front();
            }
            self.slots.push_back(ended);
            self.open = slot;
            self.before = self.now;
            self.quality = power.quality;
        }
        self.now = SoFar::of(power);
        self.quality = self.quality.max(power.quality);
    }

    fn ended(&self) -> PowerSlot {
        PowerSlot {
            slot: self.open,
            quality: self.quality,
            watts: self.now.since(&self.before),
        }
    }

    /// The pieces of the hour before `now` that are over, oldest first; those without a figure are left out.
    pub(super) fn slots(&self, now: Duration) -> Vec<PowerSlot> {
        let oldest = (now.as_secs() / SLOT_S).saturating_sub(SLOTS as u64 - 1);
        let all = self.slots.iter().copied();
        all.filter(|slot| slot.slot >= oldest && slot.watts().next().is_some())
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_power_of_a_piece_is_its_joules_over_the_time_that_was_sampled() {
        let mut past = PowerPast::default();
        for second in 0..=7200_u64 {
            // 5 W in even pieces and 9 W in odd ones, sampled half of the time.
            let joules = (0..second)
                .map(|s| {
                    if (s / SLOT_S).is_multiple_of(2) {
                        2.5
                    } else {
                        4.5
                    }
                })
                .sum::<f64>();
            let snapshot = PowerSnapshot {
                quality: EnergyQuality::Estimated,
                joules: BTreeMap::from([("total".to_owned(), joules)]),
                covered_s: BTreeMap::from([("total".to_owned(), second as f64 / 2.0)]),
                ..PowerSnapshot::default()
            };
            past.add(&snapshot, Duration::from_secs(second));
        }
        let capacity = past.slots.capacity();
        let slots = past.slots(Duration::from_secs(7200));
        assert_eq!(
            capacity,
            VecDeque::<PowerSlot>::with_capacity(SLOTS).capacity()
        );
        assert!(
            (SLOTS - 1..=SLOTS).contains(&slots.len()),
            "{}",
            slots.len()
        );
        for slot in slots.iter().skip(1) {
            let watts: Vec<_> = slot.watts().collect();
            let [("total", total)] = watts[..] else {
                panic!("{watts:?}")
            };
            // The first second of a piece belongs to the sample that began it.
            assert!((5.0..=9.0).contains(&total), "{slot:?}");
            assert_eq!(slot.quality, EnergyQuality::Estimated);
        }
        let means = slots
            .iter()
            .flat_map(PowerSlot::watts)
            .map(|(_, watts)| watts);
        let mean = means.sum::<f32>() / slots.len() as f32;
        assert!((6.9..7.1).contains(&mean), "{mean}");
    }

    #[test]
    fn without_a_source_there_is_no_power() {
        let mut past = PowerPast::default();
        for second in 0..100 {
            past.add(&PowerSnapshot::default(), Duration::from_secs(second));
        }
        assert_eq!(past.slots(Duration::from_secs(100)), []);
    }
}
