use super::*;
use crate::PreparedNode;
use crate::settings::Transaction;
use crate::settings::tests::{config, prepared};
use albireo_core::target::TargetStatus;
use std::path::Path;
use std::sync::mpsc::{TryRecvError, channel};
use std::thread;

const HALF: Option<Target> = Some(Target::SkipRate(0.5));

fn node(state: Option<&Path>, policy: &str, configured: Option<Target>) -> PreparedNode {
    let mut config = config(state, policy);
    config.target.hold = configured;
    prepared(&config)
}

fn set_target(node: &PreparedNode, target: Option<Target>) -> Result<(), TargetError> {
    let place = node.settings.turns.place();
    let set = |transaction: &mut Transaction<'_>| transaction.target(target, SettingSource::Local);
    node.settings.set_in_turn(place, set)
}

fn hold(node: &PreparedNode, target: Option<Target>) {
    set_target(node, target).unwrap();
}

/// Lets `seconds` pass in which fewer frames are skipped than wanted; returns the threshold's value.
fn pass(board: &Board, seconds: u32) -> f64 {
    let second = Measured {
        seconds: 1.0,
        frames: 10,
        skipped: 2,
        ..Measured::default()
    };
    for _ in 0..seconds {
        board.target.step(&second, |value| {
            for camera in &board.cameras {
                camera.move_threshold(value);
            }
        });
    }
    board.cameras[0].threshold().unwrap()
}

#[test]
fn a_target_moves_the_threshold_of_all_cameras_and_reports_its_state() {
    let node = node(None, "expected-loss:0.3", None);
    assert_eq!(node.board.target.report().target, None);
    hold(&node, HALF);
    let after = pass(&node.board, 8);
    assert!(after > 0.3, "{after}");
    assert_eq!(node.board.cameras[1].threshold(), Some(after));
    let report = node.board.target.report();
    assert_eq!(report.target, HALF);
    assert_eq!(report.threshold.unwrap().name.as_str(), "lambda");
    let state = report.state.unwrap();
    assert_eq!(state.status, TargetStatus::Moving);
    assert_eq!(state.threshold, after);
    assert!((state.actual.unwrap() - 0.2).abs() < 1e-9);
}

#[test]
fn a_threshold_set_by_hand_switches_the_target_off_and_reports_it() {
    let node = node(None, "albireo:3e-4", None);
    hold(&node, HALF);
    pass(&node.board, 10);
    node.settings.set_by_hand(&node.board.cameras[1..], 7e-4).unwrap();
    let report = node.board.target.report();
    assert_eq!(report.target, None);
    assert_eq!(report.state, None);
    assert_eq!(report.off.as_deref(), Some("the threshold was set by hand"));
    pass(&node.board, 10);
    assert_eq!(node.board.cameras[1].threshold(), Some(7e-4));
    // Another target begins at the threshold's value and leaves the threshold there when it ends.
    hold(&node, Some(Target::SkipRate(0.6)));
    assert_eq!(node.board.target.report().off, None);
    let there = pass(&node.board, 10);
    hold(&node, None);
    assert_eq!(node.board.cameras[0].threshold(), Some(there));
}

#[test]
fn a_target_survives_a_restart_with_its_value_until_the_configuration_is_edited() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let open = |skip_rate| {
        let configured = Some(Target::SkipRate(skip_rate));
        node(Some(&state), "expected-loss:0.3", configured)
    };
    let first = open(0.4);
    assert_eq!(
        first.board.target.report().source,
        SettingSource::Configuration
    );
    hold(&first, HALF);
    let there = pass(&first.board, 20);
    first.settings.keep_place();
    drop(first);

    let again = open(0.4);
    let report = again.board.target.report();
    assert_eq!(report.target, HALF);
    assert!((report.threshold.unwrap().value - there).abs() < 1e-12);
    // The first step applies the value, whatever the cameras began with.
    let next = pass(&again.board, 1);
    assert!((next / there - 1.0).abs() < 0.1, "{next} {there}");
    // A target switched off by hand stays off.
    again.settings.set_by_hand(&again.board.cameras[..1], 0.25).unwrap();
    drop(again);
    let off = open(0.4);
    assert_eq!(off.board.target.report().target, None);
    assert_eq!(off.board.cameras[0].threshold(), Some(0.25));
    drop(off);
    let edited = open(0.7);
    let report = edited.board.target.report();
    assert_eq!(report.target, Some(Target::SkipRate(0.7)));
    assert_eq!(report.source, SettingSource::Configuration);
}

