//! From a closed clip to its report on the wire.

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

/// The audit's part of a clip that has ended.
#[derive(Debug)]
pub(crate) struct ClosedAudit {
    /// Share of the skipped frames that is drawn.
    pub share: f64,
    /// What became known during the clip.
    pub count: AuditCount,
}

impl ClosedAudit {
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

/// A clip that has ended.
#[derive(Debug)]
pub(crate) struct ClosedClip {
    /// The camera's own name, or `window-N`.
    pub clip: Arc<str>,
    /// Number of this part of it, from 0.
    pub part: u32,
    /// Why it ended.
    pub ended_by: ClipEnd,
    /// Capture time of its first frame, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// When it began: the arrival of its first frame, or the end of the window before.
    pub start: Instant,
    /// When it ended.
    pub end: Instant,
    /// Frame states; they add up to the frames.
    pub states: FrameStates,
    /// Frames answered from prediction because the detector was not available.
    pub degraded: u64,
    /// Frames not processed, by kind.
    pub dropped: DroppedFrames,
    /// Threshold at the end.
    pub threshold: Option<Threshold>,
    /// The threshold at the start, then its changes.
    pub threshold_changes: Vec<ThresholdChange>,
    /// Latencies from reception to publication.
    pub total: Latencies,
    /// Latencies of the detector, over the frames where it ran.
    pub detector: Latencies,
    /// Detector time that its frames used.
    pub detector_used: Duration,
    /// Its energy, still being measured.
    pub energy: Measurement,
    /// What its audit has found, if there is one.
    pub audit: Option<ClosedAudit>,
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
        self.end.saturating_duration_since(self.start)
    }

    /// The report as far as it is known at once, without energy.
    fn without_energy(&self, meta: ClipMeta) -> ClipReport {
        let duration = self.duration();
        ClipReport {
            v: VERSION,
            id: new_id(),
            node: meta.node,
            camera: meta.camera,
            clip: self.clip.to_string(),
            part: self.part,
            count: None,
            ended_by: self.ended_by,
            started_ns: self.started_ns,
            duration_s: duration.as_secs_f64(),
            frames: self.states.frames(),
            states: self.states,
            skip_rate: self.states.skip_rate(self.degraded),
            degraded_frames: self.degraded,
            dropped: self.dropped,
            policy: meta.policy,
            threshold: self.threshold,
            threshold_changes: self.threshold_changes.clone(),
            model: meta.model,
            provider: meta.provider,
            total_latency_ms: self.total.percentiles(),
            detector_latency_ms: self.detector.percentiles(),
            detector_used_ms: milliseconds(self.detector_used),
            energy: energy_of(&unmeasured(), duration, 0),
            board: None,
            audit: self.audit.as_ref().map(ClosedAudit::report),
        }
    }

    /// The report, with the clip's energy and the board's state during it. Waits for the meter's first sample after the
    /// clip's end, at most an interval where the meter answers, and not at all without one. To be awaited away from the
    /// frames' way.
    pub(crate) async fn into_report(self, meta: ClipMeta) -> ClipReport {
        let mut report = self.without_energy(meta);
        let patience = match self.ended_by {
            ClipEnd::Shutdown => PATIENCE_AT_THE_END,
            _ => Duration::MAX,
        };
        let duration = self.duration();
        if let Some(measured) = self.energy.finish(self.end, patience).await {
            report.energy = energy_of(&measured, duration, report.frames);
            if let Some(audit) = &mut report.audit {
                let seconds = audit.detector_us as f64 / 1e6;
                audit.joules = measured.detector_watts.map(|watts| watts * seconds);
            }
            report.board = measured.board;
        }
        report
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
