use super::*;
use crate::camera::answer;
use crate::frame::{FrameRecord, Times};
use crate::state::board::UnreportedCounts;
use albireo_core::policy::{Albireo, FrameState};
use albireo_power::{Meter, MeterError, PowerHandle, Reading, Value, Values};
use albireo_wire::{AuditReport, ClipReport, DetectionsMessage, DroppedFrames, Latency, Threshold};
use proptest::prelude::*;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

pub(crate) async fn report(closed: Clip) -> ClipReport {
    let energy = closed.energy().await;
    closed.into_report(energy)
}

/// A meter of the whole machine whose reading at a time is what a function returns; `None`: no new one.
pub(crate) struct FakeMeter<F>(pub(crate) F);

impl<F: FnMut(Instant) -> Option<Value> + Send> Meter for FakeMeter<F> {
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let reading = |total| Reading {
            at: Some(now),
            values: Values {
                total: Some(total),
                ..Values::default()
            },
            total_from: "input_rail".into(),
            rails: Vec::new(),
        };
        Ok((self.0)(now).map(reading).into_iter().collect())
    }
}

pub(super) fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

const LONGEST_50_S: ClipConfig = ClipConfig {
    window_s: 40.0,
    longest_s: 50.0,
    silence_s: 5.0,
};

/// The tracker of one camera with its own clock, in milliseconds from its start.
pub(super) struct Camera {
    tracker: ClipTracker,
    start: Instant,
    seq: u64,
}

impl Camera {
    pub(super) fn new() -> Self {
        Self::with(ClipConfig::default())
    }

    fn with(config: ClipConfig) -> Self {
        Self {
            tracker: ClipTracker::new(config, PowerHandle::none().camera(), None, "albireo"),
            start: Instant::now(),
            seq: 0,
        }
    }

    fn at(&self, at: u64) -> Instant {
        self.start + ms(at)
    }

    fn tick(&mut self, at: u64) -> Option<Clip> {
        self.tracker.tick(self.at(at))
    }

    fn shutdown(&mut self, at: u64) -> Option<Clip> {
        self.tracker.shutdown(self.at(at))
    }

    #[track_caller]
    fn assert_ended(&self, closed: impl IntoIterator<Item = Clip>, expected: &str) {
        let mut shown = Vec::new();
        for closed in closed {
            let start = (closed.start - self.start).as_millis();
            let end = (closed.end - self.start).as_millis();
            let report = closed.report;
            assert_eq!(report.frames, report.states.frames());
            let clip = report.clip;
            let part = report.part;
            let frames = report.frames;
            let by = report.ended_by;
            shown.push(format!(
                "{clip}/{part}: {frames} frames, {start} to {end} ms, {by:?}"
            ));
        }
        assert_eq!(shown.join("; "), expected);
    }

    fn frame(&mut self, at: u64, clip: Option<&str>) -> Option<Clip> {
        self.frame_with(at, clip, 3e-4)
    }

    /// That many frames of a clip, the first at 0, and the clips that they end.
    pub(super) fn frames(&mut self, count: u64, every: u64, clip: Option<&str>) -> Vec<Clip> {
        let mut closed = Vec::new();
        for frame in 0..count {
            closed.extend(self.frame(frame * every, clip));
        }
        closed
    }

    fn frame_with(&mut self, at: u64, clip: Option<&str>, u: f64) -> Option<Clip> {
        let seq = self.seq;
        self.seq += 1;
        let arrival = self.at(at);
        let closed = self.tracker.arrive(at * 1_000_000, clip, arrival);
        self.tracker.count(&self.record(at, seq, u));
        closed
    }

    /// The record of a frame that arrives at `at` under the threshold `u`; its state is drawn from its number.
    fn record(&self, at: u64, seq: u64, u: f64) -> FrameRecord {
        let state = FrameState::ALL[(seq % 5) as usize];
        let message = DetectionsMessage {
            degraded: state == FrameState::P && seq.is_multiple_of(7),
            threshold: Some(Threshold::new(Albireo::THRESHOLD.name, u)),
            ..answer(seq, state)
        };
        FrameRecord {
            answered: self.at(at) + ms(12),
            times: Times {
                latency: Latency {
                    detector: (!state.is_skipped()).then_some(10.0),
                    ..Latency::default()
                },
                ..Times::default()
            },
            ..FrameRecord::new(Arc::new(message), ms(12))
        }
    }
}

#[test]
fn a_new_clip_id_ends_the_clip_at_the_new_clips_first_frame() {
    let mut camera = Camera::new();
    assert!(camera.frames(20, 100, Some("a")).is_empty());
    let closed = camera.frame(2000, Some("b"));
    camera.assert_ended(closed, "a/0: 20 frames, 0 to 2000 ms, NextClip");
    assert_eq!(&**camera.tracker.clip().unwrap(), "b");
    assert_eq!(camera.tracker.deadline(), Some(camera.at(7000)));
}

