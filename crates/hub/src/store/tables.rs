//! The rows of the tables that grow.

use crate::ingest::Counts;
use serde::{Deserialize, Serialize, Serializer};
use uuid::Uuid;

/// One clip, or a part of a long one. `docs/fleet.md` lists the tables.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ClipRow {
    pub(crate) day: i64,
    #[serde(with = "uuid::serde::compact")]
    pub(crate) report_id: Uuid,
    pub(crate) count: Option<i64>,
    pub(crate) camera_id: i64,
    pub(crate) setup_id: i64,
    pub(crate) at_ms: i64,
    pub(crate) received_ms: i64,
    pub(crate) started_ns: i64,
    pub(crate) clip: String,
    pub(crate) part: i64,
    pub(crate) ended_by: String,
    pub(crate) duration_us: i64,
    pub(crate) frames: i64,
    pub(crate) frames_e: i64,
    pub(crate) frames_p: i64,
    pub(crate) frames_ei: i64,
    pub(crate) frames_i: i64,
    pub(crate) frames_ai: i64,
    pub(crate) degraded: i64,
    pub(crate) dropped: i64,
    pub(crate) latency_mean_us: i64,
    pub(crate) latency_p50_us: i64,
    pub(crate) latency_p95_us: i64,
    pub(crate) latency_p99_us: i64,
    pub(crate) latency_us: i64,
    pub(crate) detector_calls: i64,
    pub(crate) detector_mean_us: i64,
    pub(crate) detector_p50_us: i64,
    pub(crate) detector_p95_us: i64,
    pub(crate) detector_p99_us: i64,
    pub(crate) detector_us: i64,
    pub(crate) avoided_calls: i64,
    pub(crate) avoided_uj: Option<i64>,
    pub(crate) quality: i64,
    pub(crate) energy_uj: Option<i64>,
    pub(crate) node_uj: Option<i64>,
    pub(crate) gpu_uj: Option<i64>,
    pub(crate) cpu_uj: Option<i64>,
    pub(crate) io_mem_uj: Option<i64>,
    pub(crate) edp: Option<f64>,
    pub(crate) samples: i64,
    pub(crate) coverage_ppm: i64,
    pub(crate) threshold_changed: i64,
    pub(crate) audit_frames: Option<i64>,
    pub(crate) audit_missed: Option<i64>,
    pub(crate) audit_missed_boxes: Option<i64>,
    pub(crate) audit_calls: Option<i64>,
    pub(crate) audit_us: Option<i64>,
    pub(crate) audit_uj: Option<i64>,
    pub(crate) audit_detected: Option<i64>,
    pub(crate) audit_shown: Option<i64>,
    pub(crate) audit_paired: Option<i64>,
    pub(crate) audit_detected_sq: Option<i64>,
    pub(crate) audit_detected_x: Option<i64>,
    pub(crate) audit_shown_sq: Option<i64>,
    pub(crate) audit_paired_sq: Option<i64>,
    pub(crate) audit_shown_x: Option<i64>,
}

/// A column of sums, and what a clip adds to it.
type Summed = (&'static str, fn(&ClipRow) -> i64);

/// What is summed over clips. A clip without a value adds nothing; a long clip is counted at its first part.
macro_rules! summed {
    ($($column:ident)+) => {
        const SUMMED: &[Summed] = &[
            ("clips", |clip| i64::from(clip.part == 0)),
            ("unpriced_calls", |clip| match clip.avoided_uj {
                Some(_) => 0,
                None => clip.avoided_calls,
            }),
            $((stringify!($column), |clip| Option::from(clip.$column).unwrap_or(0)),)+
        ];
    };
}

summed! {
    duration_us frames frames_e frames_p frames_ei frames_i frames_ai degraded dropped
    latency_us detector_calls detector_us avoided_calls
    avoided_uj energy_uj gpu_uj cpu_uj io_mem_uj
    audit_frames audit_missed audit_missed_boxes audit_calls audit_us audit_uj
    audit_detected audit_shown audit_paired
    audit_detected_sq audit_detected_x audit_shown_sq audit_paired_sq audit_shown_x
}

/// The largest sum: there it stays, so that no sum is ever too large for a column.
pub(crate) const LARGEST_SUM: i64 = 1 << 62;

/// Sums over the clips of one camera, setup and energy quality in one span of time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SumRow {
    /// Camera, 0 for the whole fleet; the beginning of the span in seconds since the Unix epoch; setup; quality.
    pub(crate) key: [i64; 4],
    sums: Vec<i64>,
}

