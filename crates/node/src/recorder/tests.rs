use super::*;
use crate::camera::answer;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::FrameState;
use albireo_recording::{Messages, Topic};
use albireo_vision::picture::PictureFormat;
use albireo_wire::VERSION;
use std::path::Path;
use window::{MOST_HELD_BYTES, Window};

fn picture(bytes: usize) -> EncodedPicture {
    EncodedPicture {
        bytes: vec![0; bytes].into(),
        format: PictureFormat::Jpeg,
        size: PictureSize::new(4, 3),
        mount: None,
    }
}

fn config(folder: &Path) -> RecordConfig {
    RecordConfig {
        folder: Some(folder.join("recordings")),
        before_s: 2.0,
        after_s: 3.0,
        ..RecordConfig::default()
    }
}

fn recorder(config: &RecordConfig) -> Arc<Recorder> {
    Recorder::new(config, vec!["front".to_owned(), "rear".to_owned()])
}

fn audit(seq: u64) -> AuditMessage {
    AuditMessage {
        v: VERSION,
        seq,
        t_ns: seq,
        width: 4,
        height: 3,
        shown: Vec::new(),
        detected: Vec::new(),
    }
}

/// Gives a recorder the frames of these seconds after `start`, one in each.
fn frames(camera: &CameraRecorder, start: Instant, seconds: std::ops::Range<u64>) {
    for second in seconds {
        let message = Arc::new(answer(second, FrameState::P));
        camera.frame(
            &picture(1000),
            &message,
            None,
            start + Duration::from_secs(second),
        );
    }
}

fn event(recorder: &Recorder, start: Instant, second: u64, camera: Option<usize>) {
    recorder.order(Order::Event {
        camera,
        at: start + Duration::from_secs(second),
        t_ns: 1,
        reason: "braking".into(),
    });
}

/// The recordings of a camera: of each, the number of messages on a topic.
fn recorded(folder: &Path, camera: &str, topic: Topic) -> Vec<usize> {
    let mut paths: Vec<_> = std::fs::read_dir(folder.join("recordings"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().ends_with(&format!("_{camera}.mcap")))
        .collect();
    paths.sort();
    let count = |path: &PathBuf| {
        Messages::open(path)
            .unwrap()
            .filter(|message| message.channel.topic == topic.of(camera))
            .count()
    };
    paths.iter().map(count).collect()
}

#[tokio::test]
async fn an_event_keeps_the_frames_before_and_after_it_of_the_cameras_it_is_about() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = recorder(&config(folder.path()));
    recorder.start(FrameLimits::default(), PictureMemory::Own).unwrap();
    let cameras = [0, 1].map(|camera| Arc::clone(&recorder).of_camera(camera));
    let start = Instant::now();
    for camera in &cameras {
        frames(camera, start, 0..10);
    }
    // The first event, at 9, keeps seconds 7 to 12; the second, at 11, prolongs that to 14.
    event(&recorder, start, 9, Some(0));
    frames(&cameras[0], start, 10..11);
    event(&recorder, start, 11, Some(0));
    frames(&cameras[0], start, 11..30);
    frames(&cameras[1], start, 10..30);
    recorder.stop().await;
    assert_eq!(recorded(folder.path(), "front", Topic::Image), [3 + 5]);
    assert_eq!(recorded(folder.path(), "front", Topic::Event), [2]);
    assert!(recorded(folder.path(), "rear", Topic::Image).is_empty());
    let status = recorder.status();
    assert_eq!(status.written_frames, 8);
    assert_eq!(status.events, 2);
    assert_eq!(status.files, 1);
    assert_eq!(status.dropped_frames, 0);
    assert_eq!(status.failed_frames, 0);
    assert!(status.bytes > 8000, "{status:?}");
    assert!(recorder.fault().is_none(), "{status:?}");
}

#[tokio::test]
async fn every_frame_is_recorded_if_that_is_asked_and_old_files_make_room() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecordConfig {
        when: vec![Occasion::Always],
        max_gb: 0.01,
        ..config(folder.path())
    };
    let recorder = recorder(&config);
    recorder.start(FrameLimits::default(), PictureMemory::Own).unwrap();
    let camera = Arc::clone(&recorder).of_camera(0);
    let limit = 30_000_000;
    let mut given = 0;
    while given < limit {
        let before = recorder.status().written_frames;
        camera.frame(
            &picture(500_000),
            &Arc::new(answer(0, FrameState::P)),
            None,
            Instant::now(),
        );
        given += 500_000;
        // One after the other: this test is not about a slow disk.
        while recorder.status().written_frames == before {
            tokio::task::yield_now().await;
        }
    }
    recorder.stop().await;
    let status = recorder.status();
    assert_eq!(status.written_frames, 60);
    let left = recorded(folder.path(), "front", Topic::Image);
    // A file takes an eighth of the limit for two cameras: three pictures.
    assert!((2..=8).contains(&left.len()), "{left:?}");
    assert!(status.bytes <= status.max_bytes, "{status:?}");
    assert_eq!(status.files, left.len() as u64);
}

