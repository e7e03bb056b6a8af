//! Begins and ends clips, and counts the frames in between.
//!
//! A clip named by the camera ends when the camera names another, and is reported in parts of at most `longest_s`.
//! Otherwise clips are windows of `window_s`. While frames keep coming, a window or a part begins where the last one
//! ended, so that no time and no energy is lost in between. Every clip also ends after `silence_s` without a frame, and
//! on shutdown; its end is then one mean frame interval after the arrival of its last frame (or the time when that
//! frame was answered, if later), so the silence is not charged to it. A clip has the frames of one policy: a switch ends the
//! part or window, and the next begins there.

use super::ClipConfig;
use super::report::Clip;
use super::travel::Travel;
use crate::frame::FrameRecord;
use crate::state::board::UnreportedCounts;
use albireo_power::CameraEnergy;
use albireo_wire::{AuditReport, ClipEnd, ClipReport, Position, Threshold};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Counts the open clip of one camera.
#[derive(Debug)]
pub(crate) struct ClipTracker {
    energy: CameraEnergy,
    /// The audit of a new clip, if there is one.
    audit: Option<AuditReport>,
    window: Duration,
    longest: Duration,
    silence: Duration,
    /// The name of the policy that decides the frames.
    policy: &'static str,
    windows: u64,
    open: Option<Clip>,
    /// A clip that ended before the final answer of its last frame.
    ended: Option<Clip>,
    /// The last window or part that ended because it was full, or by a switch of the policy: the next begins at its end if
    /// frames keep coming.
    interrupted: Option<InterruptedClip>,
}

/// A window or a part that is continued by the next one.
#[derive(Debug)]
struct InterruptedClip {
    /// The camera's name for it; `None` for a window.
    named: Option<Arc<str>>,
    part: u32,
    end: Instant,
}

impl ClipTracker {
    /// Creates a tracker without a clip. `energy` is the camera's energy, `audit` the audit of a new clip, and `policy` decides
    /// the frames.
    pub(crate) fn new(
        config: ClipConfig,
        energy: CameraEnergy,
        audit: Option<AuditReport>,
        policy: &'static str,
    ) -> Self {
        let seconds = |s: f64| Duration::try_from_secs_f64(s.max(0.001)).unwrap_or(Duration::MAX);
        Self {
            energy,
            audit,
            window: seconds(config.window_s),
            longest: seconds(config.longest_s),
            silence: seconds(config.silence_s),
            policy,
            windows: 0,
            open: None,
            ended: None,
            interrupted: None,
        }
    }

    /// Adds unprocessed frames and audit results to the open clip, if there is one.
    pub(crate) fn count_unreported(&mut self, unreported: &UnreportedCounts) {
        let Some(open) = &mut self.open else { return };
        open.report.dropped += &unreported.dropped;
        if let Some(audit) = &mut open.report.audit {
            audit.merge(&unreported.audit);
        }
    }

    /// Records a frame about to be processed, with its capture time, clip (if the camera names one) and arrival. It
    /// belongs to the clip that is open afterwards ([`clip`](Self::clip)). Returns the clip that ended before it.
    pub(crate) fn arrive(
        &mut self,
        t_ns: u64,
        clip: Option<&str>,
        arrival: Instant,
    ) -> Option<Clip> {
        let closed = self.close_before(clip, arrival);
        self.energy.frame();
        match &mut self.open {
            Some(open) => {
                open.arrivals += 1;
                open.last_arrival = open.last_arrival.max(arrival);
                open.move_end();
            }
            None => self.begin(t_ns, clip, arrival),
        }
        closed
    }

    /// Adds the position of the frame that has arrived, with its capture time and arrival.
    pub(crate) fn locate(&mut self, position: Position, t_ns: u64, arrival: Instant) {
        let Some(open) = &mut self.open else { return };
        match &mut open.travel {
            Some(travel) => travel.add(position, t_ns, arrival),
            None => open.travel = Some(Travel::new(position, t_ns, arrival)),
        }
    }

    /// Marks the last frame, with sequence number `seq` and this threshold, as pending: its final answer comes with
    /// [`count_late`](Self::count_late), and its clip is not returned before that. At most one frame is pending at a
    /// time.
    pub(crate) fn pending(&mut self, seq: u64, threshold: Option<Threshold>) {
        if let Some(open) = &mut self.open {
            open.is_pending = true;
            open.note_threshold(seq, threshold);
        }
    }

    /// Counts the outcome of the last frame.
    pub(crate) fn count(&mut self, frame: &FrameRecord) {
        self.count_energy(frame);
        if let Some(open) = &mut self.open {
            let answer = &frame.detections;
            open.note_threshold(answer.seq, answer.threshold);
        }
        self.count_in_open(frame);
    }

    /// Counts the outcome of the pending frame. Returns its clip if that has ended.
    pub(crate) fn count_late(&mut self, frame: &FrameRecord) -> Option<Clip> {
        self.count_energy(frame);
        match &mut self.ended {
            Some(ended) => ended.count(frame),
            None => self.count_in_open(frame),
        }
        self.nothing_is_pending()
    }

    /// Ends waiting for the pending frame, which gets no answer. Returns its clip if that has ended.
    pub(crate) fn nothing_is_pending(&mut self) -> Option<Clip> {
        if let Some(open) = &mut self.open {
            open.is_pending = false;
        }
        self.ended.take()
    }

