//! Defines a run of one clip under one policy, and the setup in which runs were measured.

use albireo_wire::{ClipReport, EnergyQuality, FrameStates};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What all runs of a file have in common. Runs of different setups are never averaged together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// The detector's file name without its ending.
    pub detector: String,
    /// CRC-32 and length of the detector's file; empty for published rows, which do not have it.
    #[serde(default)]
    pub detector_checksum: String,
    /// The detector's precision, such as `fp16`; `as exported` if nobody said.
    pub precision: String,
    /// The machine's power mode; empty if it has none or does not tell.
    pub power_mode: String,
    /// The machine's name.
    pub machine: String,
    /// The execution provider of ONNX Runtime.
    #[serde(default)]
    pub provider: String,
    /// How frames arrived: `unpaced`, each as soon as the node had taken the last one, or `paced`, at the clip's rate.
    #[serde(default)]
    pub pace: String,
    /// What the boxes were judged by.
    #[serde(default)]
    pub truth: String,
}

impl Setup {
    /// What names the setup, as far as it is known: detector, precision, power mode and machine.
    fn names(&self) -> impl Iterator<Item = &str> {
        let names = [
            &self.detector,
            &self.precision,
            &self.power_mode,
            &self.machine,
        ];
        names.into_iter().map(String::as_str).filter(|name| !name.is_empty())
    }

    /// Names the setup in tables.
    pub fn title(&self) -> String {
        self.names().collect::<Vec<_>>().join(", ")
    }

    /// Names the parts in which a setup of the same machine differs: `yolo26x: MAXN → 15W`.
    pub(super) fn change_to(&self, other: &Self) -> String {
        let parts = |setup: &Self| {
            [
                &setup.detector,
                &setup.precision,
                &setup.power_mode,
                &setup.provider,
                &setup.pace,
                &setup.truth,
            ]
            .map(String::clone)
        };
        let pairs = parts(self).into_iter().zip(parts(other));
        let differing = pairs.filter(|(own, others)| own != others);
        let changes: Vec<String> =
            differing.map(|(own, others)| format!("{own} → {others}")).collect();
        let detector = Some(&self.detector).filter(|own| **own == other.detector);
        let of = detector.map_or_else(String::new, |detector| format!("{detector}: "));
        format!("{of}{}", changes.join(", "))
    }

    /// Names the file of the setup's runs.
    pub fn file_name(&self) -> String {
        let kept = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        let plain = self.names().map(|name| name.replace(|c: char| !kept(c), "-"));
        format!("{}.jsonl", plain.collect::<Vec<_>>().join("."))
    }

    /// Describes the first difference to `other` in words, if there is one.
    pub(super) fn difference(&self, other: &Self) -> Option<String> {
        let parts = |setup: &Self| {
            [
                ("detector", setup.detector.clone()),
                ("checksum of the detector", setup.detector_checksum.clone()),
                ("precision", setup.precision.clone()),
                ("power mode", setup.power_mode.clone()),
                ("machine", setup.machine.clone()),
                ("execution provider", setup.provider.clone()),
                ("pace", setup.pace.clone()),
                ("ground truth", setup.truth.clone()),
            ]
        };
        let mut both = parts(self).into_iter().zip(parts(other));
        let ((name, own), (_, others)) = both.find(|((_, own), (_, others))| own != others)?;
        Some(format!("its {name} was `{own}`, and now it is `{others}`"))
    }
}

/// The figures of one clip under one policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClipRun {
    /// The clip's name.
    pub clip: String,
    /// The policy's label.
    pub policy: String,
    /// Frames answered.
    pub frames: u64,
    /// Frames that the node did not take.
    #[serde(default)]
    pub dropped: u64,
    /// Frames that nobody labelled: they are not judged, and count for everything else.
    #[serde(default)]
    pub unlabelled: u64,
    /// Frames in each state.
    pub states: FrameStates,
    /// Frames that needed the detector and did not get it.
    #[serde(default)]
    pub degraded: u64,
    /// Detector calls.
    pub detector_calls: u64,
    /// Seconds from the first frame's arrival to the last answer.
    pub duration_s: f64,
    /// Mean time of a frame until its answer, milliseconds.
    pub frame_ms: f64,
    /// AP@50 of the published boxes against the ground truth, 0 to 1; absent if the clip's truth has no box.
    pub ap50: Option<f64>,
    /// mAP@50:95, likewise.
    pub map: Option<f64>,
    /// Energy of the whole machine or of what its meter covers, joules; absent without a meter or if samples do not cover
    /// the run.
    pub joules: Option<f64>,
    /// Energy by domain of the machine, joules.
    #[serde(default)]
    pub domains: BTreeMap<String, f64>,
    /// True if the joules are estimated from utilisation and not measured.
    #[serde(default)]
    pub estimated: bool,
    /// What the joules include: `input_rail`, `processor + card`, …
    #[serde(default)]
    pub energy_of: String,
    /// Processor time of the program, seconds.
    #[serde(default)]
    pub cpu_s: Option<f64>,
    /// Share of the time in which the GPU was busy, 0 to 1; absent where nothing reads it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu_utilisation: Option<f64>,
    /// The most memory that the program held, MB. It is that of all runs' program, which keeps what an earlier run took.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_mb: Option<f64>,
    /// The machine's power every 100 ms, by domain: seconds since the first frame, and watts. Kept of the first two clips.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub traces: BTreeMap<String, Vec<[f64; 2]>>,
    /// True if the machine reported throttled clocks.
    #[serde(default)]
    pub throttled: bool,
}

/// The number of clips of which the power trace is kept.
pub const TRACED_CLIPS: usize = 2;

impl ClipRun {
    /// Takes from the node's report what it has; accuracy, times and memory of the program are the caller's.
    pub fn of(report: &ClipReport, clip: &str, policy: &str) -> Self {
        let energy = &report.energy;
        let joules = energy.whole_joules();
        let domains = energy.domains.iter().filter(|_| joules.is_some());
        Self {
            clip: clip.to_owned(),
            policy: policy.to_owned(),
            frames: report.frames,
            dropped: report.dropped.total(),
            unlabelled: 0,
            states: report.states,
            degraded: report.degraded_frames,
            detector_calls: report.detector_latency_ms.count,
            duration_s: report.duration_s,
            frame_ms: report.total_latency_ms.mean,
            ap50: None,
            map: None,
            joules,
            domains: domains.map(|domain| (domain.domain.clone(), domain.joules)).collect(),
            estimated: energy.quality == EnergyQuality::Estimated,
            energy_of: energy.total_from.clone(),
            cpu_s: None,
            gpu_utilisation: report.board.as_ref().and_then(|board| board.gpu_utilisation),
            memory_mb: None,
            traces: BTreeMap::new(),
            throttled: report.board.as_ref().is_some_and(|board| board.throttled == Some(true)),
        }
    }

    /// Share of frames that skipped the detector, without degraded ones.
    pub fn skip_rate(&self) -> f64 {
        self.states.skip_rate(self.degraded)
    }

    /// Processor cores that the program kept busy.
    pub fn cores(&self) -> Option<f64> {
        Some(self.cpu_s? / self.duration_s).filter(|cores| cores.is_finite())
    }

    /// Energy-delay product by the paper's definition, joules times duration over frames, J·ms/frame.
    pub fn edp(&self) -> Option<f64> {
        Some(self.joules? * self.duration_s * 1e3 / self.frames.max(1) as f64)
    }
}

/// The runs of a setup.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupRuns {
    /// The setup.
    pub setup: Setup,
    /// Its runs.
    pub runs: Vec<ClipRun>,
}
