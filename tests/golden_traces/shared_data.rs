//! The recorded sequences of the shared data.

use crate::support::shared;
use albireo_core::detection::Detection;
use albireo_eval::boxes::ScoredBox;
use albireo_eval::data::{Clip, recorded};

/// The published code did not get detections below this confidence.
const DETECTOR_THRESHOLD: f64 = 0.5;

pub(crate) fn sequences() -> Vec<Clip> {
    let clips = recorded::read(&shared("data/recorded")).unwrap().clips;
    assert_eq!(clips.len(), 21);
    clips
}

/// The detections per frame that the published code got.
pub(crate) fn given(sequence: &Clip) -> Vec<Vec<ScoredBox>> {
    let frames = sequence.detections.iter().flatten().cloned();
    let is_given = |found: &ScoredBox| found.confidence >= DETECTOR_THRESHOLD;
    frames.map(|frame| frame.into_iter().filter(is_given).collect()).collect()
}

/// The same detections, in the form of policies.
pub(crate) fn detections(sequence: &Clip) -> Vec<Vec<Detection>> {
    let normalise = |found: ScoredBox| found.normalise(sequence.picture);
    given(sequence)
        .into_iter()
        .map(|frame| frame.into_iter().map(normalise).collect())
        .collect()
}
