//! Computes the average precision of boxes over the frames of a clip.
//!
//! Definitions: a prediction is compared with the ground truth of its own frame. Inside a frame the
//! predictions are taken in order of falling confidence; each takes the free ground-truth box of highest
//! intersection over union (IoU), if that reaches the threshold. All predictions of the clip are then
//! ranked by confidence, and the area under the precision-recall curve is taken, all points (PASCAL VOC
//! 2010 and later) or at 101 recall levels (COCO). mAP@50:95 is the mean over the ten COCO thresholds
//! 0.50, 0.55, … 0.95.
//!
//! The paper's published evaluator pools all classes and uses all points; that is
//! [`Classes::Pooled`] with [`Interpolation::AllPoints`].
//!
//! A box that the ground truth excuses at a threshold (see [`Mark`]) is neither right nor wrong there: it
//! is taken out of the ranking.
//!
//! Cost: one sort of the predictions, plus per frame a search among the ground-truth boxes that overlap
//! horizontally, so 10⁶ boxes spread over frames take time near-linear in their number.

use super::frame_matching::{AT_50, AT_75, FrameMatcher, IOU_THRESHOLDS, Outcome};
use super::ignored::without_fixed;
#[cfg(doc)]
use super::truth::Mark;
use super::truth::Truth;
use crate::boxes::ScoredBox;
use albireo_core::detection::ClassId;
use serde::Serialize;
use std::collections::BTreeMap;

/// Figures that do not rank boxes by confidence ignore boxes below this one; see [`Accuracy::f1_50_shown`].
pub const SHOWN_CONFIDENCE: f64 = 0.3;

/// The method that computes the area under the precision-recall curve. Precision is first made monotone: at each recall
/// it is the best precision at this or a higher recall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// The exact area (PASCAL VOC 2010 and later).
    AllPoints,
    /// The mean of the precision at the recalls 0, 0.01, … 1 (COCO).
    Coco101,
}

/// The treatment of classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Classes {
    /// All together: a prediction may match ground truth of another class.
    Pooled,
    /// Each class separately, then the unweighted mean over the classes that have ground truth.
    Separate,
}

/// The accuracy of predictions against the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Accuracy {
    /// Average precision at IoU 0.50, 0 to 1.
    pub ap50: f64,
    /// Average precision at IoU 0.75, 0 to 1.
    pub ap75: f64,
    /// Mean of the average precisions at IoU 0.50 to 0.95, 0 to 1.
    pub map: f64,
    /// F1, the harmonic mean of precision and recall, at IoU 0.50 of all boxes of confidence
    /// [`SHOWN_CONFIDENCE`] and above: AP also counts boxes too faint to be shown.
    pub f1_50_shown: f64,
    /// Share of the judged predictions that match at IoU 0.50; 0 without predictions.
    pub precision: f64,
    /// Share of the ground truth that is matched at IoU 0.50.
    pub recall: f64,
    /// Number of predictions: with classes pooled of those judged at IoU 0.50, with separate classes of all that no
    /// mark with a fixed threshold leaves out.
    pub predictions: usize,
    /// Number of ground-truth boxes.
    pub truths: usize,
}

/// Judges `predictions` against `truth`, both with one list per frame. If one is shorter, its missing frames
/// count as frames without boxes.
///
/// `None` when there is no ground-truth box at all: average precision is undefined then.
pub fn accuracy<'a>(
    predictions: &[Vec<ScoredBox>],
    truth: impl Into<Truth<'a>>,
    classes: Classes,
    interpolation: Interpolation,
) -> Option<Accuracy> {
    let truth = truth.into();
    match classes {
        Classes::Pooled => Matches::of(predictions, truth, interpolation).accuracy(),
        Classes::Separate => mean_over_classes(predictions, truth, interpolation),
    }
}

/// The mean over the classes that have ground truth.
fn mean_over_classes(
    predictions: &[Vec<ScoredBox>],
    truth: Truth<'_>,
    interpolation: Interpolation,
) -> Option<Accuracy> {
    let kept = without_fixed(predictions, truth, Classes::Separate);
    let by_class = of_each_class(&kept, truth, interpolation);
    if by_class.is_empty() {
        return None;
    }
    let count = by_class.len() as f64;
    let mean = |figure: fn(&Accuracy) -> f64| by_class.values().map(figure).sum::<f64>() / count;
    Some(Accuracy {
        ap50: mean(|class| class.ap50),
        ap75: mean(|class| class.ap75),
        map: mean(|class| class.map),
        f1_50_shown: mean(|class| class.f1_50_shown),
        precision: mean(|class| class.precision),
        recall: mean(|class| class.recall),
        predictions: kept.iter().map(Vec::len).sum(),
        truths: truth.objects.iter().map(Vec::len).sum(),
    })
}

