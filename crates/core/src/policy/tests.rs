//! The promises that every policy keeps under any sequence of events.

mod camera;

pub(crate) use camera::{PICTURE, seen};
pub(super) use camera::{Run, built, head, records, ride};

use super::config::known_policies;
use super::*;
use crate::detection::ClassId;
use proptest::prelude::*;

/// The fate of a frame.
#[derive(Clone, Debug)]
struct Event {
    step: u32,
    /// Abandoned after this many answers.
    given_up: Option<usize>,
    small_picture: bool,
    screen: Option<bool>,
    grey: Option<u8>,
    detections: Option<Vec<(f64, f64, bool)>>,
    reset: bool,
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    let step = prop_oneof![8 => Just(1u32), 2 => 2..12u32, 1 => Just(5000u32)];
    let detection = (0.0..1.0, 0.5..1.0, prop::bool::weighted(0.05));
    let event = (
        step,
        prop::option::weighted(0.05, 0..3usize),
        prop::bool::weighted(0.05),
        prop::option::weighted(0.8, any::<bool>()),
        prop::option::weighted(0.8, prop_oneof![Just(0u8), Just(200u8)]),
        prop::option::weighted(0.8, prop::collection::vec(detection, 0..4)),
        prop::bool::weighted(0.02),
    );
    let event = event.prop_map(
        |(step, given_up, small_picture, screen, grey, detections, reset)| Event {
            step,
            given_up,
            small_picture,
            screen,
            grey,
            detections,
            reset,
        },
    );
    prop::collection::vec(event, 1..60)
}

fn detections(found: &[(f64, f64, bool)]) -> Vec<Detection> {
    let detection = |&(x, confidence, hostile): &(f64, f64, bool)| Detection {
        bounding_box: BoundingBox::new(x, 0.5, if hostile { f64::NAN } else { 0.1 }, 0.1),
        class: ClassId(0),
        confidence,
    };
    found.iter().map(detection).collect()
}

/// Plays one frame; returns its outcome unless it was abandoned, and how often the detector answered.
fn play(policy: &mut dyn Policy, index: u64, event: &Event) -> (Option<Outcome>, usize) {
    let picture = match event.small_picture {
        true => PictureSize::new(64, 36),
        false => PICTURE,
    };
    let found = event.detections.as_deref().map(detections);
    let grey = [event.grey.unwrap_or_default(); 128];
    let mut answers = 0;
    let mut answered = 0;
    let head = FrameHead {
        index,
        step: event.step,
        picture,
    };
    let mut need = policy.begin(head);
    while need != Need::Nothing {
        if event.given_up == Some(answers) {
            return (None, answered);
        }
        let evidence = match need {
            Need::Nothing => None,
            Need::Screen => event.screen.map(|empty| Evidence::Screen { empty }),
            Need::GreyPicture | Need::SmallGreyPicture { .. } => event.grey.map(|_| {
                Evidence::GreyPicture(GreyPicture {
                    size: PictureSize::new(16, 8),
                    pixels: &grey,
                })
            }),
            Need::Detections => found.as_deref().map(Evidence::Detections),
        };
        answered += usize::from(matches!(evidence, Some(Evidence::Detections(_))));
        need = policy.answer(evidence.unwrap_or(Evidence::Unavailable));
        answers += 1;
        assert!(answers <= 3, "too many requests");
    }
    let mut outcome = Outcome::default();
    policy.finish(&mut outcome);
    (Some(outcome), answered)
}