/// Asserts that the workers' calls end while `change` is in force but its disk stalls, and that `change` ends after that.
fn assert_served_while_the_disk_stalls(
    node: &PreparedNode,
    change: impl FnOnce() + Send,
    is_in_force: impl Fn() -> bool + Send,
) {
    thread::scope(|scope| {
        let board = &node.board;
        let stalled_outbox = node.outbox.stall();
        let stalled_settings = node.settings.stall();
        let (changed, ended) = channel();
        let served = changed.clone();
        scope.spawn(move || {
            change();
            changed.send("changed").unwrap();
        });
        scope.spawn(move || {
            while !is_in_force() {
                thread::yield_now();
            }
            pass(board, 1);
            board.publish_counters(0);
            board.target.report();
            for camera in &board.cameras {
                camera.threshold_in_force();
                camera.threshold_source();
                camera.move_threshold(0.27);
            }
            node.outbox.counts();
            board.readiness.health();
            served.send("served").unwrap();
        });
        let limit = Duration::from_secs(20);
        let first = ended.recv_timeout(limit);
        let early = ended.try_recv();
        drop(stalled_outbox);
        drop(stalled_settings);
        assert_eq!(first, Ok("served"), "while the disk stalls");
        assert_eq!(early, Err(TryRecvError::Empty), "acknowledged, not kept");
        assert_eq!(ended.recv_timeout(limit), Ok("changed"));
    });
}

#[test]
fn no_worker_waits_for_a_stalled_disk_and_nothing_is_acknowledged_before_it_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let open = || node(Some(&state), "expected-loss:0.3", None);
    let first = open();
    let is_held = || first.board.target.report().target == HALF;
    assert_served_while_the_disk_stalls(&first, || hold(&first, HALF), is_held);
    let there = pass(&first.board, 20);
    assert_served_while_the_disk_stalls(&first, || first.settings.keep_place(), || true);
    drop(first);
    let second = open();
    let report = second.board.target.report();
    assert_eq!(report.target, HALF);
    assert!((report.threshold.unwrap().value / there - 1.0).abs() < 0.1);
    // Switching off comes first, and is stored too.
    let front = &second.board.cameras[..1];
    let set = |value| {
        let settings = &second.settings;
        move || settings.set_by_hand(front, value).unwrap()
    };
    let is_off = || !second.board.target.is_on();
    assert_served_while_the_disk_stalls(&second, set(0.25), is_off);
    let is_set = || front[0].threshold() == Some(0.26);
    assert_served_while_the_disk_stalls(&second, set(0.26), is_set);
    drop(second);
    let third = open();
    assert_eq!(third.board.target.report().target, None);
    assert_eq!(third.board.cameras[0].threshold(), Some(0.26));
}

#[test]
fn a_policy_without_an_adjustable_threshold_holds_no_target_and_reports_why() {
    for policy in ["vanilla", "ctd"] {
        let node = node(None, policy, None);
        let reason = set_target(&node, HALF).unwrap_err().to_string();
        assert!(reason.contains(policy), "{reason}");
        assert_eq!(node.board.target.report().target, None);
    }
    // After a change of the policy, the stored target is not held, and the reason is given.
    let node = node(None, "vanilla", HALF);
    let report = node.board.target.report();
    assert_eq!(report.target, None);
    assert!(report.off.unwrap().contains("vanilla"));
}

#[test]
fn a_target_is_held_under_another_policy_from_its_own_threshold_within_its_own_range() {
    let mut config = config(None, "albireo");
    config.target.least = Some(2e-4);
    let node = prepared(&config);
    hold(&node, HALF);
    pass(&node.board, 10);
    let switch = |name: &str| {
        let place = node.settings.turns.place();
        node.settings
            .set_in_turn(place, |transaction| transaction.policy(name))
            .unwrap();
    };
    switch("expected-loss");
    let report = node.board.target.report();
    let range = report.range.unwrap();
    assert_eq!(report.target, HALF);
    assert_eq!(range.least, 0.05);
    assert_eq!(range.most, 1.2);
    assert_eq!(report.threshold, Some(Threshold::new("lambda", 0.3)));
    assert!(pass(&node.board, 10) > 0.3);
    switch("albireo");
    assert_eq!(node.board.target.report().range.unwrap().least, 2e-4);
    switch("vanilla");
    let report = node.board.target.report();
    assert_eq!(report.target, None);
    assert!(report.off.unwrap().contains("vanilla"));
}

#[test]
fn a_detector_outage_moves_no_threshold() {
    let node = node(None, "expected-loss:0.3", None);
    hold(&node, HALF);
    // Seconds of ten frames: how many skipped the detector, and how many could not get it.
    let pass = |seconds, skipped, degraded| {
        let second = Totals {
            frames: 10,
            skipped,
            degraded,
            detector_us: 20_000 * (10 - skipped - degraded),
            ..Totals::default()
        };
        for _ in 0..seconds {
            node.board.step_target(&second, Duration::from_secs(1));
        }
        node.board.cameras[0].threshold().unwrap()
    };
    let before = pass(8, 2, 0);
    assert!(before > 0.3, "{before}");
    assert_eq!(pass(60, 2, 8), before);
    assert!(pass(8, 2, 0) > before);
}
