//! The JSON messages. Every one carries `v`, its version; an unknown version is refused.

use super::knob::{KnobChange, KnobValue};
use albireo_core::detection::ObjectId;
use albireo_core::policy::{BoxSource, FrameState};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The version this program writes and reads.
pub const VERSION: u32 = 1;

/// Why a message cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Not the JSON expected.
    #[error("not a valid message: {0}")]
    Malformed(#[from] serde_json::Error),
    /// A version this program does not know.
    #[error("message version {found} is not known here; this program reads version {VERSION}")]
    Version {
        /// The version found.
        found: u32,
    },
}

/// Reads a message of any type of this module after checking its version.
///
/// # Errors
/// [`MessageError`] when the bytes are not JSON, have no `v`, have another version, or lack a field.
pub fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, MessageError> {
    #[derive(Deserialize)]
    struct Versioned {
        v: u32,
    }
    let Versioned { v } = serde_json::from_slice(bytes)?;
    if v != VERSION {
        return Err(MessageError::Version { found: v });
    }
    Ok(serde_json::from_slice(bytes)?)
}

/// What a camera may say about a frame, in the attachment of its sample.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FrameAttachment {
    /// Version.
    pub v: u32,
    /// Sequence number, one more for each frame. Without it frames are numbered by arrival.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seq: Option<u64>,
    /// Capture time, nanoseconds since the Unix epoch. Without it the sample's timestamp counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_ns: Option<u64>,
    /// Clip the frame belongs to. Without it clips are fixed time windows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<String>,
    /// Columns of a raw picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Rows of a raw picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
}

/// One box of a [`DetectionsMessage`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BoxMessage {
    /// Left, top, right, bottom in pixels of the source picture, clipped to it.
    #[serde(rename = "box")]
    pub corners: [f32; 4],
    /// Class name.
    pub class: String,
    /// Confidence, 0 to 1.
    pub confidence: f32,
    /// How the box is known.
    pub source: BoxSource,
    /// Object the box belongs to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<ObjectId>,
    /// Whether that object is confirmed.
    pub confirmed: bool,
}

/// Where the time of one frame went, milliseconds. A step that did not happen is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Latency {
    /// From reception to publication.
    pub total: f64,
    /// Waiting in the ring before the camera's loop took the frame.
    pub waiting: f64,
    /// Picture decoding.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decode: Option<f64>,
    /// The empty-scene screen, with its preprocessing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub screen: Option<f64>,
    /// The detector: queue, letterbox, model and head.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detector: Option<f64>,
    /// The policy itself.
    pub policy: f64,
}

/// What was found in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DetectionsMessage {
    /// Version.
    pub v: u32,
    /// Sequence number of the frame.
    pub seq: u64,
    /// Capture time, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Clip the frame belongs to.
    pub clip: String,
    /// Frame state.
    pub state: FrameState,
    /// The detector was needed but could not be had; the boxes are predictions.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub degraded: bool,
    /// Largest uncertainty τ before the decision; absent without objects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tau_max: Option<f64>,
    /// Threshold `u` in force, or the policy's own knob under its own name; absent when the policy has none.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    pub knob: Option<KnobValue>,
    /// Columns of the picture.
    pub width: u32,
    /// Rows of the picture.
    pub height: u32,
    /// What is in view.
    pub boxes: Vec<BoxMessage>,
    /// Where the time went.
    pub latency_ms: Latency,
}

