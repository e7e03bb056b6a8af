//! The report of one clip: frames, latencies, energy.

use crate::{
    AuditReport, ClipTravel, DroppedFrames, FrameStates, Target, Threshold, ThresholdChange,
};
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;
use uuid::Uuid;

/// Mean and percentiles of a set of durations, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Percentiles {
    /// Number of durations.
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

/// The quality of an energy figure, from the most to the least reliable.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum EnergyQuality {
    /// Read from a meter over the whole clip.
    Measured,
    /// Read from a meter, but samples are missing for parts of the clip (`coverage`), or a part of the machine that
    /// consumes much is not read (`total_from` names it).
    Partial,
    /// Computed from utilisation without a meter.
    Estimated,
    /// No figure, or a quality that only a later version knows.
    #[default]
    #[serde(other)]
    Unavailable,
}

impl EnergyQuality {
    /// The word for it, as on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Partial => "partial",
            Self::Estimated => "estimated",
            Self::Unavailable => "unavailable",
        }
    }
}

/// The smallest share of a clip's time that counts as full coverage by samples.
pub const FULL_COVERAGE: f64 = 0.999;

/// Energy of one domain of the board.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DomainEnergy {
    /// `total`, `gpu`, `cpu`, `io_mem`.
    pub domain: String,
    /// Joules over the time covered by samples.
    pub joules: f64,
    /// Mean power over the time covered by samples, watts.
    pub mean_watts: f64,
    /// Highest sample, watts; if the source counts energy, the highest mean between two samples. Absent without a
    /// sample inside the clip.
    pub peak_watts: Option<f64>,
}

/// Energy of one clip.
///
/// Joules count only the time covered by samples; `coverage` is its share of the clip. They are never extrapolated, so
/// with a coverage below [`FULL_COVERAGE`] (0.999) they are less than the clip used: do not compare them with other
/// joules or divide them by the clip's duration. `edp` is then absent.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClipEnergy {
    /// The clip's energy, joules: its share of `node_joules` by detector time used for its camera; absent if
    /// [`EnergyQuality::Unavailable`].
    pub joules: Option<f64>,
    /// Energy of the whole node over the same time, joules, including this clip's share `joules`. Equal to `joules` if
    /// the node has one camera.
    pub node_joules: Option<f64>,
    /// Estimated joules that this clip's avoided detector calls would have added: their run time, at most the
    /// detector's idle time, times the watts that a running detector adds on this machine. Absent until those watts are
    /// known.
    pub saved_joules_estimated: Option<f64>,
    /// Energy-delay product, J·ms/frame: clip energy × clip duration ÷ frames (paper, evaluation). Absent without
    /// frames and if samples do not cover the whole clip (`coverage` below 0.999).
    pub edp: Option<f64>,
    /// Quality of the figures.
    pub quality: EnergyQuality,
    /// Source of the figures: `rapl`, `estimate`, …
    pub source: String,
    /// What `joules` of the total domain includes: `input_rail` for the whole machine, `sum_of_rails` of a board, the
    /// parts in words (`processor + card`; `processor, without card`), or the estimate's formula.
    pub total_from: String,
    /// Number of samples inside the clip.
    pub samples: u64,
    /// Share of the clip's time covered by samples, 0 to 1.
    pub coverage: f64,
    /// Energy of the node by domain.
    pub domains: Vec<DomainEnergy>,
}

impl ClipEnergy {
    /// True if samples cover the whole clip, so that its joules are complete.
    pub fn is_whole(&self) -> bool {
        self.coverage >= FULL_COVERAGE
    }

    /// Returns the clip's joules if they are complete.
    pub fn whole_joules(&self) -> Option<f64> {
        if self.is_whole() { self.joules } else { None }
    }
}

/// The reason why a clip ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClipEnd {
    /// The camera started another clip.
    NextClip,
    /// The time window was full.
    Window,
    /// No frame arrived for a while.
    Silence,
    /// The node stopped.
    Shutdown,
    /// It reached the maximum length of one report (`clip.longest_s`); the next part follows.
    Length,
    /// The policy was switched; the next part, or the next window, has the frames of the other policy.
    Policy,
    /// A reason that only a later version knows.
    #[default]
    #[serde(other)]
    Other,
}

