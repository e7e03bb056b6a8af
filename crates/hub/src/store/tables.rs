//! The rows of the tables that grow.

use super::rows::{Row as _, row};

row! {
    /// One clip. `docs/hub-schema.md` says what each column is.
    pub(crate) struct ClipRow {
        camera_id: i64,
        instance_id: i64,
        setup_id: i64,
        report: i64,
        at_ms: i64,
        received_ms: i64,
        started_ns: i64,
        clip: String,
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
        details: Option<String>,
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

row! {
    /// Sums over the clips of one camera, setup and energy quality in one span of time.
    pub(crate) struct SumRow {
        bucket_s: i64,
        camera_id: i64,
        setup_id: i64,
        quality: i64,
        clips: i64,
        duration_us: i64,
        frames: i64,
        frames_e: i64,
        frames_p: i64,
        frames_ei: i64,
        frames_i: i64,
        frames_ai: i64,
        degraded: i64,
        dropped: i64,
        latency_us: i64,
        detector_calls: i64,
        detector_us: i64,
        avoided_calls: i64,
        unpriced_calls: i64,
        avoided_uj: i64,
        energy_uj: i64,
        gpu_uj: i64,
        cpu_uj: i64,
        io_mem_uj: i64,
        audit_frames: i64,
        audit_missed: i64,
        audit_missed_boxes: i64,
        audit_calls: i64,
        audit_us: i64,
        audit_uj: i64,
        audit_detected: i64,
        audit_shown: i64,
        audit_paired: i64,
        audit_detected_sq: i64,
        audit_detected_x: i64,
        audit_shown_sq: i64,
        audit_paired_sq: i64,
        audit_shown_x: i64,
    }
}

/// Columns of [`SumRow`] that tell which clips; the rest is summed.
pub(crate) const SUM_KEYS: usize = 4;

/// The names of the columns that are summed.
pub(crate) fn summed() -> impl Iterator<Item = &'static str> {
    SumRow::COLUMNS.iter().skip(SUM_KEYS).map(|(name, _)| *name)
}

impl SumRow {
    /// The sums of one clip in the span that begins at `bucket_s`.
    pub(crate) fn of(clip: &ClipRow, bucket_s: i64) -> Self {
        Self {
            bucket_s,
            camera_id: clip.camera_id,
            setup_id: clip.setup_id,
            quality: clip.quality,
            clips: 1,
            duration_us: clip.duration_us,
            frames: clip.frames,
            frames_e: clip.frames_e,
            frames_p: clip.frames_p,
            frames_ei: clip.frames_ei,
            frames_i: clip.frames_i,
            frames_ai: clip.frames_ai,
            degraded: clip.degraded,
            dropped: clip.dropped,
            latency_us: clip.latency_us,
            detector_calls: clip.detector_calls,
            detector_us: clip.detector_us,
            avoided_calls: clip.avoided_calls,
            unpriced_calls: if clip.avoided_uj.is_none() {
                clip.avoided_calls
            } else {
                0
            },
            avoided_uj: clip.avoided_uj.unwrap_or(0),
            energy_uj: clip.energy_uj.unwrap_or(0),
            gpu_uj: clip.gpu_uj.unwrap_or(0),
            cpu_uj: clip.cpu_uj.unwrap_or(0),
            io_mem_uj: clip.io_mem_uj.unwrap_or(0),
            audit_frames: clip.audit_frames.unwrap_or(0),
            audit_missed: clip.audit_missed.unwrap_or(0),
            audit_missed_boxes: clip.audit_missed_boxes.unwrap_or(0),
            audit_calls: clip.audit_calls.unwrap_or(0),
            audit_us: clip.audit_us.unwrap_or(0),
            audit_uj: clip.audit_uj.unwrap_or(0),
            audit_detected: clip.audit_detected.unwrap_or(0),
            audit_shown: clip.audit_shown.unwrap_or(0),
            audit_paired: clip.audit_paired.unwrap_or(0),
            audit_detected_sq: clip.audit_detected_sq.unwrap_or(0),
            audit_detected_x: clip.audit_detected_x.unwrap_or(0),
            audit_shown_sq: clip.audit_shown_sq.unwrap_or(0),
            audit_paired_sq: clip.audit_paired_sq.unwrap_or(0),
            audit_shown_x: clip.audit_shown_x.unwrap_or(0),
        }
    }

    /// What tells one row of sums from another.
    pub(crate) fn key(&self) -> (i64, i64, i64, i64) {
        (self.bucket_s, self.camera_id, self.setup_id, self.quality)
    }

    /// Adds the sums of more clips of the same key.
    pub(crate) fn add(&mut self, more: &Self) {
        self.clips += more.clips;
        self.duration_us += more.duration_us;
        self.frames += more.frames;
        self.frames_e += more.frames_e;
        self.frames_p += more.frames_p;
        self.frames_ei += more.frames_ei;
        self.frames_i += more.frames_i;
        self.frames_ai += more.frames_ai;
        self.degraded += more.degraded;
        self.dropped += more.dropped;
        self.latency_us += more.latency_us;
        self.detector_calls += more.detector_calls;
        self.detector_us += more.detector_us;
        self.avoided_calls += more.avoided_calls;
        self.unpriced_calls += more.unpriced_calls;
        self.avoided_uj += more.avoided_uj;
        self.energy_uj += more.energy_uj;
        self.gpu_uj += more.gpu_uj;
        self.cpu_uj += more.cpu_uj;
        self.io_mem_uj += more.io_mem_uj;
        self.audit_frames += more.audit_frames;
        self.audit_missed += more.audit_missed;
        self.audit_missed_boxes += more.audit_missed_boxes;
        self.audit_calls += more.audit_calls;
        self.audit_us += more.audit_us;
        self.audit_uj += more.audit_uj;
        self.audit_detected += more.audit_detected;
        self.audit_shown += more.audit_shown;
        self.audit_paired += more.audit_paired;
        self.audit_detected_sq += more.audit_detected_sq;
        self.audit_detected_x += more.audit_detected_x;
        self.audit_shown_sq += more.audit_shown_sq;
        self.audit_paired_sq += more.audit_paired_sq;
        self.audit_shown_x += more.audit_shown_x;
    }
}

row! {
    /// A report that could not be read.
    pub(crate) struct SetAsideRow {
        node_id: i64,
        instance_id: Option<i64>,
        report: Option<i64>,
        received_ms: i64,
        cause: String,
        body: String,
    }
}

row! {
    /// Numbers of an instance that never came.
    pub(crate) struct GapRow {
        instance_id: i64,
        first_report: i64,
        last_report: i64,
        noticed_ms: i64,
        cause: String,
    }
}

row! {
    /// Something that happened.
    pub(crate) struct EventRow {
        at_ms: i64,
        kind: String,
        node: Option<String>,
        detail: String,
    }
}

row! {
    /// What is known of an instance after a batch.
    pub(crate) struct InstanceRow {
        id: i64,
        machine: Option<String>,
        next_report: i64,
        last_ms: i64,
        latest_started_ns: i64,
        reports: i64,
        set_aside: i64,
        missing: i64,
        lost: i64,
        conflicts: i64,
    }
}

row! {
    /// What is known of a node between reports.
    pub(crate) struct NodeRow {
        id: i64,
        state: String,
        since_ms: i64,
        why: String,
        heard_ms: Option<i64>,
        instance: Option<String>,
        machine: Option<String>,
        started_ns: Option<i64>,
        revision: i64,
        status: Option<String>,
    }
}
