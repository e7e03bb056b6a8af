//! What is shown of the past: the last frames one by one, and the last hour in pieces. Rings whose memory is taken at the
//! start and never grows: a page that is opened now shows what happened before, and costs a node without viewers
//! nothing more.

mod growth;
mod skipping;

pub(crate) use skipping::{Estimate, SkipEstimate};

use albireo_core::policy::{CallCause, FrameState};
use albireo_wire::DetectionsMessage;
use std::collections::VecDeque;
use std::time::Duration;

/// Frames that are remembered one by one: four and a half minutes at 30 frames per second.
pub(crate) const FRAMES: usize = 8192;
/// Length of a piece of the hour, seconds.
pub(crate) const SLOT_S: u64 = 10;
/// Pieces that are remembered: an hour, and the piece that has begun.
pub(crate) const SLOTS: usize = 361;
/// Detector times of a piece that its percentiles are made of; beyond them the oldest give way.
const TIMES: usize = 1024;

/// A frame as it is remembered. What is absent is NaN: half a megabyte per camera would be twice as much otherwise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PastFrame {
    /// Sequence number.
    pub seq: u64,
    /// When it was answered, milliseconds since the node started.
    pub at_ms: u64,
    /// Its state.
    pub state: FrameState,
    /// Why the detector was called.
    pub cause: Option<CallCause>,
    /// Whether the detector was needed but not available.
    pub degraded: bool,
    /// Boxes reported.
    pub boxes: u16,
    tau_max: f32,
    threshold: f32,
    detector_ms: f32,
    total_ms: f32,
}

fn known(value: f32) -> Option<f32> {
    (!value.is_nan()).then_some(value)
}

fn kept(value: Option<f64>) -> f32 {
    value.map_or(f32::NAN, |value| value as f32)
}

impl PastFrame {
    fn of(frame: &DetectionsMessage, at: Duration) -> Self {
        Self {
            seq: frame.seq,
            at_ms: milliseconds(at),
            state: frame.state,
            cause: frame.cause,
            degraded: frame.degraded,
            boxes: u16::try_from(frame.boxes.len()).unwrap_or(u16::MAX),
            tau_max: kept(frame.tau_max),
            threshold: kept(frame.threshold.map(|threshold| threshold.value)),
            detector_ms: kept(frame.latency_ms.detector),
            total_ms: kept(Some(frame.latency_ms.total)),
        }
    }

    /// Largest uncertainty before the decision; `None` without objects.
    pub(crate) fn tau_max(&self) -> Option<f32> {
        known(self.tau_max)
    }

    /// The threshold in force.
    pub(crate) fn threshold(&self) -> Option<f32> {
        known(self.threshold)
    }

    /// Time of the detector, if it ran.
    pub(crate) fn detector_ms(&self) -> Option<f32> {
        known(self.detector_ms)
    }

    /// From reception to publication.
    pub(crate) fn total_ms(&self) -> Option<f32> {
        known(self.total_ms)
    }
}

pub(super) fn milliseconds(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// A piece of the last hour of one camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PastSlot {
    /// Its number, counted from the node's start.
    pub slot: u64,
    /// Frames processed.
    pub frames: u32,
    /// Of these, without the detector.
    pub skipped: u32,
    /// Of these, without the detector that was needed.
    pub degraded: u32,
    /// Frames that the detector was called for.
    pub calls: u32,
    /// Median time of the detector; 0 where it did not run.
    pub detector_p50_ms: f32,
    /// 99th percentile of it.
    pub detector_p99_ms: f32,
}

/// The past of one camera.
#[derive(Debug)]
pub(crate) struct History {
    frames: VecDeque<PastFrame>,
    slots: VecDeque<PastSlot>,
    open: PastSlot,
    /// Times of the detector in the open piece.
    times: Vec<f32>,
    /// How many there were.
    timed: usize,
}

impl Default for History {
    fn default() -> Self {
        Self {
            frames: VecDeque::with_capacity(FRAMES),
            slots: VecDeque::with_capacity(SLOTS),
            open: PastSlot::default(),
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
        let slot = at.as_secs() / SLOT_S;
        if slot != self.open.slot {
            let ended = self.ended();
            if ended.frames > 0 {
                if self.slots.len() == SLOTS {
                    self.slots.pop_front();
                }
                self.slots.push_back(ended);
            }
            self.open = PastSlot {
                slot,
                ..PastSlot::default()
            };
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

    /// The open piece with its percentiles.
    fn ended(&self) -> PastSlot {
        let mut sorted = self.times.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        // Nearest rank.
        let at = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100);
            let place = rank.checked_sub(1).and_then(|place| sorted.get(place));
            place.copied().unwrap_or_default()
        };
        PastSlot {
            detector_p50_ms: at(50),
            detector_p99_ms: at(99),
            ..self.open
        }
    }

    /// The last frames, oldest first, up to that many.
    pub(crate) fn frames(&self, most: usize) -> Vec<PastFrame> {
        let first = self.frames.len().saturating_sub(most);
        self.frames.iter().skip(first).copied().collect()
    }

    /// The pieces of the hour before `now`, oldest first, with the one that has begun; those without a frame are left out.
    pub(crate) fn slots(&self, now: Duration) -> Vec<PastSlot> {
        let oldest = (now.as_secs() / SLOT_S).saturating_sub(SLOTS as u64 - 1);
        let open = (self.open.frames > 0).then(|| self.ended());
        let slots = self.slots.iter().copied().chain(open);
        slots.filter(|slot| slot.slot >= oldest).collect()
    }
}

#[cfg(test)]
mod tests;