/// What became of the predictions of one clip or several, with all classes pooled.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Matches {
    matching: Matching,
    interpolation: Interpolation,
}

impl Matches {
    /// Matches the `predictions` of a clip.
    pub(crate) fn of(
        predictions: &[Vec<ScoredBox>],
        truth: Truth<'_>,
        interpolation: Interpolation,
    ) -> Self {
        let kept = without_fixed(predictions, truth, Classes::Pooled);
        let any_class = None;
        Self {
            matching: Matching::new(&kept, truth, any_class),
            interpolation,
        }
    }

    /// Puts clips one after the other, as if they were one; `None` without any.
    pub(crate) fn joined<'a>(clips: impl IntoIterator<Item = &'a Self>) -> Option<Self> {
        let mut clips = clips.into_iter().peekable();
        let interpolation = clips.peek()?.interpolation;
        let mut predictions = Vec::new();
        let mut truths = 0;
        for Self { matching, .. } in clips {
            let confidences = matching.confidences.iter().copied();
            predictions.extend(confidences.zip(matching.outcomes.iter().copied()));
            truths += matching.truths;
        }
        Some(Self {
            matching: Matching::ranked(predictions, truths),
            interpolation,
        })
    }

    /// The accuracy; `None` without ground truth.
    pub(crate) fn accuracy(&self) -> Option<Accuracy> {
        self.matching.accuracy(self.interpolation)
    }
}

/// Computes the accuracy of every class that has ground truth, each judged separately.
pub(crate) fn accuracy_by_class<'a>(
    predictions: &[Vec<ScoredBox>],
    truth: impl Into<Truth<'a>>,
    interpolation: Interpolation,
) -> BTreeMap<ClassId, Accuracy> {
    let truth = truth.into();
    let kept = without_fixed(predictions, truth, Classes::Separate);
    of_each_class(&kept, truth, interpolation)
}

/// Computes the accuracy of every class, when what fixed marks leave out is gone.
fn of_each_class(
    predictions: &[Vec<ScoredBox>],
    truth: Truth<'_>,
    interpolation: Interpolation,
) -> BTreeMap<ClassId, Accuracy> {
    let mut classes: Vec<ClassId> =
        truth.objects.iter().flatten().map(|truth| truth.class).collect();
    classes.sort_unstable();
    classes.dedup();
    let mut by_class = BTreeMap::new();
    for class in classes {
        let matching = Matching::new(predictions, truth, Some(class));
        if let Some(accuracy) = matching.accuracy(interpolation) {
            by_class.insert(class, accuracy);
        }
    }
    by_class
}

/// Counts the objects of one frame that `found` matches at IoU 0.5.
pub(crate) fn hits(found: &[ScoredBox], objects: &[ScoredBox]) -> usize {
    let truth = [objects.to_vec()];
    let any_class = None;
    Matching::new(&[found.to_vec()], (&truth).into(), any_class).hits()
}

/// The predictions of a clip in falling order of confidence, and what became of each.
#[derive(Clone, Debug, PartialEq)]
struct Matching {
    confidences: Vec<f64>,
    outcomes: Vec<Outcome>,
    /// The number of predictions, from the first on, whose confidence is at least [`SHOWN_CONFIDENCE`].
    shown: usize,
    truths: usize,
    /// Pairs of boxes whose IoU was computed.
    #[cfg(test)]
    compared: usize,
}

impl Matching {
    /// Matches the boxes of `class`; all if it is `None`.
    fn new(predictions: &[Vec<ScoredBox>], truth: Truth<'_>, class: Option<ClassId>) -> Self {
        let mut unranked: Vec<(f64, Outcome)> = Vec::new();
        let mut truths = 0;
        let mut frame = FrameMatcher::default();
        for index in 0..predictions.len().max(truth.objects.len()) {
            let found = predictions.get(index).map_or(&[][..], Vec::as_slice);
            frame.take(found, truth.objects(index), truth.ignored(index), class);
            truths += frame.truths.len();
            frame.match_all();
            let confidences = frame.predictions.iter().map(|prediction| prediction.confidence);
            unranked.extend(confidences.zip(frame.outcomes.iter().copied()));
        }
        Self {
            #[cfg(test)]
            compared: frame.compared,
            ..Self::ranked(unranked, truths)
        }
    }