#[test]
fn windows_and_parts_of_a_long_clip_tile_time_while_frames_keep_coming() {
    let windows = "window-0/0: 361 frames, 0 to 40000 ms, Window; \
                   window-1/0: 360 frames, 40000 to 80000 ms, Window; \
                   window-2/0: 361 frames, 80000 to 120000 ms, Window; \
                   window-3/0: 118 frames, 120000 to 133200 ms, Shutdown";
    let parts = "drive/0: 451 frames, 0 to 50000 ms, Length; \
                 drive/1: 450 frames, 50000 to 100000 ms, Length; \
                 drive/2: 299 frames, 100000 to 133200 ms, Shutdown";
    for (clip, expected) in [(None, windows), (Some("drive"), parts)] {
        let mut camera = Camera::with(LONGEST_50_S);
        let mut closed = camera.frames(1200, 111, clip);
        closed.extend(camera.shutdown(133_500));
        camera.assert_ended(closed, expected);
    }
}

#[test]
fn a_clip_has_the_frames_of_one_policy_and_the_next_part_begins_where_it_ended() {
    let windows = "window-0/0: 10 frames, 0 to 1000 ms, Policy; window-1/0: 1 frames, 1000 to 1012 ms, Shutdown";
    let parts =
        "drive/0: 10 frames, 0 to 1000 ms, Policy; drive/1: 1 frames, 1000 to 1012 ms, Shutdown";
    for (clip, expected) in [(None, windows), (Some("drive"), parts)] {
        let mut camera = Camera::new();
        camera.frames(10, 100, clip);
        let mut closed = Vec::from_iter(camera.tracker.switch("vanilla", camera.at(1000)));
        camera.frame(1000, clip);
        closed.extend(camera.shutdown(1200));
        let policies: Vec<_> = closed.iter().map(|one| one.report.policy.as_str()).collect();
        assert_eq!(policies, ["albireo", "vanilla"]);
        camera.assert_ended(closed, expected);
    }
    // A camera that was silent has ended its clip before the switch reaches it.
    let mut camera = Camera::new();
    camera.frames(10, 100, Some("drive"));
    let closed = camera.tracker.switch("vanilla", camera.at(60_000));
    camera.assert_ended(closed, "drive/0: 10 frames, 0 to 1000 ms, Silence");
}

#[test]
fn the_clock_ends_a_full_window_and_a_silent_clip_without_another_frame() {
    let window = "window-0/0: 191 frames, 0 to 40000 ms, Window";
    // Ten frames at 5 per second: the silence is not part of the clip.
    let silence = "a/0: 10 frames, 0 to 2000 ms, Silence";
    for (clip, frames, every, deadline, expected) in [
        (None, 191, 210, 40_000, window),
        (Some("a"), 10, 200, 6800, silence),
    ] {
        let mut camera = Camera::new();
        assert!(camera.frames(frames, every, clip).is_empty());
        assert_eq!(camera.tracker.deadline(), Some(camera.at(deadline)));
        assert!(camera.tick(deadline - 1).is_none());
        let closed = camera.tick(deadline);
        camera.assert_ended(closed, expected);
        assert!(camera.tracker.clip().is_none());
    }
}

#[test]
fn after_a_pause_a_new_clip_begins_at_its_first_frame() {
    let short_window = ClipConfig {
        window_s: 2.0,
        ..ClipConfig::default()
    };
    // One frame lasts as long as its answer took.
    let silent = "window-0/0: 1 frames, 0 to 12 ms, Silence; \
                  window-1/0: 1 frames, 60000 to 60012 ms, Shutdown";
    let full_window = "window-0/0: 20 frames, 0 to 2000 ms, Window; \
                       window-1/0: 1 frames, 6000 to 6012 ms, Shutdown";
    let full_part = "drive/0: 500 frames, 0 to 50000 ms, Length; \
                     drive/0: 1 frames, 60000 to 60012 ms, Shutdown";
    for (config, clip, frames, next, expected) in [
        (LONGEST_50_S, None, 1, 60_000, silent),
        // Longer than the window, but shorter than the silence that ends a clip.
        (short_window, None, 20, 6000, full_window),
        (LONGEST_50_S, Some("drive"), 500, 60_000, full_part),
    ] {
        let mut camera = Camera::with(config);
        let mut closed = camera.frames(frames, 100, clip);
        closed.extend(camera.tick(frames * 100));
        closed.extend(camera.frame(next, clip));
        closed.extend(camera.shutdown(next + 100));
        camera.assert_ended(closed, expected);
    }
}

