use super::*;
use crate::PreparedNode;
use crate::camera::AnswerTime;
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
    board.cameras.iter().filter_map(|camera| camera.threshold()).collect()
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
        let name = cameras[0].threshold_spec().unwrap().name;
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
fn a_switched_policy_survives_a_restart_and_brings_the_threshold_that_is_configured_for_it() {
    let directory = tempfile::tempdir().unwrap();
    let restarted = |policy: &str| {
        let mut config = config(Some(directory.path()), policy);
        config.cameras[1].threshold = Some(0.25);
        prepared(&config)
    };
    let switch = |node: &PreparedNode, name: &str| {
        node.settings.set(|transaction| transaction.policy(name)).unwrap();
    };
    let shown = |node: &PreparedNode| (node.board.policy().name, thresholds(&node.board));
    let first = restarted("albireo:5e-4");
    first.settings.set_by_hand(&first.board.cameras, 7e-4).unwrap();
    switch(&first, "expected-loss");
    // A camera's own value is for the configured policy's threshold.
    let lambda = ExpectedLoss::THRESHOLD.default;
    assert_eq!(shown(&first), ("expected-loss", vec![lambda; 2]));
    first.settings.set_by_hand(&first.board.cameras[..1], 0.6).unwrap();
    drop(first);
    let again = restarted("albireo:5e-4");
    assert_eq!(shown(&again), ("expected-loss", vec![0.6, lambda]));
    assert_eq!(again.board.savings_of_policy(), None, "since the start");
    // What was set before under a policy does not come back with it, now or after a restart.
    switch(&again, "albireo");
    let configured = ("albireo", vec![5e-4, 0.25]);
    assert_eq!(shown(&again), configured);
    assert!(again.board.savings_of_policy().is_some());
    drop(again);
    let third = restarted("albireo:5e-4");
    assert_eq!(shown(&third), configured);
    switch(&third, "vanilla");
    assert_eq!(shown(&third), ("vanilla", vec![]));
    drop(third);
    assert_eq!(shown(&restarted("albireo:5e-4")).0, "vanilla");
    // An edited configuration is newer.
    assert_eq!(shown(&restarted("kill-only")).0, "kill-only");
}

#[test]
fn a_policy_that_cannot_be_is_refused_and_changes_nothing() {
    let mut config = config(None, "albireo");
    config.cameras[1].answer = Some(AnswerTime::AtOnce);
    config.policy.lambda = -1.0;
    let node = prepared(&config);
    for (name, words) in [
        ("expected-los", "did you mean `expected-loss`?"),
        ("fast", "the policies are `albireo`, `vanilla`"),
        ("expected-loss", "policy.lambda"),
        (
            "vanilla",
            "camera `rear` answers at once: policy `vanilla` cannot",
        ),
    ] {
        let switched = node.settings.set(|transaction| transaction.policy(name));
        let refused = switched.unwrap_err().to_string();
        assert!(refused.contains(words), "{refused}");
        assert_eq!(node.board.policy().name, "albireo");
        assert_eq!(thresholds(&node.board), [3e-4; 2]);
    }
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
