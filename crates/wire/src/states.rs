//! Counts of frames: processed frames by state and dropped frames by kind.

use albireo_core::policy::{CallCause, FrameState};
use serde::{Deserialize, Serialize, Serializer};
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
    fn count_of(&mut self, state: FrameState) -> &mut u64 {
        match state {
            FrameState::E => &mut self.e,
            FrameState::P => &mut self.p,
            FrameState::EI => &mut self.ei,
            FrameState::I => &mut self.i,
            FrameState::AI => &mut self.ai,
        }
    }

    /// Counts one frame.
    pub fn count(&mut self, state: FrameState) {
        *self.count_of(state) += 1;
    }

    /// Returns the number of frames in `state`.
    pub fn get(mut self, state: FrameState) -> u64 {
        *self.count_of(state)
    }

    /// Returns the number of all frames: the sum of the five states. The largest number stands for all that are larger, as
    /// in a message of somebody else.
    pub fn frames(&self) -> u64 {
        let states = [self.e, self.p, self.ei, self.i, self.ai];
        states.into_iter().fold(0, u64::saturating_add)
    }

    /// Returns the number of frames that skipped the detector: state E or P without the `degraded` ones, which needed
    /// the detector while it was not available.
    pub fn skipped(&self, degraded: u64) -> u64 {
        self.e.saturating_add(self.p).saturating_sub(degraded)
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
        for state in FrameState::ALL {
            *self.count_of(state) += more.get(state);
        }
    }
}

/// Frames that called the detector, by cause. In JSON, causes that occurred with their counts; unknown causes of a
/// later version are ignored when read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(from = "BTreeMap<String, u64>")]
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

    /// True if there were no calls.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Iterates over causes and counts, in the order of [`CallCause::ALL`].
    pub fn by_cause(&self) -> impl Iterator<Item = (CallCause, u64)> + '_ {
        CallCause::ALL.into_iter().zip(self.0)
    }
}

impl Serialize for DetectorCalls {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let by_name = self
            .by_cause()
            .filter(|(_, count)| *count > 0)
            .map(|(cause, count)| (cause.as_str(), count));
        serializer.collect_map(by_name)
    }
}

impl From<BTreeMap<String, u64>> for DetectorCalls {
    fn from(counts: BTreeMap<String, u64>) -> Self {
        let count = |cause: CallCause| counts.get(cause.as_str()).copied().unwrap_or_default();
        Self(CallCause::ALL.map(count))
    }
}

impl std::ops::AddAssign<&Self> for DetectorCalls {
    fn add_assign(&mut self, more: &Self) {
        for (count, more) in self.0.iter_mut().zip(more.0) {
            *count += more;
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

/// Why a frame was not processed: a field of [`DroppedFrames`] each, where it is described.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the fields of `DroppedFrames` say it")]
pub enum DropKind {
    Lost,
    Overrun,
    Late,
    Stray,
    Duplicate,
    Undecodable,
    Oversized,
    UnknownFormat,
    Stopped,
}

impl DropKind {
    /// All kinds, in the order of the fields.
    pub const ALL: [Self; 9] = [
        Self::Lost,
        Self::Overrun,
        Self::Late,
        Self::Stray,
        Self::Duplicate,
        Self::Undecodable,
        Self::Oversized,
        Self::UnknownFormat,
        Self::Stopped,
    ];

    /// The name of its field.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lost => "lost",
            Self::Overrun => "overrun",
            Self::Late => "late",
            Self::Stray => "stray",
            Self::Duplicate => "duplicate",
            Self::Undecodable => "undecodable",
            Self::Oversized => "oversized",
            Self::UnknownFormat => "unknown_format",
            Self::Stopped => "stopped",
        }
    }

    /// True if the frame arrived and is no usable picture: a fault of its sender.
    pub const fn is_unusable(self) -> bool {
        matches!(
            self,
            Self::Undecodable | Self::Oversized | Self::UnknownFormat
        )
    }
}

impl DroppedFrames {
    fn count_of(&mut self, kind: DropKind) -> &mut u64 {
        match kind {
            DropKind::Lost => &mut self.lost,
            DropKind::Overrun => &mut self.overrun,
            DropKind::Late => &mut self.late,
            DropKind::Stray => &mut self.stray,
            DropKind::Duplicate => &mut self.duplicate,
            DropKind::Undecodable => &mut self.undecodable,
            DropKind::Oversized => &mut self.oversized,
            DropKind::UnknownFormat => &mut self.unknown_format,
            DropKind::Stopped => &mut self.stopped,
        }
    }

    /// Counts `number` frames of that kind.
    pub fn add(&mut self, kind: DropKind, number: u64) {
        *self.count_of(kind) += number;
    }

    /// Returns the number of frames of that kind.
    pub fn get(mut self, kind: DropKind) -> u64 {
        *self.count_of(kind)
    }

    /// Returns names and counts, in the order of the fields.
    pub fn by_kind(self) -> [(&'static str, u64); 9] {
        DropKind::ALL.map(|kind| (kind.name(), self.get(kind)))
    }

    /// Returns the number of all dropped frames.
    pub fn total(&self) -> u64 {
        self.by_kind().iter().map(|(_, count)| count).sum()
    }
}

impl std::ops::AddAssign<&Self> for DroppedFrames {
    fn add_assign(&mut self, more: &Self) {
        for kind in DropKind::ALL {
            self.add(kind, more.get(kind));
        }
    }
}
