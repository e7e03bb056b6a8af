use super::*;
use crate::camera::answer;
use crate::config::CameraConfig;
use crate::outbox::OutboxCounts;
use albireo_core::policy::{ExpectedLoss, FrameState};
use albireo_wire::Threshold;
use serde_json::Value;
use std::error::Error;
use std::path::Path;

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

/// Sets the threshold on behalf of somebody at the node.
pub(crate) fn set_by_hand(
    board: &Board,
    cameras: &[Arc<CameraBoard>],
    value: f64,
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let name = cameras[0].threshold_spec.unwrap().name;
    let (threshold, source) = (Threshold::new(name, value), SettingSource::Local);
    (board.settings).change(|kept| board.set_thresholds(cameras, threshold, source, kept))
}

fn board(state_dir: Option<&Path>, policy: &str) -> Arc<Board> {
    board_of(&config(state_dir, policy))
}

#[test]
fn a_changed_threshold_survives_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let restarted = |policy: &str| board(Some(&directory.path().join("state")), policy);
    let first = restarted("albireo");
    set_by_hand(&first, &first.cameras[..1], 5e-4).unwrap();
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
fn a_camera_has_its_own_threshold_or_that_of_the_policy() {
    let mut config = config(None, "albireo:7e-4");
    config.cameras[1].threshold = Some(1e-3);
    assert_eq!(thresholds(&board_of(&config)), [7e-4, 1e-3]);
}

#[test]
fn an_event_is_written_as_json_once_however_many_read_it() {
    let board = board(None, "albireo");
    let mut readers: Vec<_> = (0..64).map(|_| board.subscribe()).collect();
    board.cameras[0].show(answer(7, FrameState::I, false, None));
    let events = readers.iter_mut().map(|reader| reader.try_recv().unwrap());
    let events: Vec<_> = events.collect();
    assert_eq!(events[0].news.camera(), Some("front"));
    let first = events[0].json();
    let frame: Value = serde_json::from_str(first).unwrap();
    assert_eq!(frame["camera"], "front");
    assert_eq!(frame["seq"], 7);
    // The same allocation, not just equal text.
    let mut written = events.iter().map(|event| event.json());
    assert!(written.all(|json| std::ptr::eq(json, first)));
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
    set_by_hand(&failing, &failing.cameras, 1e-3).unwrap();
    assert_eq!(thresholds(&failing), [1e-3; 2]);
    assert!(!failing.outbox.counts().status.durable);
    let lost = OutboxCounts {
        last_loss: Some(std::time::Instant::now()),
        ..OutboxCounts::default()
    };
    let fault = readiness::of_outbox(&lost).unwrap();
    assert!(fault.reason.contains("were lost"), "{}", fault.reason);
}
