//! Counts of frames: processed frames by state and dropped frames by kind.

use albireo_core::policy::{CallCause, FrameState};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Number of frames in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FrameStates {
    /// The screen reported "empty"; the detector was skipped.
    #[serde(rename = "E")]
    pub e: u64,
    /// The boxes are predicted; the detector was skipped.
    #[serde(rename = "P")]
    pub p: u64,
    /// The screen reported "not empty"; the detector ran.
    #[serde(rename = "E+I")]
    pub ei: u64,
    /// The detector ran.
    #[serde(rename = "I")]
    pub i: u64,
    /// The detector ran, and at least one object was rescued.
    #[serde(rename = "AI")]
    pub ai: u64,
}

impl FrameStates {
    /// Counts one frame.
    pub fn count(&mut self, state: FrameState) {
        match state {
            FrameState::E => self.e += 1,
            FrameState::P => self.p += 1,
            FrameState::EI => self.ei += 1,
            FrameState::I => self.i += 1,
            FrameState::AI => self.ai += 1,
        }
    }

    /// Returns the number of frames in `state`.
    pub fn get(&self, state: FrameState) -> u64 {
        match state {
            FrameState::E => self.e,
            FrameState::P => self.p,
            FrameState::EI => self.ei,
            FrameState::I => self.i,
            FrameState::AI => self.ai,
        }
    }

    /// Returns the number of all frames: the sum of the five states.
    pub fn frames(&self) -> u64 {
        self.e + self.p + self.ei + self.i + self.ai
    }

    /// Returns the number of frames that skipped the detector: state E or P without the `degraded` ones, which needed
    /// the detector while it was not available.
    pub fn skipped(&self, degraded: u64) -> u64 {
        (self.e + self.p).saturating_sub(degraded)
    }

    /// Returns the share of frames that [`skipped`](Self::skipped) the detector; 0 without frames.
    pub fn skip_rate(&self, degraded: u64) -> f64 {
        match self.frames() {
            0 => 0.0,
            frames => self.skipped(degraded) as f64 / frames as f64,
        }
    }
}

impl std::ops::AddAssign for FrameStates {
    fn add_assign(&mut self, more: Self) {
        self.e += more.e;
        self.p += more.p;
        self.ei += more.ei;
        self.i += more.i;
        self.ai += more.ai;
    }
}

/// Frames that called the detector, by cause. In JSON, causes that occurred with their counts; unknown causes of a
/// later version are ignored when read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DetectorCalls([u64; CallCause::ALL.len()]);

impl DetectorCalls {
    /// Counts one call.
    pub fn count(&mut self, cause: CallCause) {
        if let Some(count) = self.0.get_mut(cause as usize) {
            *count += 1;
        }
    }

    /// Returns the number of calls with `cause`.
    pub fn get(&self, cause: CallCause) -> u64 {
        self.0.get(cause as usize).copied().unwrap_or_default()
    }

    /// Returns the number of all calls.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// True if there were no calls.
    pub fn is_empty(&self) -> bool {
        self.total() == 0
    }

    /// Iterates over causes and counts, in the order of [`CallCause::ALL`].
    pub fn by_cause(&self) -> impl Iterator<Item = (CallCause, u64)> + '_ {
        CallCause::ALL.into_iter().zip(self.0)
    }
}

impl Serialize for DetectorCalls {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let some = self.by_cause().filter(|(_, count)| *count > 0);
        serializer.collect_map(some.map(|(cause, count)| (cause.as_str(), count)))
    }
}

impl<'de> Deserialize<'de> for DetectorCalls {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let counts = BTreeMap::<String, u64>::deserialize(deserializer)?;
        let mut calls = Self::default();
        for (place, cause) in calls.0.iter_mut().zip(CallCause::ALL) {
            *place = counts.get(cause.as_str()).copied().unwrap_or_default();
        }
        Ok(calls)
    }
}

impl std::ops::AddAssign<&Self> for DetectorCalls {
    fn add_assign(&mut self, more: &Self) {
        for (place, more) in self.0.iter_mut().zip(more.0) {
            *place += more;
        }
    }
}

/// Frames that were not processed, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct DroppedFrames {
    /// Never arrived: missing sequence numbers.
    pub lost: u64,
    /// Replaced in the ring by a newer frame before their turn.
    pub overrun: u64,
    /// Arrived after a later frame; first counted as lost.
    pub late: u64,
    /// From a stream other than the camera's current one: another publisher, or a distant sequence number.
    pub stray: u64,
    /// Arrived again with the same sequence number.
    pub duplicate: u64,
    /// The picture cannot be decoded or contradicts its header.
    pub undecodable: u64,
    /// The size of payload, picture or decompressed data exceeds the limit.
    pub oversized: u64,
    /// The payload encoding is unknown, or the attachment is unreadable.
    pub unknown_format: u64,
    /// Arrived or waited while the camera's loop was not running, after a failure or during shutdown.
    pub stopped: u64,
}

impl DroppedFrames {
    /// Returns names and counts, in the order of the fields.
    pub fn by_kind(&self) -> [(&'static str, u64); 9] {
        [
            ("lost", self.lost),
            ("overrun", self.overrun),
            ("late", self.late),
            ("stray", self.stray),
            ("duplicate", self.duplicate),
            ("undecodable", self.undecodable),
            ("oversized", self.oversized),
            ("unknown_format", self.unknown_format),
            ("stopped", self.stopped),
        ]
    }

    /// Returns the number of all dropped frames.
    pub fn total(&self) -> u64 {
        self.by_kind().iter().map(|(_, n)| n).sum()
    }
}

impl std::ops::AddAssign<&Self> for DroppedFrames {
    fn add_assign(&mut self, more: &Self) {
        self.lost += more.lost;
        self.overrun += more.overrun;
        self.late += more.late;
        self.stray += more.stray;
        self.duplicate += more.duplicate;
        self.undecodable += more.undecodable;
        self.oversized += more.oversized;
        self.unknown_format += more.unknown_format;
        self.stopped += more.stopped;
    }
}
