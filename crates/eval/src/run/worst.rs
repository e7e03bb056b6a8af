//! Finds the frames on which a policy lost the most objects against the detector.

use crate::boxes::ScoredBox;
use crate::data::Clip;
use crate::error::EvalError;
use crate::footage::FrameSource;
use crate::judge::hits;
use crate::replay::Replay;
use crate::result::{ClipResult, FramePicture, WorstFrame};
use crate::spec::split_label;

/// The number of frames of a clip that are kept for each policy.
const KEPT: usize = 2;

/// The fewest frames between two that are kept, so that they show different scenes.
const MIN_DISTANCE: usize = 20;

/// The number of policies whose frames are shown, with their pictures.
const SHOWN_POLICIES: usize = 10;

/// Chooses the policies whose frames are shown: the first setting of each, then further ones.
pub(crate) fn shown_policies<'a>(labels: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let mut first = Vec::new();
    let mut further = Vec::new();
    let mut families = Vec::new();
    for label in labels {
        let (family, _) = split_label(label);
        if !families.contains(&family) {
            families.push(family);
            first.push(label);
        } else if !first.contains(&label) && !further.contains(&label) {
            further.push(label);
        }
    }
    first.extend(further);
    first.truncate(SHOWN_POLICIES);
    first
}

/// Gives the frames in `results`, which are of one clip, their pictures from `source`, for the policies that are shown.
/// The source is read again from its start to the last of these frames, without its `unusable` pictures.
///
/// # Errors
/// [`EvalError`] when the source cannot be read again; the frames then keep their boxes.
pub fn attach_pictures(
    source: &mut dyn FrameSource,
    results: &mut [ClipResult],
    unusable: &[usize],
) -> Result<(), EvalError> {
    let lost = results
        .iter()
        .filter(|result| !result.worst.is_empty())
        .map(|result| result.policy.as_str());
    let shown: Vec<String> = shown_policies(lost).into_iter().map(str::to_owned).collect();
    let mut worst: Vec<&mut WorstFrame> = results
        .iter_mut()
        .filter(|result| shown.contains(&result.policy))
        .flat_map(|result| &mut result.worst)
        .collect();
    worst.sort_by_key(|worst| worst.frame);
    if worst.is_empty() {
        return Ok(());
    }
    source.rewind()?;
    let mut without_picture = worst.into_iter().peekable();
    let mut frame = 0;
    for place in 0.. {
        if without_picture.peek().is_none() {
            break;
        }
        let next = source.next();
        if unusable.contains(&place) {
            continue;
        }
        let Some(picture) = next? else { break };
        while let Some(worst) = without_picture.next_if(|worst| worst.frame == frame) {
            worst.picture = Some(FramePicture::Encoded(picture.clone()));
        }
        frame += 1;
    }
    Ok(())
}

/// A frame that lost objects, and how many.
struct Loss {
    frame: usize,
    lost: usize,
}

/// Returns the frames of `replayed` that lost the most objects, the worst first.
pub(crate) fn worst_frames(clip: &Clip, replayed: &Replay, confidence: f64) -> Vec<WorstFrame> {
    let (Some(truth), Some(detections)) = (&clip.truth, &clip.detections) else {
        return Vec::new();
    };
    let mut losses: Vec<Loss> = Vec::new();
    for (frame, record) in replayed.frames.iter().enumerate() {
        let (Some(objects), Some(found)) = (truth.get(frame), replayed.boxes.get(frame)) else {
            continue;
        };
        if record.detector || objects.is_empty() {
            continue;
        }
        let detected: Vec<ScoredBox> = detections
            .get(frame)
            .into_iter()
            .flatten()
            .filter(|detection| detection.confidence >= confidence)
            .copied()
            .collect();
        let lost = hits(&detected, objects).saturating_sub(hits(found, objects));
        if lost > 0 {
            losses.push(Loss { frame, lost });
        }
    }
    losses.sort_by_key(|loss| (std::cmp::Reverse(loss.lost), loss.frame));
    let mut kept: Vec<WorstFrame> = Vec::new();
    for Loss { frame, lost } in losses {
        if kept.len() == KEPT {
            break;
        }
        let near = |other: &WorstFrame| other.frame.abs_diff(frame) < MIN_DISTANCE;
        if kept.iter().any(near) {
            continue;
        }
        kept.push(WorstFrame {
            frame,
            state: replayed.frames[frame].state,
            lost,
            size: clip.picture,
            truth: truth[frame].iter().map(|object| object.corners).collect(),
            found: replayed.boxes[frame].iter().map(|found| found.corners).collect(),
            picture: clip.pictures.get(frame).cloned().map(FramePicture::File),
        });
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_policy_has_a_place_before_one_has_two() {
        let labels = [
            "albireo-u3e-4-erd-nonempty",
            "albireo-u5e-4-erd-nonempty",
            "fixed-skip-2",
            "fixed-skip-3",
            "expected-loss-0.1",
            "expected-loss-0.3",
            // Of the next clip.
            "albireo-u3e-4-erd-nonempty",
        ];
        let expected = [
            "albireo-u3e-4-erd-nonempty",
            "fixed-skip-2",
            "expected-loss-0.1",
            "albireo-u5e-4-erd-nonempty",
            "fixed-skip-3",
            "expected-loss-0.3",
        ];
        assert_eq!(shown_policies(labels), expected);
    }

    #[test]
    fn of_many_settings_the_first_are_shown() {
        let many: Vec<String> = (0..20).map(|n| format!("fixed-skip-{n}")).collect();
        let shown = shown_policies(many.iter().map(String::as_str));
        assert_eq!(shown, many[..SHOWN_POLICIES]);
    }
}
