use super::super::metric::Mean;
use super::*;

const RATES: ErrorRates = ErrorRates {
    fail: 0.01,
    pass: 0.05,
};

/// Fewest clips of a node before and after.
const FEWEST_CLIPS: u64 = 5;

/// A node with just enough clips of that mean before and after.
fn node(figure: Figure, before: f64, after: f64) -> BeforeAfter {
    let clips = |mean: f64| {
        let enough = Mean {
            clips: FEWEST_CLIPS,
            sum: FEWEST_CLIPS as f64 * mean,
        };
        [(figure, enough)].into()
    };
    BeforeAfter {
        before: clips(before),
        after: clips(after),
    }
}

/// Nodes around their own levels; after is `factor` times before, give or take 2 %.
fn fleet(figure: Figure, count: usize, factor: f64) -> Vec<BeforeAfter> {
    let one = |n: usize| {
        let level = 10.0 + n as f64;
        let own = factor * (1.0 + 0.01 * ((n * 7 % 5) as f64 - 2.0));
        node(figure, level, level * own)
    };
    (0..count).map(one).collect()
}

fn judged(gate: &str, changed: &[BeforeAfter], unchanged: &[BeforeAfter]) -> Vec<GateResult> {
    let changed: Vec<_> = changed.iter().collect();
    let unchanged: Vec<_> = unchanged.iter().collect();
    let gates = [gate.parse().unwrap()];
    judge(&gates, &changed, &unchanged, FEWEST_CLIPS, RATES)
}

fn verdict(gate: &str, changed: &[BeforeAfter], unchanged: &[BeforeAfter]) -> Verdict {
    overall(&judged(gate, changed, unchanged))
}

#[test]
fn a_gate_is_read_back_as_written() {
    for (text, metric, bound) in [
        ("joules<=+5%", Metric::Joules, 0.05),
        ("joules <= 7 % ?", Metric::Joules, 0.07),
        ("skip_rate>=-0.05", Metric::SkipRate, -0.05),
        ("latency_p99<=+10%", Metric::LatencyP99, 0.1),
        ("degraded<=+0.01", Metric::Degraded, 0.01),
        ("joules<=+1e-12%", Metric::Joules, 1e-14),
        ("joules<=+199999999990%", Metric::Joules, 1_999_999_999.9),
    ] {
        let gate: Gate = text.parse().unwrap();
        let is_relative = gate.scale == Scale::Relative;
        assert_eq!(gate.metric, metric, "{text}");
        assert_eq!(is_relative, text.contains('%'), "{text}");
        assert_eq!(gate.where_measured, text.contains('?'), "{text}");
        assert!((gate.bound() - bound).abs() < 1e-15 * bound.abs(), "{text}");
        assert_eq!(gate.to_string().parse::<Gate>().unwrap(), gate);
    }
    for wrong in [
        "joules",
        "joules>=5%",
        "skip_rate<=0.1",
        "watts<=1",
        "joules<=much",
        "joules<=nan",
        "",
    ] {
        assert!(wrong.parse::<Gate>().is_err(), "{wrong}");
    }
}

#[test]
fn a_change_that_others_do_not_share_passes_within_the_bound_and_fails_beyond_it() {
    for (factor, others, expected) in [
        (0.8, 1.0, Verdict::Passed),
        (1.0, 1.0, Verdict::Passed),
        (1.03, 1.0, Verdict::Passed),
        (1.048, 1.0, Verdict::Undecided),
        (1.1, 1.0, Verdict::Failed),
        (1.5, 1.0, Verdict::Failed),
        (1.5, 1.5, Verdict::Passed),
    ] {
        let rest = fleet(Figure::JoulesMeasured, 40, others);
        let changed = fleet(Figure::JoulesMeasured, 12, factor);
        let results = judged("joules<=+5%", &changed, &rest);
        assert_eq!(overall(&results), expected, "{factor} {results:#?}");
        let estimate = results[0].change.unwrap().estimate;
        let off = estimate - (factor / others - 1.0);
        assert!(off.abs() < 0.01, "{estimate}");
    }
}

