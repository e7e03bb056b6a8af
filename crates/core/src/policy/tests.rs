//! The promises that every policy keeps under any sequence of events.

mod camera;

pub(crate) use camera::{PICTURE, random, seen};
pub(super) use camera::{Run, built, head, records, ride, textured, useful};

use super::config::known_policies;
use super::*;
use proptest::prelude::*;

#[derive(Clone, Debug)]
struct Event {
    step: u32,
    /// Abandoned after this many answers.
    given_up: Option<usize>,
    picture: PictureSize,
    screen: Option<bool>,
    grey: Option<u8>,
    detections: Option<Vec<Detection>>,
    reset: bool,
}

prop_compose! {
    pub(super) fn detection()(
        x in 0.0..1.0,
        y in 0.2..0.8,
        confidence in 0.5..1.0,
        hostile in prop::bool::weighted(0.05),
    ) -> Detection {
        Detection {
            bounding_box: BoundingBox::new(x, y, if hostile { f64::NAN } else { 0.2 }, 0.2),
            ..seen(x, confidence)
        }
    }
}

prop_compose! {
    fn event()(
        step in prop_oneof![8 => Just(1u32), 2 => 2..12u32, 1 => Just(5000u32)],
        given_up in prop::option::weighted(0.05, 0..3usize),
        picture in prop_oneof![19 => Just(PICTURE), 1 => Just(PictureSize::new(64, 36))],
        screen in prop::option::weighted(0.8, any::<bool>()),
        grey in prop::option::weighted(0.8, prop_oneof![Just(0u8), Just(200u8)]),
        detections in prop::option::weighted(0.8, prop::collection::vec(detection(), 0..4)),
        reset in prop::bool::weighted(0.02),
    ) -> Event {
        Event { step, given_up, picture, screen, grey, detections, reset }
    }
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    prop::collection::vec(event(), 1..60)
}

/// Plays one frame; returns how often the detector answered, unless the frame was abandoned.
fn play(run: &mut Run, event: &Event) -> Option<usize> {
    run.picture = event.picture;
    let pixels = [event.grey.unwrap_or_default(); 128];
    let known = FrameEvidence {
        empty: event.screen,
        grey: event.grey.map(|_| GreyPicture {
            size: PictureSize::new(16, 8),
            pixels: &pixels,
        }),
        detections: event.detections.as_deref(),
    };
    let most = event.given_up.unwrap_or(usize::MAX);
    let finished = run.frame_within(most, event.step, known);
    let asked = run.needs.iter().filter(|need| **need == Need::Detections).count();
    let answered = usize::from(event.detections.is_some()) * asked;
    finished.then_some(answered)
}

