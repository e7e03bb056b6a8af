//! What a comparison comes to: a sentence a policy, and what to try.

use super::run::{Comparison, Run};
use super::summary::{Basis, Figure, PolicySummary, Summary};
use crate::recommendation::RECOMMENDATION;
use albireo_core::policy::short;
use serde::Serialize;

/// Seconds of a year.
const YEAR_S: f64 = 365.25 * 86_400.0;

/// Joules of a kilowatt-hour.
const KWH: f64 = 3.6e6;

/// The least AP@50 against the detector's own boxes that counts as kept.
const KEPT_AP50: f64 = 0.95;

/// What one policy comes to against the first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Its label.
    pub policy: String,
    /// Detector calls against the first policy, percent; below zero is fewer.
    pub detector_calls_percent: Option<f64>,
    /// AP@50 of its boxes against those of the policy that looks at every frame, 0 to 1.
    pub ap50: Option<f64>,
    /// Kilowatt-hours that a camera that films like this for a year saves; below zero it costs more. Absent without
    /// energy of every run, and where the clip was not played at its own pace.
    pub kwh_a_year: Option<f64>,
    /// What the energy is worth.
    pub energy: Basis,
    /// Whether it skipped a frame at all.
    pub skips: bool,
    /// All of it in a sentence.
    pub sentence: String,
}

/// A verdict on every policy but the first.
pub fn verdicts(comparison: &Comparison, summary: &Summary) -> Vec<Verdict> {
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
    first: &PolicySummary,
    policy: &PolicySummary,
    variant: usize,
) -> Verdict {
    let calls = policy.change(Figure::DetectorCalls);
    let mut verdict = Verdict {
        policy: policy.policy.clone(),
        detector_calls_percent: calls.map(|change| change.percent),
        ap50: policy.mean(Figure::Ap50).map(|mean| mean.mean),
        kwh_a_year: kwh_a_year(comparison, variant),
        energy: summary.energy.clone(),
        skips: (policy.mean(Figure::SkipRate)).is_none_or(|mean| mean.mean > 0.0),
        sentence: String::new(),
    };
    verdict.sentence = sentence(comparison, summary, first, policy, variant, &verdict);
    verdict
}