fn check(name: &str, outcome: &Outcome, answered: usize) {
    let state = outcome.state;
    assert_eq!(state.is_skipped(), answered == 0, "{name}: {state}");
    assert!(answered <= 1, "{name}");
    // Every detector call has a cause, and every cause a call.
    let called = answered > 0 || outcome.degraded;
    assert_eq!(
        outcome.cause.is_some(),
        called,
        "{name}: {state} {:?}",
        outcome.cause
    );
    assert!(!outcome.degraded || state == FrameState::P, "{name}");
    for reported in &outcome.boxes {
        assert!(reported.bounding_box.is_finite(), "{name}: {reported:?}");
        assert!(
            (0.0..=1.0).contains(&reported.confidence),
            "{name}: {reported:?}"
        );
        let predicted = matches!(reported.source, BoxSource::Predicted | BoxSource::Followed);
        assert_eq!(predicted, state.is_skipped(), "{name}: {reported:?}");
    }
    if state == FrameState::E {
        assert!(outcome.boxes.is_empty(), "{name}");
    }
}

/// Every policy under every profile, with the threshold `u` if it has one.
fn all_policies(u: f64) -> impl Iterator<Item = PolicyConfig> {
    known_policies().flat_map(move |name| {
        [Profile::Paper, Profile::Reference].map(|profile| PolicyConfig {
            name: name.to_owned(),
            profile,
            u,
            ..PolicyConfig::default()
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn gaps_failures_and_hostile_numbers_leave_every_policy_coherent(script in events()) {
        for config in all_policies(PolicyConfig::default().u) {
            let mut policy = config.build().unwrap();
            let mut index = 0;
            for event in &script {
                if event.reset {
                    policy.reset();
                }
                index += u64::from(event.step);
                let (outcome, answered) = play(&mut *policy, index, event);
                if let Some(outcome) = outcome {
                    check(&config.name, &outcome, answered);
                }
            }
            // After a reset a policy decides like a new one.
            policy.reset();
            let mut fresh = config.build().unwrap();
            for (index, event) in (0u64..).zip(&script) {
                let again = play(&mut *policy, index, event);
                prop_assert_eq!(again, play(&mut *fresh, index, event), "{}", config.name);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn without_pictures_flow_changes_no_bit_of_the_decisions(
        events in events(),
        knob in 0.0..1.0f64,
    ) {
        let names = ["expected-loss", "fixed-skip-in-tracker", "even-skip-in-tracker"];
        for name in names {
            let [mut off, mut flow] =
                ["", "+flow"].map(|suffix| built(&format!("{name}{suffix}"), Profile::Paper));
            let range = off.knob().unwrap();
            let value = range.useful_minimum + knob * (range.useful_maximum - range.useful_minimum);
            off.set_knob(value).unwrap();
            flow.set_knob(value).unwrap();
            let mut index = 0;
            for event in &events {
                let event = Event { given_up: None, grey: None, ..event.clone() };
                index += u64::from(event.step);
                let (without, _) = play(&mut *off, index, &event);
                let (with, _) = play(&mut *flow, index, &event);
                prop_assert_eq!(without, with, "{} at {}", name, value);
            }
        }
    }
}

#[test]
fn a_knob_has_its_configured_value_and_rejects_values_out_of_range() {
    for name in known_policies() {
        let config = PolicyConfig {
            name: name.to_owned(),
            ..PolicyConfig::default()
        };
        let mut policy = config.build().unwrap();
        let Some(knob) = policy.knob() else {
            assert_eq!(policy.knob_value(), None, "{name}");
            assert!(policy.set_knob(1.0).is_err(), "{name}");
            continue;
        };
        assert_eq!(policy.knob_value(), Some(knob.default), "{name}");
        let below = [knob.minimum - 1e-3, -1.0, f64::NEG_INFINITY];
        let above = [knob.maximum * 1.1, f64::INFINITY, f64::NAN];
        for bad in [below, above].concat() {
            assert!(policy.set_knob(bad).is_err(), "{name}: {bad}");
            assert_eq!(policy.knob_value(), Some(knob.default), "{name}");
        }
        for good in [knob.minimum, knob.maximum] {
            policy.set_knob(good).unwrap();
            assert_eq!(policy.knob_value(), Some(good), "{name}");
        }
    }
}
