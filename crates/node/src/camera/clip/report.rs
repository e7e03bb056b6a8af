//! Converts a closed clip to its report.

use super::latencies::Latencies;
use crate::camera::audit::AuditCount;
use albireo_power::{Domain, Energy, Measured, Measurement};
use albireo_service::clock::{milliseconds, unix_nanoseconds};
use albireo_wire::{
    AuditReport, ClipEnd, ClipEnergy, ClipReport, DroppedFrames, FULL_COVERAGE, FrameStates,
    Threshold, ThresholdChange, VERSION,
};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use uuid::{NoContext, Timestamp, Uuid};

/// How long the last report may wait for its energy when the node stops: for two samples at usual intervals.
const PATIENCE_AT_THE_END: Duration = Duration::from_millis(300);

/// The audit's part of a clip.
#[derive(Debug)]
pub(crate) struct ClipAudit {
    /// Share of the skipped frames that is drawn.
    pub share: f64,
    /// What became known during the clip.
    pub count: AuditCount,
}

impl ClipAudit {
    fn report(&self) -> AuditReport {
        AuditReport {
            share: self.share,
            calls: self.count.calls,
            detector_us: self.count.detector_us,
            joules: None,
            sums: self.count.sums,
        }
    }
}

/// What is counted of a clip.
#[derive(Debug)]
pub(crate) struct Clip {
    /// The camera's own name, or `window-N`.
    pub name: Arc<str>,
    /// Number of this part of it, from 0.
    pub part: u32,
    /// Capture time of its first frame, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// When it began: the arrival of its first frame, or the end of the window before.
    pub start: Instant,
    /// Frame states; they add up to the frames.
    pub states: FrameStates,
    /// Frames answered from prediction because the detector was not available.
    pub degraded: u64,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Threshold of the last frame.
    pub threshold: Option<Threshold>,
    /// The threshold at the start, then its changes.
    pub threshold_changes: Vec<ThresholdChange>,
    /// Latencies from reception to publication.
    pub total: Latencies,
    /// Latencies of the detector, over the frames where it ran.
    pub detector: Latencies,
    /// Detector time that its frames used.
    pub detector_used: Duration,
    /// What its audit has found, if there is one.
    pub audit: Option<ClipAudit>,
}

/// A clip that has ended.
#[derive(Debug)]
pub(crate) struct ClosedClip {
    /// What was counted of it.
    pub clip: Clip,
    /// Why it ended.
    pub ended_by: ClipEnd,
    /// When it ended.
    pub end: Instant,
    /// Its energy, still being measured.
    pub energy: Measurement,
}

/// A clip whose energy is known, as far as it will be.
#[derive(Debug)]
pub(crate) struct MeasuredClip {
    clip: Clip,
    ended_by: ClipEnd,
    duration: Duration,
    energy: Option<Measured>,
}

/// What the report says of the node and no tracker counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ClipMeta {
    /// Node.
    pub node: String,
    /// Camera.
    pub camera: String,
    /// Policy.
    pub policy: String,
    /// Detector model: file name.
    pub model: String,
    /// Execution provider that ran it.
    pub provider: String,
}

impl ClosedClip {
    /// From the clip's start to its end.
    pub(crate) fn duration(&self) -> Duration {
        self.end.saturating_duration_since(self.clip.start)
    }

    /// With the clip's energy and the board's state during it. Waits for the meter's first sample after the clip's end, at
    /// most an interval where the meter answers, and not at all without one. To be awaited away from the frames' way.
    pub(crate) async fn measured(self) -> MeasuredClip {
        let patience = match self.ended_by {
            ClipEnd::Shutdown => PATIENCE_AT_THE_END,
            _ => Duration::MAX,
        };
        MeasuredClip {
            duration: self.duration(),
            ended_by: self.ended_by,
            energy: self.energy.finish(self.end, patience).await,
            clip: self.clip,
        }
    }
}

impl MeasuredClip {
    /// The report. Sorts the latencies, which takes milliseconds for a long clip.
    pub(crate) fn into_report(self, meta: ClipMeta) -> ClipReport {
        let Self {
            clip,
            ended_by,
            duration,
            energy: measured,
        } = self;
        let measured = measured.unwrap_or_else(unmeasured);
        let mut audit = clip.audit.as_ref().map(ClipAudit::report);
        if let Some(audit) = &mut audit {
            let seconds = audit.detector_us as f64 / 1e6;
            audit.joules = measured.detector_watts.map(|watts| watts * seconds);
        }
        let frames = clip.states.frames();
        ClipReport {
            v: VERSION,
            id: new_id(),
            node: meta.node,
            camera: meta.camera,
            clip: clip.name.to_string(),
            part: clip.part,
            count: None,
            ended_by,
            started_ns: clip.started_ns,
            duration_s: duration.as_secs_f64(),
            frames,
            states: clip.states,
            skip_rate: clip.states.skip_rate(clip.degraded),
            degraded_frames: clip.degraded,
            dropped: clip.dropped,
            policy: meta.policy,
            threshold: clip.threshold,
            threshold_changes: clip.threshold_changes,
            model: meta.model,
            provider: meta.provider,
            total_latency_ms: clip.total.into_percentiles(),
            detector_latency_ms: clip.detector.into_percentiles(),
            detector_used_ms: milliseconds(clip.detector_used),
            energy: energy_of(&measured, duration, frames),
            board: measured.board,
            audit,
        }
    }
}

/// Of a clip whose energy is not known.
fn unmeasured() -> Measured {
    Measured {
        node: Energy::unavailable(""),
        joules: None,
        detector_watts: None,
        saved_joules: None,
        board: None,
    }
}

/// An id that no other report has, of the present time.
fn new_id() -> Uuid {
    let now_ns = unix_nanoseconds();
    let (seconds, nanoseconds) = (now_ns / 1_000_000_000, now_ns % 1_000_000_000);
    let nanoseconds = u32::try_from(nanoseconds).unwrap_or(0);
    Uuid::new_v7(Timestamp::from_unix(NoContext, seconds, nanoseconds))
}

/// The energy section of a report. Where samples do not cover the whole clip there is no energy-delay product: the energy
/// would be that of a part of the time.
pub fn energy_of(measured: &Measured, duration: Duration, frames: u64) -> ClipEnergy {
    let node = &measured.node;
    ClipEnergy {
        joules: measured.joules,
        node_joules: node.joules(Domain::Total),
        saved_joules_estimated: measured.saved_joules,
        edp: (measured.joules)
            .filter(|_| node.coverage >= FULL_COVERAGE)
            .and_then(|joules| energy_delay_product(joules, duration, frames)),
        quality: node.quality,
        source: node.source.clone(),
        total_from: node.total_from.clone(),
        samples: node.samples,
        coverage: node.coverage,
        domains: node.domains.clone(),
    }
}

/// Energy-delay product, J·ms/frame: energy × duration ÷ frames (paper, evaluation). None without frames.
pub fn energy_delay_product(joules: f64, duration: Duration, frames: u64) -> Option<f64> {
    (frames > 0).then(|| joules * duration.as_secs_f64() * 1e3 / frames as f64)
}

#[cfg(test)]
mod tests;