/// The report of one clip.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClipReport {
    /// Version of the message.
    pub v: u32,
    /// Id, a UUID of version 7 from the node's clock; it never changes.
    #[schema(value_type = String, format = "uuid")]
    pub id: Uuid,
    /// Name of the node.
    pub node: String,
    /// Name of the camera.
    pub camera: String,
    /// Clip id: the camera's own, or `window-N`.
    pub clip: String,
    /// Part number, from 0: a long clip is reported in parts, and so is one in which the policy was switched.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub part: u32,
    /// Running number of the node's reports: gaps show how many are missing. Absent if the node could not read the last
    /// number. The id does not depend on it.
    pub count: Option<u64>,
    /// The reason why the clip ended.
    pub ended_by: ClipEnd,
    /// Capture time of the first frame, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// Seconds from the first frame's arrival to the clip's end.
    pub duration_s: f64,
    /// Frames processed: the sum of the five states.
    pub frames: u64,
    /// Frames in each of the five states.
    pub states: FrameStates,
    /// Share of frames that skipped the detector: state E or P and not degraded.
    pub skip_rate: f64,
    /// Frames answered by prediction because the detector was not available: state P, not counted as skipped.
    pub degraded_frames: u64,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Name of the policy.
    pub policy: String,
    /// Threshold at the end of the clip; absent if the policy has none.
    pub threshold: Option<Threshold>,
    /// All thresholds in force during the clip, in order: the initial one, then the changes.
    pub threshold_changes: Vec<ThresholdChange>,
    /// The target that moves the threshold; absent without one.
    // A kind that only a later version knows reads as none, so that its report is still stored.
    #[serde(default, with = "serde_with::As::<serde_with::DefaultOnError>")]
    pub target: Option<Target>,
    /// File name of the detector model.
    pub model: String,
    /// Execution provider that ran the model.
    pub provider: String,
    /// Latency from reception until the answer is handed to Zenoh.
    pub total_latency_ms: Percentiles,
    /// Latency of the detector alone, over the frames on which it ran.
    pub detector_latency_ms: Percentiles,
    /// Detector run time for this clip's frames, milliseconds, excluding waiting and the audit. The time of a batched
    /// run is divided evenly among its pictures.
    #[serde(default)]
    pub detector_used_ms: f64,
    /// Energy that the clip used, as far as a meter or an estimate knows it.
    pub energy: ClipEnergy,
    /// The state of the board during the clip; absent if the board does not report it.
    pub board: Option<BoardState>,
    /// The results of the audit on skipped frames; absent without an audit.
    pub audit: Option<AuditReport>,
    /// The clip's way; absent if no position is known.
    pub travel: Option<ClipTravel>,
}

// By reference, as `skip_serializing_if` calls it.
const fn is_zero(number: &u32) -> bool {
    *number == 0
}

/// The state of the board during a clip, as far as the board reports it. A clip's energy depends on it.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct BoardState {
    /// Power mode: its `nvpmodel` name, else the ACPI platform profile. If it changed, all modes in order.
    pub power_mode: Option<String>,
    /// Highest temperature of any sensor, °C.
    pub hottest_celsius: Option<f64>,
    /// The sensor with the highest temperature.
    pub hottest_sensor: Option<String>,
    /// True if heat, current or power throttled the clocks at any time; absent if the board does not report it.
    pub throttled: Option<bool>,
    /// Mean clock of the CPU cores, MHz.
    pub cpu_mhz: Option<f64>,
    /// Mean clock of the GPU, MHz.
    pub gpu_mhz: Option<f64>,
    /// Mean share of the time in which the GPU was busy, 0 to 1; of several, the busiest.
    pub gpu_utilisation: Option<f64>,
}

impl ClipReport {
    /// Rounds what clips are summed by (energies, times, shares, distances) to six significant digits, and what is only
    /// read (latencies, watts, speed, an audit's energy) to four. Further digits are noise that compresses badly.
    pub fn round(&mut self) {
        let six = |value: &mut f64| *value = significant(*value, 6);
        let four = |value: &mut f64| *value = significant(*value, 4);
        six(&mut self.detector_used_ms);
        six(&mut self.duration_s);
        six(&mut self.skip_rate);
        let energy = &mut self.energy;
        six(&mut energy.coverage);
        let known_energy = [
            &mut energy.joules,
            &mut energy.node_joules,
            &mut energy.saved_joules_estimated,
            &mut energy.edp,
        ];
        for figure in known_energy.into_iter().flatten() {
            six(figure);
        }
        for domain in &mut energy.domains {
            six(&mut domain.joules);
            four(&mut domain.mean_watts);
            if let Some(watts) = &mut domain.peak_watts {
                four(watts);
            }
        }
        for latency in [&mut self.total_latency_ms, &mut self.detector_latency_ms] {
            four(&mut latency.mean);
            four(&mut latency.p50);
            four(&mut latency.p95);
            four(&mut latency.p99);
        }
        if let Some(audit) = &mut self.audit
            && let Some(joules) = &mut audit.joules
        {
            four(joules);
        }
        if let Some(travel) = &mut self.travel {
            six(&mut travel.distance_m);
            if let Some(fastest) = &mut travel.fastest_m_s {
                four(fastest);
            }
        }
    }
}

/// Rounds a number for messages to `digits` significant digits.
pub fn significant(value: f64, digits: usize) -> f64 {
    // By way of decimal text: a product of powers of ten would leave binary digits that JSON writes out in full.
    let decimals = digits.saturating_sub(1);
    let text = format!("{value:.decimals$e}");
    text.parse().unwrap_or(value)
}
