use super::*;
use crate::PreparedNode;
use crate::config::{CameraConfig, NodeConfig};
use albireo_core::policy::ExpectedLoss;
use albireo_wire::{Pauses, SettingSource};
use std::error::Error;

pub(crate) fn config(state_dir: Option<&Path>, policy: &str) -> NodeConfig {
    let mut config = NodeConfig {
        cameras: ["front", "rear"].map(CameraConfig::named).to_vec(),
        ..NodeConfig::default()
    };
    config.policy.select(policy).unwrap();
    config.node.state_dir = state_dir.map(Path::to_owned);
    config
}

pub(crate) fn prepared(config: &NodeConfig) -> PreparedNode {
    PreparedNode::new(config).unwrap()
}

pub(crate) fn thresholds(board: &Board) -> Vec<f64> {
    let cameras = board.cameras.iter();
    cameras.filter_map(|camera| camera.threshold()).collect()
}

impl Settings {
    /// Stalls the disk until the result is dropped.
    pub(crate) fn stall(&self) -> impl Sized {
        self.file.stall()
    }

    /// Sets the threshold on behalf of somebody at the node.
    pub(crate) fn set_by_hand(
        &self,
        cameras: &[Arc<CameraBoard>],
        value: f64,
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        let name = cameras[0].threshold_spec.unwrap().name;
        let threshold = Threshold::new(name, value);
        self.set(|transaction| transaction.thresholds(cameras, threshold, SettingSource::Local))
    }
}

#[test]
fn a_changed_pause_survives_a_restart_and_an_edited_one_is_newer() {
    let directory = tempfile::tempdir().unwrap();
    let restarted = |pause_s| {
        let mut config = config(Some(directory.path()), "albireo");
        config.screen.pause_s = pause_s;
        prepared(&config)
    };
    let new = Pauses {
        pause_s: Some(0.2),
        ..Pauses::default()
    };
    let first = restarted(0.0);
    first.settings.set(|transaction| transaction.pauses(new)).unwrap();
    assert_eq!(first.board.empty_road().pause_s, 0.2);
    drop(first);
    assert_eq!(restarted(0.0).board.empty_road().pause_s, 0.2);
    assert_eq!(restarted(0.1).board.empty_road().pause_s, 0.1);
}

#[test]
fn a_changed_threshold_survives_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let state = directory.path().join("state");
    let restarted = |policy: &str| prepared(&config(Some(&state), policy));
    let first = restarted("albireo");
    first.settings.set_by_hand(&first.board.cameras[..1], 5e-4).unwrap();
    assert!(first.outbox.counts().status.durable);
    drop(first);
    assert_eq!(thresholds(&restarted("albireo").board), [5e-4, 3e-4]);
    // An edited configuration is newer, so it wins.
    assert_eq!(thresholds(&restarted("albireo:1e-3").board), [1e-3; 2]);
    // A value stored for another threshold does not apply.
    let lambda = ExpectedLoss::THRESHOLD.default;
    assert_eq!(thresholds(&restarted("expected-loss").board), [lambda; 2]);
}

#[test]
fn what_is_lost_or_not_stored_degrades_the_node_and_a_threshold_still_applies() {
    let reason = |node: &PreparedNode| {
        let health = node.board.readiness.health().status();
        health.reasons.get("outbox").cloned()
    };
    let folder = tempfile::tempdir().unwrap();
    let node = |state: Option<&Path>| prepared(&config(state, "albireo"));
    // Without a state directory nothing is promised, so nothing is reported.
    assert_eq!(reason(&node(None)), None);
    let sound = node(Some(&folder.path().join("state")));
    assert_eq!(reason(&sound), None);
    let blocked = folder.path().join("a file");
    std::fs::write(&blocked, b"").unwrap();
    let failing = node(Some(&blocked.join("state")));
    assert!(reason(&failing).unwrap().contains("do not survive"));
    failing.settings.set_by_hand(&failing.board.cameras, 1e-3).unwrap();
    assert_eq!(thresholds(&failing.board), [1e-3; 2]);
    assert!(!failing.outbox.counts().status.durable);
}
