//! The clip tracker ends clips and counts frames.

use super::*;
use crate::camera::evidence::Times;
use crate::camera::{FrameRecord, answer};
use albireo_core::policy::Albireo;
use albireo_core::policy::FrameState;
use albireo_power::{Meter, MeterError, PowerHandle, Reading, Value};
use albireo_wire::{AuditReport, ClipReport, DroppedFrames, Latency, Threshold};
use proptest::prelude::*;
use std::time::Duration;
use tokio::time::Instant;

/// The report of a clip that has ended.
pub(crate) async fn report(closed: Clip) -> ClipReport {
    let energy = closed.energy().await;
    closed.into_report(energy)
}

/// A meter of the whole machine whose reading at a time is what a function returns; `None`: no new one.
pub(crate) struct FakeMeter<F>(pub(crate) F);

impl<F: FnMut(Instant) -> Option<Value> + Send> Meter for FakeMeter<F> {
    fn source(&self) -> &str {
        "fake"
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let reading = |total| Reading {
            at: Some(now),
            values: [Some(total), None, None, None],
            total_from: "input_rail".into(),
            rails: Vec::new(),
        };
        Ok((self.0)(now).map(reading).into_iter().collect())
    }
}

pub(super) fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// The tracker of one camera with its own clock, in milliseconds from its start.
pub(super) struct Camera {
    pub(super) tracker: ClipTracker,
    start: Instant,
    seq: u64,
}

impl Camera {
    pub(super) fn new() -> Self {
        Self::with(ClipConfig::default())
    }

