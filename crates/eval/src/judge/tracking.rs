//! Measures whether boxes keep the identity of their object over a clip: HOTA and IDF1, as in TrackEval.
//!
//! Classes are pooled. Boxes of a confidence below [`SHOWN_CONFIDENCE`] are ignored: unlike average precision,
//! neither figure ranks boxes by confidence.

use super::Classes;
use super::assignment::assign;
use super::average_precision::SHOWN_CONFIDENCE;
use super::ignored::without_ignored;
use super::truth::Truth;
use crate::boxes::ScoredBox;
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};

/// HOTA is the mean over the IoU thresholds 0.05, 0.10, … 0.95.
const THRESHOLDS: usize = 19;

/// The figures of tracking.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tracking {
    /// Higher Order Tracking Accuracy, 0 to 1.
    pub hota: f64,
    /// Share of boxes with the right identity under the best one-to-one assignment of tracks to objects at
    /// IoU 0.5, 0 to 1.
    pub idf1: f64,
}

/// Counts how often each track or object appears; they are numbered in the order of their first appearance.
#[derive(Default)]
struct Appearances {
    numbers: HashMap<u64, usize>,
    counts: Vec<f64>,
}

impl Appearances {
    /// Counts an appearance, and returns the number of the track or object.
    fn add(&mut self, object: u64) -> usize {
        let next = self.counts.len();
        let number = *self.numbers.entry(object).or_insert(next);
        if number == next {
            self.counts.push(0.0);
        }
        self.counts[number] += 1.0;
        number
    }

    fn total(&self) -> f64 {
        self.counts.iter().sum()
    }
}

/// The numbers of the objects and tracks of one frame, and their overlaps.
#[derive(Default)]
struct Overlaps {
    truths: Vec<usize>,
    tracks: Vec<usize>,
    /// The IoU of every truth (rows) with every track (columns).
    iou: Vec<f64>,
}

impl Overlaps {
    /// Each pair by its row and its column, with its IoU.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let columns = self.tracks.len();
        self.iou
            .iter()
            .enumerate()
            .map(move |(pair, iou)| (pair / columns, pair % columns, *iou))
    }
}

/// Judges the tracks of `predictions` against `truth`, both with one list per frame.
///
/// `None` without ground truth, or if a box that is not ignored has no object number.
pub fn tracking<'a>(
    predictions: &[Vec<ScoredBox>],
    truth: impl Into<Truth<'a>>,
) -> Option<Tracking> {
    let truth = truth.into();
    let is_shown = |found: &&ScoredBox| found.confidence >= SHOWN_CONFIDENCE;
    let shown: Vec<Vec<ScoredBox>> = predictions
        .iter()
        .map(|found| found.iter().filter(is_shown).copied().collect())
        .collect();
    let judged = without_ignored(&shown, truth, Classes::Pooled);
    let mut objects = Appearances::default();
    let mut tracks = Appearances::default();
    let mut frames = Vec::new();
    for index in 0..judged.len().max(truth.objects.len()) {
        let known = truth.objects(index);
        let found = judged.get(index).map_or(&[][..], Vec::as_slice);
        let mut frame = Overlaps::default();
        for object in known {
            let number = objects.add(object.object?);
            frame.truths.push(number);
        }
        for one in found {
            let number = tracks.add(one.object?);
            frame.tracks.push(number);
        }
        for object in known {
            let iou = |one: &ScoredBox| object.corners.intersection_over_union(one.corners);
            frame.iou.extend(found.iter().map(iou));
        }
        frames.push(frame);
    }
    if objects.counts.is_empty() {
        return None;
    }
    Some(Tracking {
        hota: hota(&frames, &objects, &tracks),
        idf1: idf1(&frames, &objects, &tracks),
    })
}

