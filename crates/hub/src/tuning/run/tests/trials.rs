use super::super::super::metric::{BeforeAfter, Figure, Mean};
use super::super::super::plan::TrialPlan;
use super::super::*;
use super::{SECOND, World, in_windows, new, old};
use albireo_wire::Threshold;
use proptest::prelude::*;
use std::collections::BTreeSet;

fn u(value: f64) -> Threshold {
    Threshold::new("u", value)
}

fn plan() -> TrialPlan {
    TrialPlan {
        values: vec![u(1e-4), u(2e-4), new()],
        duration_s: 100.0,
        ..TrialPlan::default()
    }
}

fn begin(candidates: Vec<Member>, seed: u64) -> Result<Run, String> {
    Run::begin(Kind::Trial { plan: plan() }, candidates, seed, "ops", 0)
}

/// A trial whose nodes have their values. The last value costs less, the others what the old one costs.
fn running(nodes: usize) -> (World, Run) {
    let mut world = World::new(nodes);
    for node in world.nodes.values_mut() {
        node.factor = 0.7;
    }
    let mut trial = begin(world.candidates(), 3).unwrap();
    world.step(&mut trial);
    (world, trial)
}

fn joules(arm: &ArmResult) -> &ArmFigure {
    arm.figures.iter().find(|one| one.figure == Figure::JoulesMeasured).unwrap()
}

#[test]
fn a_trial_gives_each_group_its_value_measures_it_and_restores_the_old_value() {
    let (mut world, mut trial) = running(60);
    let have: Vec<_> = plan().values.iter().map(|v| world.have(*v)).collect();
    assert_eq!(have, [20; 3]);
    world.run(&mut trial, 99);
    assert_eq!(trial.phase, Phase::Running);
    assert_eq!(trial.since_ms, SECOND);
    world.step(&mut trial);
    assert_eq!(trial.phase, Phase::Returning);
    let result = trial.result.clone().unwrap();
    assert_eq!(result.from_ms, SECOND);
    assert_eq!(result.until_ms, 101 * SECOND);
    for (arm, factor) in result.values.iter().zip([1.0, 1.0, 0.7]) {
        let found = joules(arm);
        assert_eq!(found.nodes, 20);
        assert!((found.mean / found.before - factor).abs() < 1e-9);
        let is_first = arm.value == plan().values[0];
        match found.difference {
            None => assert!(is_first, "{found:?}"),
            Some(difference) => {
                assert!(!is_first, "the others are compared with it: {found:?}");
                let expected = factor - 1.0;
                assert!((difference.estimate - expected).abs() < 1e-9, "{found:?}");
            }
        }
    }
    world.step(&mut trial);
    assert_eq!(trial.phase, Phase::Done);
    assert_eq!(world.have(old()), 60);
}

#[test]
fn unreachable_nodes_are_in_no_group_and_too_few_nodes_are_rejected() {
    let mut fleet = World::new(25).candidates();
    fleet[3].reachable = false;
    let trial = begin(fleet.clone(), 3).unwrap();
    assert!(trial.members.iter().all(|m| m.node != "cam-003"));
    fleet[4].reachable = false;
    let error = begin(fleet, 3).unwrap_err();
    assert!(
        error.starts_with("select: too few nodes are in reach, 23 for 3 values"),
        "{error}"
    );
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
    let (world, mut trial) = running(30);
    let mut measured = in_windows(&trial.windows(50_000), |window| world.clips(window));
    measured.get_mut("cam-000").unwrap().after.clear();
    // By default a node needs five clips.
    let too_few = Mean { clips: 4, sum: 4.0 };
    measured.get_mut("cam-001").unwrap().after = [(Figure::JoulesMeasured, too_few)].into();
    trial.end_trial(&measured, EndedBy::Person("ops"), 50_000);
    let result = trial.result.unwrap();
    let sum = |count: fn(&ArmResult) -> usize| result.values.iter().map(count).sum::<usize>();
    assert_eq!(sum(|v| v.applied), 30);
    assert_eq!(sum(|v| v.silent), 1);
    assert_eq!(sum(|v| joules(v).nodes), 28);
    // Nor do its four clips count.
    let mut compared = measured;
    compared.remove("cam-001");
    let of_joules =
        |node: &BeforeAfter| node.after.get(&Figure::JoulesMeasured).map(|mean| mean.clips);
    let clips: u64 = compared.values().filter_map(of_joules).sum();
    let counted: u64 = result.values.iter().map(|v| joules(v).clips).sum();
    assert_eq!(counted, clips);
}

#[test]
fn a_trial_that_cannot_be_measured_ends_without_a_result_and_restores_the_old_value() {
    let (_, mut trial) = running(30);
    for second in 101..101 + i64::from(MOST_FAILED_MEASUREMENTS) {
        assert!(trial.tick(second * SECOND).is_some());
        trial.not_measured(second * SECOND);
    }
    assert_eq!(trial.phase, Phase::Returning);
    assert_eq!(trial.result, None);
    assert_eq!(trial.due()[0].threshold, old());
}

proptest! {
    #[test]
    fn the_draw_is_even_and_reproducible(count in 24usize..200, seed in any::<u64>()) {
        let mut candidates = World::new(count).candidates();
        let mut trial = begin(candidates.clone(), seed).unwrap();
        candidates.reverse();
        prop_assert_eq!(&trial, &begin(candidates, seed).unwrap());
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
