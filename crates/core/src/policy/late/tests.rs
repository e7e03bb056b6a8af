use super::*;
use crate::detection::{ClassId, Detection};
use crate::geometry::{BoundingBox, PictureSize};
use crate::policy::config::known_policies;
use crate::policy::tests::{PICTURE, built, head, records, seen};
use crate::policy::{EvidenceAtHand, FrameEvidence, FrameState, GreyPicture, Profile, decide};
use proptest::prelude::*;

const GREY: PictureSize = PictureSize::new(64, 48);

/// The evidence available for a frame, and when it arrives.
#[derive(Clone, Debug)]
struct Event {
    step: u32,
    empty: Option<bool>,
    /// How far the picture has moved, pixels; `None` without a picture.
    moved: Option<u8>,
    detections: Option<Vec<Detection>>,
    /// Share of its useful range to which the threshold is set before the frame.
    threshold: Option<f64>,
    /// Number of further frames before the requested evidence arrives.
    delay: usize,
}

fn events(longest: usize) -> impl Strategy<Value = Vec<Event>> {
    let detection = (0.0..1.0, 0.2..0.8, 0.5..1.0, prop::bool::weighted(0.03)).prop_map(
        |(x, y, confidence, hostile)| Detection {
            bounding_box: BoundingBox::new(x, y, if hostile { f64::NAN } else { 0.2 }, 0.2),
            class: ClassId(0),
            confidence,
        },
    );
    let event = (
        prop_oneof![8 => Just(1u32), 1 => 2..6u32],
        prop::option::weighted(0.9, prop::bool::weighted(0.2)),
        prop::option::weighted(0.9, 0..20u8),
        prop::option::weighted(0.9, prop::collection::vec(detection, 0..4)),
        prop::option::weighted(0.1, 0.0..1.0),
        0..=longest,
    );
    let event = event.prop_map(|(step, empty, moved, detections, threshold, delay)| Event {
        step,
        empty,
        moved,
        detections,
        threshold,
        delay,
    });
    prop::collection::vec(event, 1..40)
}

impl Event {
    fn grey(&self) -> Vec<u8> {
        let moved = f64::from(self.moved.unwrap_or_default());
        let pixel = |place: u32| {
            let (x, y) = (
                f64::from(place % GREY.width) - moved,
                f64::from(place / GREY.width),
            );
            (128.0 + 50.0 * (0.7 * x + 0.2 * y).sin() + 50.0 * (0.8 * y - 0.3 * x).sin()) as u8
        };
        (0..GREY.width * GREY.height).map(pixel).collect()
    }

    /// The frame's evidence, with `grey` as its pixels.
    fn known<'a>(&'a self, grey: &'a [u8]) -> FrameEvidence<'a> {
        FrameEvidence {
            empty: self.empty,
            grey: self.moved.map(|_| GreyPicture {
                size: GREY,
                pixels: grey,
            }),
            detections: self.detections.as_deref(),
        }
    }

    fn set_threshold(&self, policy: &mut dyn Policy) {
        if let (Some(share), Some(knob)) = (self.threshold, policy.knob()) {
            let range = knob.useful_maximum - knob.useful_minimum;
            policy
                .set_knob(knob.useful_minimum + share * range)
                .unwrap();
        }
    }
}

/// The frames of a script.
fn heads(script: &[Event]) -> Vec<FrameHead> {
    let mut next = 0;
    let head = |event: &Event| {
        next += u64::from(event.step);
        FrameHead {
            index: next - 1,
            step: event.step,
            picture: PICTURE,
        }
    };
    script.iter().map(head).collect()
}

/// Names of all policies that can answer at once.
fn late_policies() -> impl Iterator<Item = &'static str> {
    known_policies().filter(|name| build(name).can_rewind())
}

fn build(name: &str) -> Box<dyn Policy> {
    built(name, Profile::Paper)
}

fn profiles() -> impl Strategy<Value = Profile> {
    prop_oneof![Just(Profile::Paper), Just(Profile::Reference)]
}

fn late(name: &str) -> LatePolicy {
    LatePolicy::new(build(name)).unwrap()
}

/// Gives frame `event` what it needs; returns what it needs next.
fn deliver(
    late: &mut LatePolicy,
    index: u64,
    need: Need,
    event: &Event,
    outcome: &mut Outcome,
) -> Need {
    let grey = event.grey();
    let mut known = event.known(&grey);
    let Ok(evidence) = known.evidence(need);
    late.deliver(index, evidence, outcome).unwrap()
}

/// A frame answered at once.
fn predicted(outcome: &Outcome) -> Outcome {
    Outcome {
        degraded: false,
        cause: None,
        ..outcome.clone()
    }
}

