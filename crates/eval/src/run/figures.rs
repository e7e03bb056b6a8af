//! Computes the figures of a policy on a clip from its replay.

use crate::boxes::ScoredBox;
use crate::data::classes::Evaluated;
use crate::data::{Clip, Pass};
use crate::judge::{Classes, Matches, Truth, accuracy, accuracy_by_class, newcomers, tracking};
use crate::replay::{FrameRecord, Replay, StoredEvidence};
use crate::result::{ClipResult, FrameTime, Provenance, Spread};
use crate::settings::{ScreenRule, Settings};
use albireo_core::policy::{FrameState, Need};
use albireo_wire::FrameStates;

/// Fills in the figures that follow from the replay's records, but not accuracy, frame time and energy.
pub(super) fn of_replay(clip: &Clip, policy: &str, replayed: &Replay) -> ClipResult {
    let frames = &replayed.frames;
    let mut states = FrameStates::default();
    for frame in frames {
        states.count(frame.state);
    }
    let count = |test: fn(&FrameRecord) -> bool| frames.iter().filter(|frame| test(frame)).count();
    let decisions = frames.iter().map(|frame| frame.decision.as_secs_f64() * 1e6).collect();
    ClipResult {
        clip: clip.name.clone(),
        camera: clip.camera.clone(),
        policy: policy.to_owned(),
        frames: frames.len(),
        unlabelled_frames: clip.unlabelled(),
        frame_rate: clip.frame_rate,
        states,
        detector_frames: count(|frame| frame.detector),
        screen_frames: count(|frame| frame.screen),
        looked_frames: count(|frame| frame.examined),
        degraded_frames: count(|frame| frame.degraded),
        rejected_detections: replayed.rejected_detections,
        boxes: replayed.boxes.iter().map(Vec::len).sum(),
        decision_us: Spread::of(decisions),
        states_by_frame: frames.iter().map(|frame| frame.state).collect(),
        examined: frames.iter().map(|frame| frame.examined).collect(),
        ..ClipResult::default()
    }
}

/// Judges the boxes of a replay, and fills in the figures of accuracy, tracking and newcomers.
pub(super) fn judge(
    result: &mut ClipResult,
    truth: Truth<'_>,
    replayed: &Replay,
    classes: &Evaluated,
    settings: &Settings,
) {
    let accuracy_of =
        |boxes: &[Vec<ScoredBox>]| accuracy(boxes, truth, settings.classes, settings.interpolation);
    if settings.classes == Classes::Pooled {
        let matches = Matches::of(&replayed.boxes, truth, settings.interpolation);
        result.accuracy = matches.accuracy();
        result.matches = Some(matches);
    } else {
        result.accuracy = accuracy_of(&replayed.boxes);
    }
    result.tracking = tracking(&replayed.boxes, truth);
    result.newcomers = newcomers(&replayed.boxes, truth, settings.classes);
    if let Some(all) = &replayed.boxes_all {
        result.accuracy_all = accuracy_of(all);
        result.tracking_all = tracking(all, truth);
    }
    if let Some(last) = &replayed.boxes_last_confidence {
        result.accuracy_last_confidence = accuracy_of(last);
    }
    result.classes = accuracy_by_class(&replayed.boxes, truth, settings.interpolation)
        .into_iter()
        .map(|(class, accuracy)| (classes.name(class), accuracy))
        .collect();
}

/// Fills in the time per frame, composed from its steps, and counts the occupied frames and those of them that the
/// screen wrongly calls empty. All need the detector's pass over all pictures.
pub(super) fn time(
    result: &mut ClipResult,
    pass: &Pass,
    replayed: &Replay,
    source: &StoredEvidence<'_>,
    pictures: Option<Need>,
    settings: &Settings,
) {
    for (state, found) in result.states_by_frame.iter().zip(source.all_detections()) {
        if !found.is_empty() {
            result.occupied_frames += 1;
            if *state == FrameState::E {
                result.false_empty_frames += 1;
            }
        }
    }
    let screened = settings.screen == ScreenRule::Recorded;
    let times = frame_times(pass, &replayed.frames, pictures, screened);
    result.frame_time = Spread::of(times).map(|milliseconds| FrameTime {
        milliseconds,
        provenance: Provenance::Composed,
    });
}

/// Composes the milliseconds of each frame under a policy that needs `pictures`: its decision time from `records`, and
/// the times of its steps as measured in the pass. Screen and detector share one decoded picture; `screened` is true
/// if the clip's own screen gave the verdicts.
fn frame_times(
    pass: &Pass,
    records: &[FrameRecord],
    pictures: Option<Need>,
    screened: bool,
) -> Vec<f64> {
    let mut milliseconds = Vec::with_capacity(records.len());
    for (record, times) in records.iter().zip(&pass.times) {
        let screen = record.screen && screened;
        let mut steps = 0.0;
        if record.detector || screen {
            steps += times.decode;
        }
        if record.detector {
            steps += times.detector;
        }
        if screen {
            steps += times.screen;
        }
        if record.examined {
            steps += match pictures {
                Some(Need::GreyPicture) => times.grey,
                _ => times.small,
            };
        }
        milliseconds.push(record.decision.as_secs_f64() * 1e3 + steps);
    }
    milliseconds
}