impl SumRow {
    /// The columns of the key.
    pub(crate) const KEY: [&str; 4] = ["camera_id", "bucket_s", "setup_id", "quality"];

    /// The sums of one clip in the span that begins at `bucket_s`, under a camera.
    pub(crate) fn of(clip: &ClipRow, bucket_s: i64, camera_id: i64) -> Self {
        Self {
            key: [camera_id, bucket_s, clip.setup_id, clip.quality],
            sums: SUMMED.iter().map(|(_, of)| of(clip)).collect(),
        }
    }

    /// Adds the sums of more clips of the same key.
    pub(crate) fn add(&mut self, more: &Self) {
        for (sum, more) in self.sums.iter_mut().zip(&more.sums) {
            *sum = sum.saturating_add(*more).min(LARGEST_SUM);
        }
    }

    /// The columns that are summed.
    pub(crate) fn summed() -> impl Iterator<Item = &'static str> {
        SUMMED.iter().map(|(name, _)| *name)
    }
}

impl Serialize for SumRow {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let columns = Self::KEY.into_iter().chain(Self::summed());
        to.collect_map(columns.zip(self.key.iter().chain(&self.sums)))
    }
}

/// A report that makes no sense.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct SetAsideRow {
    pub(crate) node_id: i64,
    pub(crate) report_id: Option<String>,
    pub(crate) received_ms: i64,
    pub(crate) cause: String,
    pub(crate) body: String,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct EventRow {
    pub(crate) at_ms: i64,
    pub(crate) kind: String,
    pub(crate) node: Option<String>,
    pub(crate) detail: String,
}

impl EventRow {
    /// Something that happened to a node.
    pub(crate) fn new(at_ms: i64, kind: &str, node: &str, detail: serde_json::Value) -> Self {
        Self {
            at_ms,
            kind: kind.to_owned(),
            node: Some(node.to_owned()),
            detail: detail.to_string(),
        }
    }
}

/// What is known of the reports of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ReportCountsRow {
    pub(crate) node_id: i64,
    pub(crate) first_ms: i64,
    pub(crate) last_ms: i64,
    pub(crate) stored: i64,
    pub(crate) set_aside: i64,
    pub(crate) refused: i64,
    pub(crate) resets: i64,
    #[serde(flatten)]
    pub(crate) counts: Counts,
}

/// What is known of a node between reports; its status is absent where it did not change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct NodeRow {
    pub(crate) name: String,
    pub(crate) first_seen_ms: i64,
    pub(crate) state: String,
    pub(crate) since_ms: i64,
    pub(crate) why: String,
    pub(crate) heard_ms: Option<i64>,
    pub(crate) run: Option<i64>,
    pub(crate) started_ns: Option<i64>,
    pub(crate) revision: i64,
    pub(crate) status: Option<String>,
}

/// With what a clip was made: clips with the same share one number. Texts that a clip has not are empty.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub(crate) struct SetupKey {
    pub(crate) policy: String,
    /// Name of the threshold.
    pub(crate) knob: String,
    /// Its value, in the shortest text that reads back as the same.
    pub(crate) value: String,
    pub(crate) model: String,
    pub(crate) provider: String,
    pub(crate) power_source: String,
    /// How the total energy was found.
    pub(crate) total_from: String,
}
