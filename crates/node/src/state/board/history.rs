//! Keeps the past that pages show, in bounded memory: the last frames one by one, and the last hour in pieces.

mod growth;
mod skipping;

pub(crate) use skipping::SkipEstimate;

use super::PowerSnapshot;
use crate::percentiles::percentile;
use albireo_core::policy::{CallCause, FrameState};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{DetectionsMessage, EnergyQuality};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use tokio::time::Instant;
use utoipa::ToSchema;

/// The number of frames kept one by one: four and a half minutes at 30 frames per second.
pub(crate) const FRAMES: usize = 8192;
/// The length of a piece of the hour, seconds.
pub(crate) const SLOT_S: u64 = 10;
/// The number of pieces kept: an hour, and the open piece.
const SLOTS: usize = 361;
/// The maximum number of detector times per piece that are used for its percentiles.
const TIMES: usize = 1024;

/// A kept frame, in single precision because there are many.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PastFrame {
    /// Sequence number.
    pub seq: u64,
    /// The time of its answer, milliseconds since the node's start.
    pub at_ms: u64,
    /// Its state.
    pub state: FrameState,
    /// The cause of the detector call.
    pub cause: Option<CallCause>,
    /// True if the detector was needed but not available.
    pub degraded: bool,
    /// The number of reported boxes.
    pub boxes: u16,
    /// Largest uncertainty before the decision; `None` without objects.
    pub tau_max: Option<f32>,
    /// The threshold in force.
    pub threshold: Option<f32>,
    /// The detector's time, if it ran.
    pub detector_ms: Option<f32>,
    /// The time from reception to publication.
    pub total_ms: f32,
}

impl PastFrame {
    fn of(frame: &DetectionsMessage, at: Duration) -> Self {
        let single = |value: f64| value as f32;
        Self {
            seq: frame.seq,
            at_ms: at.as_millis() as u64,
            state: frame.state,
            cause: frame.cause,
            degraded: frame.degraded,
            boxes: u16::try_from(frame.boxes.len()).unwrap_or(u16::MAX),
            tau_max: frame.tau_max.map(single),
            threshold: frame.threshold.map(|threshold| single(threshold.value)),
            detector_ms: frame.latency_ms.detector.map(single),
            total_ms: single(frame.latency_ms.total),
        }
    }
}

/// Converts the node's times to the present wall clock: if that was set in between, all times shift.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    /// The wall clock, milliseconds since the Unix epoch.
    pub now_ms: i64,
    /// The time since the node's start.
    pub age: Duration,
}

impl Clock {
    /// The present time, of a node started at `started`.
    pub(super) fn now(started: Instant) -> Self {
        Self {
            now_ms: unix_milliseconds(),
            age: started.elapsed(),
        }
    }

    /// The milliseconds since an event, from its time after the node's start.
    pub(crate) fn before_now_ms(&self, at_ms: u64) -> u64 {
        (self.age.as_millis() as u64).saturating_sub(at_ms)
    }
}

/// The last hour in pieces.
#[derive(Debug)]
struct Hour<T> {
    /// The ended pieces, each with its number, counted from the node's start.
    ended: VecDeque<(u64, T)>,
    /// The open piece.
    open: T,
    /// Its number.
    open_slot: u64,
}

impl<T: Default> Default for Hour<T> {
    fn default() -> Self {
        Self {
            ended: VecDeque::with_capacity(SLOTS),
            open: T::default(),
            open_slot: 0,
        }
    }
}

impl<T: Clone + Default> Hour<T> {
    /// If the open piece is over at `at` after the node's start, opens the next and returns the ended one.
    fn turn(&mut self, at: Duration) -> Option<&mut T> {
        let slot = at.as_secs() / SLOT_S;
        if slot == self.open_slot {
            return None;
        }
        if self.ended.len() == SLOTS {
            self.ended.pop_front();
        }
        let ended = std::mem::take(&mut self.open);
        self.ended.push_back((self.open_slot, ended));
        self.open_slot = slot;
        self.ended.back_mut().map(|(_, piece)| piece)
    }

    /// The pieces of the last hour with their starts, oldest first, the open one last.
    fn read(&self, now: &Clock) -> Vec<(i64, T)> {
        let oldest = (now.age.as_secs() / SLOT_S).saturating_sub(SLOTS as u64 - 1);
        let started_ms = |slot: u64| now.now_ms - now.before_now_ms(slot * SLOT_S * 1000) as i64;
        let mut pieces = Vec::with_capacity(SLOTS);
        for (slot, piece) in &self.ended {
            if *slot >= oldest {
                pieces.push((started_ms(*slot), piece.clone()));
            }
        }
        if self.open_slot >= oldest {
            pieces.push((started_ms(self.open_slot), self.open.clone()));
        }
        pieces
    }
}

