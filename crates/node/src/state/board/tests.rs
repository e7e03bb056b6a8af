use super::*;
use crate::camera::{FrameRecord, answer};
use crate::config::CameraConfig;
use crate::delivery::outbox::OutboxCounts;
use albireo_core::policy::{ExpectedLoss, FrameState};
use albireo_wire::{CallCause, DetectionsMessage, DroppedFrames, Threshold};
use std::path::Path;
use std::time::Duration;

/// A configuration with the cameras `front` and `rear` under a policy.
pub(crate) fn config(state_dir: Option<&Path>, policy: &str) -> NodeConfig {
    let mut config = NodeConfig {
        cameras: ["front", "rear"].map(CameraConfig::named).to_vec(),
        ..NodeConfig::default()
    };
    config.policy.select(policy).unwrap();
    config.node.state_dir = state_dir.map(Path::to_owned);
    config
}

pub(crate) fn board_of(config: &NodeConfig) -> Arc<Board> {
    Board::open(config).unwrap()
}

pub(crate) fn thresholds(board: &Board) -> Vec<f64> {
    let cameras = board.cameras.iter();
    cameras.filter_map(|camera| camera.threshold()).collect()
}

fn board(state_dir: Option<&Path>, policy: &str) -> Arc<Board> {
    board_of(&config(state_dir, policy))
}

fn frame(seq: u64, state: FrameState) -> Arc<DetectionsMessage> {
    let threshold = Threshold::new("u", 3e-4);
    answer(seq, state, state == FrameState::P, Some(threshold))
}

impl CameraBoard {
    /// Counts a frame with its final answer.
    fn answered(&self, detections: Arc<DetectionsMessage>) {
        let total = Duration::from_secs_f64(detections.latency_ms.total / 1e3);
        self.show(Arc::clone(&detections));
        self.record_frame(&FrameRecord::new(detections, total));
    }
}

#[test]
fn every_frame_is_counted_by_state_and_sent_to_subscribers() {
    let board = board(None, "albireo");
    let mut events = board.subscribe();
    let camera = board.camera("front").unwrap();
    for (seq, state) in FrameState::ALL.into_iter().enumerate() {
        camera.answered(frame(seq as u64, state));
        let event = events.try_recv().unwrap();
        assert_eq!(
            (event.news.name(), event.news.camera()),
            ("frame", Some("front"))
        );
        let json: serde_json::Value = serde_json::from_str(event.json().unwrap()).unwrap();
        assert_eq!(json["seq"], seq as u64);
        assert_eq!(json["camera"], "front");
    }
    camera.record_dropped(&DroppedFrames {
        late: 2,
        ..DroppedFrames::default()
    });
    let counters = board.counters(camera, 7);
    assert_eq!(counters.frames, 5);
    assert_eq!(counters.degraded_frames, 1);
    assert_eq!(counters.calls.get(CallCause::Uncertain), 4);
    assert_eq!(counters.calls.total(), 4);
    assert_eq!(counters.dropped.late, 2);
    assert_eq!(board.counters(board.camera("rear").unwrap(), 7).frames, 0);
}

#[test]
fn a_threshold_outside_the_knob_changes_nothing() {
    let board = board(None, "albireo:1e-3");
    let camera = board.camera("front").unwrap();
    let seen = camera.watch_threshold();
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 2.0] {
        assert!(set_by_hand(&board.cameras, bad).is_err(), "{bad}");
    }
    let lambda = Threshold::new("lambda", 0.5);
    let other = set_thresholds(&board.cameras, lambda, SettingSource::Hub);
    assert!(other.unwrap_err().to_string().contains("not `lambda`"));
    assert_eq!(*seen.borrow(), Some(1e-3));
    set_by_hand(&board.cameras[..1], 5e-4).unwrap();
    assert_eq!(*seen.borrow(), Some(5e-4));
    assert!(!board.outbox.counts().status.durable);
}