fn hota(frames: &[Overlaps], objects: &Appearances, tracks: &Appearances) -> f64 {
    let columns = tracks.counts.len();
    // How often each object and each track match, where a match weighs less if other boxes overlap in its frame.
    let mut shared = vec![0.0; objects.counts.len() * columns];
    for frame in frames {
        let mut row_sums = vec![0.0; frame.truths.len()];
        let mut column_sums = vec![0.0; frame.tracks.len()];
        for (row, column, iou) in frame.pairs() {
            row_sums[row] += iou;
            column_sums[column] += iou;
        }
        for (row, column, iou) in frame.pairs() {
            let object = frame.truths[row];
            let track = frame.tracks[column];
            let of_either = row_sums[row] + column_sums[column] - iou;
            if of_either > f64::EPSILON {
                shared[object * columns + track] += iou / of_either;
            }
        }
    }
    let mut matches: BTreeMap<(usize, usize), [f64; THRESHOLDS]> = BTreeMap::new();
    for frame in frames {
        let mut scores = Vec::new();
        for (row, column, iou) in frame.pairs() {
            let object = frame.truths[row];
            let track = frame.tracks[column];
            let both = shared[object * columns + track];
            let either = objects.counts[object] + tracks.counts[track] - both;
            scores.push(iou * (both / either));
        }
        for (row, column) in assign(frame.truths.len(), frame.tracks.len(), &scores) {
            let iou = frame.iou[row * frame.tracks.len() + column];
            let pair = (frame.truths[row], frame.tracks[column]);
            let counts = matches.entry(pair).or_insert([0.0; THRESHOLDS]);
            for (index, count) in counts.iter_mut().enumerate() {
                let threshold = 0.05 + 0.05 * index as f64;
                if iou >= threshold - f64::EPSILON {
                    *count += 1.0;
                }
            }
        }
    }
    let at = |index: usize| {
        let mut hits = 0.0;
        let mut association = 0.0;
        for (&(object, track), counts) in &matches {
            let count = counts[index];
            let either = objects.counts[object] + tracks.counts[track] - count;
            hits += count;
            association += count * count / either;
        }
        // The square root of detection accuracy, hits / (all - hits), times association accuracy, association / hits.
        let all = objects.total() + tracks.total();
        (association / (all - hits)).sqrt()
    };
    (0..THRESHOLDS).map(at).sum::<f64>() / THRESHOLDS as f64
}

fn idf1(frames: &[Overlaps], objects: &Appearances, tracks: &Appearances) -> f64 {
    let columns = tracks.counts.len();
    let mut matches = vec![0.0; objects.counts.len() * columns];
    for frame in frames {
        for (row, column, iou) in frame.pairs() {
            if iou >= 0.5 {
                let object = frame.truths[row];
                let track = frame.tracks[column];
                matches[object * columns + track] += 1.0;
            }
        }
    }
    let best = assign(objects.counts.len(), columns, &matches);
    let right: f64 = best.map(|(row, column)| matches[row * columns + column]).sum();
    2.0 * right / (objects.total() + tracks.total())
}

#[cfg(test)]
mod tests {
    use super::super::average_precision::tests::at;
    use super::*;

    fn found(left: f64, object: Option<u64>, confidence: f64) -> ScoredBox {
        ScoredBox {
            object,
            ..at(left, confidence)
        }
    }

    fn known(object: Option<u64>) -> Vec<ScoredBox> {
        vec![found(0.0, object, 1.0)]
    }

    #[test]
    fn a_track_that_is_never_cut_is_perfect() {
        let truth = vec![known(Some(7)); 4];
        let whole = vec![vec![found(0.0, Some(3), 0.9)]; 4];
        let perfect = tracking(&whole, &truth).unwrap();
        assert_eq!(perfect.hota, 1.0);
        assert_eq!(perfect.idf1, 1.0);
    }

    #[test]
    fn a_track_cut_in_two_keeps_half_of_its_identity() {
        let truth = vec![known(Some(7)); 4];
        let cut: Vec<_> = (0..4).map(|frame| vec![found(0.0, Some(frame / 2), 0.9)]).collect();
        let halves = tracking(&cut, &truth).unwrap();
        assert!((halves.hota - 0.5_f64.sqrt()).abs() < 1e-12, "{halves:?}");
        assert_eq!(halves.idf1, 0.5);
    }

    /// A frame with the right box of the object, and a wrong box.
    fn right_and_wrong(object: Option<u64>, confidence: f64) -> Vec<Vec<ScoredBox>> {
        vec![vec![
            found(0.0, Some(1), 0.9),
            found(50.0, object, confidence),
        ]]
    }

    #[test]
    fn a_wrong_box_counts_unless_it_is_faint() {
        let truth = [known(Some(7))];
        let faint = tracking(&right_and_wrong(Some(2), 0.2), &truth).unwrap();
        assert_eq!(faint.hota, 1.0);
        let shown = tracking(&right_and_wrong(Some(2), 0.3), &truth).unwrap();
        assert!(shown.hota < 1.0, "{shown:?}");
    }

    #[test]
    fn boxes_without_an_object_number_cannot_be_scored_unless_they_are_faint() {
        let truth = [known(Some(7))];
        assert_eq!(tracking(&right_and_wrong(None, 0.3), &truth), None);
        let faint = tracking(&right_and_wrong(None, 0.2), &truth).unwrap();
        assert_eq!(faint.hota, 1.0);
    }

    #[test]
    fn an_object_without_a_number_cannot_be_scored() {
        let numbered = right_and_wrong(Some(2), 0.3);
        assert_eq!(tracking(&numbered, &[known(None)]), None);
    }

    #[test]
    fn without_ground_truth_the_figures_are_undefined() {
        assert_eq!(tracking(&[], &[]), None);
    }

    #[test]
    fn without_boxes_the_figures_are_zero() {
        let nothing = tracking(&[], &[known(Some(7))]).unwrap();
        assert_eq!(nothing.hota, 0.0);
        assert_eq!(nothing.idf1, 0.0);
    }
}
