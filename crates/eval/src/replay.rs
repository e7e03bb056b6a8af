//! Replays one clip through one policy and records its answers.

use crate::average_precision::ScoredBox;
use crate::error::EvalError;
use crate::scoring::{
    decay_threshold, decayed_confidence, score_object, score_published, score_truncated,
};
use crate::source::StoredEvidence;
use crate::trace::TraceFrame;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    Evidence, EvidenceAtHand, FrameHead, FrameState, MinConfidence, Need, ObjectRecord, Outcome,
    Policy, Profile, decide,
};
use std::time::{Duration, Instant};

/// What happened in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRecord {
    /// The frame's state.
    pub state: FrameState,
    /// The detector was needed and failed.
    pub degraded: bool,
    /// The detector ran.
    pub detector: bool,
    /// The empty-scene screen ran.
    pub screen: bool,
    /// A grey picture was looked at.
    pub examined: bool,
    /// Time inside the policy, without what was spent on evidence.
    pub decision: Duration,
}

/// What a policy did with a clip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replay {
    /// One record per frame.
    pub frames: Vec<FrameRecord>,
    /// The boxes to judge, one list per frame: those a node publishes, or all with the published evaluator's confidence.
    pub boxes: Vec<Vec<ScoredBox>>,
    /// All boxes of the policy, where only the published ones are judged.
    pub boxes_all: Option<Vec<Vec<ScoredBox>>>,
    /// The same boxes with the confidence of their last detection, where the profile decays it.
    pub boxes_last_confidence: Option<Vec<Vec<ScoredBox>>>,
    /// Detections the policy refused because their numbers make no box.
    pub rejected_detections: u64,
    /// The trace, if asked for.
    pub trace: Option<Vec<TraceFrame>>,
}

/// Takes `policy` from its initial state through all frames of `source`. `min_confidence` selects the boxes that are
/// judged under the profile `paper`.
///
/// # Errors
/// [`EvalError`] when the source cannot give what the policy asks for.
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
        boxes_last_confidence: (profile == Profile::Reference).then(Vec::new),
        trace: keep_trace.then(Vec::new),
        ..Replay::default()
    };
    let mut objects = Vec::new();
    drive(policy, source, &mut |policy, played| {
        result.frames.push(played.record);
        objects.clear();
        collect_objects(policy, &mut objects);
        match &mut result.boxes_last_confidence {
            None => {
                let (published, all) =
                    score_published(&played.outcome.boxes, picture, min_confidence);
                result.boxes.push(published);
                result.boxes_all.get_or_insert_default().push(all);
            }
            Some(last) => {
                let (decayed, undecayed) =
                    score_as_published(&objects, played.outcome, picture, decay_u);
                result.boxes.push(decayed);
                last.push(undecayed);
            }
        }
        if let Some(trace) = &mut result.trace {
            trace.push(TraceFrame {
                frame: played.head.index,
                state: played.outcome.state,
                tau_max: played.outcome.tau_max,
                active: played.outcome.active,
                objects: objects.clone(),
            });
        }
    })?;
    result.rejected_detections = policy.rejected_detections() - rejected_before;
    Ok(result)
}

/// One frame that a policy was taken through.
pub(crate) struct Played<'a> {
    /// What the policy received.
    pub head: FrameHead,
    /// What happened.
    pub record: FrameRecord,
    /// State and boxes.
    pub outcome: &'a Outcome,
}

/// Takes `policy` from its initial state through all frames of `source`, and shows each to `each`.
///
/// # Errors
/// [`EvalError`] when the source cannot give what the policy asks for.
pub(crate) fn drive(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    each: &mut dyn FnMut(&dyn Policy, &Played<'_>),
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
        let played = Played {
            head,
            record,
            outcome: &outcome,
        };
        each(&*policy, &played);
    }
    Ok(())
}

/// One frame of a clip as evidence; notes what was asked for, and times it.
pub(crate) struct ClipFrame<'a, 'c> {
    clip: &'a mut StoredEvidence<'c>,
    frame: usize,
    /// Whether the detector was asked.
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

/// One frame; times the policy and the evidence apart.
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

/// The boxes the published evaluator scores, with decayed and with last confidences: all objects, and the
/// boxes that belong to none.
fn score_as_published(
    objects: &[ObjectRecord],
    outcome: &Outcome,
    picture: PictureSize,
    decay_u: f64,
) -> (Vec<ScoredBox>, Vec<ScoredBox>) {
    let free = outcome
        .boxes
        .iter()
        .filter(|output| output.object.is_none())
        .map(|output| score_truncated(output, picture));
    let undecayed: Vec<ScoredBox> = objects
        .iter()
        .map(|object| score_object(object, picture))
        .chain(free)
        .collect();
    let mut decayed = undecayed.clone();
    for (scored, object) in decayed.iter_mut().zip(objects) {
        scored.confidence = decayed_confidence(object.confidence, object.tau, decay_u);
    }
    (decayed, undecayed)
}

/// Appends the policy's objects in its own order.
fn collect_objects(policy: &dyn Policy, objects: &mut Vec<ObjectRecord>) {
    policy.objects(&mut |record: &ObjectRecord| objects.push(*record));
}

#[cfg(test)]
mod tests;
