use super::*;
use proptest::prelude::*;

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

fn candidates(count: usize) -> Vec<Candidate> {
    let one = |i: usize| Candidate {
        node: format!("cam-{i:03}"),
        before: u(2e-4),
        reachable: true,
    };
    (0..count).map(one).collect()
}

/// Nodes report at once what they are asked for.
fn obey(trial: &mut Trial, revision: &mut u64, now: Millis) {
    let mut have = BTreeMap::new();
    for order in trial.due() {
        *revision += 1;
        for node in &order.nodes {
            have.insert(node.clone(), (*revision, order.knob));
        }
        trial.asked(&order, *revision, now);
    }
    trial.observe(now, |node| {
        have.get(node).map(|(revision, knob)| Seen {
            reachable: true,
            revision: *revision,
            knob: Some(*knob),
            target: None,
            cannot_hold: None,
            refused: None,
        })
    });
}

/// Each node has a level of its own; the energy falls with the value.
fn measure(window: &TrialWindow) -> BTreeMap<String, Figures> {
    let of = |(i, (node, value)): (usize, &(String, Threshold))| {
        let level = 100.0 + (i % 7) as f64 - 30.0 * (value.value / 1e-4).log10();
        let joules = Moments::of([0.98, 1.0, 1.02, 0.99, 1.01].map(|s| level * s));
        (
            node.clone(),
            Figures::from([(Figure::JoulesMeasured, joules)]),
        )
    };
    window.nodes.iter().enumerate().map(of).collect()
}

#[test]
fn a_trial_gives_each_group_its_value_measures_it_and_gives_the_old_value_back() {
    let (mut now, mut revision) = (0, 0);
    let mut trial = Trial::begin(plan(), candidates(60), 3, now).unwrap();
    for (arm, value) in plan().values.iter().enumerate() {
        let order = trial.due().into_iter().find(|o| o.knob == *value).unwrap();
        assert_eq!(order.nodes.len(), 20, "{arm}");
    }
    obey(&mut trial, &mut revision, now);
    trial.tick(now);
    assert_eq!(trial.phase, TrialPhase::Running { since_ms: 0 });
    now += 99_999;
    assert_eq!(trial.tick(now), None);
    now += 1;
    let window = trial.tick(now).unwrap();
    assert_eq!(
        (window.nodes.len(), window.from_ms, window.until_ms),
        (60, 0, 100_000)
    );
    trial.end(&window, &measure(&window), None, now);
    let result = trial.result.clone().unwrap();
    let means: Vec<f64> = result.values.iter().map(|v| v.figures[0].mean).collect();
    assert!(means[0] > means[1] && means[1] > means[2], "{means:?}");
    assert_eq!(result.values[0].figures[0].difference, None);
    let against_first = result.values[2].figures[0].difference.unwrap();
    assert!(
        against_first.lower < -30.0 && -30.0 < against_first.upper,
        "{against_first:?}"
    );
    assert!(against_first.upper < 0.0);
    assert_eq!(trial.due().len(), 1);
    assert_eq!(trial.due()[0].knob, u(2e-4));
    obey(&mut trial, &mut revision, now);
    trial.tick(now);
    assert_eq!(trial.phase, TrialPhase::Done);
}

#[test]
fn nodes_out_of_reach_are_in_no_group_and_too_few_are_refused() {
    let mut fleet = candidates(8);
    fleet[3].reachable = false;
    let trial = Trial::begin(plan(), fleet.clone(), 3, 0).unwrap();
    assert!(trial.members.iter().all(|m| m.node != "cam-003"));
    fleet[4].reachable = false;
    fleet[5].reachable = false;
    let error = Trial::begin(plan(), fleet, 3, 0).unwrap_err();
    assert_eq!(error.field, "select");
}

#[test]
fn a_plan_that_compares_nothing_is_refused() {
    for values in [
        vec![],
        vec![u(1e-4)],
        vec![u(1e-4), u(1e-4)],
        vec![u(1e-4), Threshold::new("lambda", 0.3)],
    ] {
        let plan = TrialPlan { values, ..plan() };
        assert_eq!(plan.check().unwrap_err().field, "values");
    }
}

#[test]
fn a_node_with_too_few_clips_or_without_its_value_is_not_in_the_result() {
    let mut revision = 0;
    let mut trial = Trial::begin(plan(), candidates(12), 3, 0).unwrap();
    obey(&mut trial, &mut revision, 0);
    trial.tick(0);
    let mut window = trial.window(50_000);
    let silent = window.nodes.remove(0).0;
    let mut measured = measure(&window);
    let short = window.nodes[0].0.clone();
    measured.insert(
        short.clone(),
        [(Figure::JoulesMeasured, Moments::of([1.0, 1.0]))].into(),
    );
    let result = trial.compare(&window, &measured);
    let nodes: u64 = result.values.iter().map(|v| v.figures[0].nodes).sum();
    assert_eq!(nodes, 10, "without {silent} and {short}");
    assert_eq!(result.values.iter().map(|v| v.applied).sum::<usize>(), 11);
}

proptest! {
    #[test]
    fn the_draw_is_even_and_the_same_for_the_same_seed(count in 6usize..200, seed in any::<u64>()) {
        let trial = Trial::begin(plan(), candidates(count), seed, 0).unwrap();
        let mut reversed = candidates(count);
        reversed.reverse();
        prop_assert_eq!(&trial, &Trial::begin(plan(), reversed, seed, 0).unwrap());
        let size = |arm| trial.members.iter().filter(|m| m.group == arm).count();
        let sizes = [size(0), size(1), size(2)];
        prop_assert_eq!(sizes.iter().sum::<usize>(), count);
        prop_assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1);
        // What is read from the database goes on as it was.
        let text = serde_json::to_string(&trial).unwrap();
        prop_assert_eq!(serde_json::from_str::<Trial>(&text).unwrap(), trial);
    }
}
