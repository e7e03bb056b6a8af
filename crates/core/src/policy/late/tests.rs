use super::*;
use crate::detection::Detection;
use crate::geometry::PictureSize;
use crate::policy::config::{EVEN, FIXED, PRICED, known_policies};
use crate::policy::tests::{built, detection, head, records, seen, textured, useful};
use crate::policy::{
    Ablation, Albireo, EvidenceAtHand, ExpectedLoss, FrameEvidence, FrameState, GreyPicture,
    Pixels, PolicyConfig, Profile,
};
use proptest::prelude::*;
use std::sync::LazyLock;

const GREY: PictureSize = PictureSize::new(64, 48);

/// The evidence available for a frame, and when it arrives.
#[derive(Clone, Debug)]
struct Event {
    head: FrameHead,
    empty: Option<bool>,
    /// How far the picture has moved, pixels; `None` without a picture.
    moved: Option<usize>,
    detections: Option<Vec<Detection>>,
    /// Share of its useful range to which the threshold is set before the frame.
    threshold: Option<f64>,
    /// Number of further frames before the requested evidence arrives.
    delay: usize,
}

prop_compose! {
    fn event(longest: usize)(
        step in prop_oneof![8 => Just(1u32), 1 => 2..6u32],
        empty in prop::option::weighted(0.9, prop::bool::weighted(0.2)),
        moved in prop::option::weighted(0.9, 0..20usize),
        detections in prop::option::weighted(0.9, prop::collection::vec(detection(), 0..4)),
        threshold in prop::option::weighted(0.1, 0.0..1.0),
        delay in 0..=longest,
    ) -> Event {
        Event { head: FrameHead { step, ..head(0) }, empty, moved, detections, threshold, delay }
    }
}

fn events(longest: usize) -> impl Strategy<Value = Vec<Event>> {
    prop::collection::vec(event(longest), 1..40).prop_map(|mut events| {
        let mut next = 0;
        for Event { head, .. } in &mut events {
            next += u64::from(head.step);
            head.index = next - 1;
        }
        events
    })
}

/// The pictures of a world that has moved by 0 to 19 pixels.
static PICTURES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| (0..20u8).map(|moved| textured(GREY, moved.into())).collect());

impl Event {
    fn known(&self) -> FrameEvidence<'_> {
        FrameEvidence {
            empty: self.empty,
            grey: self.moved.map(|moved| GreyPicture {
                size: GREY,
                pixels: &PICTURES[moved],
            }),
            detections: self.detections.as_deref(),
        }
    }

    fn threshold(&self, policy: &dyn Policy) -> Option<f64> {
        Some(useful(policy.threshold_spec()?, self.threshold?))
    }
}

fn build(name: &str) -> Box<dyn Policy> {
    built(name, Profile::Paper)
}

/// The definition: `policy` through the script's frames, where frame i gets only its first `given[i]` pieces of evidence.
fn play(policy: &mut dyn Policy, script: &[Event], given: &[usize]) -> Vec<Outcome> {
    let mut outcomes = Vec::new();
    for (event, &given) in script.iter().zip(given) {
        if let Some(value) = event.threshold(policy) {
            policy.set_threshold(value).unwrap();
        }
        let mut known = event.known();
        let mut need = policy.begin(event.head);
        let mut pieces = 0..given;
        while need != Need::Nothing {
            let Ok(evidence) = known.evidence(need);
            let evidence = pieces.next().map(|_| evidence);
            need = policy.answer(evidence.unwrap_or(Evidence::Unavailable));
        }
        let mut outcome = Outcome::default();
        policy.finish(&mut outcome);
        outcomes.push(outcome);
    }
    outcomes
}

