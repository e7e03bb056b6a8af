//! Writes the conclusion of an evaluation in sentences.

use crate::spec::{BASELINE, short_label};
use crate::summary::PolicySummary;
use crate::text::{counted, signed};

/// Loss of AP@50 up to which a policy counts as keeping it: the interval of its change must not reach below this loss.
const MARGIN: f64 = 0.01;

/// AP@50 of the baseline below which its detector and the labels have nothing to do with each other.
const NEXT_TO_NONE: f64 = 0.02;

/// The number of clips from which on an interval over clips is worth choosing a policy by. With fewer it describes the
/// clips.
const ENOUGH_CLIPS: usize = 8;

/// Names the policy that skips most and keeps the accuracy, the most accurate one with about half of the calls, and
/// those that skipped nothing. There is no sentence if the baseline did not run.
pub fn conclusion(summaries: &[PolicySummary]) -> Vec<String> {
    let Some(baseline) = summaries.iter().find(|found| found.policy == BASELINE) else {
        return Vec::new();
    };
    let others: Vec<_> = summaries.iter().filter(|found| found.policy != BASELINE).collect();
    let mut sentences = Vec::new();
    if baseline.ap50.is_none() {
        sentences.push(
            "There is no box of ground truth, so nothing can be said about accuracy, only about skipped frames."
                .to_owned(),
        );
    } else {
        sentences.extend(foreign_labels(baseline));
        sentences.extend(too_short(baseline));
        let kept = others.iter().filter(|found| {
            lower_end(found).is_some_and(|lower| lower >= -MARGIN) && found.skip_rate > 0.0
        });
        let saving = match kept.max_by(|a, b| a.skip_rate.total_cmp(&b.skip_rate)) {
            Some(best) => format!(
                "The largest saving shown to cost at most one point of AP@50 is that of {}",
                described(best, baseline)
            ),
            None => "No policy is shown to cost at most one point of AP@50: every interval reaches below that."
                .to_owned(),
        };
        sentences.push(saving);
        let half = others.iter().filter(|found| found.skip_rate >= 0.45);
        if let Some(best) = half.max_by(|a, b| accuracy(a).total_cmp(&accuracy(b)))
            && best.ap50.is_some()
        {
            sentences.push(format!(
                "The most accurate policy with about half of the calls or fewer is {}",
                described(best, baseline)
            ));
        }
    }
    let idle: Vec<_> = others
        .iter()
        .filter(|found| found.skip_rate == 0.0)
        .map(|found| short_label(&found.policy))
        .collect();
    if !idle.is_empty() {
        sentences.push(format!(
            "These policies skipped no frame: {}.",
            idle.join(", ")
        ));
    }
    sentences
}

/// Says that the labels can hardly be those of the pictures, if the detector on every frame finds next to none of them.
fn foreign_labels(baseline: &PolicySummary) -> Option<String> {
    let ap50 = baseline.ap50.filter(|ap50| *ap50 < NEXT_TO_NONE)?;
    Some(format!(
        "The detector on every frame finds next to none of the labelled objects (AP@50 {ap50:.3}): are the labels of these \
         pictures, their boxes in pixels, and corners not taken for sizes?"
    ))
}

/// Says that there are too few clips to choose a policy by, if there are.
fn too_short(baseline: &PolicySummary) -> Option<String> {
    let judged = baseline.clips;
    if judged >= ENOUGH_CLIPS {
        return None;
    }
    Some(format!(
        "{}, {} frames: too short to choose a policy by, whatever an interval says. What follows describes these clips only.",
        counted(judged, "clip"),
        baseline.frames
    ))
}

fn accuracy(summary: &PolicySummary) -> f64 {
    summary.ap50.unwrap_or(f64::NEG_INFINITY)
}

/// The lower end of the 95 % interval of the change of AP@50.
fn lower_end(summary: &PolicySummary) -> Option<f64> {
    let [lower, _] = summary.ap50_change?.interval?;
    Some(lower)
}

/// `albireo-u5e-4: 39.8 % of the frames skip the detector, AP@50 -0.4 points [-2.0, +1.1] over 17 clips, energy -34 %
/// (projected).`
fn described(summary: &PolicySummary, baseline: &PolicySummary) -> String {
    let mut text = format!(
        "{}: {:.1} % of the frames skip the detector",
        short_label(&summary.policy),
        summary.skip_rate * 100.0
    );
    if let Some(ap50) = summary.ap50_change {
        let points = ap50.scaled(100.0);
        text.push_str(&format!(", AP@50 {} points", signed(points.mean, 1)));
        if let Some([from, to]) = points.interval {
            let [from, to] = [from, to].map(|end| signed(end, 1));
            text.push_str(&format!(" [{from}, {to}] over {} clips", ap50.clips));
        }
    }
    if let (Some(own), Some(before)) = (summary.energy, baseline.energy)
        && before.joules > 0.0
    {
        let percent = (own.joules / before.joules - 1.0) * 100.0;
        text.push_str(&format!(", energy {} % (projected)", signed(percent, 0)));
    }
    text.push('.');
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::summarise;
    use crate::summary::tests::result;

    /// What is concluded of the detector on every frame with this AP@50.
    fn concluded(ap50: Option<f64>) -> String {
        conclusion(&summarise(&[result("a", BASELINE, ap50, 0)])).join(" ")
    }

    #[test]
    fn labels_of_which_the_detector_finds_next_to_none_are_doubted() {
        let doubt = "finds next to none of the labelled objects (AP@50 0.001)";
        let said = concluded(Some(0.001));
        assert!(said.starts_with("The detector on every frame"), "{said}");
        assert!(said.contains(doubt), "{said}");
        assert!(!concluded(Some(0.1)).contains("next to none"));
    }

    #[test]
    fn without_a_box_of_ground_truth_nothing_is_said_about_accuracy() {
        let said = concluded(None);
        assert!(said.contains("no box of ground truth"), "{said}");
        assert!(!said.contains("next to none"), "{said}");
    }
}
