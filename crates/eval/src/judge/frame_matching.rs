//! Matches the boxes of one frame with its ground truth, at each of COCO's thresholds.

use super::average_precision::Classes;
use super::ignored::is_of_coco;
use super::truth::{Ignored, Mark};
use crate::boxes::ScoredBox;
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;

/// The ten IoU thresholds of COCO.
pub(super) const IOU_THRESHOLDS: [f64; 10] =
    [0.50, 0.55, 0.60, 0.65, 0.70, 0.75, 0.80, 0.85, 0.90, 0.95];

/// The places of 0.50 and 0.75 in [`IOU_THRESHOLDS`].
pub(super) const AT_50: usize = 0;
pub(super) const AT_75: usize = 5;

/// What became of a prediction. Bit `t` of each is about `IOU_THRESHOLDS[t]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Outcome {
    /// It matches an object.
    matched: u16,
    /// It matches none, and lies where the ground truth excuses it.
    excused: u16,
}

impl Outcome {
    pub(super) fn is_matched(self, threshold: usize) -> bool {
        self.matched & (1 << threshold) != 0
    }

    pub(super) fn is_excused(self, threshold: usize) -> bool {
        self.excused & (1 << threshold) != 0
    }
}

/// A prediction of the frame that is matched.
pub(super) struct Prediction {
    /// Its place in the frame's list.
    index: usize,
    pub(super) confidence: f64,
    corners: Corners,
}

/// Matches the boxes of one frame; its buffers are reused for the next frame.
#[derive(Default)]
pub(super) struct FrameMatcher {
    pub(super) truths: Vec<Corners>,
    /// The places that COCO's rules excuse; most data sets have none.
    ignored: Vec<Ignored>,
    /// Sorted by falling confidence in `match_all`.
    pub(super) predictions: Vec<Prediction>,
    /// One entry per prediction.
    pub(super) outcomes: Vec<Outcome>,
    /// Ground truth by left edge, with its index.
    by_left: Vec<(f64, usize)>,
    /// The candidates of all predictions, one after the other: index of a ground-truth box and the IoU with it.
    candidates: Vec<(usize, f64)>,
    /// Where each prediction's candidates end.
    ends: Vec<usize>,
    free: Vec<bool>,
    /// Pairs compared so far, over all frames.
    #[cfg(test)]
    pub(super) compared: usize,
}

impl FrameMatcher {
    /// Takes the boxes of a frame that are of `class`; all if it is `None`.
    pub(super) fn take(
        &mut self,
        found: &[ScoredBox],
        objects: &[ScoredBox],
        ignored: &[Ignored],
        class: Option<ClassId>,
    ) {
        let wanted = |candidate: ClassId| class.is_none_or(|class| class == candidate);
        self.truths.clear();
        self.ignored.clear();
        self.predictions.clear();
        let truths = objects.iter().filter(|object| wanted(object.class));
        self.truths.extend(truths.map(|object| object.corners));
        let excusing = ignored.iter().filter(|ignored| {
            is_of_coco(ignored.mark) && class.is_none_or(|class| ignored.concerns(class))
        });
        self.ignored.extend(excusing);
        let predictions = found.iter().enumerate().filter(|(_, found)| wanted(found.class));
        self.predictions.extend(predictions.map(|(index, found)| Prediction {
            index,
            confidence: found.confidence,
            corners: found.corners,
        }));
    }

    /// Matches the boxes of the frame, and finds what is excused.
    pub(super) fn match_all(&mut self) {
        self.predictions.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        self.outcomes.clear();
        self.outcomes.resize(self.predictions.len(), Outcome::default());
        if !self.truths.is_empty() && !self.predictions.is_empty() {
            self.match_truths();
        }
        if !self.ignored.is_empty() {
            self.excuse();
        }
    }

