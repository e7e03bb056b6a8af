use super::*;
use crate::detection::Detection;
use crate::policy::config::known_policies;
use crate::policy::tests::{Run, built, detection, head, seen};
use crate::policy::{
    Albireo, AlbireoSettings, FrameEvidence, FrameState, LatePolicy, PolicyConfig, Profile,
};
use proptest::prelude::*;

const PAUSE: PauseFrames = PauseFrames {
    every: 3,
    after: 4,
    ..PauseFrames::OFF
};

fn paused(asked: &str, pause: PauseFrames) -> Run<WithPause> {
    let policy = WithPause::new(built(asked, Profile::Paper), pause);
    Run::with(Box::new(policy))
}

/// The states of frames without a screen model in which the detector, if called, finds `found`, joined by spaces.
fn states(run: &mut Run<WithPause>, frames: usize, found: &[Detection]) -> String {
    let mut states = Vec::new();
    for _ in 0..frames {
        states.push(run.frame(1, FrameEvidence::detections(found)).as_str());
    }
    states.join(" ")
}

#[test]
fn on_an_empty_road_one_frame_in_n_is_looked_at_and_says_so() {
    for name in ["albireo", "erd-only", "kill+erd"] {
        let mut run = paused(name, PAUSE);
        run.frame(1, FrameEvidence::detections(&[]));
        let cause = Some(CallCause::NoObjects);
        assert_eq!(run.outcome.cause, cause, "{name}");
        assert_eq!(states(&mut run, 9, &[]), "I I I E E I E E I", "{name}");
        let cause = Some(CallCause::EmptyRoad);
        assert_eq!(run.outcome.cause, cause, "{name}");
        assert_eq!(states(&mut run, 1, &[]), "E", "{name}");
        assert_eq!(
            run.outcome,
            Outcome {
                state: FrameState::E,
                passed: Some(PassCause::EmptyRoad),
                ..Outcome::default()
            }
        );
    }
}

#[test]
fn a_find_ends_the_pause_and_so_does_an_object_that_is_not_confirmed_yet() {
    let mut run = paused("albireo", PAUSE);
    assert_eq!(states(&mut run, 6, &[]), "I I I I E E");
    let car = [seen(0.5, 0.9)];
    assert_eq!(states(&mut run, 1, &car), "I");
    assert_eq!(run.outcome.cause, Some(CallCause::EmptyRoad));
    assert!(!run.outcome.boxes[0].confirmed);
    // The object is lost at once: the road is empty only after some looks.
    assert_eq!(states(&mut run, 6, &[]), "I I I I E E");
    run.policy.reset();
    assert_eq!(states(&mut run, 5, &[]), "I I I I E");
}

#[test]
fn lost_frames_are_time_and_a_failed_look_is_repeated() {
    let mut run = paused("albireo", PAUSE);
    assert_eq!(states(&mut run, 5, &[]), "I I I I E");
    let none = FrameEvidence::detections(&[]);
    assert_eq!(run.frame(7, none), FrameState::I);
    assert_eq!(states(&mut run, 2, &[]), "E E");
    for _ in 0..2 {
        assert_eq!(run.blind(), FrameState::P);
        assert!(run.outcome.degraded);
        assert_eq!(run.outcome.cause, Some(CallCause::EmptyRoad));
    }
    assert_eq!(states(&mut run, 3, &[]), "I E E");
    // Time alone is no look: nobody has seen that the road is empty.
    let mut run = paused("albireo", PAUSE);
    run.frame(1, FrameEvidence::detections(&[seen(0.5, 0.9)]));
    assert_eq!(run.frame(5000, none), FrameState::I);
    assert_eq!(states(&mut run, 1, &[]), "E");
}

#[test]
fn the_pause_comes_before_a_screen_model_and_its_verdict_is_a_look() {
    let mut run = paused("albireo", PAUSE);
    let empty = FrameEvidence {
        empty: Some(true),
        ..FrameEvidence::default()
    };
    let mut asked = Vec::new();
    for _ in 0..10 {
        assert_eq!(run.frame(1, empty), FrameState::E);
        asked.push(run.needs.len());
    }
    assert_eq!(asked, [1, 1, 1, 1, 0, 0, 1, 0, 0, 1]);
    run.frame(2, empty);
    let in_view = FrameEvidence::in_view(&[]);
    assert_eq!(run.frame(1, in_view), FrameState::EI);
    assert_eq!(run.outcome.cause, Some(CallCause::Screen));
}