/// How many frames had each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FrameStates {
    /// Screen says empty, detector skipped.
    #[serde(rename = "E")]
    pub e: u64,
    /// Predicted boxes, detector skipped.
    #[serde(rename = "P")]
    pub p: u64,
    /// Screen, then detector.
    #[serde(rename = "E+I")]
    pub ei: u64,
    /// Detector.
    #[serde(rename = "I")]
    pub i: u64,
    /// Detector with at least one rescue.
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

    /// The number of frames with `state`.
    pub fn get(&self, state: FrameState) -> u64 {
        match state {
            FrameState::E => self.e,
            FrameState::P => self.p,
            FrameState::EI => self.ei,
            FrameState::I => self.i,
            FrameState::AI => self.ai,
        }
    }

    /// All frames: the five add up to it.
    pub fn frames(&self) -> u64 {
        self.e + self.p + self.ei + self.i + self.ai
    }

    /// Share of frames that skipped the detector; 0 without frames.
    pub fn skip_rate(&self) -> f64 {
        match self.frames() {
            0 => 0.0,
            frames => (self.e + self.p) as f64 / frames as f64,
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

/// Frames that were not processed, each kind under its own name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct DroppedFrames {
    /// Never arrived: numbers missing in the sequence.
    pub lost: u64,
    /// Pushed out of the ring by a newer one before its turn.
    pub overrun: u64,
    /// Arrived after a later frame; it had been counted as lost when the later one came.
    pub late: u64,
    /// Arrived again with the same sequence number.
    pub duplicate: u64,
    /// The picture could not be decoded, or contradicts its own header.
    pub undecodable: u64,
    /// Payload, picture or decompressed size above the limit.
    pub oversized: u64,
    /// A payload encoding that is not known, or an attachment that cannot be read.
    pub unknown_format: u64,
}

impl DroppedFrames {
    /// Names and numbers, in the order of the fields.
    pub fn by_kind(&self) -> [(&'static str, u64); 7] {
        [
            ("lost", self.lost),
            ("overrun", self.overrun),
            ("late", self.late),
            ("duplicate", self.duplicate),
            ("undecodable", self.undecodable),
            ("oversized", self.oversized),
            ("unknown_format", self.unknown_format),
        ]
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        self.by_kind().iter().map(|(_, n)| n).sum()
    }
}

impl std::ops::AddAssign<&Self> for DroppedFrames {
    fn add_assign(&mut self, more: &Self) {
        self.lost += more.lost;
        self.overrun += more.overrun;
        self.late += more.late;
        self.duplicate += more.duplicate;
        self.undecodable += more.undecodable;
        self.oversized += more.oversized;
        self.unknown_format += more.unknown_format;
    }
}

/// Middle and tail of a set of durations, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Percentiles {
    /// How many durations.
    pub count: u64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// How far an energy figure can be trusted; the order is from most to least.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EnergyQuality {
    /// Read from a meter over the whole clip.
    Measured,
    /// Read from a meter, but parts of the clip have no samples.
    Partial,
    /// Computed from utilisation; no meter was read.
    Estimated,
    /// No figure at all.
    Unavailable,
}

/// Energy of one domain of the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DomainEnergy {
    /// `total`, `gpu`, `cpu`, `io_mem`.
    pub domain: String,
    /// Joules.
    pub joules: f64,
    /// Mean power, watts.
    pub mean_watts: f64,
    /// Highest sample, watts; where the source counts energy, the highest mean between two samples. Absent
    /// without a sample inside the clip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_watts: Option<f64>,
}

/// Energy of one clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClipEnergy {
    /// Joules of this clip; absent when [`EnergyQuality::Unavailable`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joules: Option<f64>,
    /// Joules of the whole node over the same time, of which `joules` is the clip's share. The same
    /// number when the node has one camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node_joules: Option<f64>,
    /// Energy-delay product, J·ms/frame: clip energy × clip duration ÷ frames (paper, evaluation).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edp: Option<f64>,
    /// How far to trust it.
    pub quality: EnergyQuality,
    /// Where it comes from: `rapl`, `estimate`, …
    pub source: String,
    /// How `joules` of the total domain came about: `input_rail` or `sum_of_rails`, or the estimate's
    /// formula in words.
    pub total_from: String,
    /// Samples inside the clip.
    pub samples: u64,
    /// Share of the clip's time that samples cover, 0 to 1.
    pub coverage: f64,
    /// Node energy by domain.
    pub domains: Vec<DomainEnergy>,
}

/// Why a clip ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClipEnd {
    /// The camera began another clip.
    NextClip,
    /// The time window was full.
    Window,
    /// No frame came for a while.
    Silence,
    /// The node stopped.
    Shutdown,
}

