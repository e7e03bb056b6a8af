//! Defines the figures of one policy on one clip.

use crate::judge::{Accuracy, Matches, Newcomers, Tracking};
use crate::statistics::quantile;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::FrameState;
use albireo_vision::picture::EncodedPicture;
use albireo_wire::FrameStates;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The origin of a time. The two are never mixed in one figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Provenance {
    /// The sum of the times of the steps that a frame needed (detector, screen, decision), each measured on this
    /// machine.
    Composed,
    /// Computed with the model of a board from the numbers of frames.
    Projected,
}

impl Provenance {
    /// The word in tables and files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Composed => "composed",
            Self::Projected => "projected",
        }
    }
}

/// The distribution of a time over the frames of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl Spread {
    /// The spread of `values`; `None` if there are none.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        Some(Self {
            mean: values.iter().sum::<f64>() / values.len() as f64,
            p50: quantile(&values, 0.50)?,
            p95: quantile(&values, 0.95)?,
            p99: quantile(&values, 0.99)?,
        })
    }
}

/// Time per frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameTime {
    /// The time in milliseconds.
    #[serde(flatten)]
    pub milliseconds: Spread,
    /// The origin of the time.
    pub provenance: Provenance,
}

/// Energy of a clip, projected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Energy {
    /// Joules of the whole clip.
    pub joules: f64,
    /// Duration of the clip in seconds.
    pub duration_s: f64,
    /// Energy-delay product by the paper's definition, joules times duration over frames, in J·ms/frame.
    pub edp: f64,
}

impl Energy {
    /// The energy of a clip of `frames` frames.
    pub(crate) fn new(joules: f64, duration_s: f64, frames: usize) -> Self {
        Self {
            joules,
            duration_s,
            edp: joules * duration_s * 1e3 / frames as f64,
        }
    }
}

/// The figures of one policy on one clip.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ClipResult {
    /// Name of the clip.
    pub clip: String,
    /// `moving` or `fixed`, if known.
    pub camera: Option<String>,
    /// Label of the policy.
    pub policy: String,
    /// Number of frames.
    pub frames: usize,
    /// The number of frames that nobody labelled: they are not judged, and count for everything else.
    pub unlabelled_frames: usize,
    /// Frames per second, if known.
    pub frame_rate: Option<f64>,
    /// The number of frames in each state.
    pub states: FrameStates,
    /// The number of frames on which the detector ran.
    pub detector_frames: usize,
    /// The number of frames on which the empty-scene screen ran.
    pub screen_frames: usize,
    /// The number of frames of which a grey picture was examined.
    pub looked_frames: usize,
    /// The number of frames in which the detector finds something, whether or not this policy ran it; 0 if only
    /// stored detections were evaluated.
    pub occupied_frames: usize,
    /// The number of these frames with state E, which the empty-scene screen misses.
    pub false_empty_frames: usize,
    /// The number of frames that needed the detector and did not get it.
    pub degraded_frames: usize,
    /// The number of detections that the policy rejected because they are not valid boxes.
    pub rejected_detections: u64,
    /// The number of scored boxes.
    pub boxes: usize,
    /// Accuracy of the boxes that a node publishes; `None` without ground truth.
    pub accuracy: Option<Accuracy>,
    /// Tracking figures of these boxes; `None` if boxes or ground truth have no object numbers.
    pub tracking: Option<Tracking>,
    /// How late objects were found in these boxes; `None` if the ground truth does not number its objects.
    pub newcomers: Option<Newcomers>,
    /// Accuracy of all boxes of the policy, also those too faint to be published; `None` under the published scoring.
    pub accuracy_all: Option<Accuracy>,
    /// Tracking figures of all boxes.
    pub tracking_all: Option<Tracking>,
    /// Accuracy with the confidences of the last detections, if the profile decays confidences.
    pub accuracy_last_confidence: Option<Accuracy>,
    /// Accuracy of every class that has ground truth, by name.
    pub classes: BTreeMap<String, Accuracy>,
    /// Time inside the policy per frame in microseconds, measured on this machine.
    pub decision_us: Option<Spread>,
    /// Time per frame, including detector and screen.
    pub frame_time: Option<FrameTime>,
    /// Energy, if projected.
    #[serde(rename = "projected_energy")]
    pub energy: Option<Energy>,
    /// What became of the boxes that a node publishes, to be pooled with other clips; `None` if classes are separate.
    #[serde(skip)]
    pub(crate) matches: Option<Matches>,
    /// Mean delay of settled frames, in frames.
    #[serde(skip)]
    pub delay: f64,
    /// The state of each frame.
    #[serde(skip)]
    pub states_by_frame: Vec<FrameState>,
    /// One entry per frame: true if a grey picture was examined.
    #[serde(skip)]
    pub examined: Vec<bool>,
    /// The frames that lost the most objects against the detector, if `keep_worst` is set.
    #[serde(skip)]
    pub worst: Vec<WorstFrame>,
}

impl ClipResult {
    /// Share of frames that skipped the detector, without degraded ones.
    pub fn skip_rate(&self) -> f64 {
        self.states.skip_rate(self.degraded_frames as u64)
    }

    /// How late objects were found, milliseconds; `None` without a frame rate.
    pub fn newcomer_ms(&self) -> Option<f64> {
        Some(self.newcomers?.delay_frames * 1e3 / self.frame_rate?)
    }

    /// Detector calls a second; `None` without a frame rate.
    pub fn calls_a_second(&self) -> Option<f64> {
        let frames = self.frames.max(1) as f64;
        Some(self.detector_frames as f64 / frames * self.frame_rate?)
    }

    /// Share of each state in the order E, P, E+I, I, AI.
    pub fn state_shares(&self) -> [f64; 5] {
        FrameState::ALL.map(|state| self.states.get(state) as f64 / self.states.frames() as f64)
    }
}

/// The picture of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum FramePicture {
    /// A file of the data set.
    File(PathBuf),
    /// The picture as it is in the footage.
    Encoded(EncodedPicture),
}

/// A frame that skipped the detector and lost objects that the detector would have found.
#[derive(Clone, Debug, PartialEq)]
pub struct WorstFrame {
    /// The frame's index in the clip.
    pub frame: usize,
    /// The frame's state.
    pub state: FrameState,
    /// The number of ground-truth objects that the detector finds (IoU 0.5) and the policy does not.
    pub lost: usize,
    /// Size of the picture.
    pub size: PictureSize,
    /// The ground truth.
    pub truth: Vec<Corners>,
    /// The policy's boxes.
    pub found: Vec<Corners>,
    /// The frame's picture, if there is one.
    pub picture: Option<FramePicture>,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clip of six frames: one in each state, and another in state P.
    fn six_frames() -> ClipResult {
        let mut result = ClipResult::default();
        for state in FrameState::ALL.into_iter().chain([FrameState::P]) {
            result.states.count(state);
        }
        result
    }

    #[test]
    fn skipped_frames_are_e_and_p_without_degraded_ones() {
        let mut result = six_frames();
        assert!((result.skip_rate() - 0.5).abs() < 1e-15);
        result.degraded_frames = 1;
        assert!((result.skip_rate() - 2.0 / 6.0).abs() < 1e-15);
    }

    #[test]
    fn the_share_of_a_state_is_that_of_its_frames() {
        let shares = [1.0, 2.0, 1.0, 1.0, 1.0].map(|frames| frames / 6.0);
        assert_eq!(six_frames().state_shares(), shares);
    }
}
