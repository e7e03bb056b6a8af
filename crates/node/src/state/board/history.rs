//! Keeps the past that pages show: the last frames one by one, and the last hour in pieces, in bounded memory.

mod growth;
mod skipping;

pub(crate) use skipping::SkipEstimate;

use super::PowerSnapshot;
use crate::camera::clip::percentile;
use albireo_core::policy::{CallCause, FrameState};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{DetectionsMessage, EnergyQuality};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use tokio::time::Instant;
use utoipa::ToSchema;

/// Frames that are remembered one by one: four and a half minutes at 30 frames per second.
pub(crate) const FRAMES: usize = 8192;
/// Length of a piece of the hour, seconds.
pub(crate) const SLOT_S: u64 = 10;
/// Pieces that are remembered: an hour, and the piece that has begun.
const SLOTS: usize = 361;
/// Detector times of a piece that its percentiles are made of; beyond them the oldest give way.
const TIMES: usize = 1024;

/// A frame as it is remembered: in single precision, as there are many of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PastFrame {
    /// Sequence number.
    pub seq: u64,
    /// It was answered this many milliseconds after the start of the node.
    pub at_ms: u64,
    /// Its state.
    pub state: FrameState,
    /// The cause for which the detector was called.
    pub cause: Option<CallCause>,
    /// It is true if the detector was needed but not available.
    pub degraded: bool,
    /// Boxes reported.
    pub boxes: u16,
    /// Largest uncertainty before the decision; `None` without objects.
    pub tau_max: Option<f32>,
    /// The threshold in force.
    pub threshold: Option<f32>,
    /// Time of the detector, if it ran.
    pub detector_ms: Option<f32>,
    /// From reception to publication.
    pub total_ms: f32,
}

