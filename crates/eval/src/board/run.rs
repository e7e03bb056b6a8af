//! Defines a run of one clip under one policy, and the setup in which runs were measured.

use albireo_core::policy::FrameState;
use albireo_wire::{ClipReport, EnergyQuality, FrameStates};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// What all runs of a file have in common. Runs of different setups are never averaged together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// The detector's file name without its ending.
    pub detector: String,
    /// The detector's precision, such as `fp16`; `as exported` if nobody said.
    pub precision: String,
    /// The machine's power mode; empty if it has none or does not tell.
    pub power_mode: String,
    /// The machine's name.
    pub machine: String,
    /// Everything else that can change a run, by key: versions, digests of the models, and each setting of the node.
    /// Published rows have only [`FRAMES`] and [`JUDGED_BY`].
    #[serde(default)]
    pub settings: BTreeMap<String, String>,
}

/// The setting that tells how frames arrived: `unpaced`, each as soon as the node had taken the last one, or `paced`,
/// at the clip's rate.
pub const FRAMES: &str = "frames";

/// The setting that tells the layout of the ground truth, and the rules.
pub const JUDGED_BY: &str = "judged by";

/// What a setting that has no value is called in sentences.
const UNSET: &str = "not set";

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

    /// Names the setup in sentences.
    pub fn title(&self) -> String {
        self.names().collect::<Vec<_>>().join(", ")
    }

    /// Names the setup in tables and figures of `setups`. One of the same title adds the settings that differ.
    pub(super) fn title_among(&self, setups: &[SetupRuns]) -> String {
        let title = self.title();
        let mut settings = BTreeMap::new();
        for SetupRuns { setup: other, .. } in setups {
            if other.title() != title {
                continue;
            }
            for Differing { key, own, .. } in self.differing_settings(other) {
                settings.insert(key, own);
            }
        }
        if settings.is_empty() {
            return title;
        }
        let settings: Vec<String> =
            settings.iter().map(|(key, own)| format!("{key} {own}")).collect();
        format!("{title} ({})", settings.join(", "))
    }

    /// Names the parts in which a setup of the same machine differs: `yolo26x: MAXN → 15W`. Settings tell two setups
    /// apart only if nothing that names them does.
    pub(super) fn change_to(&self, other: &Self) -> String {
        let named = [
            (&self.detector, &other.detector),
            (&self.precision, &other.precision),
            (&self.power_mode, &other.power_mode),
        ];
        let mut changes = Vec::new();
        for (own, others) in named {
            if own != others {
                changes.push(format!("{own} → {others}"));
            }
        }
        if changes.is_empty() {
            for Differing { key, own, other } in self.differing_settings(other) {
                changes.push(format!("{key} {own} → {other}"));
            }
        }
        let list = changes.join(", ");
        if self.detector == other.detector {
            format!("{}: {list}", self.detector)
        } else {
            list
        }
    }

    /// Names the file of the setup's runs.
    pub fn file_name(&self) -> String {
        let kept = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        let plain = self.names().map(|name| name.replace(|c: char| !kept(c), "-"));
        format!("{}.jsonl", plain.collect::<Vec<_>>().join("."))
    }

    /// The settings that differ in `other`.
    pub(super) fn differing_settings<'a>(&'a self, other: &'a Self) -> Vec<Differing<'a>> {
        let keys: BTreeSet<&String> = self.settings.keys().chain(other.settings.keys()).collect();
        let value =
            |setup: &'a Self, key: &str| setup.settings.get(key).map_or(UNSET, String::as_str);
        keys.into_iter()
            .map(|key| Differing {
                key,
                own: value(self, key),
                other: value(other, key),
            })
            .filter(|setting| setting.own != setting.other)
            .collect()
    }

    /// Describes how `now` differs, a line for each key; `None` if it does not.
    pub(super) fn difference(&self, now: &Self) -> Option<String> {
        if self.settings.is_empty() && !now.settings.is_empty() {
            return Some(
                "it does not say under which settings it was measured: another version wrote it"
                    .to_owned(),
            );
        }
        let named = [
            ("detector", &self.detector, &now.detector),
            ("precision", &self.precision, &now.precision),
            ("power mode", &self.power_mode, &now.power_mode),
            ("machine", &self.machine, &now.machine),
        ];
        let mut differing: Vec<Differing<'_>> =
            named.map(|(key, own, other)| Differing { key, own, other }).into();
        differing.retain(|name| name.own != name.other);
        differing.extend(self.differing_settings(now));
        if differing.is_empty() {
            return None;
        }
        let mut text = "its runs were measured with other settings:".to_owned();
        for Differing { key, own, other } in differing {
            text.push_str(&format!("\n  {key} was {own}, and now is {other}"));
        }
        Some(text)
    }
}