    fn with(config: ClipConfig) -> Self {
        Self {
            tracker: ClipTracker::new(config, PowerHandle::none().camera(), None),
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

    /// Asserts the clips that have ended.
    #[track_caller]
    fn assert_ended(&self, closed: impl IntoIterator<Item = Clip>, expected: &str) {
        let shown = closed.into_iter().map(|closed| {
            let Clip {
                report, start, end, ..
            } = closed;
            assert_eq!(report.frames, report.states.frames());
            let [start, end] = [start, end].map(|at| (at - self.start).as_millis());
            let (clip, part, frames) = (report.clip, report.part, report.frames);
            format!(
                "{clip}/{part}: {frames} frames, {start} to {end} ms, {:?}",
                report.ended_by
            )
        });
        assert_eq!(shown.collect::<Vec<_>>().join("; "), expected);
    }

    pub(super) fn frame(&mut self, at: u64, clip: Option<&str>) -> Option<Clip> {
        self.frame_with(at, clip, Some(3e-4))
    }

    fn frame_with(&mut self, at: u64, clip: Option<&str>, u: Option<f64>) -> Option<Clip> {
        let seq = self.seq;
        self.seq += 1;
        let arrival = self.at(at);
        let closed = self.tracker.arrive(at * 1_000_000, clip, arrival);
        self.tracker.count(&self.result(at, seq, u));
        closed
    }

    fn result(&self, at: u64, seq: u64, u: Option<f64>) -> FrameRecord {
        let state = FrameState::ALL[(seq % 5) as usize];
        let degraded = state == FrameState::P && seq.is_multiple_of(7);
        let threshold = u.map(|u| Threshold::new(Albireo::THRESHOLD.name, u));
        FrameRecord {
            answered: self.at(at) + ms(12),
            times: Times {
                latency: Latency {
                    detector: (!state.is_skipped()).then_some(10.0),
                    ..Latency::default()
                },
                ..Times::default()
            },
            ..FrameRecord::new(answer(seq, state, degraded, threshold), ms(12))
        }
    }
}

#[test]
fn a_new_clip_id_ends_the_clip_at_the_new_clips_first_frame() {
    let mut camera = Camera::new();
    for i in 0..20 {
        assert!(camera.frame(i * 100, Some("a")).is_none());
    }
    let closed = camera.frame(2000, Some("b"));
    camera.assert_ended(closed, "a/0: 20 frames, 0 to 2000 ms, NextClip");
    assert_eq!(&**camera.tracker.clip().unwrap(), "b");
    assert_eq!(camera.tracker.deadline(), Some(camera.at(7000)));
}

#[test]
fn windows_tile_time_while_frames_keep_coming() {
    let mut camera = Camera::new();
    let closed: Vec<_> = (0..900)
        .filter_map(|i| camera.frame(i * 111, None))
        .collect();
    let expected = "window-0/0: 361 frames, 0 to 40000 ms, Window; \
                    window-1/0: 360 frames, 40000 to 80000 ms, Window";
    camera.assert_ended(closed, expected);
}

#[test]
fn a_full_window_ends_at_its_deadline_without_waiting_for_a_frame() {
    let mut camera = Camera::new();
    for i in 0..=190 {
        camera.frame(i * 210, None);
    }
    assert_eq!(camera.tracker.deadline(), Some(camera.at(40_000)));
    assert!(camera.tick(39_999).is_none());
    let closed = camera.tick(40_000);
    camera.assert_ended(closed, "window-0/0: 191 frames, 0 to 40000 ms, Window");
    assert!(camera.tracker.clip().is_none());
}

#[test]
fn silence_ends_a_clip_and_is_not_part_of_it() {
    let mut camera = Camera::new();
    for i in 0..10 {
        camera.frame(i * 200, Some("a"));
    }
    assert!(camera.tick(6799).is_none());
    let closed = camera.tick(6800);
    // Ten frames at 5 per second.
    camera.assert_ended(closed, "a/0: 10 frames, 0 to 2000 ms, Silence");
}

#[test]
fn a_frame_after_silence_begins_a_new_window_at_its_own_arrival() {
    let mut camera = Camera::new();
    camera.frame(0, None);
    let closed = camera.frame(60_000, None);
    // One frame lasts as long as its answer took.
    camera.assert_ended(closed, "window-0/0: 1 frames, 0 to 12 ms, Silence");
    let closed = camera.shutdown(60_050);
    camera.assert_ended(closed, "window-1/0: 1 frames, 60000 to 60012 ms, Shutdown");
}

#[test]
fn a_window_shorter_than_a_pause_never_ends_before_its_first_frame() {
    let mut camera = Camera::with(ClipConfig {
        window_s: 2.0,
        ..ClipConfig::default()
    });
    for at in [0, 1000, 1900] {
        assert!(camera.frame(at, None).is_none());
    }
    let closed = camera.tick(2000);
    camera.assert_ended(closed, "window-0/0: 3 frames, 0 to 2000 ms, Window");
    assert!(camera.frame(6000, None).is_none());
    let closed = camera.shutdown(6100);
    camera.assert_ended(closed, "window-1/0: 1 frames, 6000 to 6012 ms, Shutdown");
}

#[test]
fn a_long_clip_is_reported_in_parts_that_tile_its_time() {
    let mut camera = Camera::with(ClipConfig {
        longest_s: 60.0,
        ..ClipConfig::default()
    });
    let closed = (0..1500).filter_map(|i| camera.frame(i * 100, Some("drive")));
    let mut closed: Vec<_> = closed.collect();
    closed.extend(camera.shutdown(150_000));
    let expected = "drive/0: 600 frames, 0 to 60000 ms, Length; \
                    drive/1: 600 frames, 60000 to 120000 ms, Length; \
                    drive/2: 300 frames, 120000 to 150000 ms, Shutdown";
    camera.assert_ended(closed, expected);
}

#[test]
fn a_name_that_returns_after_a_silence_is_a_new_clip() {
    let mut camera = Camera::with(ClipConfig {
        longest_s: 60.0,
        ..ClipConfig::default()
    });
    for i in 0..600 {
        assert!(camera.frame(i * 100, Some("drive")).is_none());
    }
    let closed = camera.tick(60_000);
    camera.assert_ended(closed, "drive/0: 600 frames, 0 to 60000 ms, Length");
    assert!(camera.frame(70_000, Some("drive")).is_none());
    let closed = camera.shutdown(70_100);
    camera.assert_ended(closed, "drive/0: 1 frames, 70000 to 70012 ms, Shutdown");
}

#[test]
fn shutdown_ends_the_open_clip_and_only_that() {
    let mut camera = Camera::new();
    assert!(camera.shutdown(0).is_none());
    camera.frame(0, Some("a"));
    camera.frame(100, Some("a"));
    let closed = camera.shutdown(150);
    // No clip ends in the future.
    camera.assert_ended(closed, "a/0: 2 frames, 0 to 150 ms, Shutdown");
    assert!(camera.shutdown(200).is_none());
}

#[test]
fn a_clip_is_returned_when_its_pending_frame_has_its_final_answer() {
    let mut camera = Camera::new();
    camera.frame(0, Some("a"));
    camera.tracker.arrive(0, Some("a"), camera.at(100));
    let u = |u| Some(Threshold::new(Albireo::THRESHOLD.name, u));
    camera.tracker.pending(1, u(3e-4));
    // The next clip begins, and its frames are its own.
    assert!(camera.frame_with(200, Some("b"), Some(5e-4)).is_none());
    let late = camera.result(300, 1, Some(3e-4));
    let closed = camera.tracker.count_late(&late).expect("clip a has ended");
    assert_eq!(closed.report.threshold, u(3e-4));
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
            camera.frame_with(camera.seq * 10, Some("a"), Some(u));
        }
        let report = camera.shutdown(50_000).unwrap().report;
        let last = report.threshold.unwrap().value;
        let changes = report.threshold_changes.into_iter();
        let changes: Vec<_> = changes.map(|c| (c.seq, c.threshold.value)).collect();
        assert_eq!(changes.last().unwrap().1, last);
        changes
    };
    let few = changes_of(&mut [3e-4, 3e-4, 5e-4, 5e-4, 3e-4].into_iter());
    assert_eq!(few, [(0, 3e-4), (2, 5e-4), (4, 3e-4)]);
    let many = changes_of(&mut (0..5000).map(f64::from));
    assert_eq!((many.len(), many[255]), (256, (4999, 4999.0)));
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
        let mut camera = Camera::with(ClipConfig {
            longest_s: 50.0,
            ..ClipConfig::default()
        });
        let mut closed: Vec<Clip> = Vec::new();
        let (mut now, mut frames, mut dropped) = (0, 0, 0);
        for event in events {
            match event {
                Event::Frame { wait, clip } => {
                    now += wait;
                    frames += 1;
                    let name = clip.map(|c| format!("clip-{c}"));
                    closed.extend(camera.frame(now, name.as_deref()));
                    let open = camera.tracker.clip().map(|c| c.to_string());
                    match name {
                        Some(name) => prop_assert_eq!(open, Some(name)),
                        None => prop_assert!(open.is_some_and(|o| o.starts_with("window-"))),
                    }
                }
                Event::Dropped { lost, late } => {
                    let more = DroppedFrames { lost, late, ..DroppedFrames::default() };
                    camera.tracker.count_others(&more, &AuditReport::default());
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
        prop_assert_eq!(closed.iter().map(|c| c.report.states.frames()).sum::<u64>(), frames);
        prop_assert_eq!(closed.iter().map(|c| c.report.dropped.total()).sum::<u64>(), dropped);
        prop_assert_eq!(closed.iter().map(|c| c.total.len() as u64).sum::<u64>(), frames);
        for clip in &closed {
            prop_assert!(clip.start <= clip.end);
            prop_assert!(clip.end <= camera.at(now));
        }
        for pair in closed.windows(2) {
            prop_assert!(pair[0].end <= pair[1].start);
        }
    }
}