fn check(name: &str, outcome: &Outcome, answered: usize) {
    let state = outcome.state;
    assert_eq!(state.is_skipped(), answered == 0, "{name}: {state}");
    assert!(answered <= 1, "{name}");
    // Every detector call has a cause, and every cause a call.
    let called = answered > 0 || outcome.degraded;
    let cause = outcome.cause;
    assert_eq!(cause.is_some(), called, "{name}: {state} {cause:?}");
    assert!(!outcome.degraded || state == FrameState::P, "{name}");
    for reported in &outcome.boxes {
        assert!(reported.bounding_box.is_finite(), "{name}: {reported:?}");
        let is_share = (0.0..=1.0).contains(&reported.confidence);
        assert!(is_share, "{name}: {reported:?}");
        let predicted = matches!(reported.source, BoxSource::Predicted | BoxSource::Followed);
        assert_eq!(predicted, state.is_skipped(), "{name}: {reported:?}");
    }
    if state == FrameState::E {
        assert!(outcome.boxes.is_empty(), "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn gaps_failures_and_hostile_numbers_leave_every_policy_coherent(
        script in events(),
        share in 0.0..1.0f64,
    ) {
        for name in known_policies() {
            for profile in [Profile::Paper, Profile::Reference] {
                let mut config = PolicyConfig { name: name.to_owned(), profile, ..PolicyConfig::default() };
                let mut run = Run::with(config.build().unwrap());
                for event in &script {
                    if event.reset {
                        run.policy.reset();
                    }
                    if let Some(answered) = play(&mut run, event) {
                        check(name, &run.outcome, answered);
                    }
                }
                // After a reset a policy decides like a new one with its threshold.
                let mut again = Run::with(run.policy);
                if let Some(spec) = again.policy.threshold_spec() {
                    let value = useful(spec, share);
                    again.policy.set_threshold(value).unwrap();
                    config.set_argument(&value.to_string()).unwrap();
                }
                again.policy.reset();
                let mut fresh = Run::with(config.build().unwrap());
                for event in &script {
                    prop_assert_eq!(play(&mut again, event), play(&mut fresh, event), "{}", name);
                    prop_assert_eq!(&again.outcome, &fresh.outcome, "{}", name);
                    prop_assert_eq!(again.records(), fresh.records(), "{}", name);
                }
            }
        }
    }

    #[test]
    fn without_pictures_flow_changes_no_bit_of_the_decisions(
        events in events(),
        share in 0.0..1.0f64,
    ) {
        let names = ["expected-loss", "fixed-skip-in-tracker", "even-skip-in-tracker"];
        for name in names {
            let mut off = Run::new(name, Profile::Paper);
            let mut flow = Run::new(&format!("{name}+flow"), Profile::Paper);
            let value = useful(off.policy.threshold_spec().unwrap(), share);
            off.policy.set_threshold(value).unwrap();
            flow.policy.set_threshold(value).unwrap();
            for event in &events {
                let event = Event { given_up: None, grey: None, ..event.clone() };
                play(&mut off, &event);
                play(&mut flow, &event);
                prop_assert_eq!(&off.outcome, &flow.outcome, "{} at {}", name, value);
            }
        }
    }
}

#[test]
fn a_threshold_has_its_configured_value_and_rejects_values_out_of_range() {
    for name in known_policies() {
        let mut config = PolicyConfig::default();
        config.select(name).unwrap();
        let mut policy = config.build().unwrap();
        assert_eq!(policy.name(), name);
        let Some(spec) = policy.threshold_spec() else {
            assert_eq!(policy.threshold(), None, "{name}");
            assert!(policy.set_threshold(1.0).is_err(), "{name}");
            continue;
        };
        assert_eq!(policy.threshold(), Some(spec.default), "{name}");
        // It fits into a message.
        assert!(spec.name.len() <= 24, "{name}: {}", spec.name);
        let below = [spec.minimum - 1e-3, -1.0, f64::NEG_INFINITY];
        let above = [spec.maximum * 1.1, f64::INFINITY, f64::NAN];
        for bad in [below, above].concat() {
            assert!(policy.set_threshold(bad).is_err(), "{name}: {bad}");
            assert_eq!(policy.threshold(), Some(spec.default), "{name}");
            config.set_argument(&bad.to_string()).unwrap();
            assert!(config.build().is_err(), "{name}: {bad}");
        }
        for good in [spec.minimum, spec.maximum] {
            policy.set_threshold(good).unwrap();
            let selected = built(&format!("{name}:{good:e}"), Profile::Paper);
            for policy in [&policy, &selected] {
                assert_eq!((policy.name(), policy.threshold()), (name, Some(good)));
            }
        }
    }
}

#[test]
fn policies_without_objects_report_the_usable_detections_unchanged() {
    let found = [0.1, f64::NAN, 0.2].map(|x| seen(x, 0.9));
    let usable = [0.1, 0.2].map(|x| (BoxSource::Detected, x, 0.9));
    let detections = &[Need::Detections][..];
    let screened = &[Need::Screen, Need::Detections];
    for (name, state, needs, cause) in [
        ("vanilla", FrameState::I, detections, CallCause::EveryFrame),
        ("erd-only", FrameState::EI, screened, CallCause::Screen),
    ] {
        let mut run = Run::new(name, Profile::Paper);
        for _ in 0..3 {
            assert_eq!(run.see(&found), state, "{name}");
            assert_eq!(run.needs, needs, "{name}");
            assert_eq!(run.outcome.cause, Some(cause), "{name}");
            assert_eq!(run.reported(), usable, "{name}");
            assert!(!run.outcome.degraded, "{name}");
        }
        assert_eq!(run.policy.rejected_detections(), 3, "{name}");
    }
}

#[test]
fn a_frame_without_the_detector_is_predicted_and_the_next_one_asks_again() {
    let all = "vanilla erd-only statues fixed-skip ctd:0.5 albireo kill-only expected-loss:0 even-skip-in-tracker";
    for asked in all.split(' ') {
        let boxes = usize::from(!matches!(asked, "vanilla" | "erd-only"));
        for profile in [Profile::Paper, Profile::Reference] {
            let what = format!("{asked} {profile:?}");
            let found = [seen(0.5, 0.9)];
            let mut run = Run::new(asked, profile);
            for _ in 0..10 {
                run.see(&found);
            }
            let mut waited = 0;
            while !run.outcome.degraded {
                run.blind();
                waited += 1;
                assert!(waited < 20, "{what} never asks the detector");
            }
            let counts = |record: &ObjectRecord| (record.id, record.misses, record.since_update);
            let before: Vec<_> = run.records().iter().map(counts).collect();
            for blind in 1..3 {
                assert_eq!(run.blind(), FrameState::P, "{what}");
                assert!(run.outcome.degraded, "{what}");
                assert_eq!(run.outcome.boxes.len(), boxes, "{what}");
                // No miss is counted.
                let since = before.iter().map(|&(id, misses, since)| (id, misses, since + blind));
                let records = run.records();
                assert!(records.iter().map(counts).eq(since), "{what}: {records:?}");
            }
            assert!(!run.see(&found).is_skipped(), "{what}");
            assert!(!run.outcome.degraded, "{what}");
            let seen_again = before.iter().map(|&(id, misses, _)| (id, misses, 0));
            let records = run.records();
            assert!(
                records.iter().map(counts).eq(seen_again),
                "{what}: {records:?}"
            );
        }
    }
}

#[test]
fn an_empty_scene_skips_the_detector_and_without_the_screen_it_runs() {
    let found = [seen(0.5, 0.9)];
    let in_view = FrameEvidence::in_view(&found);
    let unscreened = FrameEvidence::detections(&found);
    let empty = FrameEvidence {
        empty: Some(true),
        ..unscreened
    };
    for (name, cause) in [
        ("albireo", CallCause::NoObjects),
        ("kill+erd", CallCause::NoObjects),
        ("kill+erd-10d", CallCause::NoObjects),
        ("erd-only", CallCause::NoObjects),
        ("expected-loss", CallCause::Start),
    ] {
        let mut run = Run::new(name, Profile::Paper);
        for _ in 0..40 {
            assert_eq!(run.frame(1, empty), FrameState::E, "{name}");
            assert_eq!(run.needs, [Need::Screen], "{name}");
            let outcome = Outcome {
                state: FrameState::E,
                ..Outcome::default()
            };
            assert_eq!(run.outcome, outcome, "{name}");
        }
        for (known, state, cause) in [
            (in_view, FrameState::EI, CallCause::Screen),
            (unscreened, FrameState::I, cause),
        ] {
            run.policy.reset();
            assert_eq!(run.frame(1, known), state, "{name}");
            assert_eq!(run.needs, [Need::Screen, Need::Detections], "{name}");
            assert_eq!(run.outcome.cause, Some(cause), "{name}");
            assert_eq!(run.outcome.boxes.len(), 1, "{name}");
        }
    }
    let mut run = Run::new("kill-only", Profile::Paper);
    assert_eq!(run.frame(1, empty), FrameState::I);
    assert_eq!(run.needs, [Need::Detections]);
}

/// The frames on which `asked`, with an object in view, calls the detector: while another camera runs it on every frame
/// and calls within `share` of the threshold join.
fn calls_joining(asked: &str, share: f64) -> Vec<(u64, CallCause)> {
    let mut run = Run::new(asked, Profile::Paper);
    run.policy.set_join(share);
    let mut calls = Vec::new();
    for index in 0..40 {
        run.see(&[seen(0.5, 0.9)]);
        if let Some(cause) = run.outcome.cause {
            calls.push((index, cause));
        }
    }
    calls
}

#[test]
fn a_call_that_is_near_joins_a_run_and_is_told_from_one_that_is_due() {
    for asked in ["albireo:3e-3", "expected-loss:1", "expected-loss+flow:1"] {
        let joined = |share| {
            let calls = calls_joining(asked, share);
            calls.into_iter().filter(|(_, cause)| *cause == CallCause::Joined).count()
        };
        assert_eq!(joined(0.0), 0, "{asked}");
        assert!(joined(0.5) > 0, "{asked}");
        let (own, near) = (
            calls_joining(asked, 0.0).len(),
            calls_joining(asked, 0.5).len(),
        );
        assert!(near > own, "{asked}: {near} calls, without joining {own}");
    }
}

#[test]
fn a_policy_that_weighs_no_calls_joins_none() {
    for asked in known_policies() {
        let weighs =
            ["albireo", "kill", "expected-loss"].iter().any(|name| asked.starts_with(name));
        if !weighs {
            assert_eq!(
                calls_joining(asked, 0.9),
                calls_joining(asked, 0.0),
                "{asked}"
            );
        }
    }
}

#[test]
fn an_empty_scene_joins_no_run() {
    for asked in ["albireo", "expected-loss:100"] {
        let mut run = Run::new(asked, Profile::Paper);
        run.see(&[]);
        run.policy.set_join(0.9);
        for _ in 0..5 {
            let empty = FrameEvidence {
                empty: Some(true),
                ..FrameEvidence::default()
            };
            assert!(run.frame(1, empty).is_skipped(), "{asked}");
            assert_eq!(run.outcome.cause, None, "{asked}");
        }
    }
}