#[test]
fn the_pause_can_be_changed_between_frames() {
    let mut run = paused("albireo", PauseFrames::OFF);
    assert_eq!(states(&mut run, 6, &[]), "I I I I I I");
    run.policy.set_pause(PAUSE);
    assert_eq!(states(&mut run, 4, &[]), "E E I E");
    run.policy.set_pause(PauseFrames::OFF);
    assert_eq!(states(&mut run, 2, &[]), "I I");
}

#[test]
fn seconds_are_rounded_to_frames_by_the_rate_and_mean_nothing_without_one() {
    let road = |pause_s, after_s| EmptyRoad {
        pause_s,
        after_s,
        still_s: 0.0,
    };
    for (road, rate, every, after) in [
        (road(0.4, 0.3), 5.0, 2, 2),
        (road(0.39, 0.3), 5.0, 1, 2),
        (road(0.12, 0.32), 25.0, 3, 8),
        // A measured rate is never exact.
        (road(0.12, 0.32), 24.8, 3, 8),
        (road(0.12, 0.32), 25.2, 3, 8),
        (road(0.15, 0.32), 25.0, 3, 8),
        (road(0.0, 0.0), 30.0, 0, 0),
        (road(60.0, 3600.0), 1e9, u32::MAX, u32::MAX),
    ] {
        let frames = PauseFrames {
            every,
            after,
            still: 0,
            second: (rate / 1.02_f64).ceil() as u32,
        };
        assert_eq!(road.frames(Some(rate)), frames, "{road:?} at {rate}");
    }
    for rate in [
        None,
        Some(0.0),
        Some(-1.0),
        Some(f64::NAN),
        Some(f64::INFINITY),
    ] {
        assert_eq!(road(1.0, 0.0).frames(rate), PauseFrames::OFF);
    }
    assert_eq!(EmptyRoad::default().frames(Some(25.0)).every, 0);
    for (wrong, key) in [
        (road(-0.1, 0.3), "pause_s"),
        (road(61.0, 0.3), "pause_s"),
        (road(f64::NAN, 0.3), "pause_s"),
        (road(0.1, -1.0), "after_s"),
        (road(0.1, f64::INFINITY), "after_s"),
    ] {
        assert_eq!(wrong.problem().map(|(key, _)| key), Some(key), "{wrong:?}");
    }
    assert_eq!(EmptyRoad::default().problem(), None);
}

#[test]
fn a_pause_changes_no_policy_that_does_not_call_whenever_nothing_is_tracked() {
    for name in known_policies() {
        let can = matches!(name, "albireo" | "erd-only" | "kill+erd" | "kill+erd-10d");
        let mut policy = built(name, Profile::Paper);
        assert_eq!(policy.takes_pause(), can, "{name}");
        // What the method says is what the policy does.
        let mut need = policy.begin(head(0));
        let asks_screen = need == Need::Screen;
        while need != Need::Nothing {
            need = policy.answer(Evidence::Unavailable);
        }
        let mut outcome = Outcome::default();
        policy.finish(&mut outcome);
        let asks = asks_screen && outcome.cause == Some(CallCause::NoObjects);
        assert_eq!(asks, can, "{name}");
    }
    let mut run = paused("expected-loss:0", PAUSE);
    assert_eq!(states(&mut run, 8, &[]), "I I I I I I I I");
}

/// Answers at once, with looks that arrive `delay` frames later; returns the final state of every frame.
fn late_states(delay: u64, frames: u64) -> Vec<FrameState> {
    let mut late = LatePolicy::new(built("albireo", Profile::Paper)).unwrap();
    late.set_pause(PAUSE);
    let mut outcome = Outcome::default();
    let mut states = Vec::new();
    let mut look = None;
    for index in 0..frames {
        let need = late.frame(head(index), &mut outcome);
        assert!(outcome.state.is_skipped() && !outcome.degraded && outcome.cause.is_none());
        states.push(outcome.state);
        if look.is_none() && need != Need::Nothing {
            look = Some(index);
        }
        if let Some(frame) = look
            && frame + delay == index
        {
            assert_eq!(
                late.deliver(frame, Evidence::Unavailable, &mut outcome),
                Ok(Need::Detections)
            );
            assert_eq!(
                late.deliver(frame, Evidence::Detections(&[]), &mut outcome),
                Ok(Need::Nothing)
            );
            states[frame as usize] = outcome.state;
            look = None;
        }
    }
    states
}

#[test]
fn answers_at_once_have_the_pause_too_counted_from_the_frame_that_was_looked_at() {
    use FrameState::{E, I, P};
    assert_eq!(late_states(0, 10), [I, I, I, I, E, E, I, E, E, I]);
    // The look at frame 5 arrives with frame 6; frame 7 is the second since then.
    assert_eq!(late_states(1, 11), [I, P, I, P, E, I, P, E, I, P, E]);
}

