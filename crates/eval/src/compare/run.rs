//! Defines the records of a comparison and of each of its runs.

use super::agreement::Agreement;
use albireo_wire::ClipReport;
use serde::Serialize;

/// The clip that was played, and the way it was played.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Playback {
    /// The clip's name.
    pub clip: String,
    /// The number of frames.
    pub frames: u64,
    /// Size of the pictures, such as `1280x720`.
    pub size: String,
    /// The clip's own frames per second.
    pub rate: f64,
    /// The frames per second at which it was played; `None` if each frame was sent once the previous one was accepted.
    pub played_rate: Option<f64>,
    /// Warm-up under each policy before each run, seconds.
    pub warm_up_s: f64,
    /// Idle time before each run, seconds.
    pub cool_down_s: f64,
    /// The detector's file and execution provider.
    pub detector: String,
    /// The number of processor cores of this machine.
    pub cores: usize,
    /// The ground truth that belongs to the clip, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<TruthSize>,
}

/// The size of a clip's ground truth, of the frames that are played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct TruthSize {
    /// The number of boxes.
    pub boxes: usize,
    /// The number of frames, with and without boxes.
    pub frames: usize,
    /// The number of clips, which are judged as one.
    pub clips: usize,
}

/// One run: the clip played once to a node with one policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Number of the round, from 0.
    pub round: usize,
    /// Number of the variant, from 0.
    pub variant: usize,
    /// The node's report on the clip.
    pub report: ClipReport,
    /// CPU time of this process from the clip's first frame until its last was answered, seconds: node,
    /// camera and meter.
    pub cpu_s: f64,
    /// The part of this time spent on reading the power meter, as a share of one core.
    pub meter_share_of_core: f64,
    /// Mean time of a frame until its answer, milliseconds: from its reception if frames came at a rate, as a person
    /// meets it; else from its turn, for its wait behind the frame before is the sender's doing. `None` if no frame was
    /// answered.
    pub frame_ms: Option<f64>,
    /// The agreement of its boxes with the detector's; `None` if the detector found nothing.
    pub agreement: Option<Agreement>,
    /// The agreement of its boxes with the ground truth; `None` if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by_truth: Option<Agreement>,
    /// A value to try, if no frame was skipped although objects were tracked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<Suggestion>,
}

/// A value of the threshold under which frames would have been skipped.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Suggestion {
    /// Name of the threshold.
    pub threshold: &'static str,
    /// The value to try.
    #[serde(rename = "try")]
    pub value: f64,
}

/// All runs of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The clip, and the way it was played.
    pub playing: Playback,
    /// Labels of the variants.
    pub policies: Vec<String>,
    /// Number of the variant whose boxes are the reference for the others.
    pub boxes_of: usize,
    /// All runs of complete rounds, in the order in which they were played.
    pub runs: Vec<Run>,
}
