//! The records of a comparison and of each of its runs.

use super::agreement::Agreement;
use albireo_wire::ClipReport;
use serde::Serialize;

/// What was played, and how.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Playing {
    /// The clip's name.
    pub clip: String,
    /// Frames in it.
    pub frames: u64,
    /// Size of its pictures, `1280x720`.
    pub size: String,
    /// Its own frames per second.
    pub rate: f64,
    /// Frames per second it was played at; `None` for as fast as they were taken.
    pub played_rate: Option<f64>,
    /// Warm-up under each policy before each run, seconds.
    pub warm_up_s: f64,
    /// Idle time before each run, seconds.
    pub cool_down_s: f64,
    /// The detector: file, and what runs it.
    pub detector: String,
    /// Cores of this machine.
    pub cores: usize,
}

/// One run: the clip played once to a node with one policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Number of the round, from 0.
    pub round: usize,
    /// Which variant, from 0.
    pub variant: usize,
    /// What the node reported of the clip.
    pub report: ClipReport,
    /// CPU time of this process from the clip's first frame until its last was answered, seconds: node,
    /// camera and meter.
    pub cpu_s: f64,
    /// CPU time of reading the power meter, of that, as a share of one core.
    pub meter_share_of_core: f64,
    /// Its boxes against the detector's; `None` when the detector found nothing.
    pub agreement: Option<Agreement>,
    /// What to try, where no frame was skipped though objects were followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<Advice>,
}

/// A value of the threshold under which frames would have been skipped.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// Name of the threshold.
    pub knob: &'static str,
    /// The value to try.
    #[serde(rename = "try")]
    pub attempt: f64,
}

/// A comparison that was played.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// What was played.
    pub playing: Playing,
    /// Labels of the variants.
    pub policies: Vec<String>,
    /// The variant whose boxes stand for what the detector finds.
    pub boxes_of: usize,
    /// All runs of complete rounds, in the order in which they were played.
    pub runs: Vec<Run>,
}