#[test]
fn a_lower_skip_rate_is_worse() {
    let share = |after: f64| -> Vec<BeforeAfter> {
        let rate = |level: f64, n: i32| level + 0.01 * f64::from(n);
        (0..10)
            .map(|n| node(Figure::SkipRate, rate(0.6, n % 3), rate(after, n % 4)))
            .collect()
    };
    let verdict = |after| verdict("skip_rate>=-0.05", &share(after), &share(0.6));
    assert_eq!(verdict(0.8), Verdict::Passed);
    assert_eq!(verdict(0.58), Verdict::Passed);
    assert_eq!(verdict(0.4), Verdict::Failed);
    assert_eq!(verdict(0.55), Verdict::Undecided);
}

#[test]
fn measured_and_estimated_energy_are_judged_separately() {
    let mut changed = fleet(Figure::JoulesMeasured, 8, 1.2);
    let mut rest = fleet(Figure::JoulesMeasured, 8, 1.0);
    // A hundred estimates that say the opposite do not outvote eight meters.
    changed.extend(fleet(Figure::JoulesEstimated, 100, 0.7));
    rest.extend(fleet(Figure::JoulesEstimated, 100, 1.0));
    let results = judged("joules<=+5%", &changed, &rest);
    let expected = [
        (Figure::JoulesMeasured, 8, Verdict::Failed),
        (Figure::JoulesEstimated, 100, Verdict::Passed),
    ];
    assert_eq!(results.len(), expected.len());
    for (result, (figure, nodes, verdict)) in results.iter().zip(expected) {
        assert_eq!(result.figure, Some(figure));
        assert_eq!(result.nodes, nodes);
        assert_eq!(result.verdict, verdict);
    }
    assert_eq!(overall(&results), Verdict::Failed);
    // A node whose power source changed has no pair of one kind.
    let mut replaced = fleet(Figure::JoulesMeasured, 8, 1.0);
    for node in &mut replaced {
        node.after = fleet(Figure::JoulesEstimated, 1, 1.0)[0].after.clone();
    }
    let results = judged("joules<=+5%", &replaced, &rest);
    for result in &results {
        assert_eq!(result.nodes, 0);
        assert_eq!(result.verdict, Verdict::NotMeasured);
    }
}

#[test]
fn nodes_with_too_few_clips_do_not_count_and_fewer_than_eight_nodes_measure_nothing() {
    let rest = fleet(Figure::JoulesMeasured, 40, 1.0);
    let mut changed = fleet(Figure::JoulesMeasured, 8, 2.0);
    let gate = "joules<=+5%";
    assert_eq!(verdict(gate, &changed, &rest), Verdict::Failed);
    let too_few = Mean {
        clips: FEWEST_CLIPS - 1,
        sum: 80.0,
    };
    changed[0].after = [(Figure::JoulesMeasured, too_few)].into();
    let results = judged(gate, &changed, &rest);
    assert_eq!(results[0].nodes, 7);
    assert_eq!(results[0].compared, 40);
    assert_eq!(overall(&results), Verdict::NotMeasured);
    let against_seven = verdict(gate, &rest, &rest[..7]);
    assert_eq!(against_seven, Verdict::NotMeasured);
    // Eight that changed alike leave no doubt.
    let alike = vec![node(Figure::JoulesMeasured, 1.0, 1.0); 8];
    let change = judged(gate, &alike, &alike)[0].change.unwrap();
    assert_eq!(change.lower, 0.0);
    assert_eq!(change.upper, 0.0);
}

#[test]
fn an_unreported_metric_leaves_its_gate_undecided_unless_the_gate_applies_where_measured() {
    let nodes = fleet(Figure::SkipRate, 10, 1.0);
    for (text, expected) in [
        ("recall>=-0.02", Verdict::Undecided),
        ("recall>=-0.02?", Verdict::Passed),
    ] {
        let results = judged(text, &nodes, &nodes);
        assert_eq!(results.len(), 1);
        assert_eq!(results[0].verdict, expected);
    }
}