impl PastFrame {
    fn of(frame: &DetectionsMessage, at: Duration) -> Self {
        let single = |value: f64| value as f32;
        Self {
            seq: frame.seq,
            at_ms: milliseconds(at),
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

fn milliseconds(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// A moment of the node's life by the wall clock as it goes now: a clock that was set in between moves all of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    /// The wall clock, milliseconds since the Unix epoch.
    pub now_ms: i64,
    /// The node's age.
    pub age: Duration,
}

impl Clock {
    /// Now, of a node that was started then.
    pub(super) fn now(started: Instant) -> Self {
        Self {
            now_ms: unix_milliseconds(),
            age: started.elapsed(),
        }
    }

    /// Returns how long ago something happened, from its time after the node's start.
    pub(crate) fn before_now_ms(&self, at_ms: u64) -> u64 {
        milliseconds(self.age).saturating_sub(at_ms)
    }
}

/// The last hour in pieces that hold something.
#[derive(Debug)]
struct Hour<T> {
    ended: VecDeque<(u64, T)>,
    /// The number of the piece that has begun, counted from the node's start.
    open: u64,
}

impl<T> Default for Hour<T> {
    fn default() -> Self {
        Self {
            ended: VecDeque::with_capacity(SLOTS),
            open: 0,
        }
    }
}

impl<T: Clone> Hour<T> {
    /// Says whether the open piece is over at that time after the node's start. It is then to be ended.
    fn is_over(&self, at: Duration) -> bool {
        at.as_secs() / SLOT_S != self.open
    }

    /// Ends the open piece, with what it held if that was anything; the next has begun.
    fn end(&mut self, held: Option<T>, at: Duration) {
        if let Some(held) = held {
            if self.ended.len() == SLOTS {
                self.ended.pop_front();
            }
            self.ended.push_back((self.open, held));
        }
        self.open = at.as_secs() / SLOT_S;
    }

    /// The pieces of the hour before now, oldest first, and the open one, each as `shown` with the time of its beginning.
    fn read<S>(&self, open: Option<T>, now: &Clock, shown: impl Fn(T, i64) -> S) -> Vec<S> {
        let oldest = (now.age.as_secs() / SLOT_S).saturating_sub(SLOTS as u64 - 1);
        let ended = self.ended.iter().cloned();
        let pieces = ended.chain(open.map(|open| (self.open, open)));
        pieces
            .filter(|(slot, _)| *slot >= oldest)
            .map(|(slot, held)| {
                let before = now.before_now_ms(slot.saturating_mul(SLOT_S * 1000));
                let at_ms = now.now_ms - i64::try_from(before).unwrap_or(i64::MAX);
                shown(held, at_ms)
            })
            .collect()
    }
}

/// A piece of the last hour.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
#[schema(as = CameraSlot)]
pub(crate) struct CameraPiece {
    /// When it began, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// Frames processed.
    pub frames: u32,
    /// Of these, without the detector: state E or P and not degraded.
    pub skipped: u32,
    /// Of these, answered from prediction because the detector was not available.
    pub degraded: u32,
    /// Frames that the detector was called for.
    pub calls: u32,
    /// Median time of the detector, milliseconds; absent where it did not run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detector_p50_ms: Option<f32>,
    /// 99th percentile of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detector_p99_ms: Option<f32>,
}

/// The past of one camera.
#[derive(Debug)]
pub(crate) struct History {
    frames: VecDeque<PastFrame>,
    hour: Hour<CameraPiece>,
    open: CameraPiece,
    /// Times of the detector in the open piece.
    times: Vec<f32>,
    /// The number of times that there were.
    timed: usize,
}

impl Default for History {
    fn default() -> Self {
        Self {
            frames: VecDeque::with_capacity(FRAMES),
            hour: Hour::default(),
            open: CameraPiece::default(),
            times: Vec::with_capacity(TIMES),
            timed: 0,
        }
    }
}

impl History {
    /// Remembers a frame that was answered `at` that time after the node's start.
    pub(crate) fn add(&mut self, frame: &DetectionsMessage, at: Duration) {
        if self.frames.len() == FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back(PastFrame::of(frame, at));
        if self.hour.is_over(at) {
            self.hour.end(self.ended(), at);
            self.open = CameraPiece::default();
            self.times.clear();
            self.timed = 0;
        }
        self.open.frames += 1;
        self.open.skipped += u32::from(frame.state.is_skipped() && !frame.degraded);
        self.open.degraded += u32::from(frame.degraded);
        self.open.calls += u32::from(frame.cause.is_some());
        if let Some(time) = frame.latency_ms.detector {
            let time = time as f32;
            match self.times.get_mut(self.timed % TIMES) {
                Some(place) => *place = time,
                None => self.times.push(time),
            }
            self.timed += 1;
        }
    }

    /// The open piece with its percentiles; nothing without a frame.
    fn ended(&self) -> Option<CameraPiece> {
        let mut sorted = self.times.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        (self.open.frames > 0).then(|| CameraPiece {
            detector_p50_ms: percentile(&sorted, 50),
            detector_p99_ms: percentile(&sorted, 99),
            ..self.open.clone()
        })
    }

    /// The last frames, oldest first, up to that many.
    pub(crate) fn frames(&self, most: usize) -> Vec<PastFrame> {
        let first = self.frames.len().saturating_sub(most);
        self.frames.iter().skip(first).copied().collect()
    }

    /// The pieces of the hour before now, oldest first, with the one that has begun; those without a frame are left out.
    pub(crate) fn slots(&self, now: &Clock) -> Vec<CameraPiece> {
        self.hour
            .read(self.ended(), now, |held, at_ms| CameraPiece {
                at_ms,
                ..held
            })
    }
}

/// Power of a piece of the last hour.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct PowerPiece {
    /// When it began, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// How far to trust it: the worst during the piece.
    pub quality: EnergyQuality,
    /// Mean power over the time that samples cover, watts, by domain.
    pub watts: BTreeMap<String, f32>,
}

/// The power of the node over the last hour.
#[derive(Debug, Default)]
pub(super) struct PowerPast {
    hour: Hour<PowerPiece>,
    /// The figures when the open piece began, and the newest; the worst quality since.
    began: PowerSnapshot,
    newest: PowerSnapshot,
    worst: Option<EnergyQuality>,
}

impl PowerPast {
    /// Takes the figures `at` that time after the node's start.
    pub(super) fn add(&mut self, power: PowerSnapshot, at: Duration) {
        if self.hour.is_over(at) {
            let ended = self.ended();
            self.hour.end(ended, at);
            self.began = std::mem::take(&mut self.newest);
            self.worst = None;
        }
        self.worst = self.worst.max(Some(power.quality));
        self.newest = power;
    }

    /// The open piece: joules over the time that samples cover, and never over the rest; nothing without samples.
    fn ended(&self) -> Option<PowerPiece> {
        let piece = self.newest.clone().since(&self.began);
        let watts: BTreeMap<_, _> = (piece.joules.keys())
            .filter_map(|domain| {
                let (joules, seconds) = piece.energy(domain)?;
                Some((domain.clone(), (joules / seconds) as f32))
            })
            .collect();
        (!watts.is_empty()).then(|| PowerPiece {
            at_ms: 0,
            quality: self.worst.unwrap_or(EnergyQuality::Unavailable),
            watts,
        })
    }

    /// The newest figures.
    pub(super) fn newest(&self) -> &PowerSnapshot {
        &self.newest
    }

    /// The pieces of the hour before now that are over, oldest first; those without a figure are left out.
    pub(super) fn slots(&self, now: &Clock) -> Vec<PowerPiece> {
        self.hour
            .read(None, now, |held, at_ms| PowerPiece { at_ms, ..held })
    }
}

#[cfg(test)]
mod tests;