#[test]
fn predicting_policies_answer_at_once_and_others_are_rejected() {
    for name in known_policies() {
        let can = LatePolicy::new(build(name));
        let predicting = ["albireo", "expected-loss", "kill", "in-tracker"];
        let predicts = predicting.iter().any(|part| name.contains(part));
        assert_eq!(can.is_ok(), predicts, "{name}");
        if let Err(refused) = can {
            let said = format!("`{name}` cannot answer at once");
            assert!(refused.to_string().contains(&said), "{refused}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn late_evidence_gives_the_same_result_as_early_evidence(
        // Without a delay the policy has waited for its evidence.
        script in prop_oneof![events(0), events(6)],
        profile in prop::sample::select(vec![Profile::Paper, Profile::Reference]),
    ) {
        let config = PolicyConfig { profile, ..PolicyConfig::default() };
        let mut names = vec![compare(&Albireo::from_config(&config).unwrap(), &script)?];
        for ablation in [Ablation::KillOnly, Ablation::KillErd, Ablation::KillErd10d] {
            names.push(compare(&Albireo::ablated(ablation, &config).unwrap(), &script)?);
        }
        for pixels in [Pixels::Off, Pixels::Flow] {
            for trigger in [PRICED, FIXED, EVEN] {
                let policy = ExpectedLoss::with(trigger(&config), pixels).unwrap();
                names.push(compare(&policy, &script)?);
            }
        }
        let all: Vec<_> = known_policies().filter(|name| build(name).can_rewind()).collect();
        prop_assert_eq!(names, all);
    }
}

/// Evidence that a frame waits for.
#[derive(Clone, Copy)]
struct Awaited {
    /// Index in the script.
    frame: usize,
    need: Need,
    /// Index in the script of the frame after which it arrives.
    arrives: usize,
}

/// Plays the script with a camera that answers at once; each answer must be what `new` decides early. Returns its name.
fn compare<P: Policy + Clone + 'static>(
    new: &P,
    script: &[Event],
) -> Result<&'static str, TestCaseError> {
    let name = new.name();
    let mut late = LatePolicy::new(Box::new(new.clone())).unwrap();
    let mut answer = Outcome::default();
    // Number of pieces of evidence given to each frame.
    let mut given = vec![0; script.len()];
    let mut awaited: Option<Awaited> = None;
    let mut settled: Vec<(usize, Outcome)> = Vec::new();
    // The policy before the first frame that may still get evidence, and its index: what came before is final.
    let mut before = new.clone();
    let mut first = 0;
    for (number, event) in script.iter().enumerate() {
        if let Some(value) = event.threshold(late.policy()) {
            late.set_threshold(value).unwrap();
        }
        let need = late.frame(event.head, &mut answer);
        prop_assert_eq!(answer.state, FrameState::P);
        if need != Need::Nothing {
            prop_assert!(awaited.is_none(), "one frame at a time");
            awaited = Some(Awaited {
                frame: number,
                need,
                arrives: number + event.delay,
            });
        }
        let played = &script[first..=number];
        let mut policy = before.clone();
        let mut live = play(&mut policy, played, &given[first..]).pop().unwrap();
        live.degraded = false;
        live.cause = None;
        prop_assert_eq!(&answer, &live, "{}", name);
        prop_assert_eq!(records(late.policy()), records(&policy), "{}", name);
        let mut came = false;
        while let Some(Awaited {
            frame,
            need,
            arrives,
        }) = awaited
            && arrives <= number
        {
            came = true;
            let event = &script[frame];
            let mut outcome = Outcome::default();
            let mut known = event.known();
            let Ok(evidence) = known.evidence(need);
            let need = late.deliver(event.head.index, evidence, &mut outcome).unwrap();
            given[frame] += 1;
            if need == Need::Nothing {
                settled.push((frame, outcome));
                awaited = None;
            } else {
                awaited = Some(Awaited {
                    frame,
                    need,
                    arrives: number + event.delay,
                });
            }
        }
        prop_assert_eq!(late.pending().is_some(), awaited.is_some());
        if came {
            policy = before.clone();
            let after = play(&mut policy, played, &given[first..]);
            prop_assert_eq!(records(late.policy()), records(&policy), "{}", name);
            prop_assert_eq!(late.policy().threshold(), policy.threshold());
            for (frame, outcome) in settled.iter().filter(|(frame, _)| *frame >= first) {
                prop_assert_eq!(outcome, &after[frame - first], "{}, frame {}", name, frame);
            }
        }
        if awaited.is_none() {
            before = policy;
            first = number + 1;
        }
    }
    let mut policy = new.clone();
    let outcomes = play(&mut policy, script, &given);
    prop_assert_eq!(records(late.policy()), records(&policy), "{}", name);
    for (frame, outcome) in &settled {
        prop_assert_eq!(outcome, &outcomes[*frame], "{}, frame {}", name, frame);
    }
    Ok(name)
}

