//! Writes the verdict of a comparison: a sentence per policy.

use super::run::{Comparison, Run};
use super::summary::{Change, Figure, Mean, Summary, VariantSummary};
use albireo_core::policy::short;
use albireo_wire::{EnergyQuality, FULL_COVERAGE};
use serde::Serialize;

/// Seconds per year.
const SECONDS_PER_YEAR: f64 = 365.25 * 86_400.0;

/// Joules per kilowatt-hour.
const JOULES_PER_KWH: f64 = 3.6e6;

/// The result of one policy against the first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Verdict {
    /// The policy's label.
    pub policy: String,
    /// Change of detector calls against the first policy, percent; negative if there are fewer.
    pub detector_calls_percent: Option<f64>,
    /// AP@50 of its boxes against those of the policy that runs the detector on every frame, 0 to 1.
    pub ap50: Option<f64>,
    /// Kilowatt-hours per year that a camera saves if every hour is like this clip; negative if it costs more. `None`
    /// if a run has no energy, if there is one round only, or if the clip was not played at its own rate.
    pub kwh_a_year: Option<Mean>,
    /// The quality of the energy figures.
    pub energy: EnergyQuality,
    /// True if it skipped at least one frame.
    pub skips: bool,
    /// The frames of all rounds that its node did not process: without them it had less work.
    pub dropped: u64,
    /// The same of the first policy.
    pub dropped_by_first: u64,
    /// The verdict as a sentence.
    pub sentence: String,
}

/// Returns a verdict on every policy except the first.
pub(super) fn verdicts(comparison: &Comparison, summary: &Summary) -> Vec<Verdict> {
    let Some((first, others)) = summary.policies.split_first() else {
        return Vec::new();
    };
    others
        .iter()
        .enumerate()
        .map(|(index, policy)| verdict(comparison, summary, first, policy, index + 1))
        .collect()
}

fn verdict(
    comparison: &Comparison,
    summary: &Summary,
    first: &VariantSummary,
    policy: &VariantSummary,
    variant: usize,
) -> Verdict {
    let calls = policy.change(Figure::DetectorCalls);
    let mut verdict = Verdict {
        policy: policy.policy.clone(),
        detector_calls_percent: calls.map(|change| change.percent),
        ap50: policy.mean(Figure::Ap50).map(|mean| mean.mean),
        kwh_a_year: kwh_a_year(comparison, variant),
        energy: summary.energy,
        skips: skips(comparison, variant),
        dropped: dropped(comparison, variant),
        dropped_by_first: dropped(comparison, 0),
        sentence: String::new(),
    };
    verdict.sentence = sentence(comparison, summary, first, policy, variant, &verdict);
    if verdict.dropped + verdict.dropped_by_first > 0 {
        verdict.sentence.push_str(&unequal(comparison, &verdict));
    }
    verdict
}

/// True if a variant skipped a frame in any round.
fn skips(comparison: &Comparison, variant: usize) -> bool {
    let mut own = comparison.runs.iter().filter(|run| run.variant == variant);
    own.any(|run| run.report.skip_rate > 0.0)
}

/// The frames of a variant that its node did not process, over all rounds.
fn dropped(comparison: &Comparison, variant: usize) -> u64 {
    comparison
        .runs
        .iter()
        .filter(|run| run.variant == variant)
        .map(|run| run.report.dropped.total())
        .sum()
}

/// Says that frames were dropped, what that means for the comparison, and how none is.
fn unequal(comparison: &Comparison, verdict: &Verdict) -> String {
    let rounds = comparison.runs.iter().filter(|run| run.variant == 0).count() as u64;
    let slower = match comparison.playing.played_rate {
        Some(rate) => short(rate / comparison.playing.rate / 2.0),
        None => "0.5".to_owned(),
    };
    format!(
        " Not equal work: of {} frames each, {} of its own and {} of {} were dropped. A dropped frame costs no detector \
         call and is not judged. Play it so that none is: --unpaced, or --speed {slower} or less.",
        comparison.playing.frames * rounds,
        verdict.dropped,
        verdict.dropped_by_first,
        comparison.policies.first().map_or("", String::as_str),
    )
}

