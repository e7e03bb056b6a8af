//! What was saved, since the start and today. Sums and no list: a node that runs for a year needs no more memory than one
//! that began now.
//!
//! A day is one of UTC, so that it is the same for every node of a fleet and no clock change makes it 23 hours long. A
//! node that began today counts from its start on. A clip counts for the day on which it ended.

use super::camera::CameraBoard;
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{ClipReport, EnergyQuality, FrameStates};
use serde::Serialize;
use std::sync::Arc;
use utoipa::ToSchema;

const DAY_MS: i64 = 86_400_000;

/// Qualities of energy, in the order of the sums.
const QUALITIES: [EnergyQuality; 3] = [
    EnergyQuality::Measured,
    EnergyQuality::Partial,
    EnergyQuality::Estimated,
];

/// Energy of the clips of one quality; sums of different qualities are never added.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct SavedEnergy {
    /// How far to trust the joules.
    pub quality: EnergyQuality,
    /// Clips whose energy is known in whole.
    pub clips: u64,
    /// Their time, seconds.
    pub duration_s: f64,
    /// What they used.
    pub joules: f64,
    /// What they would have used with a detector call on every frame: an avoided call is priced at its clip's own mean
    /// power times its own mean detector time. Always an estimate.
    pub vanilla_joules_estimated: f64,
    /// Avoided calls without a price, because their clip had no call: they are in neither sum.
    pub unpriced_calls: u64,
}

/// What was saved over a time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Balance {
    /// From when on, milliseconds since the Unix epoch: the node's start, or midnight UTC where that is later.
    pub since_ms: i64,
    /// Frames processed.
    pub frames: u64,
    /// Detector calls avoided: frames answered without it, degraded ones not among them.
    pub avoided_calls: u64,
    /// Frames answered from prediction because the detector could not be had.
    pub degraded_frames: u64,
    /// Energy of the clips that ended in this time, by quality; a quality without clips is left out.
    pub energy: Vec<SavedEnergy>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    clips: u64,
    duration_s: f64,
    joules: f64,
    vanilla: f64,
    unpriced: u64,
}

impl Sums {
    fn add(&mut self, clip: &ClipReport, joules: f64) {
        let avoided = clip.states.skipped(clip.degraded_frames);
        self.clips += 1;
        self.duration_s += clip.duration_s;
        self.joules += joules;
        self.vanilla += joules;
        if clip.detector_latency_ms.count > 0 {
            let call = joules / clip.duration_s * clip.detector_latency_ms.mean / 1e3;
            self.vanilla += call * avoided as f64;
        } else {
            self.unpriced += avoided;
        }
    }
}

/// Frames as they are counted since the start.
#[derive(Clone, Copy, Debug, Default)]
struct Frames {
    states: FrameStates,
    degraded: u64,
}

impl Frames {
    fn of(cameras: &[Arc<CameraBoard>]) -> Self {
        let mut all = Self::default();
        for camera in cameras {
            let snapshot = camera.snapshot();
            all.states += snapshot.states;
            all.degraded += snapshot.degraded_frames;
        }
        all
    }
}

#[derive(Clone, Debug, Default)]
struct Period {
    since_ms: i64,
    /// What was counted when it began.
    before: Frames,
    energy: [Sums; QUALITIES.len()],
}

impl Period {
    fn add(&mut self, clip: &ClipReport) {
        let place = QUALITIES
            .iter()
            .position(|quality| *quality == clip.energy.quality);
        let sums = place.and_then(|place| self.energy.get_mut(place));
        if let (Some(sums), Some(joules)) = (sums, clip.energy.whole_joules())
            && clip.duration_s > 0.0
        {
            sums.add(clip, joules);
        }
    }

    fn balance(&self, now: Frames) -> Balance {
        let frames = now.states.frames() - self.before.states.frames();
        let degraded = now.degraded - self.before.degraded;
        let skipped = |frames: &Frames| frames.states.skipped(frames.degraded);
        let energy = QUALITIES.iter().zip(&self.energy);
        Balance {
            since_ms: self.since_ms,
            frames,
            avoided_calls: skipped(&now).saturating_sub(skipped(&self.before)),
            degraded_frames: degraded,
            energy: energy
                .filter(|(_, sums)| sums.clips > 0)
                .map(|(quality, sums)| SavedEnergy {
                    quality: *quality,
                    clips: sums.clips,
                    duration_s: sums.duration_s,
                    joules: sums.joules,
                    vanilla_joules_estimated: sums.vanilla,
                    unpriced_calls: sums.unpriced,
                })
                .collect(),
        }
    }
}

/// The sums of both times.
#[derive(Debug)]
pub(super) struct Balances {
    whole: Period,
    today: Period,
}

impl Balances {
    /// Of a node that begins now.
    pub(super) fn new() -> Self {
        let begun = Period {
            since_ms: unix_milliseconds(),
            ..Period::default()
        };
        Self {
            whole: begun.clone(),
            today: begun,
        }
    }

    /// Counts a clip that ended at `now_ms`.
    pub(super) fn add(&mut self, clip: &ClipReport, cameras: &[Arc<CameraBoard>], now_ms: i64) {
        self.turn(cameras, now_ms);
        self.whole.add(clip);
        self.today.add(clip);
    }

    /// Begins a new day if one has begun. To be called at least once a second, so that its first frames count for it.
    pub(super) fn turn(&mut self, cameras: &[Arc<CameraBoard>], now_ms: i64) {
        let (day, known) = (
            now_ms.div_euclid(DAY_MS),
            self.today.since_ms.div_euclid(DAY_MS),
        );
        // A clock that is set back makes no new day.
        if day > known {
            self.today = Period {
                since_ms: day * DAY_MS,
                before: Frames::of(cameras),
                energy: Default::default(),
            };
        }
    }

    /// Since the start, and today.
    pub(super) fn read(&mut self, cameras: &[Arc<CameraBoard>], now_ms: i64) -> (Balance, Balance) {
        self.turn(cameras, now_ms);
        let now = Frames::of(cameras);
        (self.whole.balance(now), self.today.balance(now))
    }
}
