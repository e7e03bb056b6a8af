use super::super::metric::Figures;
use super::*;
use rand_core::{RngCore, SeedableRng};

const EVIDENCE: Evidence = Evidence {
    level: 0.9,
    fewest_clips: 3,
};

fn node(figure: Figure, before: &[f64], after: &[f64]) -> BeforeAfter {
    let figures =
        |values: &[f64]| -> Figures { [(figure, Moments::of(values.iter().copied()))].into() };
    BeforeAfter {
        before: figures(before),
        after: figures(after),
    }
}

/// Nodes with clips that spread by 1 % around their own level; `after` is `factor` times before.
fn fleet(figure: Figure, count: usize, factor: f64) -> Vec<BeforeAfter> {
    let one = |n: usize| {
        let level = 10.0 + n as f64;
        let clips = |factor: f64| [0.99, 1.0, 1.01, 1.0].map(|spread| level * spread * factor);
        let own = factor * (1.0 + 0.002 * (n % 3) as f64);
        node(figure, &clips(1.0), &clips(own))
    };
    (0..count).map(one).collect()
}

#[test]
fn a_gate_reads_as_it_is_written() {
    for (text, metric, bound, relative, where_measured) in [
        ("joules<=+5%", Metric::Joules, 0.05, true, false),
        ("joules <= 7 % ?", Metric::Joules, 0.07, true, true),
        ("skip_rate>=-0.05", Metric::SkipRate, -0.05, false, false),
        ("latency_p99<=+10%", Metric::LatencyP99, 0.1, true, false),
        ("degraded<=+0.01", Metric::Degraded, 0.01, false, false),
    ] {
        let gate: Gate = text.parse().unwrap();
        assert_eq!(
            (gate.metric, gate.relative, gate.where_measured),
            (metric, relative, where_measured),
            "{text}"
        );
        assert!((gate.bound - bound).abs() < 1e-12, "{text}");
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
fn a_change_within_the_bound_passes_one_beyond_it_fails_and_between_nothing_is_decided() {
    let gates: [Gate; 1] = ["joules<=+5%".parse().unwrap()];
    for (factor, expected) in [
        (0.8, Verdict::Passed),
        (1.0, Verdict::Passed),
        (1.03, Verdict::Passed),
        (1.048, Verdict::Undecided),
        (1.1, Verdict::Failed),
    ] {
        for count in [1, 3, 8] {
            let results = judge(
                &gates,
                &fleet(Figure::JoulesMeasured, count, factor),
                EVIDENCE,
            );
            assert_eq!(overall(&results), expected, "{factor} {count} {results:#?}");
            let basis = if count >= PAIRED_FROM {
                Basis::Nodes
            } else {
                Basis::Clips
            };
            assert_eq!(results[0].basis, Some(basis));
        }
    }
}

#[test]
fn for_the_skip_rate_less_is_worse() {
    let gates: [Gate; 1] = ["skip_rate>=-0.05".parse().unwrap()];
    let clips = |level: f64| [level - 0.01, level, level + 0.01];
    let verdict = |after| {
        overall(&judge(
            &gates,
            &[node(Figure::SkipRate, &clips(0.6), &clips(after))],
            EVIDENCE,
        ))
    };
    assert_eq!(verdict(0.8), Verdict::Passed);
    assert_eq!(verdict(0.58), Verdict::Passed);
    assert_eq!(verdict(0.4), Verdict::Failed);
    assert_eq!(verdict(0.55), Verdict::Undecided);
}

#[test]
fn measured_and_estimated_energy_are_judged_apart() {
    let gates: [Gate; 1] = ["joules<=+5%".parse().unwrap()];
    let mut nodes = fleet(Figure::JoulesMeasured, 6, 1.2);
    // A hundred estimates that say the opposite do not outvote six meters.
    nodes.extend(fleet(Figure::JoulesEstimated, 100, 0.7));
    let results = judge(&gates, &nodes, EVIDENCE);
    let by_figure: Vec<_> = results
        .iter()
        .map(|r| (r.figure, r.nodes, r.verdict))
        .collect();
    assert_eq!(
        by_figure,
        [
            (Some(Figure::JoulesMeasured), 6, Verdict::Failed),
            (Some(Figure::JoulesEstimated), 100, Verdict::Passed),
        ]
    );
    assert_eq!(overall(&results), Verdict::Failed);
    // A node whose power source changed has no pair of one kind.
    let mut changed = fleet(Figure::JoulesMeasured, 1, 1.0);
    changed[0].after = fleet(Figure::JoulesEstimated, 1, 1.0)[0].after.clone();
    let results = judge(&gates, &changed, EVIDENCE);
    assert!(
        results
            .iter()
            .all(|r| r.nodes == 0 && r.verdict == Verdict::Undecided),
        "{results:?}"
    );
}

#[test]
fn too_few_clips_decide_nothing() {
    let gates: [Gate; 1] = ["joules<=+5%".parse().unwrap()];
    let short = node(Figure::JoulesMeasured, &[10.0, 10.1], &[20.0, 20.1, 20.2]);
    let results = judge(&gates, &[short], EVIDENCE);
    assert_eq!((results[0].nodes, results[0].nodes_left_out), (0, 1));
    assert_eq!(overall(&results), Verdict::Undecided);
}

#[test]
fn a_metric_that_nobody_reports_leaves_its_gate_undecided_unless_it_is_where_measured() {
    let nodes = fleet(Figure::SkipRate, 6, 1.0);
    for (text, expected) in [
        ("detector_errors<=+0.01", Verdict::Undecided),
        ("detector_errors<=+0.01?", Verdict::Passed),
    ] {
        let results = judge(&[text.parse().unwrap()], &nodes, EVIDENCE);
        assert_eq!((results.len(), results[0].verdict), (1, expected));
    }
}

/// On nodes whose change is exactly at the bound, a verdict of "passed" or "failed" is an error: it must come as
/// seldom as the level says.
#[test]
fn the_error_rate_of_a_verdict_is_that_of_its_level() {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(7);
    let mut normal = || {
        let uniform = (0..12).map(|_| f64::from(random.next_u32()) / f64::from(u32::MAX));
        uniform.sum::<f64>() - 6.0
    };
    let gates: [Gate; 1] = ["joules<=+0".parse().unwrap()];
    for count in [3, 8] {
        let (mut passed, mut failed) = (0, 0);
        for _ in 0..400 {
            // A few nodes are judged as these nodes, so that none of their own drift is in question.
            let drift = if count >= PAIRED_FROM { 0.3 } else { 0.0 };
            let nodes: Vec<_> = (0..count)
                .map(|_| {
                    let (level, shift) = (10.0 + normal(), drift * normal());
                    let mut clips = |shift: f64| [0; 4].map(|_| level + shift + 0.5 * normal());
                    let (before, after) = (clips(0.0), clips(shift));
                    node(Figure::JoulesMeasured, &before, &after)
                })
                .collect();
            match overall(&judge(&gates, &nodes, EVIDENCE)) {
                Verdict::Passed => passed += 1,
                Verdict::Failed => failed += 1,
                Verdict::Undecided => {}
            }
        }
        // 5 % of 400 on each side, within four standard deviations.
        for verdicts in [passed, failed] {
            assert!(
                (3..=38).contains(&verdicts),
                "{count} nodes: {passed} {failed}"
            );
        }
    }
}