fn sentence(
    comparison: &Comparison,
    summary: &Summary,
    first: &VariantSummary,
    policy: &VariantSummary,
    variant: usize,
    verdict: &Verdict,
) -> String {
    let name = &verdict.policy;
    if !verdict.skips {
        let advice = comparison
            .runs
            .iter()
            .filter(|run| run.variant == variant)
            .find_map(|run| run.advice.as_ref());
        return match advice {
            Some(advice) => format!(
                "{name}: no frame was skipped, so nothing was saved; try {} = {}.",
                advice.threshold,
                short(advice.value)
            ),
            None => format!("{name}: no frame was skipped, so nothing was saved."),
        };
    }
    let mut parts = Vec::new();
    if let Some(calls) = policy.change(Figure::DetectorCalls) {
        let than = &first.policy;
        if is_unclear(calls) {
            parts.push(format!(
                "no clear difference in detector calls to {than} in {} rounds",
                summary.rounds
            ));
        } else {
            let word = if calls.percent > 0.0 { "more" } else { "fewer" };
            let share = with_half(calls.percent.abs(), calls.half);
            parts.push(format!("{share} % {word} detector calls than {than}"));
        }
    }
    if let Some(ap50) = verdict.ap50 {
        let of = comparison.policies.get(comparison.boxes_of);
        parts.push(format!(
            "AP@50 {:.1} % against the boxes of {}",
            ap50 * 100.0,
            of.map_or("", String::as_str)
        ));
    }
    parts.extend(energy(summary, policy, verdict));
    format!("{name}: {}.", parts.join(", "))
}

/// Describes the change of energy; `None` if the energy is known, but not its change.
fn energy(summary: &Summary, policy: &VariantSummary, verdict: &Verdict) -> Option<String> {
    let source = &summary.energy_source;
    let basis = match summary.energy {
        EnergyQuality::Measured => format!("measured by `{source}`"),
        EnergyQuality::Partial if summary.coverage >= FULL_COVERAGE => {
            format!("measured by `{source}` for a part of the machine")
        }
        EnergyQuality::Partial => format!("measured by `{source}` with gaps"),
        EnergyQuality::Estimated => "estimated".to_owned(),
        EnergyQuality::Unavailable => return Some("energy not known".to_owned()),
    };
    let change = policy.change(Figure::Joules)?;
    if is_unclear(change) {
        return Some(format!(
            "no clear difference in energy in {} rounds ({basis})",
            summary.rounds
        ));
    }
    let word = |saved: f64| if saved < 0.0 { "more" } else { "saved" };
    Some(match verdict.kwh_a_year {
        Some(kwh) => format!(
            "{} kWh for a year like this clip {} ({basis})",
            with_half(kwh.mean.abs(), kwh.half),
            word(kwh.mean)
        ),
        None => format!(
            "{} % of the energy {} ({basis})",
            with_half(change.percent.abs(), change.half),
            word(-change.percent)
        ),
    })
}

/// True if the interval of a change contains zero.
fn is_unclear(change: Change) -> bool {
    change.half.is_some_and(|half| half >= change.percent.abs())
}

/// Formats a value and half of its 95 % interval with the same decimals: `25 ± 3`.
fn with_half(value: f64, half: Option<f64>) -> String {
    match half.filter(|half| *half > 1e-9) {
        None => format!("{value:.0}"),
        Some(half) => {
            let decimals = usize::from(half < 1.0);
            format!("{value:.decimals$} ± {half:.decimals$}")
        }
    }
}

/// Computes the energy saved per year from the difference of mean power in each round.
fn kwh_a_year(comparison: &Comparison, variant: usize) -> Option<Mean> {
    // Played faster or slower than the camera, the power is not that of a camera.
    if comparison.playing.played_rate != Some(comparison.playing.rate) {
        return None;
    }
    let watts = |variant: usize| -> Option<Vec<f64>> {
        comparison
            .runs
            .iter()
            .filter(|run| run.variant == variant)
            .map(mean_watts)
            .collect()
    };
    let first = watts(0)?;
    let own = watts(variant)?;
    let rounds = first.iter().zip(&own);
    let saved: Vec<f64> = rounds
        .map(|(first, own)| (first - own) * SECONDS_PER_YEAR / JOULES_PER_KWH)
        .collect();
    Mean::of(&saved).filter(|mean| mean.half.is_some())
}