#[tokio::test]
async fn a_frame_of_the_audit_is_kept_alone_if_nothing_around_it_is_wanted() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecordConfig {
        when: vec![Occasion::Audit],
        before_s: 0.0,
        after_s: 0.0,
        ..config(folder.path())
    };
    let recorder = recorder(&config);
    recorder.start(FrameLimits::default(), PictureMemory::Own).unwrap();
    let camera = Arc::clone(&recorder).of_camera(1);
    assert!(camera.wants_audited());
    for seq in 0..3 {
        let start = Instant::now();
        frames(&camera, start, 0..5);
        camera.audited(picture(1000), audit(seq));
        // Received before the audit's result and answered after it: not recorded either.
        frames(&camera, start, 0..1);
    }
    recorder.stop().await;
    assert_eq!(recorded(folder.path(), "rear", Topic::AuditImage), [3]);
    assert_eq!(recorded(folder.path(), "rear", Topic::Audit), [3]);
    assert_eq!(recorded(folder.path(), "rear", Topic::Image), [0]);
    assert_eq!(recorder.status().audited_frames, 3);
}

#[tokio::test]
async fn the_audit_keeps_what_surrounds_its_frame_if_that_is_wanted() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecordConfig {
        when: vec![Occasion::Audit],
        before_s: 600.0,
        after_s: 600.0,
        ..config(folder.path())
    };
    let recorder = recorder(&config);
    recorder.start(FrameLimits::default(), PictureMemory::Own).unwrap();
    let camera = Arc::clone(&recorder).of_camera(0);
    let start = Instant::now();
    frames(&camera, start, 0..5);
    camera.audited(picture(1000), audit(4));
    frames(&camera, start, 5..8);
    recorder.stop().await;
    assert_eq!(recorded(folder.path(), "front", Topic::Image), [5 + 3]);
    assert_eq!(recorded(folder.path(), "front", Topic::AuditImage), [1]);
}

#[test]
fn a_writer_that_is_behind_writes_one_file_for_one_event() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let recordings = config.folder.clone().unwrap();
    let names = ["front".to_owned()];
    let counts = Arc::default();
    let limits = FrameLimits::default();
    let memory = PictureMemory::Own;
    let mut writer = Writer::new(&config, &recordings, &names, limits, memory, counts);
    let begun = Instant::now() - Duration::from_secs(60);
    writer.take(Order::Event {
        camera: None,
        at: begun,
        t_ns: 1,
        reason: "braking".into(),
    });
    for second in 0..3 {
        let frame = held(1000, begun, second);
        let reached = frame.at;
        writer.take(Order::Frame(frame));
        writer.keep(reached);
    }
    writer.keep(begun + Duration::from_secs(4));
    assert_eq!(recorded(folder.path(), "front", Topic::Image), [3]);
}

fn held(bytes: usize, start: Instant, second: u64) -> RecordedFrame {
    RecordedFrame {
        camera: 0,
        at: start + Duration::from_secs(second),
        picture: picture(bytes),
        detections: Arc::new(answer(second, FrameState::P)),
        position: None,
    }
}

#[test]
fn what_is_older_than_wanted_is_not_kept_and_what_memory_lacks_is_told() {
    let start = Instant::now();
    let seconds = Duration::from_secs;
    let mut window = Window::around_events(seconds(10), seconds(0));
    for second in 0..5 {
        assert!(window.frame(held(1000, start, second)).is_none());
    }
    let before = window.event(start + seconds(13));
    assert_eq!(before.frames.len(), 2, "of seconds 3 and 4");
    assert_eq!(before.shortened_to, None);

    let large = MOST_HELD_BYTES / 2;
    for second in 20..25 {
        assert!(window.frame(held(large, start, second)).is_none());
    }
    let before = window.event(start + seconds(25));
    assert_eq!(before.frames.len(), 2);
    assert_eq!(before.shortened_to, Some(seconds(2)));
}

#[tokio::test]
async fn a_full_queue_and_a_broken_disk_are_counted_and_told_and_nobody_waits() {
    let folder = tempfile::tempdir().unwrap();
    let config = RecordConfig {
        when: vec![Occasion::Always],
        ..config(folder.path())
    };
    // A file where the folder should be.
    std::fs::write(folder.path().join("recordings"), "").unwrap();
    let recorder = recorder(&config);
    let camera = Arc::clone(&recorder).of_camera(0);
    // The writer has not started, as if the disk had stalled.
    frames(&camera, Instant::now(), 0..300);
    assert_eq!(recorder.status().dropped_frames, 300 - MOST_WAITING as u64);
    let fault = recorder.fault().unwrap().reason;
    assert!(fault.contains("too slow"), "{fault}");

    recorder.start(FrameLimits::default(), PictureMemory::Own).unwrap();
    recorder.stop().await;
    assert_eq!(recorder.status().failed_frames, MOST_WAITING as u64);
    let fault = recorder.fault().unwrap().reason;
    assert!(fault.contains("record.folder"), "{fault}");
    assert!(!recorder.event(None, "after the end"));
}

#[test]
fn pictures_that_wait_are_bounded_by_their_bytes_too() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = recorder(&config(folder.path()));
    let camera = Arc::clone(&recorder).of_camera(0);
    let message = Arc::new(answer(0, FrameState::P));
    for _ in 0..10 {
        camera.frame(
            &picture(MOST_WAITING_BYTES / 4),
            &message,
            None,
            Instant::now(),
        );
    }
    assert_eq!(recorder.status().dropped_frames, 6);
}

#[test]
fn without_a_folder_nothing_is_recorded() {
    let recorder = recorder(&RecordConfig::default());
    let camera = Arc::clone(&recorder).of_camera(0);
    frames(&camera, Instant::now(), 0..300);
    assert!(!recorder.event(None, "braking"));
    assert!(!camera.wants_audited());
    let status = recorder.status();
    assert_eq!(status.dropped_frames, 0);
    assert_eq!(status.events, 0);
    assert!(recorder.fault().is_none());
}
