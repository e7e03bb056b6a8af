//! The frames on which a policy lost the most against the detector: what a person wants to see first.

use crate::average_precision::{Classes, Interpolation, ScoredBox, accuracy};
use crate::data::Clip;
use crate::error::EvalError;
use crate::footage::FrameSource;
use crate::replay::Replay;
use crate::result::ClipResult;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::FrameState;
use albireo_vision::picture::EncodedPicture;
use std::path::PathBuf;

/// Frames of a clip that are kept for each policy.
const KEPT: usize = 2;

/// Frames between two that are kept, so that they show two things.
const APART: usize = 20;

/// Policies whose frames are kept with their pictures, and shown.
pub(crate) const SHOWN_POLICIES: usize = 8;

/// Where the picture of a frame is.
#[derive(Clone, Debug, PartialEq)]
pub enum FramePicture {
    /// In a file of the data set.
    File(PathBuf),
    /// As it came from the footage.
    Encoded(EncodedPicture),
}

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
    /// What is to be seen, where that is at hand.
    pub shown: Option<FramePicture>,
}

/// Gives the frames in `results`, one clip's, the pictures of `source`, which is played again from its start as far as the
/// last of them.
///
/// # Errors
/// [`EvalError`] when the source cannot be played again; the frames keep their boxes then.
pub fn attach_pictures(
    source: &mut dyn FrameSource,
    results: &mut [ClipResult],
) -> Result<(), EvalError> {
    let mut wanted: Vec<&mut WorstFrame> = (results.iter_mut())
        .filter(|result| !result.worst.is_empty())
        .take(SHOWN_POLICIES)
        .flat_map(|result| &mut result.worst)
        .collect();
    wanted.sort_by_key(|worst| worst.frame);
    if wanted.is_empty() {
        return Ok(());
    }
    source.rewind()?;
    let mut wanted = wanted.into_iter().peekable();
    for frame in 0.. {
        if wanted.peek().is_none() {
            break;
        }
        let Some(picture) = source.next()? else { break };
        while let Some(worst) = wanted.next_if(|worst| worst.frame == frame) {
            worst.shown = Some(FramePicture::Encoded(picture.clone()));
        }
    }
    Ok(())
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
            .copied()
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
            shown: clip.pictures.get(frame).cloned().map(FramePicture::File),
        });
    }
    kept
}

/// Objects of `truth` that `found` has.
fn hits(found: &[ScoredBox], truth: &[ScoredBox]) -> usize {
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
