use super::super::run::Playback;
use super::*;
use albireo_wire::{BoardState, ClipEnergy, ClipReport, FrameStates, Percentiles};

/// A run of 100 frames and 10 s with `calls` detector calls and this energy.
pub(crate) fn run(round: usize, variant: usize, calls: u64, joules: Option<f64>) -> Run {
    let states = FrameStates {
        i: calls,
        p: 100 - calls,
        ..FrameStates::default()
    };
    let times = |count, mean| Percentiles {
        count,
        mean,
        ..Percentiles::default()
    };
    let quality = joules.map_or(EnergyQuality::Unavailable, |_| EnergyQuality::Measured);
    let energy = ClipEnergy {
        joules,
        edp: joules.map(|joules| joules * 100.0),
        quality,
        source: "rapl".to_owned(),
        samples: 100,
        coverage: 1.0,
        ..ClipEnergy::default()
    };
    Run {
        round,
        variant,
        cpu_s: calls as f64 / 50.0,
        meter_share_of_core: 0.001,
        frame_ms: Some(12.5),
        agreement: None,
        by_truth: None,
        advice: None,
        report: ClipReport {
            duration_s: 10.0,
            frames: 100,
            states,
            skip_rate: states.skip_rate(0),
            detector_latency_ms: times(calls, 20.0),
            energy,
            ..ClipReport::default()
        },
    }
}

/// A round of vanilla and of a policy with `calls` detector calls.
pub(crate) fn round(round: usize, joules: [f64; 2], calls: u64) -> [Run; 2] {
    let [vanilla, other] = joules.map(Some);
    [run(round, 0, 100, vanilla), run(round, 1, calls, other)]
}

/// Three rounds whose joules differ slightly.
pub(crate) fn rounds(joules: [f64; 2], calls: u64) -> impl Iterator<Item = Run> {
    let [vanilla, other] = joules;
    let noises = [0.0, 0.5, -0.5];
    noises
        .into_iter()
        .enumerate()
        .flat_map(move |(number, noise)| round(number, [vanilla + noise, other - noise], calls))
}

pub(crate) fn comparison(policies: &[&str], runs: Vec<Run>) -> Comparison {
    Comparison {
        playing: Playback {
            clip: "synth-1".to_owned(),
            frames: 100,
            size: "1280x720".to_owned(),
            rate: 10.0,
            played_rate: Some(10.0),
            warm_up_s: 2.0,
            cool_down_s: 3.0,
            detector: "detector.onnx run by cpu".to_owned(),
            cores: 2,
            truth: None,
        },
        policies: policies.iter().map(|name| (*name).to_owned()).collect(),
        boxes_of: 0,
        runs,
    }
}

#[test]
fn a_mean_has_students_interval_over_the_rounds() {
    // Mean 12, standard deviation 2, t(0.975, 2) = 4.302653: 4.302653 · 2 / √3.
    let found = Mean::of(&[10.0, 12.0, 14.0]).unwrap();
    assert_eq!(found.mean, 12.0);
    assert_eq!(found.rounds, 3);
    assert!((found.half.unwrap() - 4.968_275).abs() < 1e-5, "{found:?}");
}

#[test]
fn a_single_round_has_no_interval_and_equal_ones_have_one_of_zero() {
    assert_eq!(Mean::of(&[3.0]).unwrap().half, None);
    assert_eq!(Mean::of(&[0.0, 0.0]).unwrap().half, Some(0.0));
    assert_eq!(Mean::of(&[2.0, 2.0]).unwrap().half, Some(0.0));
}

#[test]
fn there_is_no_mean_of_no_values_or_of_one_that_is_not_finite() {
    assert_eq!(Mean::of(&[]), None);
    assert_eq!(Mean::of(&[1.0, f64::NAN]), None);
}

#[test]
fn changes_are_paired_by_round_so_that_a_drift_does_not_widen_them() {
    // The board warms up from round to round; albireo saves a quarter of 100 J each time.
    let drifting = (0..4).flat_map(|number| {
        let drift = 10.0 * number as f64;
        round(number, [85.0 + drift, 60.0 + drift], 40)
    });
    let comparison = comparison(&["vanilla", "albireo u=5e-4"], drifting.collect());
    let summary = summarise(&comparison);
    let [vanilla, albireo] = summary.policies.as_slice() else {
        panic!("{summary:?}");
    };
    assert!(vanilla.mean(Figure::Joules).unwrap().half.unwrap() > 15.0);
    assert!(vanilla.changes.is_empty());
    let change = albireo.change(Figure::Joules).unwrap();
    assert!((change.percent + 25.0).abs() < 1e-9);
    assert!(change.half.unwrap() < 1e-9);
    assert_eq!(summary.rounds, 4);
}

#[test]
fn the_least_reliable_quality_of_a_run_is_that_of_the_whole() {
    let mut runs = round(0, [9.0, 5.0], 50).to_vec();
    let quality_of = |runs: &Vec<Run>| summarise(&comparison(&["a", "b"], runs.clone())).energy;
    runs[1].report.energy.quality = EnergyQuality::Partial;
    assert_eq!(quality_of(&runs), EnergyQuality::Partial);
    runs[0].report.energy.quality = EnergyQuality::Estimated;
    assert_eq!(quality_of(&runs), EnergyQuality::Estimated);
    runs[0].report.energy.joules = None;
    assert_eq!(quality_of(&runs), EnergyQuality::Unavailable);
}

#[test]
fn a_run_without_energy_leaves_its_policy_without_a_mean() {
    let [mut first, second] = round(0, [9.0, 5.0], 50);
    first.report.energy.joules = None;
    let summary = summarise(&comparison(&["a", "b"], vec![first, second]));
    assert_eq!(summary.policies[0].mean(Figure::Joules), None);
    let other = summary.policies[1].mean(Figure::Joules);
    assert_eq!(other.unwrap().mean, 5.0);
}

#[test]
fn the_boards_mode_and_throttling_are_reported() {
    let mut runs = round(0, [9.0, 5.0], 50).to_vec();
    for (run, throttled) in runs.iter_mut().zip([false, true]) {
        run.report.board = Some(BoardState {
            power_mode: Some("15W".to_owned()),
            throttled: Some(throttled),
            ..BoardState::default()
        });
    }
    let summary = summarise(&comparison(&["a", "b"], runs));
    assert_eq!(summary.throttled_runs, 1);
    assert_eq!(summary.power_modes, ["15W"]);
}