    /// Lets each prediction take the free object of highest IoU, threshold by threshold.
    fn match_truths(&mut self) {
        self.find_candidates();
        for (bit, &threshold) in IOU_THRESHOLDS.iter().enumerate() {
            self.free.clear();
            self.free.resize(self.truths.len(), true);
            let mut start = 0;
            for (outcome, &end) in self.outcomes.iter_mut().zip(&self.ends) {
                let mut best: Option<(usize, f64)> = None;
                for &(truth, overlap) in &self.candidates[start..end] {
                    if self.free[truth]
                        && overlap >= threshold
                        && best.is_none_or(|(_, best)| overlap > best)
                    {
                        best = Some((truth, overlap));
                    }
                }
                if let Some((truth, _)) = best {
                    self.free[truth] = false;
                    outcome.matched |= 1 << bit;
                }
                start = end;
            }
        }
    }

    /// Excuses predictions that match no object, as COCO does: each takes the marked place of highest overlap; a crowd
    /// can be taken any number of times, an object once.
    fn excuse(&mut self) {
        for (bit, &threshold) in IOU_THRESHOLDS.iter().enumerate() {
            self.free.clear();
            self.free.resize(self.ignored.len(), true);
            for (prediction, outcome) in self.predictions.iter().zip(&mut self.outcomes) {
                if outcome.is_matched(bit) {
                    continue;
                }
                let mut best: Option<(usize, f64)> = None;
                for (index, ignored) in self.ignored.iter().enumerate() {
                    let own = prediction.corners;
                    let overlap = match ignored.mark {
                        Mark::Crowd => own.shared_area(ignored.corners) / own.area(),
                        _ => own.intersection_over_union(ignored.corners),
                    };
                    if self.free[index]
                        && overlap >= threshold
                        && best.is_none_or(|(_, best)| overlap > best)
                    {
                        best = Some((index, overlap));
                    }
                }
                if let Some((index, _)) = best {
                    self.free[index] = self.ignored[index].mark == Mark::Crowd;
                    outcome.excused |= 1 << bit;
                }
            }
        }
    }

    /// Lists, for each prediction, the ground truth whose IoU reaches the lowest threshold, in order of
    /// the ground truth so that ties go to the earlier box.
    fn find_candidates(&mut self) {
        self.candidates.clear();
        self.ends.clear();
        self.by_left.clear();
        let left_edges = self.truths.iter().enumerate().map(|(index, truth)| (truth.x1, index));
        self.by_left.extend(left_edges);
        self.by_left.sort_by(|(left, _), (other, _)| left.total_cmp(other));
        let widest = self.truths.iter().map(|truth| truth.x2 - truth.x1).fold(0.0, f64::max);
        for prediction in &self.predictions {
            let own = prediction.corners;
            let first = self.by_left.partition_point(|&(left, _)| left < own.x1 - widest);
            let begin = self.candidates.len();
            for &(left, index) in &self.by_left[first..] {
                if left > own.x2 {
                    break;
                }
                #[cfg(test)]
                {
                    self.compared += 1;
                }
                let overlap = own.intersection_over_union(self.truths[index]);
                if overlap >= IOU_THRESHOLDS[0] {
                    self.candidates.push((index, overlap));
                }
            }
            self.candidates[begin..].sort_unstable_by_key(|&(index, _)| index);
            self.ends.push(self.candidates.len());
        }
    }
}

/// Tells for each box of a frame whether COCO's marks excuse it at IoU 0.5.
pub(super) fn excused_at_50(
    found: &[ScoredBox],
    objects: &[ScoredBox],
    ignored: &[Ignored],
    classes: Classes,
) -> Vec<bool> {
    let mut excused = vec![false; found.len()];
    // All boxes together, or those of each class by themselves.
    let mut groups: Vec<Option<ClassId>> = match classes {
        Classes::Pooled => vec![None],
        Classes::Separate => found.iter().map(|found| Some(found.class)).collect(),
    };
    groups.sort_unstable();
    groups.dedup();
    let mut frame = FrameMatcher::default();
    for class in groups {
        frame.take(found, objects, ignored, class);
        frame.match_all();
        for (prediction, outcome) in frame.predictions.iter().zip(&frame.outcomes) {
            excused[prediction.index] |= outcome.is_excused(AT_50);
        }
    }
    excused
}
