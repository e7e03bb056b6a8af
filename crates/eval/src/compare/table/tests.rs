use super::super::summary::tests::{comparison, rounds};
use super::super::{Agreement, summarise};
use super::*;
use crate::text::WIDTH;
use albireo_wire::EnergyQuality;

fn played(quality: EnergyQuality) -> Comparison {
    let mut runs = Vec::from_iter(rounds([80.0, 60.0], 40));
    for run in &mut runs {
        run.report.energy.quality = quality;
        run.agreement = Some(Agreement {
            ap50: 0.912,
            precision: 0.95,
            recall: 0.93,
            frames: 100,
        });
    }
    comparison(&["vanilla", "albireo u=5e-4"], runs)
}

fn text(comparison: &Comparison) -> String {
    render(comparison, &summarise(comparison), WIDTH)
}

#[test]
fn a_measured_comparison_shows_means_changes_and_boxes() {
    let found = text(&played(EnergyQuality::Measured));
    assert_eq!(found, include_str!("measured.txt"), "\n{found}");
}

#[test]
fn a_clip_with_ground_truth_is_judged_by_it_as_well_and_its_size_is_told() {
    let mut comparison = played(EnergyQuality::Measured);
    assert!(!text(&comparison).contains("ground truth"));
    comparison.playing.truth = Some(TruthSize {
        boxes: 834,
        frames: 500,
        clips: 2,
    });
    for run in &mut comparison.runs {
        run.by_truth = Some(Agreement {
            ap50: 0.512,
            precision: 0.8,
            recall: 0.61,
            frames: 500,
        });
    }
    let found = text(&comparison);
    let words = found.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        words.contains("834 boxes in 500 frames of 2 clips as one"),
        "{words}"
    );
    assert!(words.contains("51.2 ± 0"), "{words}");
}

#[test]
fn an_estimate_is_never_called_a_measurement() {
    let found = text(&played(EnergyQuality::Estimated));
    assert!(found.contains("There is no power meter here"), "{found}");
    assert!(found.contains("ESTIMATED       ESTIMATED"), "{found}");
    assert!(!found.contains("measured by"), "{found}");
}

#[test]
fn without_energy_there_is_no_column_for_it() {
    let mut comparison = played(EnergyQuality::Unavailable);
    for run in &mut comparison.runs {
        run.report.energy.joules = None;
        run.report.energy.edp = None;
    }
    let found = text(&comparison);
    for column in ["energy J", "EDP"] {
        assert!(!found.contains(column), "{found}");
    }
    assert!(found.contains("so there is no energy"), "{found}");
    assert!(found.contains("detector calls"), "{found}");
}

#[test]
fn gaps_of_the_meter_are_reported_with_the_covered_share() {
    let mut comparison = played(EnergyQuality::Partial);
    comparison.runs[0].report.energy.coverage = 0.815;
    let found = text(&comparison);
    let share = "samples cover 81.5 % of the worst run";
    assert!(found.contains(share), "{found}");
}

#[test]
fn the_energy_of_a_part_of_a_run_is_in_no_mean() {
    let mut comparison = played(EnergyQuality::Partial);
    for (coverage, is_whole) in [(0.815, false), (0.9995, true)] {
        comparison.runs[0].report.energy.coverage = coverage;
        let summary = summarise(&comparison);
        for figure in [Figure::Joules, Figure::Edp] {
            let mean = summary.policies[0].mean(figure);
            assert_eq!(mean.is_some(), is_whole, "{figure:?} at {coverage}");
        }
    }
}

#[test]
fn a_single_round_has_no_intervals() {
    let mut comparison = played(EnergyQuality::Measured);
    comparison.runs.truncate(2);
    let found = text(&comparison);
    assert!(!found.contains('±'), "{found}");
    assert!(found.contains("no confidence interval"), "{found}");
    assert!(found.contains("-25.0 %"), "{found}");
}

#[test]
fn no_line_is_wider_than_the_terminal_and_no_column_is_lost() {
    let mut comparison = played(EnergyQuality::Measured);
    comparison.policies = vec![
        "fixed-skip-in-tracker n=3".to_owned(),
        "a policy with a name as long as this one here".to_owned(),
    ];
    comparison.playing.clip = "word ".repeat(60);
    for run in &mut comparison.runs {
        run.report.energy.joules = run.report.energy.joules.map(|joules| joules * 12_345.6);
        run.report.energy.edp = run.report.energy.edp.map(|product| product * 12_345.6);
    }
    let summary = summarise(&comparison);
    for width in [80, WIDTH] {
        let found = render(&comparison, &summary, width);
        for line in found.lines() {
            assert!(line.chars().count() <= width, "{line}");
        }
        for column in ["EDP J·ms/frame", "detector calls", "frames dropped"] {
            assert!(found.contains(column), "{found}");
        }
    }
}