/// The books of one clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClipReport {
    /// Version.
    pub v: u32,
    /// Node.
    pub node: String,
    /// Camera.
    pub camera: String,
    /// Clip id: the camera's own, or `window-N`.
    pub clip: String,
    /// Number of this report within the node's life, from 0: with `node` and `started_ns` it tells two
    /// deliveries of the same report from two reports.
    pub report: u64,
    /// Why it ended.
    pub ended_by: ClipEnd,
    /// First frame's capture time, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// Seconds from the first frame's arrival to the clip's end.
    pub duration_s: f64,
    /// Frames processed; the five states add up to it.
    pub frames: u64,
    /// Frame states.
    pub states: FrameStates,
    /// Share of frames with state E or P.
    pub skip_rate: f64,
    /// Frames answered from prediction because the detector could not be had.
    pub degraded_frames: u64,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Policy.
    pub policy: String,
    /// Threshold at the end of the clip, under the knob's name; absent when the policy has none.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    pub knob: Option<KnobValue>,
    /// Every value in force during the clip, in order: the one at the start, then the changes.
    pub knob_changes: Vec<KnobChange>,
    /// Detector model: file name.
    pub model: String,
    /// Execution provider that really ran it.
    pub provider: String,
    /// Latency from reception to publication.
    pub total_latency_ms: Percentiles,
    /// Latency of the detector alone, over the frames where it ran.
    pub detector_latency_ms: Percentiles,
    /// Energy.
    pub energy: ClipEnergy,
    /// The state of the board during the clip; absent where the board tells nothing of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<BoardState>,
}

/// The state of the board during a clip, as far as the board tells: the same clip costs differently in
/// each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct BoardState {
    /// Power mode: `nvpmodel`'s name for it, else the platform profile of ACPI. Several, in order, when it
    /// changed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power_mode: Option<String>,
    /// Highest temperature of any sensor, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hottest_celsius: Option<f64>,
    /// The sensor that read it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hottest_sensor: Option<String>,
    /// Whether clocks were held back by heat, current or power at any time; absent when nothing tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub throttled: Option<bool>,
    /// Mean clock of the CPU cores, MHz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu_mhz: Option<f64>,
    /// Mean clock of the GPU, MHz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpu_mhz: Option<f64>,
}

/// Where a camera stands, once a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CountersMessage {
    /// Version.
    pub v: u32,
    /// When, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Camera.
    pub camera: String,
    /// Frames processed since the node started.
    pub frames: u64,
    /// Frame states since the node started.
    pub states: FrameStates,
    /// Skip rate since the node started.
    pub skip_rate: f64,
    /// Frames answered from prediction because the detector could not be had.
    pub degraded_frames: u64,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Threshold in force, under the knob's name; absent when the policy has none.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    pub knob: Option<KnobValue>,
    /// Power now by domain, watts; empty without a source.
    pub watts: Vec<DomainWatts>,
    /// How far to trust the watts.
    pub power_quality: EnergyQuality,
}

/// Power of one domain now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DomainWatts {
    /// `total`, `gpu`, `cpu`, `io_mem`.
    pub domain: String,
    /// Watts.
    pub watts: f64,
}

pub(super) const fn current_version() -> u32 {
    VERSION
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_version_is_refused_by_name() {
        let error = read::<FrameAttachment>(br#"{"v":9,"seq":1}"#).unwrap_err();
        assert_eq!(
            error.to_string(),
            "message version 9 is not known here; this program reads version 1"
        );
        assert!(read::<FrameAttachment>(br#"{"seq":1}"#).is_err());
        assert!(read::<FrameAttachment>(b"\xff").is_err());
    }

    #[test]
    fn the_five_states_add_up() {
        let mut states = FrameStates::default();
        for state in FrameState::ALL {
            states.count(state);
            assert_eq!(states.get(state), 1);
        }
        assert_eq!(states.frames(), 5);
        assert!((states.skip_rate() - 0.4).abs() < 1e-12);
    }
}