fn sentence(
    comparison: &Comparison,
    summary: &Summary,
    first: &PolicySummary,
    policy: &PolicySummary,
    variant: usize,
    verdict: &Verdict,
) -> String {
    let name = &verdict.policy;
    if !verdict.skips {
        let mut of_variant = comparison.runs.iter().filter(|run| run.variant == variant);
        let attempt = of_variant.find_map(|run| run.advice.as_ref());
        return match attempt {
            Some(advice) => format!(
                "{name}: no frame was skipped, so nothing was saved; try {} = {}.",
                advice.knob,
                short(advice.attempt)
            ),
            None => format!("{name}: no frame was skipped, so nothing was saved."),
        };
    }
    let mut parts = Vec::new();
    if let Some(percent) = verdict.detector_calls_percent {
        let word = if percent > 0.0 { "more" } else { "fewer" };
        parts.push(format!(
            "{:.0} % {word} detector calls than {}",
            percent.abs(),
            first.policy
        ));
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

/// What becomes of the energy, in words.
fn energy(summary: &Summary, policy: &PolicySummary, verdict: &Verdict) -> Option<String> {
    let basis = match &summary.energy {
        Basis::Measured { source } => format!("measured by `{source}`"),
        Basis::Partial { source } => format!("measured by `{source}` with gaps"),
        Basis::Estimated => "estimated".to_owned(),
        Basis::Unavailable => return Some("energy not known".to_owned()),
    };
    let change = policy.change(Figure::Joules)?;
    let unclear = change.half.is_some_and(|half| half >= change.percent.abs());
    if unclear {
        return Some(format!(
            "no difference in energy that {} rounds can tell ({basis})",
            summary.rounds
        ));
    }
    let word = |value: f64| if value < 0.0 { "more" } else { "saved" };
    Some(match verdict.kwh_a_year {
        Some(kwh) => format!(
            "about {} kWh a year and camera {} ({basis})",
            two_digits(kwh.abs()),
            word(kwh)
        ),
        None => format!(
            "{:.0} % of the energy {} ({basis})",
            change.percent.abs(),
            word(-change.percent)
        ),
    })
}

/// The difference of mean power over a year, where the clip was played at its own pace.
fn kwh_a_year(comparison: &Comparison, variant: usize) -> Option<f64> {
    (comparison.playing.played_rate == Some(comparison.playing.rate)).then_some(())?;
    let watts = |variant: usize| -> Option<f64> {
        let runs = comparison.runs.iter().filter(|run| run.variant == variant);
        let watts: Option<Vec<f64>> = runs.map(mean_watts).collect();
        crate::statistics::mean(watts?)
    };
    Some((watts(0)? - watts(variant)?) * YEAR_S / KWH)
}

fn mean_watts(run: &Run) -> Option<f64> {
    let seconds = run.report.duration_s;
    let joules = run.report.energy.whole_joules()?;
    (seconds > 0.0).then(|| joules / seconds)
}

/// A figure with two significant digits, as a person says it: `41`, `3.4`, `120`.
fn two_digits(value: f64) -> String {
    let rounded: f64 = format!("{value:.1e}").parse().unwrap_or(value);
    if rounded >= 10.0 {
        format!("{rounded:.0}")
    } else {
        short(rounded)
    }
}

/// The verdicts as paragraphs, with which of them to take.
pub(super) fn paragraphs(comparison: &Comparison, summary: &Summary) -> Vec<String> {
    let verdicts = verdicts(comparison, summary);
    let mut paragraphs: Vec<String> = verdicts
        .iter()
        .map(|verdict| verdict.sentence.clone())
        .collect();
    paragraphs.extend(choice(&verdicts));
    if paragraphs.is_empty() {
        return paragraphs;
    }
    let offered = |name: &str| {
        let mut policies = comparison.policies.iter();
        policies.any(|policy| policy.split(' ').next() == Some(name))
    };
    if offered("albireo") || offered("expected-loss") {
        paragraphs.push(RECOMMENDATION.join(" "));
    }
    paragraphs
}

/// Of those that keep the boxes, the one with the fewest calls.
fn choice(verdicts: &[Verdict]) -> Option<String> {
    let judged: Vec<_> = (verdicts.iter())
        .filter_map(|verdict| Some((verdict, verdict.ap50?, verdict.detector_calls_percent?)))
        .filter(|(verdict, ..)| verdict.skips)
        .collect();
    let kept = judged.iter().filter(|(_, ap50, _)| *ap50 >= KEPT_AP50);
    match kept.min_by(|a, b| a.2.total_cmp(&b.2)) {
        Some((best, ..)) => Some(format!(
            "On this clip {} calls the detector least of those that keep AP@50 at {:.0} % or more.",
            best.policy,
            KEPT_AP50 * 100.0
        )),
        None if judged.is_empty() => None,
        None => Some(format!(
            "On this clip none of them keeps AP@50 at {:.0} %: turn them down, or leave the detector to every frame.",
            KEPT_AP50 * 100.0
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::super::summary::tests::{comparison, run};
    use super::super::{Advice, Agreement, summarise};
    use super::*;

    fn told(joules: [f64; 2], ap50: f64, calls: u64) -> Vec<String> {
        let runs = (0..3)
            .flat_map(|round| {
                let noise = [0.0, 0.5, -0.5][round];
                [
                    run(round, 0, 100, Some(joules[0] + noise)),
                    run(round, 1, calls, Some(joules[1] - noise)),
                ]
            })
            .map(|mut run| {
                let ap50 = if run.variant == 0 { 1.0 } else { ap50 };
                run.agreement = Some(Agreement {
                    ap50,
                    precision: 0.9,
                    recall: 0.9,
                    frames: 100,
                });
                run
            })
            .collect();
        let comparison = comparison(&["vanilla", "expected-loss lambda=0.3"], runs);
        paragraphs(&comparison, &summarise(&comparison))
    }

    #[test]
    fn a_policy_comes_to_calls_boxes_and_kilowatt_hours_in_a_sentence() {
        // 8 W against 6 W for a year are 17.5 kWh.
        let told = told([80.0, 60.0], 0.968, 39);
        assert_eq!(
            told[0],
            "expected-loss lambda=0.3: 61 % fewer detector calls than vanilla, AP@50 96.8 % against the boxes of \
             vanilla, about 18 kWh a year and camera saved (measured by `rapl`)."
        );
        assert!(told[1].contains("calls the detector least"), "{told:?}");
        assert_eq!(told[2], RECOMMENDATION.join(" "));
    }

    #[test]
    fn a_difference_that_the_rounds_cannot_tell_is_none() {
        let told = told([80.0, 79.9], 0.9, 39);
        assert!(
            told[0].contains("no difference in energy that 3 rounds can tell"),
            "{told:?}"
        );
        assert!(
            told[1].contains("none of them keeps AP@50 at 95 %"),
            "{told:?}"
        );
    }

    #[test]
    fn where_nothing_was_skipped_it_is_told_what_to_try() {
        let mut runs = vec![run(0, 0, 100, None), run(0, 1, 100, None)];
        runs[1].advice = Some(Advice {
            knob: "u",
            attempt: 4e-4,
        });
        let comparison = comparison(&["vanilla", "albireo u=1e-4"], runs);
        let told = paragraphs(&comparison, &summarise(&comparison));
        assert_eq!(
            told[0],
            "albireo u=1e-4: no frame was skipped, so nothing was saved; try u = 4e-4."
        );
    }

    #[test]
    fn a_clip_that_was_not_played_at_its_own_pace_says_nothing_of_a_year() {
        let runs = vec![run(0, 0, 100, Some(80.0)), run(0, 1, 40, Some(60.0))];
        let mut comparison = comparison(&["vanilla", "albireo u=5e-4"], runs);
        comparison.playing.played_rate = None;
        let told = paragraphs(&comparison, &summarise(&comparison));
        assert!(told[0].contains("25 % of the energy saved"), "{told:?}");
    }
}
