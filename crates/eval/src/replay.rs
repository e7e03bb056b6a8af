//! Replays a clip through a policy and records its answers.

mod evidence;
mod scoring;
pub mod trace;

pub(crate) use evidence::StoredEvidence;
pub(crate) use scoring::{score_all, score_published};

use self::scoring::{decay_threshold, decayed_confidence, score_object, score_truncated};
use self::trace::TraceFrame;
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    Evidence, EvidenceAtHand, FrameHead, FrameState, MinConfidence, Need, ObjectRecord, Outcome,
    Policy, Profile, decide,
};
use std::time::{Duration, Instant};

/// The record of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameRecord {
    /// The frame's state.
    pub state: FrameState,
    /// True if the detector was needed and failed.
    pub degraded: bool,
    /// True if the policy asked for detections.
    pub detector: bool,
    /// True if the policy asked for the verdict of the empty-scene screen.
    pub screen: bool,
    /// True if a grey picture was examined.
    pub examined: bool,
    /// Time inside the policy, without the time spent on evidence.
    pub decision: Duration,
}

/// The replay of a clip by a policy.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Replay {
    /// One record per frame.
    pub frames: Vec<FrameRecord>,
    /// The boxes to judge, one list per frame: those a node publishes, or all with the published evaluator's confidence.
    pub boxes: Vec<Vec<ScoredBox>>,
    /// All boxes of the policy, if only the published ones are judged.
    pub boxes_all: Option<Vec<Vec<ScoredBox>>>,
    /// The boxes of `boxes` with the confidence of their last detection, if the profile decays confidences.
    pub boxes_last_confidence: Option<Vec<Vec<ScoredBox>>>,
    /// The number of detections that the policy rejected because they are not valid boxes.
    pub rejected_detections: u64,
    /// The trace, if it was kept.
    pub trace: Option<Vec<TraceFrame>>,
}

/// Replays all frames of `source` through `policy` from its initial state. `min_confidence` selects the boxes that are
/// judged under the profile `paper`.
///
/// # Errors
/// [`EvalError`] when the source does not have what the policy needs.
pub(crate) fn replay(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    profile: Profile,
    min_confidence: MinConfidence,
    keep_trace: bool,
) -> Result<Replay, EvalError> {
    let decay_u = decay_threshold(policy);
    let rejected_before = policy.rejected_detections();
    let picture = source.picture();
    let frames = source.frames();
    let mut result = Replay {
        frames: Vec::with_capacity(frames),
        boxes: Vec::with_capacity(frames),
        trace: keep_trace.then(Vec::new),
        ..Replay::default()
    };
    let mut objects = Vec::new();
    drive(policy, source, &mut |policy, decided| {
        result.frames.push(decided.record);
        objects.clear();
        collect_objects(policy, &mut objects);
        match profile {
            Profile::Paper => {
                let boxes = &decided.outcome.boxes;
                result.boxes.push(score_published(boxes, picture, min_confidence));
                result.boxes_all.get_or_insert_default().push(score_all(boxes, picture));
            }
            Profile::Reference => {
                let undecayed = score_by_published_evaluator(&objects, decided.outcome, picture);
                result.boxes.push(decayed(&undecayed, &objects, decay_u));
                result.boxes_last_confidence.get_or_insert_default().push(undecayed);
            }
        }
        if let Some(trace) = &mut result.trace {
            trace.push(TraceFrame {
                frame: decided.head.index,
                state: decided.outcome.state,
                tau_max: decided.outcome.tau_max,
                active: decided.outcome.active,
                objects: objects.clone(),
            });
        }
    })?;
    result.rejected_detections = policy.rejected_detections() - rejected_before;
    Ok(result)
}

/// A frame that a policy has decided.
pub(crate) struct DecidedFrame<'a> {
    /// The head that the policy received.
    pub head: FrameHead,
    /// The record of the frame.
    pub record: FrameRecord,
    /// The frame's state and boxes.
    pub outcome: &'a Outcome,
}

