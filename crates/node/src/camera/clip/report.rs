//! Counts the frames of a clip and creates its report.

use super::travel::Travel;
use crate::frame::FrameRecord;
use crate::percentiles::percentiles;
use albireo_power::{Measured, Measurement};
use albireo_service::clock::{milliseconds, unix_nanoseconds};
use albireo_wire::{ClipEnd, ClipEnergy, ClipReport, Threshold, ThresholdChange, VERSION};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use uuid::{NoContext, Timestamp, Uuid};

/// The time limit for the energy of the last report when the node stops: two samples at usual intervals.
const PATIENCE_AT_THE_END: Duration = Duration::from_millis(300);

/// The maximum number of threshold values in one report; beyond it, only the newest is updated.
const MOST_CHANGES: usize = 256;

/// An open or ended clip.
#[derive(Debug)]
pub(crate) struct Clip {
    /// Its report so far: the counters while it is open, then also the reason for its end.
    pub report: ClipReport,
    /// The start: the arrival of its first frame, or the end of the previous window.
    pub start: Instant,
    /// The end; provisional while it is open: one mean frame interval after the last arrival, or the time of its
    /// answer, if later.
    pub end: Instant,
    /// Latencies from reception to publication, milliseconds. Clips are reported in parts, which bounds their number.
    pub total_ms: Vec<f32>,
    /// Latencies of the detector, for the frames on which it ran, milliseconds.
    pub detector_ms: Vec<f32>,
    /// Its running energy measurement.
    pub energy: Measurement,
    /// The camera's name for it, or `window-N`.
    pub name: Arc<str>,
    /// True if the camera does not name it.
    pub is_window: bool,
    /// The arrival of its first frame.
    pub first_arrival: Instant,
    /// The arrival of its last frame.
    pub last_arrival: Instant,
    /// The time of the last answer, or of the first arrival, if later.
    pub last_answered: Instant,
    /// The number of frames that have arrived.
    pub arrivals: u64,
    /// True while one of its frames waits for its final answer.
    pub is_pending: bool,
    /// Its way, once a frame had a position.
    pub(super) travel: Option<Travel>,
}

impl Clip {
    /// The time from its start to its end.
    pub(crate) fn duration(&self) -> Duration {
        self.end.saturating_duration_since(self.start)
    }

    /// Moves the provisional end after a frame has arrived or was answered, and keeps the energy up to there.
    pub(super) fn move_end(&mut self) {
        let between = self.last_arrival.saturating_duration_since(self.first_arrival);
        let intervals = u32::try_from(self.arrivals.saturating_sub(1)).unwrap_or(u32::MAX);
        let mean = between.checked_div(intervals).unwrap_or_default();
        self.end = self.last_answered.max(self.last_arrival + mean);
        self.energy.until(self.end);
    }

    /// Counts a frame with its final answer.
    pub(super) fn count(&mut self, frame: &FrameRecord) {
        let report = &mut self.report;
        report.frames += 1;
        report.states.count(frame.detections.state);
        report.degraded_frames += u64::from(frame.detections.degraded);
        self.total_ms.push(milliseconds(frame.first_answer) as f32);
        if let Some(detector_ms) = frame.times.latency.detector {
            self.detector_ms.push(detector_ms as f32);
        }
        if let Some(run) = frame.times.detector_run {
            report.detector_used_ms += milliseconds(run.used);
        }
    }

    pub(super) fn note_threshold(&mut self, seq: u64, threshold: Option<Threshold>) {
        let report = &mut self.report;
        if let Some(threshold) = threshold
            && report.threshold != Some(threshold)
        {
            if report.threshold_changes.len() == MOST_CHANGES {
                report.threshold_changes.pop();
            }
            report.threshold_changes.push(ThresholdChange { seq, threshold });
        }
        report.threshold = threshold;
    }

    /// Returns its energy after its end. Waits for the meter's next sample, at most one interval if the meter answers,
    /// and not at all without a meter. Await it off the path of frames.
    pub(crate) async fn energy(&self) -> Measured {
        let patience = match self.report.ended_by {
            ClipEnd::Shutdown => PATIENCE_AT_THE_END,
            _ => Duration::MAX,
        };
        self.energy.finish(self.end, patience).await.unwrap_or_default()
    }

    /// Creates the report, except for the names that the reporter adds. Sorts the latencies, which takes milliseconds
    /// for a long clip.
    pub(crate) fn into_report(self, measured: Measured) -> ClipReport {
        let duration = self.duration();
        let Self {
            mut report, travel, ..
        } = self;
        if let Some(audit) = &mut report.audit {
            let seconds = audit.detector_us as f64 / 1e6;
            audit.joules = measured.detector_watts.map(|watts| watts * seconds);
        }
        ClipReport {
            v: VERSION,
            id: new_id(),
            travel: travel.map(Travel::report),
            duration_s: duration.as_secs_f64(),
            skip_rate: report.states.skip_rate(report.degraded_frames),
            total_latency_ms: percentiles(self.total_ms),
            detector_latency_ms: percentiles(self.detector_ms),
            energy: ClipEnergy {
                edp: energy_delay_product(&measured.energy, duration, report.frames),
                ..measured.energy
            },
            board: measured.board,
            ..report
        }
    }
}

/// A unique report id with the present time. `Uuid::now_v7` would keep a later time after the clock was set back.
fn new_id() -> Uuid {
    let now_ns = unix_nanoseconds();
    let seconds = now_ns / 1_000_000_000;
    let nanoseconds = u32::try_from(now_ns % 1_000_000_000).unwrap_or(0);
    Uuid::new_v7(Timestamp::from_unix(NoContext, seconds, nanoseconds))
}

/// Energy-delay product, J·ms/frame: energy × duration ÷ frames (paper, evaluation). `None` without frames, or if
/// samples do not cover the whole clip: the energy would be that of a part of the time.
fn energy_delay_product(energy: &ClipEnergy, duration: Duration, frames: u64) -> Option<f64> {
    if frames == 0 {
        return None;
    }
    let joules = energy.whole_joules()?;
    Some(joules * duration.as_secs_f64() * 1e3 / frames as f64)
}

#[cfg(test)]
mod tests;