/// A policy with one object and a pending frame, and the index of that frame.
fn pending(name: &str) -> (LatePolicy, u64) {
    let mut late = LatePolicy::new(build(name)).unwrap();
    let mut outcome = Outcome::default();
    for index in 0.. {
        let mut need = late.frame(head(index), &mut outcome);
        if index > 3 && need != Need::Nothing {
            return (late, index);
        }
        while need != Need::Nothing {
            let found = [seen(0.5, 0.9)];
            let mut known = FrameEvidence::in_view(&found);
            let Ok(evidence) = known.evidence(need);
            need = late.deliver(index, evidence, &mut outcome).unwrap();
        }
    }
    unreachable!("the detector is called sooner or later");
}

#[test]
fn evidence_for_another_frame_is_an_error_and_changes_nothing() {
    let (mut late, index) = pending("albireo");
    let before = records(late.policy());
    let found = [seen(0.2, 0.9)];
    let mut outcome = Outcome::default();
    let untouched = outcome.clone();
    for wrong in [0, index - 1, index + 1, u64::MAX] {
        let refused = late.deliver(wrong, Evidence::Detections(&found), &mut outcome);
        assert_eq!(refused, Err(NotPending { frame: wrong }));
    }
    assert_eq!(late.pending(), Some(index));
    assert_eq!(records(late.policy()), before);
    assert_eq!(outcome, untouched);
    let need = late.deliver(index, Evidence::Detections(&found), &mut outcome);
    assert!(need.is_ok());
    assert_eq!(outcome.state, FrameState::AI);
    let again = late.deliver(index, Evidence::Detections(&found), &mut outcome);
    assert_eq!(again, Err(NotPending { frame: index }));
    let (mut late, index) = pending("albireo");
    late.reset();
    let forgotten = late.deliver(index, Evidence::Detections(&found), &mut outcome);
    assert_eq!(forgotten, Err(NotPending { frame: index }));
}

#[test]
fn frames_beyond_the_list_of_steps_are_repeated_as_lost_ones() {
    let frames = MOST_STEPS as u64 + 20;
    for name in ["albireo", "expected-loss"] {
        let (mut late, index) = pending(name);
        let mut outcome = Outcome::default();
        for later in 1..=frames {
            assert_eq!(late.frame(head(index + later), &mut outcome), Need::Nothing);
            assert!(late.steps.len() <= MOST_STEPS);
        }
        let last = late.steps.last().unwrap().head;
        assert_eq!((last.index, last.step), (index + frames, 21));
        let found = [seen(0.5, 0.9)];
        let need = late.deliver(index, Evidence::Detections(&found), &mut outcome);
        assert!(need.is_ok());
        let (mut short, index) = pending(name);
        for later in 1..MOST_STEPS as u64 {
            short.frame(head(index + later), &mut outcome);
        }
        let need = short.deliver(index, Evidence::Detections(&found), &mut outcome);
        assert!(need.is_ok());
        let lost = FrameHead {
            step: 21,
            ..head(index + frames)
        };
        let need = short.policy.begin(lost);
        predict(&mut short.policy, need, &mut outcome);
        assert_eq!(records(late.policy()), records(short.policy()), "{name}");
    }
}