    fn count_in_open(&mut self, frame: &FrameRecord) {
        if let Some(open) = &mut self.open {
            open.count(frame);
            open.last_answered = open.last_answered.max(frame.answered);
            open.move_end();
        }
    }

    fn count_energy(&self, frame: &FrameRecord) {
        if let Some(run) = frame.times.detector_run {
            self.energy.detector_called(run.end, run.used);
        }
        if frame.detections.skipped_detector() {
            self.energy.call_avoided();
        }
    }

    /// The clip of the last frame.
    pub(crate) fn clip(&self) -> Option<&Arc<str>> {
        self.open.as_ref().map(|open| &open.name)
    }

    /// The time to call [`tick`](Self::tick) if no frame arrives before.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        let open = self.open.as_ref()?;
        Some(self.silent_at(open).min(self.full_at(open)))
    }

    /// The time at which the camera of an open clip has been silent for long enough, if no frame arrives before.
    fn silent_at(&self, open: &Clip) -> Instant {
        open.last_arrival + self.silence
    }

    /// The time at which an open window or part is full.
    fn full_at(&self, open: &Clip) -> Instant {
        open.start + self.limit(open.is_window)
    }

    /// The longest duration of a window, or of a part of another clip.
    const fn limit(&self, is_window: bool) -> Duration {
        if is_window { self.window } else { self.longest }
    }

    /// Ends the clip if its window or part is full or its camera has been silent for long enough. Call it only
    /// while no frame is being processed.
    pub(crate) fn tick(&mut self, now: Instant) -> Option<Clip> {
        let open = self.open.as_ref()?;
        let full_at = self.full_at(open);
        let silent_at = self.silent_at(open);
        // A camera that stopped before ends the clip by its silence, not by the clock.
        if now >= full_at && full_at <= silent_at {
            let ended_by = if open.is_window {
                ClipEnd::Window
            } else {
                ClipEnd::Length
            };
            return self.close(ended_by, full_at);
        }
        if now >= silent_at {
            let end = open.end.min(now);
            return self.close(ClipEnd::Silence, end);
        }
        None
    }

    /// Ends the open clip because the node stops.
    pub(crate) fn shutdown(&mut self, now: Instant) -> Option<Clip> {
        let end = self.open.as_ref()?.end.min(now);
        self.close(ClipEnd::Shutdown, end)
    }

    /// Ends the open clip before a frame with this arrival, because `policy` decides from there on. Call it only while no
    /// frame is being processed.
    pub(crate) fn switch(&mut self, policy: &'static str, arrival: Instant) -> Option<Clip> {
        self.policy = policy;
        if let Some(closed) = self.tick(arrival) {
            return Some(closed);
        }
        let end = arrival.max(self.open.as_ref()?.last_arrival);
        self.close(ClipEnd::Policy, end)
    }

    /// Ends the open clip if it is over when a frame of `clip` arrives, or if the frame belongs to another clip.
    fn close_before(&mut self, clip: Option<&str>, arrival: Instant) -> Option<Clip> {
        if let Some(closed) = self.tick(arrival) {
            return Some(closed);
        }
        let open = self.open.as_ref()?;
        let is_same_clip = match clip {
            Some(clip) => !open.is_window && clip == &*open.name,
            None => open.is_window,
        };
        if is_same_clip {
            return None;
        }
        let end = arrival.max(open.last_arrival);
        self.close(ClipEnd::NextClip, end)
    }

    fn begin(&mut self, t_ns: u64, clip: Option<&str>, arrival: Instant) {
        let is_window = clip.is_none();
        // It is continued if frames keep coming, and its successor must not be over before the frame arrived.
        let longest_gap = self.silence.min(self.limit(is_window));
        let mut start = arrival;
        let mut part = 0;
        let interrupted = self.interrupted.take();
        if let Some(before) = interrupted
            && before.named.as_deref() == clip
            && arrival.saturating_duration_since(before.end) < longest_gap
        {
            start = before.end;
            if !is_window {
                part = before.part.saturating_add(1);
            }
        }
        let name = match clip {
            Some(clip) => clip.to_owned(),
            None => {
                let name = format!("window-{}", self.windows);
                self.windows += 1;
                name
            }
        };
        let first_arrival = arrival.max(start);
        let energy = self.energy.measure(start);
        energy.until(first_arrival);
        self.open = Some(Clip {
            report: ClipReport {
                clip: name.clone(),
                part,
                started_ns: t_ns,
                audit: self.audit.clone(),
                policy: self.policy.to_owned(),
                ..ClipReport::default()
            },
            start,
            end: first_arrival,
            total_ms: Vec::new(),
            detector_ms: Vec::new(),
            energy,
            name: name.into(),
            is_window,
            first_arrival,
            last_arrival: first_arrival,
            last_answered: first_arrival,
            arrivals: 1,
            is_pending: false,
            travel: None,
        });
    }

    fn close(&mut self, ended_by: ClipEnd, end: Instant) -> Option<Clip> {
        let mut open = self.open.take()?;
        open.report.ended_by = ended_by;
        open.end = end;
        let named = if open.is_window {
            None
        } else {
            Some(Arc::clone(&open.name))
        };
        self.interrupted = match ended_by {
            ClipEnd::Window | ClipEnd::Length | ClipEnd::Policy => Some(InterruptedClip {
                named,
                part: open.report.part,
                end,
            }),
            _ => None,
        };
        if open.is_pending {
            self.ended = Some(open);
            return None;
        }
        Some(open)
    }
}
