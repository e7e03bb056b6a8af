//! The frames on which a policy lost the most against the detector: what a person wants to see first.

use crate::average_precision::{Classes, Interpolation, ScoredBox, TruthBox, accuracy};
use crate::data::Clip;
use crate::replay::Replay;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::FrameState;

/// Frames of a clip that are kept for each policy.
const KEPT: usize = 2;

/// Frames between two that are kept, so that they show two things.
const APART: usize = 20;

/// A frame without the detector on which objects were lost that the detector would have found.
#[derive(Clone, Debug, PartialEq)]
pub struct WorstFrame {
    /// Its number in the clip, from 0.
    pub frame: usize,
    /// Its state.
    pub state: FrameState,
    /// How many objects of the ground truth the detector finds here (IoU 0.5) and the policy does not.
    pub lost: usize,
    /// Size of the picture.
    pub picture: PictureSize,
    /// The ground truth.
    pub truth: Vec<Corners>,
    /// The policy's boxes.
    pub found: Vec<Corners>,
}

/// The frames of `replayed` that lost most, the worst first.
pub(crate) fn worst_frames(clip: &Clip, replayed: &Replay, confidence: f64) -> Vec<WorstFrame> {
    let (Some(truth), Some(detections)) = (&clip.truth, &clip.detections) else {
        return Vec::new();
    };
    let mut lost: Vec<(usize, usize)> = Vec::new();
    for (frame, record) in replayed.frames.iter().enumerate() {
        let (Some(truth), Some(found)) = (truth.get(frame), replayed.boxes.get(frame)) else {
            continue;
        };
        if record.detector || truth.is_empty() {
            continue;
        }
        let detected: Vec<ScoredBox> = detections
            .get(frame)
            .into_iter()
            .flatten()
            .filter(|detection| detection.confidence >= confidence)
            .map(|detection| ScoredBox {
                corners: detection.corners,
                class: detection.class,
                confidence: detection.confidence,
            })
            .collect();
        let missed = hits(&detected, truth).saturating_sub(hits(found, truth));
        if missed > 0 {
            lost.push((missed, frame));
        }
    }
    lost.sort_by_key(|&(missed, frame)| (std::cmp::Reverse(missed), frame));
    let mut kept: Vec<WorstFrame> = Vec::new();
    for (missed, frame) in lost {
        let near = |other: &WorstFrame| other.frame.abs_diff(frame) < APART;
        if kept.len() == KEPT || kept.iter().any(near) {
            continue;
        }
        kept.push(WorstFrame {
            frame,
            state: replayed.frames[frame].state,
            lost: missed,
            picture: clip.picture,
            truth: truth[frame].iter().map(|truth| truth.corners).collect(),
            found: (replayed.boxes[frame].iter())
                .map(|found| found.corners)
                .collect(),
        });
    }
    kept
}

/// Objects of `truth` that `found` has.
fn hits(found: &[ScoredBox], truth: &[TruthBox]) -> usize {
    let judged = accuracy(
        &[found.to_vec()],
        &[truth.to_vec()],
        Classes::Pooled,
        Interpolation::AllPoints,
    );
    judged.map_or(0, |judged| {
        (judged.recall * truth.len() as f64).round() as usize
    })
}