#[derive(Clone, Debug)]
struct Event {
    step: u32,
    screen: Option<bool>,
    detections: Option<Vec<Detection>>,
    pause: PauseFrames,
}

prop_compose! {
    fn event()(
        step in prop_oneof![8 => Just(1u32), 2 => 2..6u32, 1 => Just(u32::MAX)],
        screen in prop::option::weighted(0.2, any::<bool>()),
        detections in prop::option::weighted(0.9, prop_oneof![
            5 => Just(Vec::new()),
            1 => prop::collection::vec(detection(), 1..3),
        ]),
        every in 0..6u32,
        after in 0..6u32,
    ) -> Event {
        Event { step, screen, detections, pause: PauseFrames { every, after, ..PauseFrames::OFF } }
    }
}

impl Event {
    fn known(&self) -> FrameEvidence<'_> {
        FrameEvidence {
            empty: self.screen,
            grey: None,
            detections: self.detections.as_deref(),
        }
    }
}

#[derive(Clone, Copy)]
struct Look {
    frames_ago: u64,
    found: bool,
}

/// The definition, from the whole history: the latest looks, newest first, and the frames since the start.
fn passes(history: &[Look], start: u64, pause: PauseFrames) -> bool {
    let last_find = history.iter().find(|look| look.found);
    let since_find = last_find.map_or(start, |look| look.frames_ago);
    let last_look = history.first();
    let since_look = last_look.map_or(start, |look| look.frames_ago);
    let was_empty = last_look.is_some_and(|look| !look.found);
    was_empty && since_find > u64::from(pause.after) && since_look < u64::from(pause.every)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn a_frame_is_passed_over_exactly_by_the_definition(script in prop::collection::vec(event(), 1..80)) {
        let mut run = paused("albireo", PauseFrames::OFF);
        let mut plain = Albireo::new(AlbireoSettings::paper(), 3e-4).unwrap();
        let mut history: Vec<Look> = Vec::new();
        let mut start = 0;
        for event in &script {
            run.policy.set_pause(event.pause);
            start += u64::from(event.step);
            for look in &mut history {
                look.frames_ago += u64::from(event.step);
            }
            run.frame(event.step, event.known());
            // The same policy without a pause, in the same state: does it ask a screen?
            let index = run.index - 1;
            let mut need = plain.begin(FrameHead { index, step: event.step, ..head(0) });
            let passed = need == Need::Screen && passes(&history, start, event.pause);
            prop_assert_eq!(run.needs.is_empty() && run.outcome.state == FrameState::E, passed);
            let mut known = event.known();
            if passed {
                known = FrameEvidence { empty: Some(true), ..known };
            }
            while need != Need::Nothing {
                let Ok(evidence) = crate::policy::EvidenceAtHand::evidence(&mut known, need);
                let found = match evidence {
                    Evidence::Screen { empty: true } if !passed => Some(false),
                    Evidence::Detections(found) => Some(!found.is_empty()),
                    _ => None,
                };
                if let Some(found) = found {
                    history.insert(0, Look { frames_ago: 0, found });
                }
                need = plain.answer(evidence);
            }
            let mut outcome = Outcome::default();
            plain.finish(&mut outcome);
            outcome.passed = run.outcome.passed;
            prop_assert_eq!(outcome.passed, passed.then_some(PassCause::EmptyRoad));
            if run.outcome.cause == Some(CallCause::EmptyRoad) {
                outcome.cause = Some(CallCause::EmptyRoad);
            }
            prop_assert_eq!(&run.outcome, &outcome);
        }
    }

    #[test]
    fn without_a_pause_no_bit_changes(script in prop::collection::vec(event(), 1..60), every in 0..2u32) {
        for name in known_policies() {
            let config = PolicyConfig { name: name.to_owned(), ..PolicyConfig::default() };
            let off = PauseFrames { every, ..PauseFrames::OFF };
            let mut with = Run::with(Box::new(WithPause::new(config.build().unwrap(), off)));
            let mut without = Run::with(config.build().unwrap());
            for event in &script {
                with.frame(event.step, event.known());
                without.frame(event.step, event.known());
                prop_assert_eq!(&with.outcome, &without.outcome, "{}", name);
                prop_assert_eq!(&with.needs, &without.needs, "{}", name);
                prop_assert_eq!(with.records(), without.records(), "{}", name);
            }
        }
    }
}
