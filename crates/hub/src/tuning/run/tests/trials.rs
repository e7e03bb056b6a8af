//! Trials: the draw, the result, and the return to the old value.

use super::super::super::metric::{Figure, Mean};
use super::super::*;
use super::{clips, in_windows, reported};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

fn u(value: f64) -> Threshold {
    Threshold::new("u", value)
}

fn plan() -> TrialPlan {
    TrialPlan {
        values: vec![u(1e-4), u(3e-4), u(1e-3)],
        duration_s: 100.0,
        ..TrialPlan::default()
    }
}

fn begin(candidates: Vec<Member>, seed: u64) -> Result<Run, String> {
    Run::begin(Kind::Trial { plan: plan() }, candidates, seed, "ops", 0)
}

fn candidates(count: usize) -> Vec<Member> {
    let one = |i: usize| Member::new(format!("cam-{i:03}"), u(2e-4), true);
    (0..count).map(one).collect()
}

/// Nodes apply and report at once what they are asked for.
fn obey(trial: &mut Run, revision: &mut u64, now: Millis) {
    let mut have = BTreeMap::new();
    for order in trial.due() {
        *revision += 1;
        for node in &order.nodes {
            have.insert(node.clone(), (*revision, order.threshold));
        }
        trial.asked(&order, *revision, now);
    }
    trial.observe(now, |node| {
        let (revision, threshold) = have.get(node)?;
        Some(reported(true, *revision, *threshold, None))
    });
}

/// A trial of thirty nodes that have their values.
fn running() -> Run {
    let mut trial = begin(candidates(30), 3).unwrap();
    obey(&mut trial, &mut 0, 0);
    trial.tick(0);
    trial
}

/// Each node has its own level, and the energy falls with the value.
fn measure(windows: &[[Window; 2]]) -> Measured {
    in_windows(windows, |window| {
        let number: usize = window.node["cam-".len()..].parse().unwrap();
        let level = 100.0 + (number % 7) as f64;
        let value: f64 = window.value.parse().unwrap();
        let factor = 1.0 - 0.3 * (value / 1e-4).log10();
        [(Figure::JoulesMeasured, clips(level * factor))].into()
    })
}

#[test]
fn a_trial_gives_each_group_its_value_measures_it_and_restores_the_old_value() {
    let (mut now, mut revision) = (0, 0);
    let mut trial = begin(candidates(60), 3).unwrap();
    for (arm, value) in plan().values.iter().enumerate() {
        let order = trial
            .due()
            .into_iter()
            .find(|o| o.threshold == *value)
            .unwrap();
        assert_eq!(order.nodes.len(), 20, "{arm}");
    }
    obey(&mut trial, &mut revision, now);
    trial.tick(now);
    assert_eq!((trial.phase, trial.since_ms), (Phase::Running, 0));
    now += 99_999;
    assert_eq!(trial.tick(now), None);
    now += 1;
    let windows = trial.tick(now).unwrap();
    assert_eq!(windows.len(), 60);
    for [before, after] in &windows {
        assert_eq!((after.from_ms, after.until_ms), (0, 100_000));
        assert_eq!(before.value, "0.0002");
    }
    trial.measured(&measure(&windows), now);
    let result = trial.result.clone().unwrap();
    let means: Vec<f64> = result.values.iter().map(|v| v.figures[0].mean).collect();
    assert!(means[0] > means[1] && means[1] > means[2], "{means:?}");
    assert_eq!(result.values[0].figures[0].difference, None);
    // From the first value to the last the energy falls to 0.7 of it.
    let estimate = result.values[2].figures[0].difference.unwrap().estimate;
    assert!((estimate + 0.3).abs() < 1e-9, "{estimate}");
    assert_eq!(trial.due().len(), 1);
    assert_eq!(trial.due()[0].threshold, u(2e-4));
    obey(&mut trial, &mut revision, now);
    trial.tick(now);
    assert_eq!(trial.phase, Phase::Done);
}

#[test]
fn unreachable_nodes_are_in_no_group_and_too_few_nodes_are_rejected() {
    let mut fleet = candidates(25);
    fleet[3].reachable = false;
    let trial = begin(fleet.clone(), 3).unwrap();
    assert!(trial.members.iter().all(|m| m.node != "cam-003"));
    fleet[4].reachable = false;
    let error = begin(fleet, 3).unwrap_err();
    assert!(error.starts_with("select: 23 nodes"), "{error}");
}

#[test]
fn a_plan_that_compares_nothing_is_rejected() {
    for values in [
        vec![],
        vec![u(1e-4)],
        vec![u(1e-4), u(1e-4)],
        vec![u(1e-4), Threshold::new("lambda", 0.3)],
    ] {
        let plan = TrialPlan { values, ..plan() };
        assert!(plan.check().unwrap_err().starts_with("values: "));
    }
}

#[test]
fn a_node_with_too_few_clips_is_in_no_figure_and_a_silent_one_is_counted() {
    let mut trial = running();
    let mut measured = measure(&trial.windows(50_000));
    measured.get_mut("cam-000").unwrap().after.clear();
    measured.get_mut("cam-001").unwrap().after =
        [(Figure::JoulesMeasured, Mean { clips: 4, sum: 4.0 })].into();
    trial.end_trial(&measured, Some("ops"), 50_000);
    let result = trial.result.unwrap();
    let sum = |of: fn(&ArmResult) -> usize| result.values.iter().map(of).sum::<usize>();
    assert_eq!(sum(|v| v.applied), 30);
    assert_eq!(sum(|v| v.silent), 1);
    assert_eq!(sum(|v| v.figures[0].nodes), 28);
}

#[test]
fn a_trial_that_cannot_be_measured_ends_without_a_result_and_restores_the_old_value() {
    let mut trial = running();
    for second in 0..i64::from(ATTEMPTS) {
        assert!(trial.tick(100_000 + second * 1_000).is_some());
        trial.not_measured(100_000 + second * 1_000);
    }
    assert_eq!(trial.phase, Phase::Returning);
    assert_eq!(trial.result, None);
    assert_eq!(trial.due()[0].threshold, u(2e-4));
}

proptest! {
    #[test]
    fn the_draw_is_even_and_reproducible(count in 24usize..200, seed in any::<u64>()) {
        let mut trial = begin(candidates(count), seed).unwrap();
        let mut reversed = candidates(count);
        reversed.reverse();
        prop_assert_eq!(&trial, &begin(reversed, seed).unwrap());
        let nodes: BTreeSet<_> = trial.members.iter().map(|m| &m.node).collect();
        prop_assert_eq!(nodes.len(), count);
        let size = |arm| trial.members.iter().filter(|m| m.group == arm).count();
        let sizes = [size(0), size(1), size(2)];
        prop_assert_eq!(sizes.iter().sum::<usize>(), count);
        prop_assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1);
        // A trial read from the database continues unchanged.
        trial.unsaved = false;
        let text = serde_json::to_string(&trial).unwrap();
        prop_assert_eq!(serde_json::from_str::<Run>(&text).unwrap(), trial);
    }
}