fn mean_watts(run: &Run) -> Option<f64> {
    let seconds = run.report.duration_s;
    let joules = run.report.energy.whole_joules()?;
    (seconds > 0.0).then(|| joules / seconds)
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::{comparison, round, rounds, run};
    use super::super::{Suggestion, summarise};
    use super::*;

    fn sentences(comparison: &Comparison) -> Vec<String> {
        verdicts(comparison, &summarise(comparison))
            .into_iter()
            .map(|verdict| verdict.sentence)
            .collect()
    }

    #[test]
    fn a_difference_in_energy_within_its_interval_is_not_clear() {
        let policies = ["vanilla", "expected-loss lambda=0.3"];
        let lines = sentences(&comparison(&policies, rounds([80.0, 79.9], 39).collect()));
        let said = "no clear difference in energy in 3 rounds";
        assert!(lines[0].contains(said), "{lines:?}");
    }

    #[test]
    fn a_difference_in_detector_calls_within_its_interval_is_not_clear() {
        let policies = ["vanilla", "expected-loss lambda=0.3"];
        let calls = [(100, 20), (100, 95), (100, 85)];
        let runs = calls.iter().enumerate().flat_map(|(round, &(first, own))| {
            [run(round, 0, first, None), run(round, 1, own, None)]
        });
        let lines = sentences(&comparison(&policies, runs.collect()));
        let said = "no clear difference in detector calls to vanilla in 3 rounds";
        assert!(lines[0].contains(said), "{lines:?}");
    }

    #[test]
    fn dropped_frames_are_counted_in_the_verdict_with_what_they_mean_and_the_way_out() {
        let policies = ["vanilla", "albireo u=5e-4"];
        let mut dropping = comparison(&policies, rounds([80.0, 60.0], 40).collect());
        assert!(!sentences(&dropping)[0].contains("dropped"));
        for run in &mut dropping.runs {
            if run.variant == 0 {
                run.report.dropped.overrun = 4;
            }
        }
        dropping.runs[1].report.dropped.overrun = 1;
        let said = "Not equal work: of 300 frames each, 1 of its own and 12 of vanilla were dropped. A dropped frame costs \
                    no detector call and is not judged. Play it so that none is: --unpaced, or --speed 0.5 or less.";
        let lines = sentences(&dropping);
        assert!(lines[0].ends_with(said), "{lines:?}");
    }

    #[test]
    fn without_skipped_frames_the_verdict_gives_advice() {
        let mut runs = vec![run(0, 0, 100, None), run(0, 1, 100, None)];
        runs[1].advice = Some(Suggestion {
            threshold: "u",
            value: 4e-4,
        });
        let lines = sentences(&comparison(&["vanilla", "albireo u=1e-4"], runs));
        let said = "albireo u=1e-4: no frame was skipped, so nothing was saved; try u = 4e-4.";
        assert_eq!(lines[0], said);
    }

    #[test]
    fn a_policy_under_which_no_frame_was_answered_has_saved_nothing() {
        let mut silent = run(0, 1, 0, None);
        silent.frame_ms = None;
        silent.report.frames = 0;
        silent.report.skip_rate = 0.0;
        silent.report.dropped.overrun = 100;
        let runs = vec![run(0, 0, 100, None), silent];
        let lines = sentences(&comparison(&["vanilla", "albireo u=1e-4"], runs));
        let said = "albireo u=1e-4: no frame was skipped, so nothing was saved. Not equal work";
        assert!(lines[0].starts_with(said), "{lines:?}");
    }

    #[test]
    fn one_round_or_an_unpaced_clip_gives_no_yearly_figure() {
        let played = |rounds: usize| {
            let runs = (0..rounds).flat_map(|number| round(number, [80.0, 60.0], 40));
            comparison(&["vanilla", "albireo u=5e-4"], runs.collect())
        };
        let mut unpaced = played(2);
        assert!(sentences(&unpaced)[0].contains("year"));
        unpaced.playing.played_rate = None;
        for comparison in [unpaced, played(1)] {
            let lines = sentences(&comparison);
            assert!(lines[0].contains("25 % of the energy saved"), "{lines:?}");
            assert!(!lines[0].contains("year"), "{lines:?}");
        }
    }
}