#[test]
fn a_clip_is_returned_when_its_pending_frame_has_its_final_answer() {
    let mut camera = Camera::new();
    camera.frame(0, Some("a"));
    camera.tracker.arrive(0, Some("a"), camera.at(100));
    let threshold = |u| Some(Threshold::new(Albireo::THRESHOLD.name, u));
    camera.tracker.pending(1, threshold(3e-4));
    // The next clip begins, and its frames are its own.
    assert!(camera.frame_with(200, Some("b"), 5e-4).is_none());
    let late = camera.record(300, 1, 3e-4);
    let closed = camera.tracker.count_late(&late).expect("clip a has ended");
    assert_eq!(closed.report.threshold, threshold(3e-4));
    camera.assert_ended([closed], "a/0: 2 frames, 0 to 200 ms, NextClip");
    let closed = camera.shutdown(400).unwrap();
    assert_eq!(closed.report.threshold_changes.len(), 1);
    camera.assert_ended([closed], "b/0: 1 frames, 200 to 212 ms, Shutdown");
}

#[test]
fn the_initial_threshold_and_each_change_are_reported_once_within_a_bound() {
    let changes_of = |thresholds: &mut dyn Iterator<Item = f64>| {
        let mut camera = Camera::new();
        for u in thresholds {
            camera.frame_with(camera.seq * 10, Some("a"), u);
        }
        let report = camera.shutdown(50_000).unwrap().report;
        let last = report.threshold.unwrap().value;
        assert_eq!(
            report.threshold_changes.last().unwrap().threshold.value,
            last
        );
        report
            .threshold_changes
            .into_iter()
            .map(|change| (change.seq, change.threshold.value))
            .collect::<Vec<_>>()
    };
    let few = changes_of(&mut [3e-4, 3e-4, 5e-4, 5e-4, 3e-4].into_iter());
    assert_eq!(few, [(0, 3e-4), (2, 5e-4), (4, 3e-4)]);
    let many = changes_of(&mut (0..5000).map(f64::from));
    assert_eq!(many.len(), 256);
    assert_eq!(many[255], (4999, 4999.0));
}

#[derive(Clone, Debug)]
enum Event {
    Frame { wait: u64, clip: Option<u8> },
    Dropped { lost: u64, late: u64 },
    Tick { wait: u64 },
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    let wait = prop_oneof![8 => 0..400_u64, 1 => 3_000..60_000_u64];
    prop::collection::vec(
        prop_oneof![
            6 => (wait.clone(), prop::option::of(0..3_u8))
                .prop_map(|(wait, clip)| Event::Frame { wait, clip }),
            1 => (0..5_u64, 0..5_u64).prop_map(|(lost, late)| Event::Dropped { lost, late }),
            1 => wait.prop_map(|wait| Event::Tick { wait }),
        ],
        0..400,
    )
}

proptest! {
    #[test]
    fn no_frame_is_lost_between_clips_and_no_time_is_counted_twice(events in events()) {
        let mut camera = Camera::with(LONGEST_50_S);
        let mut closed: Vec<Clip> = Vec::new();
        let mut now = 0;
        let mut frames = 0;
        let mut dropped = 0;
        for event in events {
            match event {
                Event::Frame { wait, clip } => {
                    now += wait;
                    frames += 1;
                    let name = clip.map(|number| format!("clip-{number}"));
                    closed.extend(camera.frame(now, name.as_deref()));
                    let open = camera.tracker.clip().unwrap();
                    match name {
                        Some(name) => prop_assert_eq!(&**open, name),
                        None => prop_assert!(open.starts_with("window-")),
                    }
                }
                Event::Dropped { lost, late } => {
                    let unreported = UnreportedCounts {
                        dropped: DroppedFrames { lost, late, ..DroppedFrames::default() },
                        audit: AuditReport::default(),
                    };
                    camera.tracker.count_unreported(&unreported);
                    if camera.tracker.clip().is_some() {
                        dropped += lost + late;
                    }
                }
                Event::Tick { wait } => {
                    now += wait;
                    closed.extend(camera.tick(now));
                }
            }
        }
        closed.extend(camera.shutdown(now));
        prop_assert!(camera.shutdown(now).is_none());
        let total = |count: fn(&Clip) -> u64| closed.iter().map(count).sum::<u64>();
        prop_assert_eq!(total(|clip| clip.report.states.frames()), frames);
        prop_assert_eq!(total(|clip| clip.report.dropped.total()), dropped);
        prop_assert_eq!(total(|clip| clip.total_ms.len() as u64), frames);
        let times = closed.iter().flat_map(|clip| [clip.start, clip.end]);
        prop_assert!(times.chain([camera.at(now)]).is_sorted());
    }
}