/// A setting, or another part of a setup, in which two setups differ.
pub(super) struct Differing<'a> {
    pub key: &'a str,
    pub own: &'a str,
    pub other: &'a str,
}

/// The figures of one clip under one policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClipRun {
    /// The clip's name.
    pub clip: String,
    /// The policy's label.
    pub policy: String,
    /// What the clip was: size and number of its pictures, and a digest of its ground truth. Empty for published rows.
    #[serde(default)]
    pub content: String,
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
    /// Mean time of a frame until its answer, milliseconds; absent if no frame was answered.
    pub frame_ms: Option<f64>,
    /// AP@50 of the published boxes against the ground truth, 0 to 1; absent if the clip's truth has no box.
    pub ap50: Option<f64>,
    /// mAP@50:95, likewise.
    pub map: Option<f64>,
    /// Energy of the whole machine or of what its meter covers, joules; absent without a meter or if samples do not
    /// cover the run.
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
    /// The most memory that the program held, MB. One program plays all runs: what an earlier run took and was not
    /// given back is included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_mb: Option<f64>,
    /// The machine's power every 100 ms, by domain: seconds since the first frame, and watts. Kept of the first two
    /// clips.
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
        let times = &report.total_latency_ms;
        let mut domains = BTreeMap::new();
        // Joules of a part of the time are not shown, neither as a sum nor by domain.
        if joules.is_some() {
            for domain in &energy.domains {
                domains.insert(domain.domain.clone(), domain.joules);
            }
        }
        Self {
            clip: clip.to_owned(),
            policy: policy.to_owned(),
            content: String::new(),
            frames: report.frames,
            dropped: report.dropped.total(),
            unlabelled: 0,
            states: report.states,
            degraded: report.degraded_frames,
            detector_calls: report.detector_latency_ms.count,
            duration_s: report.duration_s,
            frame_ms: (times.count > 0).then_some(times.mean),
            ap50: None,
            map: None,
            joules,
            domains,
            estimated: energy.quality == EnergyQuality::Estimated,
            energy_of: energy.total_from.clone(),
            cpu_s: None,
            gpu_utilisation: report.board.as_ref().and_then(|board| board.gpu_utilisation),
            memory_mb: None,
            traces: BTreeMap::new(),
            throttled: report.board.as_ref().is_some_and(|board| board.throttled == Some(true)),
        }
    }

    /// Share of frames that skipped the detector, without degraded ones; `None` if no frame was answered.
    pub fn skip_rate(&self) -> Option<f64> {
        (self.states.frames() > 0).then(|| self.states.skip_rate(self.degraded))
    }

    /// Share of frames that are in one of `states`; `None` if no frame was answered.
    pub(super) fn share_of(&self, states: &[FrameState]) -> Option<f64> {
        let all = self.states.frames();
        let frames: u64 = states.iter().map(|state| self.states.get(*state)).sum();
        (all > 0).then(|| frames as f64 / all as f64)
    }

    /// Processor cores that the program kept busy.
    pub fn cores(&self) -> Option<f64> {
        let cores = self.cpu_s? / self.duration_s;
        cores.is_finite().then_some(cores)
    }

    /// Energy-delay product by the paper's definition, joules times duration over frames, J·ms/frame; `None` without
    /// energy, or if no frame was answered.
    pub fn edp(&self) -> Option<f64> {
        let joules = self.joules?;
        (self.frames > 0).then(|| joules * self.duration_s * 1e3 / self.frames as f64)
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