#[test]
fn a_changed_threshold_survives_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let restarted = |policy: &str| board(Some(&directory.path().join("state")), policy);
    let first = restarted("albireo");
    set_by_hand(&first.cameras[..1], 5e-4).unwrap();
    assert!(first.outbox.counts().status.durable);
    drop(first);
    assert_eq!(thresholds(&restarted("albireo")), [5e-4, 3e-4]);
    // An edited configuration is newer, so it wins.
    assert_eq!(thresholds(&restarted("albireo:1e-3")), [1e-3; 2]);
    // A value stored for another knob does not apply.
    let lambda = ExpectedLoss::KNOB.default;
    assert_eq!(thresholds(&restarted("expected-loss")), [lambda; 2]);
}

#[test]
fn a_threshold_that_cannot_be_stored_still_applies_and_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    let blocked = directory.path().join("a-file");
    std::fs::write(&blocked, "").unwrap();
    let board = board(Some(&blocked.join("state")), "albireo");
    set_by_hand(&board.cameras, 1e-3).unwrap();
    assert_eq!(board.camera("front").unwrap().threshold(), Some(1e-3));
    assert!(!board.outbox.counts().status.durable);
}

#[test]
fn the_node_is_ready_once_the_detector_and_every_other_part_is() {
    let board = board(None, "albireo");
    let zenoh = board.readiness.part(readiness::ZENOH);
    zenoh.not_ready("the session is not open yet");
    let reasons = || board.readiness.health().status().reasons;
    assert_eq!(reasons().len(), 2);
    board.set_detector_status(DetectorStatus::Ready {
        provider: ExecutionProvider::Cpu,
    });
    assert_eq!(reasons().keys().collect::<Vec<_>>(), [readiness::ZENOH]);
    zenoh.works();
    assert!(board.readiness.health().is_ready());
    let provider = ExecutionProvider::Cpu;
    let reason = "a run took too long".to_owned();
    board.set_detector_status(DetectorStatus::Degraded { reason, provider });
    assert!(!board.readiness.health().is_ready());
}

#[test]
fn a_configuration_describes_its_cameras_with_their_own_thresholds() {
    let mut config = NodeConfig::default();
    config.policy.u = 7e-4;
    config.cameras.push(CameraConfig {
        key: Some("vehicle/rear".to_owned()),
        threshold: Some(1e-3),
        ..CameraConfig::named("rear")
    });
    let board = board_of(&config);
    let front = board.camera("front").unwrap();
    assert_eq!(front.key, "albireo/node/front/frame");
    assert_eq!(front.threshold(), Some(7e-4));
    let rear = board.camera("rear").unwrap();
    assert_eq!(rear.key, "vehicle/rear");
    assert_eq!(rear.threshold(), Some(1e-3));
    assert_eq!(board.model, "yolox_nano.onnx");
    assert_eq!(board.policy, "albireo");
}

#[test]
fn an_event_is_written_as_json_once_however_many_read_it() {
    let board = board(None, "albireo");
    let mut readers: Vec<_> = (0..64).map(|_| board.subscribe()).collect();
    let camera = board.camera("front").unwrap();
    camera.answered(frame(0, FrameState::I));
    let events: Vec<_> = (readers.iter_mut())
        .map(|reader| reader.try_recv().unwrap())
        .collect();
    // The same allocation, not just equal text.
    let first = events[0].json().unwrap();
    assert!(
        events
            .iter()
            .all(|event| std::ptr::eq(event.json().unwrap(), first))
    );
}

#[test]
fn lost_and_unsaved_reports_degrade_the_node_with_the_outbox_as_reason() {
    let reason = |board: &Board| board.readiness.health().status().reasons.remove("outbox");
    let folder = tempfile::tempdir().unwrap();
    // Without a state directory nothing is promised, so nothing is reported.
    assert_eq!(reason(&board(None, "albireo")), None);
    let sound = board(Some(&folder.path().join("state")), "albireo");
    assert_eq!(reason(&sound), None);
    let blocked = folder.path().join("a file");
    std::fs::write(&blocked, b"").unwrap();
    let failing = board(Some(&blocked.join("state")), "albireo");
    assert!(reason(&failing).unwrap().contains("do not survive"));
    let mut lost = OutboxCounts {
        last_loss: Some(std::time::Instant::now()),
        ..OutboxCounts::default()
    };
    lost.status.durable = true;
    let fault = readiness::of_outbox(&lost, true).unwrap();
    assert!(fault.reason.contains("were lost"), "{}", fault.reason);
}
