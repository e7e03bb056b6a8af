//! The rows of the tables that grow.

use super::record::{Cell, Record, record, text};
use uuid::Uuid;

record! {
    /// One clip, or a part of a long one. `docs/fleet.md` lists the tables.
    pub(crate) struct ClipRow {
        day: i64,
        report_id: Uuid,
        count: Option<i64>,
        camera_id: i64,
        setup_id: i64,
        at_ms: i64,
        received_ms: i64,
        started_ns: i64,
        clip: String,
        part: i64,
        ended_by: String,
        duration_us: i64,
        frames: i64,
        frames_e: i64,
        frames_p: i64,
        frames_ei: i64,
        frames_i: i64,
        frames_ai: i64,
        degraded: i64,
        dropped: i64,
        latency_mean_us: i64,
        latency_p50_us: i64,
        latency_p95_us: i64,
        latency_p99_us: i64,
        latency_us: i64,
        detector_calls: i64,
        detector_mean_us: i64,
        detector_p50_us: i64,
        detector_p95_us: i64,
        detector_p99_us: i64,
        detector_us: i64,
        avoided_calls: i64,
        avoided_uj: Option<i64>,
        quality: i64,
        energy_uj: Option<i64>,
        node_uj: Option<i64>,
        gpu_uj: Option<i64>,
        cpu_uj: Option<i64>,
        io_mem_uj: Option<i64>,
        edp: Option<f64>,
        samples: i64,
        coverage_ppm: i64,
        threshold_changed: i64,
        audit_frames: Option<i64>,
        audit_missed: Option<i64>,
        audit_missed_boxes: Option<i64>,
        audit_calls: Option<i64>,
        audit_us: Option<i64>,
        audit_uj: Option<i64>,
        audit_detected: Option<i64>,
        audit_shown: Option<i64>,
        audit_paired: Option<i64>,
        audit_detected_sq: Option<i64>,
        audit_detected_x: Option<i64>,
        audit_shown_sq: Option<i64>,
        audit_paired_sq: Option<i64>,
        audit_shown_x: Option<i64>,
    }
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
    /// The beginning of the span in seconds since the Unix epoch, camera, setup, quality.
    pub(crate) key: [i64; 4],
    sums: Vec<i64>,
}

impl SumRow {
    /// The columns of the key.
    pub(crate) const KEY: [&str; 4] = ["bucket_s", "camera_id", "setup_id", "quality"];

    /// The sums of one clip in the span that begins at `bucket_s`.
    pub(crate) fn of(clip: &ClipRow, bucket_s: i64) -> Self {
        Self {
            key: [bucket_s, clip.camera_id, clip.setup_id, clip.quality],
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

impl Record for SumRow {
    fn columns() -> Vec<&'static str> {
        Self::KEY.into_iter().chain(Self::summed()).collect()
    }

    fn cells(&self) -> Vec<Cell> {
        self.key
            .iter()
            .chain(&self.sums)
            .map(|n| (*n).into())
            .collect()
    }
}

record! {
    /// A report that makes no sense.
    pub(crate) struct SetAsideRow {
        node_id: i64,
        report_id: Option<String>,
        received_ms: i64,
        cause: String,
        body: String,
    }
}

record! {
    /// Something that happened.
    pub(crate) struct EventRow {
        at_ms: i64,
        kind: String,
        node: Option<String>,
        detail: String,
    }
}

impl EventRow {
    /// Something that happened to a node.
    pub(crate) fn new(at_ms: i64, kind: &str, node: &str, detail: serde_json::Value) -> Self {
        Self {
            at_ms,
            kind: kind.to_owned(),
            node: Some(text(node)),
            detail: text(&detail.to_string()),
        }
    }
}

record! {
    /// What is known of the reports of a node.
    pub(crate) struct ReportCountsRow {
        node_id: i64,
        first_ms: i64,
        last_ms: i64,
        stored: i64,
        set_aside: i64,
        refused: i64,
        resets: i64,
        base: i64,
        highest: i64,
        missing: String,
    }
}

record! {
    /// What is known of a node between reports; its status is absent where it did not change.
    pub(crate) struct NodeRow {
        name: String,
        first_seen_ms: i64,
        state: String,
        since_ms: i64,
        why: String,
        heard_ms: Option<i64>,
        run: Option<i64>,
        started_ns: Option<i64>,
        revision: i64,
        status: Option<String>,
    }
}

record! {
    /// With what a clip was made: clips with the same share one number. Texts that a clip has not are empty.
    #[derive(Eq, PartialOrd, Ord, Hash)]
    pub(crate) struct SetupKey {
        policy: String,
        /// Name of the threshold.
        knob: String,
        /// Its value, in the shortest text that reads back as the same.
        value: String,
        model: String,
        provider: String,
        power_source: String,
        /// How the total energy was found.
        total_from: String,
    }
}