    /// Ranks predictions, given in order of frames by their confidence and outcome.
    fn ranked(mut predictions: Vec<(f64, Outcome)>, truths: usize) -> Self {
        // The sort is stable: equal confidences stay in order of frames, as in the published evaluator and COCO's.
        predictions.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let (confidences, outcomes): (Vec<f64>, _) = predictions.into_iter().unzip();
        Self {
            shown: confidences.partition_point(|confidence| *confidence >= SHOWN_CONFIDENCE),
            confidences,
            outcomes,
            truths,
            #[cfg(test)]
            compared: 0,
        }
    }

    fn accuracy(&self, interpolation: Interpolation) -> Option<Accuracy> {
        if self.truths == 0 {
            return None;
        }
        let mut points = Vec::new();
        let mut sum = 0.0;
        let mut ap50 = 0.0;
        let mut ap75 = 0.0;
        for threshold in 0..IOU_THRESHOLDS.len() {
            self.precision_at_hits(threshold, &mut points);
            let ap = area(&points, self.truths, interpolation);
            sum += ap;
            match threshold {
                AT_50 => ap50 = ap,
                AT_75 => ap75 = ap,
                _ => {}
            }
        }
        let hits = self.hits();
        let judged = judged_at_50(&self.outcomes);
        let precision = if judged == 0 {
            0.0
        } else {
            hits as f64 / judged as f64
        };
        Some(Accuracy {
            ap50,
            ap75,
            map: sum / IOU_THRESHOLDS.len() as f64,
            f1_50_shown: self.f1_shown(),
            precision,
            recall: hits as f64 / self.truths as f64,
            predictions: judged,
            truths: self.truths,
        })
    }

    /// The number of predictions that match at IoU 0.50.
    fn hits(&self) -> usize {
        self.outcomes.iter().filter(|outcome| outcome.is_matched(AT_50)).count()
    }

    /// F1 at IoU 0.50 of the predictions that are shown.
    fn f1_shown(&self) -> f64 {
        let shown = &self.outcomes[..self.shown];
        let hits = shown.iter().filter(|outcome| outcome.is_matched(AT_50)).count();
        2.0 * hits as f64 / (judged_at_50(shown) + self.truths) as f64
    }

    /// Computes the precision after each prediction that matches, in order; entry `k` is at recall
    /// `(k + 1) / truths`. Precision only rises at a match, so the points between do not change the envelope.
    fn precision_at_hits(&self, threshold: usize, points: &mut Vec<f64>) {
        points.clear();
        let judged = self.outcomes.iter().filter(|outcome| !outcome.is_excused(threshold));
        for (rank, outcome) in judged.enumerate() {
            if outcome.is_matched(threshold) {
                points.push((points.len() + 1) as f64 / (rank + 1) as f64);
            }
        }
        let mut best: f64 = 0.0;
        for point in points.iter_mut().rev() {
            best = best.max(*point);
            *point = best;
        }
    }
}

/// The number of predictions that are judged at IoU 0.50.
fn judged_at_50(outcomes: &[Outcome]) -> usize {
    outcomes.iter().filter(|outcome| !outcome.is_excused(AT_50)).count()
}

/// The area under monotone precisions at recalls `1/truths, 2/truths, …`.
fn area(points: &[f64], truths: usize, interpolation: Interpolation) -> f64 {
    match interpolation {
        // `sum()` of nothing is -0, which would be printed.
        Interpolation::AllPoints => {
            points.iter().fold(0.0, |sum, point| sum + point) / truths as f64
        }
        Interpolation::Coco101 => {
            let mut sum = 0.0;
            let mut next = 0;
            for level in 0..=100u32 {
                // Computed as NumPy's linspace does, so that comparisons for equality agree.
                let recall = f64::from(level) * 0.01;
                while next < points.len() && (next + 1) as f64 / (truths as f64) < recall {
                    next += 1;
                }
                sum += points.get(next).copied().unwrap_or(0.0);
            }
            sum / 101.0
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