/// Runs all frames of `source` through `policy` from its initial state, and calls `each` after each of them.
///
/// # Errors
/// [`EvalError`] when the source does not have what the policy needs.
pub(crate) fn drive(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    each: &mut dyn FnMut(&dyn Policy, &DecidedFrame<'_>),
) -> Result<(), EvalError> {
    policy.reset();
    let picture = source.picture();
    let mut outcome = Outcome::default();
    for frame in 0..source.frames() {
        let head = FrameHead {
            index: frame as u64,
            step: 1,
            picture,
        };
        let record = decide_frame(policy, source, head, frame, &mut outcome)?;
        let decided = DecidedFrame {
            head,
            record,
            outcome: &outcome,
        };
        each(&*policy, &decided);
    }
    Ok(())
}

/// The evidence of one frame of a clip. It records the requests of the policy, and measures the time of fetching
/// evidence.
pub(crate) struct ClipFrame<'a, 'c> {
    clip: &'a mut StoredEvidence<'c>,
    frame: usize,
    /// True if the policy asked for detections.
    pub detector: bool,
    screen: bool,
    examined: bool,
    waited: Duration,
}

impl<'a, 'c> ClipFrame<'a, 'c> {
    pub(crate) fn new(clip: &'a mut StoredEvidence<'c>, frame: usize) -> Self {
        Self {
            clip,
            frame,
            detector: false,
            screen: false,
            examined: false,
            waited: Duration::ZERO,
        }
    }
}

impl EvidenceAtHand for ClipFrame<'_, '_> {
    type Error = EvalError;

    fn evidence(&mut self, need: Need) -> Result<Evidence<'_>, EvalError> {
        let start = Instant::now();
        match need {
            Need::Nothing => {}
            Need::Screen => self.screen = true,
            Need::GreyPicture | Need::SmallGreyPicture { .. } => self.examined = true,
            Need::Detections => self.detector = true,
        }
        let evidence = self.clip.evidence(self.frame, need);
        self.waited += start.elapsed();
        evidence
    }
}

/// Decides one frame, and measures the time of the policy without the time of the evidence.
fn decide_frame(
    policy: &mut dyn Policy,
    clip: &mut StoredEvidence<'_>,
    head: FrameHead,
    frame: usize,
    outcome: &mut Outcome,
) -> Result<FrameRecord, EvalError> {
    let mut source = ClipFrame::new(clip, frame);
    let start = Instant::now();
    decide(policy, head, &mut source, outcome)?;
    Ok(FrameRecord {
        state: outcome.state,
        degraded: outcome.degraded,
        detector: source.detector,
        screen: source.screen,
        examined: source.examined,
        decision: start.elapsed().saturating_sub(source.waited),
    })
}

/// Returns the boxes that the published evaluator scores, with the confidence of their last detection: first those of all
/// objects, then those that belong to no object.
fn score_by_published_evaluator(
    objects: &[ObjectRecord],
    outcome: &Outcome,
    picture: PictureSize,
) -> Vec<ScoredBox> {
    let of_objects = objects.iter().map(|object| score_object(object, picture));
    let free = outcome
        .boxes
        .iter()
        .filter(|output| output.object.is_none())
        .map(|output| score_truncated(output, picture));
    of_objects.chain(free).collect()
}

/// The boxes with the confidence that the published evaluator gives them. Those of objects, which come first, lose some with
/// each frame since the last detection; the others keep theirs.
fn decayed(undecayed: &[ScoredBox], objects: &[ObjectRecord], decay_u: f64) -> Vec<ScoredBox> {
    let mut boxes = undecayed.to_vec();
    for (scored, object) in boxes[..objects.len()].iter_mut().zip(objects) {
        scored.confidence = decayed_confidence(object.confidence, object.tau, decay_u);
    }
    boxes
}

/// Appends the policy's objects in its own order.
fn collect_objects(policy: &dyn Policy, objects: &mut Vec<ObjectRecord>) {
    policy.objects(&mut |record: &ObjectRecord| objects.push(*record));
}

#[cfg(test)]
mod tests;
