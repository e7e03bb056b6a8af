//! Promises of the clip's tracker.

use super::*;
use crate::camera::evidence::Times;
use crate::camera::{FrameRecord, answer};
use albireo_core::policy::Albireo;
use albireo_core::policy::FrameState;
use albireo_power::PowerHandle;
use albireo_wire::{ClipEnd, ClipReport, DroppedFrames, Threshold};
use proptest::prelude::*;
use std::time::Duration;
use tokio::time::Instant;

/// The report of a clip that has ended.
pub(crate) async fn report(closed: Clip) -> ClipReport {
    let energy = closed.energy().await;
    closed.into_report(energy)
}

pub(super) fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// The tracker of one camera with a clock of its own, in milliseconds from its start.
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
            tracker: ClipTracker::new(config, PowerHandle::none().camera("front"), None),
            start: Instant::now(),
            seq: 0,
        }
    }

    fn at(&self, at: u64) -> Instant {
        self.start + ms(at)
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
        let threshold = u.map(|u| Threshold::new(Albireo::KNOB.name, u));
        FrameRecord {
            answered: self.at(at) + ms(12),
            times: Times {
                detector: (!state.is_skipped()).then_some(ms(10)),
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
    let closed = camera.frame(2000, Some("b")).unwrap();
    assert_eq!(
        (&*closed.report.clip, closed.report.ended_by),
        ("a", ClipEnd::NextClip)
    );
    assert_eq!(closed.report.states.frames(), 20);
    assert_eq!(closed.duration(), ms(2000));
    assert_eq!(&**camera.tracker.clip().unwrap(), "b");
    assert_eq!(camera.tracker.deadline(), Some(camera.at(7000)));
}

#[test]
fn windows_tile_time_while_frames_keep_coming() {
    let mut camera = Camera::new();
    let mut closed = Vec::new();
    for i in 0..900 {
        closed.extend(camera.frame(i * 111, None));
    }
    assert_eq!(closed.len(), 2);
    for (i, clip) in closed.iter().enumerate() {
        assert_eq!(clip.report.clip, format!("window-{i}"));
        assert_eq!(clip.report.ended_by, ClipEnd::Window);
        assert_eq!(clip.duration(), ms(40_000));
    }
    assert_eq!(closed[0].end, closed[1].start);
    assert_eq!(closed[0].report.states.frames(), 361);
}

#[test]
fn a_full_window_ends_at_its_deadline_without_waiting_for_a_frame() {
    let mut camera = Camera::new();
    for i in 0..=190 {
        camera.frame(i * 210, None);
    }
    let deadline = camera.tracker.deadline().unwrap();
    assert_eq!(deadline, camera.at(40_000));
    assert!(camera.tracker.tick(deadline - ms(1)).is_none());
    let closed = camera.tracker.tick(deadline).unwrap();
    assert_eq!(
        (closed.report.ended_by, closed.end),
        (ClipEnd::Window, deadline)
    );
    assert!(camera.tracker.clip().is_none());
}

#[test]
fn silence_ends_a_clip_and_is_not_charged_to_it() {
    let mut camera = Camera::new();
    for i in 0..10 {
        camera.frame(i * 200, Some("a"));
    }
    assert!(camera.tracker.tick(camera.at(6799)).is_none());
    let closed = camera.tracker.tick(camera.at(6800)).unwrap();
    assert_eq!(closed.report.ended_by, ClipEnd::Silence);
    assert_eq!(closed.duration(), ms(2000), "ten frames at five a second");
}

#[test]
fn a_frame_after_silence_begins_a_new_window_at_its_own_arrival() {
    let mut camera = Camera::new();
    camera.frame(0, None);
    let closed = camera.frame(60_000, None).unwrap();
    assert_eq!(closed.report.ended_by, ClipEnd::Silence);
    assert_eq!(
        closed.duration(),
        ms(12),
        "one frame lasts as long as its answer took"
    );
    let closed = camera.tracker.shutdown(camera.at(60_050)).unwrap();
    assert_eq!(
        (&*closed.report.clip, closed.start),
        ("window-1", camera.at(60_000))
    );
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
    let closed = camera.tracker.tick(camera.at(2000)).unwrap();
    assert_eq!(
        (closed.report.ended_by, closed.end),
        (ClipEnd::Window, camera.at(2000))
    );
    assert!(camera.frame(6000, None).is_none());
    let closed = camera.tracker.shutdown(camera.at(6100)).unwrap();
    assert_eq!(closed.start, camera.at(6000));
    assert!(closed.end >= camera.at(6000));
}

#[test]
fn a_long_clip_is_reported_in_parts_that_tile_its_time() {
    let mut camera = Camera::with(ClipConfig {
        longest_s: 60.0,
        ..ClipConfig::default()
    });
    let mut closed = Vec::new();
    for i in 0..1500 {
        closed.extend(camera.frame(i * 100, Some("drive")));
    }
    closed.extend(camera.tracker.shutdown(camera.at(150_000)));
    let told: Vec<_> = (closed.iter())
        .map(|part| {
            (
                &*part.report.clip,
                part.report.part,
                part.report.ended_by,
                part.duration(),
            )
        })
        .collect();
    assert_eq!(
        told,
        [
            ("drive", 0, ClipEnd::Length, ms(60_000)),
            ("drive", 1, ClipEnd::Length, ms(60_000)),
            ("drive", 2, ClipEnd::Shutdown, ms(30_000)),
        ]
    );
    assert_eq!(closed[0].end, closed[1].start);
    assert_eq!(closed[1].end, closed[2].start);
    let frames: u64 = closed.iter().map(|part| part.report.states.frames()).sum();
    assert_eq!(frames, 1500);
}

#[test]
fn a_name_that_comes_back_after_a_silence_is_a_new_clip_and_no_part() {
    let mut camera = Camera::with(ClipConfig {
        longest_s: 60.0,
        ..ClipConfig::default()
    });
    for i in 0..600 {
        assert!(camera.frame(i * 100, Some("drive")).is_none());
    }
    let closed = camera.tracker.tick(camera.at(60_000)).unwrap();
    assert_eq!(
        (closed.report.part, closed.report.ended_by),
        (0, ClipEnd::Length)
    );
    assert!(camera.frame(70_000, Some("drive")).is_none());
    let closed = camera.tracker.shutdown(camera.at(70_100)).unwrap();
    assert_eq!((closed.report.part, closed.start), (0, camera.at(70_000)));
}

#[test]
fn shutdown_ends_the_open_clip_and_only_that() {
    let mut camera = Camera::new();
    assert!(camera.tracker.shutdown(camera.at(0)).is_none());
    camera.frame(0, Some("a"));
    camera.frame(100, Some("a"));
    let closed = camera.tracker.shutdown(camera.at(150)).unwrap();
    assert_eq!(closed.report.ended_by, ClipEnd::Shutdown);
    assert_eq!(closed.end, camera.at(150), "no clip ends in the future");
    assert!(camera.tracker.shutdown(camera.at(200)).is_none());
}

#[test]
fn a_clip_is_given_back_when_its_pending_frame_has_its_final_answer() {
    let mut camera = Camera::new();
    camera.frame(0, Some("a"));
    camera.tracker.arrive(0, Some("a"), camera.at(100));
    let u = |u| Some(Threshold::new(Albireo::KNOB.name, u));
    camera.tracker.pending(1, u(3e-4));
    // The next clip begins, and its frames are its own.
    assert!(camera.frame_with(200, Some("b"), Some(5e-4)).is_none());
    let late = camera.result(300, 1, Some(3e-4));
    let closed = camera.tracker.count_late(&late).expect("clip a has ended");
    assert_eq!(
        (&*closed.report.clip, closed.report.states.frames()),
        ("a", 2)
    );
    assert_eq!(closed.report.threshold, u(3e-4));
    let closed = camera.tracker.shutdown(camera.at(400)).unwrap();
    assert_eq!(
        (&*closed.report.clip, closed.report.states.frames()),
        ("b", 1)
    );
    assert_eq!(closed.report.threshold_changes.len(), 1);
}

#[test]
fn the_threshold_at_the_start_and_each_change_are_told_once() {
    let mut camera = Camera::new();
    for u in [3e-4, 3e-4, 5e-4, 5e-4, 3e-4] {
        camera.frame_with(camera.seq * 100, Some("a"), Some(u));
    }
    let closed = camera.tracker.shutdown(camera.at(1000)).unwrap();
    let told: Vec<_> = closed
        .report
        .threshold_changes
        .iter()
        .map(|c| (c.seq, c.threshold.value))
        .collect();
    assert_eq!(told, [(0, 3e-4), (2, 5e-4), (4, 3e-4)]);
    assert_eq!(
        closed.report.threshold.map(|threshold| threshold.value),
        Some(3e-4)
    );
}

#[test]
fn a_threshold_that_never_rests_does_not_fill_the_memory() {
    let mut camera = Camera::new();
    for i in 0..5000 {
        camera.frame_with(i * 10, Some("a"), Some(i as f64));
    }
    let closed = camera.tracker.shutdown(camera.at(50_000)).unwrap();
    assert_eq!(closed.report.threshold_changes.len(), 256);
    assert_eq!(closed.report.threshold_changes[255].threshold.value, 4999.0);
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
                    camera.tracker.count_others(&more, None);
                    if camera.tracker.clip().is_some() {
                        dropped += lost + late;
                    }
                }
                Event::Tick { wait } => {
                    now += wait;
                    closed.extend(camera.tracker.tick(camera.at(now)));
                }
            }
        }
        closed.extend(camera.tracker.shutdown(camera.at(now)));
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