/// The definition: `policy` from the start of the stream through all frames, where frame i is given its first
/// `given[i]` pieces of evidence and no more. Returns the outcome of every frame.
fn from_the_start(policy: &mut dyn Policy, script: &[Event], given: &[usize]) -> Vec<Outcome> {
    let mut outcomes = Vec::new();
    for ((event, head), &given) in script.iter().zip(heads(script)).zip(given) {
        event.set_threshold(policy);
        let grey = event.grey();
        let mut known = event.known(&grey);
        let mut need = policy.begin(head);
        for piece in 0.. {
            if need == Need::Nothing {
                break;
            }
            let Ok(evidence) = known.evidence(need);
            need = policy.answer(if piece < given {
                evidence
            } else {
                Evidence::Unavailable
            });
        }
        let mut outcome = Outcome::default();
        policy.finish(&mut outcome);
        outcomes.push(outcome);
    }
    outcomes
}

/// A camera whose frames are answered at once, and the answers so far.
struct Camera<'a> {
    late: LatePolicy,
    script: &'a [Event],
    heads: Vec<FrameHead>,
    next: usize,
    /// The pending frame, what it needs, and after which frame that arrives.
    waits: Option<(usize, Need, usize)>,
    /// Number of pieces of evidence given to each frame.
    given: Vec<usize>,
    live: Vec<Outcome>,
    settled: Vec<(usize, Outcome)>,
}

impl<'a> Camera<'a> {
    fn new(policy: Box<dyn Policy>, script: &'a [Event]) -> Self {
        Self {
            late: LatePolicy::new(policy).unwrap(),
            script,
            heads: heads(script),
            next: 0,
            waits: None,
            given: vec![0; script.len()],
            live: Vec::new(),
            settled: Vec::new(),
        }
    }

    /// Plays the next frame; returns false after the last.
    fn frame(&mut self) -> bool {
        let Some(event) = self.script.get(self.next) else {
            return false;
        };
        event.set_threshold(&mut *self.late.policy);
        let mut outcome = Outcome::default();
        let need = self.late.frame(self.heads[self.next], &mut outcome);
        assert_eq!(outcome.state, FrameState::P);
        self.live.push(outcome);
        if need != Need::Nothing {
            assert!(self.waits.is_none(), "one frame at a time");
            self.waits = Some((self.next, need, self.next + event.delay));
        }
        self.next += 1;
        true
    }

    /// Delivers the evidence that has arrived by now.
    fn arrivals(&mut self) -> bool {
        let mut came = false;
        while let Some((frame, need, at)) = self.waits
            && at < self.next
        {
            came = true;
            let mut outcome = Outcome::default();
            let event = &self.script[frame];
            let index = self.heads[frame].index;
            let need = deliver(&mut self.late, index, need, event, &mut outcome);
            self.given[frame] += 1;
            self.waits = match need {
                Need::Nothing => {
                    self.settled.push((frame, outcome));
                    None
                }
                need => Some((frame, need, self.next - 1 + event.delay)),
            };
        }
        came
    }
}

