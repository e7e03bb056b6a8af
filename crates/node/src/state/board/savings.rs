//! What was saved, since the start and today. Sums and no list: a node that runs for a year needs no more memory than one
//! that began now.
//!
//! A day is one of UTC, so that it is the same for every node of a fleet and no clock change makes it 23 hours long. A
//! node that began today counts from its start on.

use super::PowerSnapshot;
use super::camera::CameraBoard;
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{EnergyQuality, FULL_COVERAGE, FrameStates};
use serde::Serialize;
use std::sync::Arc;
use utoipa::ToSchema;

const DAY_MS: i64 = 86_400_000;

/// What the whole node used over a time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct EnergyUsed {
    /// How far to trust the joules: partial where the meter had gaps.
    pub quality: EnergyQuality,
    /// Joules, over the time that samples cover.
    pub joules: f64,
    /// That time, seconds.
    pub covered_s: f64,
    /// Estimate of what the avoided calls would have added, joules: the time they would have run, no longer than the one
    /// detector had nothing to do, times the watts that a running detector adds on this machine. Null while it is not
    /// known what it adds.
    pub saved_joules_estimated: Option<f64>,
}

/// What was saved over a time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Savings {
    /// From when on, milliseconds since the Unix epoch: the node's start, or midnight UTC where that is later.
    pub since_ms: i64,
    /// Frames processed.
    pub frames: u64,
    /// Detector calls avoided: frames answered without it, degraded ones not among them.
    pub avoided_calls: u64,
    /// Frames answered from prediction because the detector was not available.
    pub degraded_frames: u64,
    /// Energy of the node; null without a figure.
    pub energy: Option<EnergyUsed>,
}

/// What is counted since the start.
#[derive(Clone, Copy, Debug, Default)]
struct Counted {
    states: FrameStates,
    degraded: u64,
    joules: f64,
    covered_s: f64,
    sampled_s: f64,
    saved_detector_s: f64,
}

impl Counted {
    fn of(cameras: &[Arc<CameraBoard>], power: &PowerSnapshot) -> Self {
        let total = |sums: &std::collections::BTreeMap<String, f64>| {
            sums.get("total").copied().unwrap_or_default()
        };
        let mut all = Self {
            joules: total(&power.joules),
            covered_s: total(&power.covered_s),
            sampled_s: power.sampled_s,
            saved_detector_s: power.saved_detector_s,
            ..Self::default()
        };
        for camera in cameras {
            let snapshot = camera.snapshot();
            all.states += snapshot.states;
            all.degraded += snapshot.degraded_frames;
        }
        all
    }

    fn skipped(&self) -> u64 {
        self.states.skipped(self.degraded)
    }
}

/// A time that goes on.
#[derive(Clone, Debug)]
struct Period {
    since_ms: i64,
    /// What was counted when it began.
    before: Counted,
}

impl Period {
    fn savings(&self, now: &Counted, power: &PowerSnapshot) -> Savings {
        let before = &self.before;
        let covered_s = now.covered_s - before.covered_s;
        let gaps = covered_s < FULL_COVERAGE * (now.sampled_s - before.sampled_s);
        let saved_s = now.saved_detector_s - before.saved_detector_s;
        Savings {
            since_ms: self.since_ms,
            frames: now.states.frames() - before.states.frames(),
            avoided_calls: now.skipped().saturating_sub(before.skipped()),
            degraded_frames: now.degraded - before.degraded,
            energy: (covered_s > 0.0).then(|| EnergyUsed {
                quality: match power.meter_quality {
                    EnergyQuality::Measured if gaps => EnergyQuality::Partial,
                    quality => quality,
                },
                joules: now.joules - before.joules,
                covered_s,
                saved_joules_estimated: power.detector_watts.map(|watts| watts * saved_s),
            }),
        }
    }
}

/// Both times.
#[derive(Debug)]
pub(super) struct SavingsSince {
    start: Period,
    today: Period,
}

impl SavingsSince {
    /// Of a node that begins now.
    pub(super) fn new() -> Self {
        let begun = Period {
            since_ms: unix_milliseconds(),
            before: Counted::default(),
        };
        Self {
            start: begun.clone(),
            today: begun,
        }
    }

    /// Begins a new day if one has begun. To be called at least once a second, so that its first frames count for it.
    pub(super) fn turn(
        &mut self,
        cameras: &[Arc<CameraBoard>],
        power: &PowerSnapshot,
        now_ms: i64,
    ) {
        let day = now_ms.div_euclid(DAY_MS);
        if day != self.today.since_ms.div_euclid(DAY_MS) {
            self.today = Period {
                since_ms: day * DAY_MS,
                before: Counted::of(cameras, power),
            };
        }
    }

    /// Since the start, and today.
    pub(super) fn read(
        &self,
        cameras: &[Arc<CameraBoard>],
        power: &PowerSnapshot,
    ) -> (Savings, Savings) {
        let now = Counted::of(cameras, power);
        (
            self.start.savings(&now, power),
            self.today.savings(&now, power),
        )
    }
}

#[cfg(test)]
mod tests;
