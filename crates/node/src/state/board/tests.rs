use super::*;
use crate::camera::{FrameRecord, answer};
use crate::config::CameraConfig;
use crate::delivery::outbox::OutboxCounts;
use albireo_core::policy::{ExpectedLoss, FrameState};
use albireo_wire::{DetectionsMessage, DroppedFrames, Threshold};
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
fn every_frame_is_sent_to_subscribers_and_counted() {
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
    assert_eq!((counters.frames, counters.degraded_frames), (5, 1));
    assert_eq!((counters.calls.total(), counters.dropped.late), (4, 2));
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
    // A value stored for another threshold does not apply.
    let lambda = ExpectedLoss::THRESHOLD.default;
    assert_eq!(thresholds(&restarted("expected-loss")), [lambda; 2]);
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
fn a_camera_has_its_own_threshold_or_that_of_the_policy() {
    let mut config = config(None, "albireo:7e-4");
    config.cameras[1].threshold = Some(1e-3);
    assert_eq!(thresholds(&board_of(&config)), [7e-4, 1e-3]);
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
fn what_is_lost_or_not_stored_degrades_the_node_and_a_threshold_still_applies() {
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
    set_by_hand(&failing.cameras, 1e-3).unwrap();
    assert_eq!(thresholds(&failing), [1e-3; 2]);
    assert!(!failing.outbox.counts().status.durable);
    let mut lost = OutboxCounts {
        last_loss: Some(std::time::Instant::now()),
        ..OutboxCounts::default()
    };
    lost.status.durable = true;
    let fault = readiness::of_outbox(&lost, true).unwrap();
    assert!(fault.reason.contains("were lost"), "{}", fault.reason);
}