#[test]
fn predicting_policies_answer_at_once_and_others_are_rejected() {
    for name in known_policies() {
        let can = LatePolicy::new(build(name));
        let mut predicting = ["albireo", "expected-loss", "kill", "in-tracker"].iter();
        assert_eq!(
            can.is_ok(),
            predicting.any(|part| name.contains(part)),
            "{name}"
        );
        if let Err(refused) = can {
            let said = format!("`{name}` cannot answer at once");
            assert!(refused.to_string().contains(&said), "{refused}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn without_delay_every_frame_equals_that_of_a_waiting_policy(
        script in events(0),
        profile in profiles(),
    ) {
        for name in late_policies() {
            let mut waiting = built(name, profile);
            let mut camera = Camera::new(built(name, profile), &script);
            for (frame, (event, head)) in script.iter().zip(heads(&script)).enumerate() {
                event.set_threshold(&mut *waiting);
                let grey = event.grey();
                let mut expected = Outcome::default();
                let Ok(()) =
                    decide(&mut *waiting, head, &mut event.known(&grey), &mut expected);
                camera.frame();
                let last = match camera.arrivals() {
                    true => camera.settled.last().map(|(_, outcome)| outcome),
                    false => camera.live.last(),
                };
                prop_assert_eq!(last, Some(&expected), "{}, frame {}", name, frame);
                prop_assert_eq!(camera.late.pending(), None);
                prop_assert_eq!(records(camera.late.policy()), records(&*waiting), "{}", name);
            }
        }
    }

    #[test]
    fn late_evidence_gives_the_same_result_as_early_evidence(
        script in events(6),
        profile in profiles(),
    ) {
        for name in late_policies() {
            let mut camera = Camera::new(built(name, profile), &script);
            while camera.frame() {
                let so_far = &script[..camera.next];
                let mut policy = built(name, profile);
                let before = from_the_start(&mut *policy, so_far, &camera.given);
                let before = before.last().map(predicted);
                prop_assert_eq!(camera.live.last(), before.as_ref(), "{}", name);
                prop_assert_eq!(records(camera.late.policy()), records(&*policy), "{}", name);
                if !camera.arrivals() {
                    continue;
                }
                let mut policy = built(name, profile);
                let after = from_the_start(&mut *policy, so_far, &camera.given);
                prop_assert_eq!(records(camera.late.policy()), records(&*policy), "{}", name);
                prop_assert_eq!(camera.late.policy().knob_value(), policy.knob_value());
                for (frame, outcome) in &camera.settled {
                    prop_assert_eq!(outcome, &after[*frame], "{}, frame {}", name, frame);
                }
            }
        }
    }

    #[test]
    fn two_cameras_in_any_order_do_not_affect_each_other(
        scripts in [events(4), events(4)],
        order in prop::collection::vec(any::<bool>(), 0..200),
    ) {
        for name in ["albireo", "expected-loss", "expected-loss+flow"] {
            let alone = scripts.each_ref().map(|script| {
                let mut camera = Camera::new(build(name), script);
                while camera.frame() {
                    camera.arrivals();
                }
                camera
            });
            let mut together = scripts.each_ref().map(|script| Camera::new(build(name), script));
            let rest = (0..80).flat_map(|_| [false, true]);
            for second in order.iter().copied().chain(rest) {
                let camera = &mut together[usize::from(second)];
                if camera.frame() {
                    camera.arrivals();
                }
            }
            for (alone, together) in alone.iter().zip(&together) {
                prop_assert_eq!(&alone.live, &together.live);
                prop_assert_eq!(&alone.settled, &together.settled);
            }
        }
    }
}

/// A policy with one object and a pending frame, and the index of that frame.
fn pending(name: &str) -> (LatePolicy, u64) {
    let mut late = late(name);
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
    assert_eq!(
        (late.pending(), records(late.policy())),
        (Some(index), before)
    );
    assert_eq!(outcome, untouched);
    late.deliver(index, Evidence::Detections(&found), &mut outcome)
        .unwrap();
    assert_eq!(outcome.state, FrameState::AI);
    let again = late.deliver(index, Evidence::Detections(&found), &mut outcome);
    assert_eq!(again, Err(NotPending { frame: index }));
    let (mut late, index) = pending("albireo");
    late.reset();
    let forgotten = late.deliver(index, Evidence::Detections(&found), &mut outcome);
    assert_eq!(forgotten, Err(NotPending { frame: index }));
}

#[test]
fn a_failed_detector_degrades_the_frame_and_is_called_again() {
    for name in ["albireo", "expected-loss"] {
        let (mut late, index) = pending(name);
        let mut outcome = Outcome::default();
        assert_eq!(late.frame(head(index + 1), &mut outcome), Need::Nothing);
        assert!(!outcome.degraded);
        let live = records(late.policy());
        let need = late.deliver(index, Evidence::Unavailable, &mut outcome);
        assert_eq!(need, Ok(Need::Nothing));
        assert_eq!((outcome.state, outcome.degraded), (FrameState::P, true));
        assert_eq!(records(late.policy()), live);
        assert_eq!(late.frame(head(index + 2), &mut outcome), Need::Detections);
    }
}

#[test]
fn a_threshold_set_in_between_is_kept() {
    let (mut late, index) = pending("albireo");
    late.set_knob(1e-2).unwrap();
    let mut outcome = Outcome::default();
    late.frame(head(index + 1), &mut outcome);
    let found = [seen(0.5, 0.9)];
    late.deliver(index, Evidence::Detections(&found), &mut outcome)
        .unwrap();
    assert_eq!(late.policy().knob_value(), Some(1e-2));
    assert!(late.set_knob(f64::NAN).is_err());
    assert_eq!(late.policy().knob_value(), Some(1e-2));
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
        late.deliver(index, Evidence::Detections(&found), &mut outcome)
            .unwrap();
        let (mut short, index) = pending(name);
        for later in 1..MOST_STEPS as u64 {
            short.frame(head(index + later), &mut outcome);
        }
        short
            .deliver(index, Evidence::Detections(&found), &mut outcome)
            .unwrap();
        let lost = FrameHead {
            step: 21,
            ..head(index + frames)
        };
        let need = short.policy.begin(lost);
        predict(&mut *short.policy, need, &mut outcome);
        assert_eq!(records(late.policy()), records(short.policy()), "{name}");
    }
}