/// A piece of the last hour.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
#[schema(as = CameraSlot)]
pub(crate) struct CameraPiece {
    /// Its start, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Frames processed.
    pub frames: u32,
    /// Frames that skipped the detector: state E or P and not degraded.
    pub skipped: u32,
    /// Frames answered from prediction because the detector was not available.
    pub degraded: u32,
    /// Frames for which the detector was called.
    pub calls: u32,
    /// Median time of the detector, milliseconds; absent where it did not run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detector_p50_ms: Option<f32>,
    /// 99th percentile of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detector_p99_ms: Option<f32>,
}

impl CameraPiece {
    /// Sets the percentiles of these detector times.
    fn set_percentiles(&mut self, times: &[f32]) {
        let mut sorted = times.to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        self.detector_p50_ms = percentile(&sorted, 50);
        self.detector_p99_ms = percentile(&sorted, 99);
    }
}

/// The past of one camera.
#[derive(Debug)]
pub(crate) struct History {
    frames: VecDeque<PastFrame>,
    /// The number of the last of them that the policy in force decided.
    of_policy: usize,
    hour: Hour<CameraPiece>,
    /// The first detector times in the open piece.
    times: Vec<f32>,
}

impl Default for History {
    fn default() -> Self {
        Self {
            frames: VecDeque::with_capacity(FRAMES),
            of_policy: 0,
            hour: Hour::default(),
            times: Vec::with_capacity(TIMES),
        }
    }
}

impl History {
    /// Adds a frame answered at `at` after the node's start.
    pub(crate) fn add(&mut self, frame: &DetectionsMessage, at: Duration) {
        if self.frames.len() == FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back(PastFrame::of(frame, at));
        self.of_policy = (self.of_policy + 1).min(FRAMES);
        if let Some(ended) = self.hour.turn(at) {
            ended.set_percentiles(&self.times);
            self.times.clear();
        }
        let open = &mut self.hour.open;
        open.frames += 1;
        open.skipped += u32::from(frame.skipped_detector());
        open.degraded += u32::from(frame.degraded);
        open.calls += u32::from(frame.cause.is_some());
        if let Some(time) = frame.latency_ms.detector
            && self.times.len() < TIMES
        {
            self.times.push(time as f32);
        }
    }

    /// The frames that follow are decided by another policy.
    pub(super) fn policy_begins(&mut self) {
        self.of_policy = 0;
    }

    /// The number of the last frames that the policy in force decided.
    pub(crate) fn of_policy(&self) -> usize {
        self.of_policy
    }

    /// The last frames, oldest first, at most `most`.
    pub(crate) fn frames(&self, most: usize) -> Vec<PastFrame> {
        let first = self.frames.len().saturating_sub(most);
        self.frames.iter().skip(first).copied().collect()
    }

    /// The pieces of the last hour, oldest first, with the open one; pieces without a frame are left out.
    pub(crate) fn slots(&self, now: &Clock) -> Vec<CameraPiece> {
        let mut pieces = self.hour.read(now);
        if let Some((_, open)) = pieces.last_mut() {
            open.set_percentiles(&self.times);
        }
        pieces
            .into_iter()
            .filter(|(_, piece)| piece.frames > 0)
            .map(|(at_ms, piece)| CameraPiece { at_ms, ..piece })
            .collect()
    }
}

/// Power of a piece of the last hour.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub(crate) struct PowerPiece {
    /// Its start, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Its quality: the worst during the piece.
    pub quality: EnergyQuality,
    /// Mean power over the time that samples cover, watts, by domain.
    pub watts: BTreeMap<String, f32>,
}

/// The node's power over the last hour.
#[derive(Debug, Default)]
pub(super) struct PowerPast {
    hour: Hour<PowerPiece>,
    /// The figures at the start of the open piece.
    began: PowerSnapshot,
    newest: PowerSnapshot,
    /// The worst quality in the open piece.
    worst: Option<EnergyQuality>,
}

impl PowerPast {
    /// Adds the figures at `at` after the node's start. Means are only over the time that samples cover.
    pub(super) fn add(&mut self, power: PowerSnapshot, at: Duration) {
        if self.hour.turn(at).is_some() {
            self.began = std::mem::take(&mut self.newest);
            self.worst = None;
        }
        self.worst = self.worst.max(Some(power.quality));
        self.newest = power;
        let piece = self.newest.clone().since(&self.began);
        let watts = piece.joules.keys().filter_map(|domain| {
            let (joules, seconds) = piece.energy(domain)?;
            Some((domain.clone(), (joules / seconds) as f32))
        });
        self.hour.open = PowerPiece {
            at_ms: 0,
            quality: self.worst.unwrap_or_default(),
            watts: watts.collect(),
        };
    }

    /// The newest figures.
    pub(super) fn newest(&self) -> &PowerSnapshot {
        &self.newest
    }

    /// The ended pieces of the last hour, oldest first; pieces without a figure are left out.
    pub(super) fn slots(&self, now: &Clock) -> Vec<PowerPiece> {
        let mut pieces = self.hour.read(now);
        // The open one.
        pieces.pop();
        pieces
            .into_iter()
            .filter(|(_, piece)| !piece.watts.is_empty())
            .map(|(at_ms, piece)| PowerPiece { at_ms, ..piece })
            .collect()
    }
}

#[cfg(test)]
mod tests;
