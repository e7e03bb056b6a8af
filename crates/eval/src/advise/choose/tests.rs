//! The advice meets its target and can be used as it is.

use super::*;
use crate::advise::render;
use crate::judge::average_precision::tests::{scored, square};
use crate::text::WIDTH;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::Albireo;

/// Two objects that drift by `speed` pixels per frame, and one that comes and goes.
fn recording(name: &str, speed: f64, frames: usize) -> Clip {
    let found = |x: f64, y: f64| scored(square(x, y, 50.0), 0.8);
    // Back and forth, so that nothing leaves the picture; a filter errs at the turns.
    let swing = |frame: usize, phase: f64| {
        let way = (speed * frame as f64 + phase).rem_euclid(800.0);
        50.0 + way.min(800.0 - way)
    };
    let boxes = |frame: usize| {
        let mut boxes = vec![
            found(swing(frame, 0.0), 50.0),
            found(swing(frame, 130.0), 150.0),
        ];
        let since = frame % 40;
        if since < 25 {
            boxes.push(found(300.0 + since as f64, 300.0));
        }
        boxes
    };
    Clip {
        frame_rate: Some(10.0),
        detections: Some((0..frames).map(boxes).collect()),
        ..Clip::new(name.to_owned(), PictureSize::new(640, 480), frames)
    }
}

fn recordings() -> Vec<Clip> {
    vec![recording("slow", 3.0, 600), recording("fast", 11.0, 600)]
}

/// A least precision that every value has.
const ANY_PRECISION: f64 = 0.0;

fn advice(policy: &str, target: &str) -> Advice {
    let target = target.parse().unwrap();
    advise(
        &recordings(),
        target,
        ANY_PRECISION,
        policy,
        &Settings::default(),
    )
    .unwrap()
}

#[test]
fn a_recall_is_met_by_its_lower_bound() {
    let advice = advice("expected-loss", "recall=0.8");
    let best = advice.best().expect("it can be met");
    assert!(best.recall.unwrap().low >= 0.8, "{best:?}");
    assert!(best.skip_rate.unwrap().value > 0.1, "{best:?}");
}

#[test]
fn a_stricter_recall_saves_no_more() {
    let rate = |best: &Proposal| best.skip_rate.unwrap().value;
    let saved = |target: &str| advice("expected-loss", target).best().map_or(0.0, rate);
    let loose = saved("recall=0.8");
    let strict = saved("recall=0.9");
    assert!(strict <= loose + 1e-12, "{strict} and {loose}");
}

#[test]
fn the_text_proposes_the_best_value_in_lines_that_fit() {
    let text = render(&advice("expected-loss", "recall=0.8"), WIDTH);
    let fits = |line: &str| line.chars().count() <= WIDTH;
    assert!(text.lines().all(fits), "{text}");
    let policy = "[policy]\nname = ";
    for part in ["Proposed:", policy, "* ", "against the detector"] {
        assert!(text.contains(part), "{part} is missing:\n{text}");
    }
}

#[test]
fn a_skip_rate_is_met_and_not_exceeded() {
    for (target, asked) in [("skip_rate=0.5", 0.5), ("skip_rate=0.7", 0.7)] {
        let advice = advice("even-skip-in-tracker", target);
        let best = advice.best().expect("it can be met");
        let skipped = best.skip_rate.unwrap().value;
        let range = asked..asked + 0.08;
        assert!(range.contains(&skipped), "{target}: {best:?}");
    }
}

#[test]
fn a_policy_whose_lower_threshold_skips_more_is_advised_like_the_others() {
    for (target, asked) in [("skip_rate=0.2", 0.2), ("skip_rate=0.4", 0.4)] {
        let advice = advice("ctd", target);
        let best = advice.best().expect("it can be met");
        let skipped = best.skip_rate.unwrap().value;
        let range = asked..asked + 0.15;
        assert!(range.contains(&skipped), "{target}: {best:?}");
    }
    let value = |target: &str| advice("ctd", target).proposals[0].value;
    let careful = value("recall=0.999");
    let bold = value("recall=0.5");
    assert!(careful > bold, "{careful} and {bold}");
}

#[test]
fn a_skip_rate_without_the_precision_is_answered_with_the_value_that_reaches_it() {
    let target = "skip_rate=0.5".parse().unwrap();
    let out_of_reach = 0.9999;
    let policy = "even-skip-in-tracker";
    let advice = advise(
        &recordings(),
        target,
        out_of_reach,
        policy,
        &Settings::default(),
    )
    .unwrap();
    assert!(advice.best().is_none());
    let skipped = advice.proposals[0].skip_rate.unwrap().value;
    assert!((0.5..0.58).contains(&skipped), "{skipped}");
}

#[test]
fn a_recorded_screen_is_tried_as_well_as_none() {
    let mut clips = recordings();
    assert_eq!(advice("albireo", "skip_rate=0.1").proposals.len(), 1);
    for clip in &mut clips {
        let boxes = clip.detections.iter().flatten();
        clip.screen = Some(boxes.map(|boxes| Some(boxes.is_empty())).collect());
    }
    let target = "skip_rate=0.1".parse().unwrap();
    let advice = advise(
        &clips,
        target,
        ANY_PRECISION,
        "albireo",
        &Settings::default(),
    )
    .unwrap();
    let screens: Vec<_> = advice.proposals.iter().map(|found| found.screen).collect();
    assert_eq!(screens.len(), 2);
    assert!(screens.contains(&ScreenRule::Recorded));
    assert!(screens.contains(&ScreenRule::Nonempty));
}

#[test]
fn an_unreachable_target_is_reported_without_a_proposal() {
    let advice = advice("albireo", "skip_rate=0.999");
    assert_eq!(advice.best(), None);
    let text = render(&advice, WIDTH);
    assert!(text.contains("No value meets the target"), "{text}");
    assert!(!text.contains("node.toml"), "{text}");
}

/// The reason why there is no advice.
fn refusal(policy: &str, settings: &Settings) -> String {
    let target = Target::Recall(0.9);
    advise(&recordings(), target, ANY_PRECISION, policy, settings)
        .unwrap_err()
        .to_string()
}

#[test]
fn a_recording_without_boxes_at_the_confidence_is_rejected() {
    let sure = Settings {
        confidence: 0.9,
        ..Settings::default()
    };
    let reason = refusal("albireo", &sure);
    assert!(reason.contains("--confidence"), "{reason}");
}

#[test]
fn a_policy_that_is_unknown_or_has_no_threshold_is_rejected() {
    for (policy, expected) in [
        ("vanilla", "no threshold"),
        ("albiro", "no policy `albiro`"),
    ] {
        let reason = refusal(policy, &Settings::default());
        assert!(reason.contains(expected), "{reason}");
    }
}

#[test]
fn the_proposed_lines_are_a_valid_node_configuration() {
    #[derive(serde::Deserialize)]
    struct Node {
        policy: PolicyConfig,
    }
    for policy in ["albireo", "expected-loss", "even-skip-in-tracker"] {
        for proposal in advice(policy, "skip_rate=0.3").proposals {
            let node: Node = toml::from_str(&proposal.node_toml).unwrap();
            assert_eq!(node.policy.name, policy);
            let built = node.policy.build().unwrap();
            assert_eq!(built.threshold(), Some(proposal.value));
        }
    }
}

#[test]
fn values_have_two_digits_and_stay_where_a_controller_would() {
    for (policy, spec, lowest, highest) in [
        (ExpectedLoss::NAME, ExpectedLoss::THRESHOLD, 0.05, 1.2),
        ("albireo", Albireo::THRESHOLD, 1.5e-4, 2e-3),
    ] {
        let values = values(policy, &spec);
        assert!(values.is_sorted(), "{values:?}");
        assert!(values.len() > VALUES / 2, "{values:?}");
        assert_eq!(values.first(), Some(&lowest));
        assert_eq!(values.last(), Some(&highest));
        for value in values {
            assert_eq!(format!("{value:.1e}").parse(), Ok(value));
        }
    }
}

/// The advice on one clip for a least precision.
fn precise(least: f64) -> Advice {
    let target = Target::Recall(0.5);
    let clips = &recordings()[..1];
    advise(clips, target, least, "expected-loss", &Settings::default()).unwrap()
}

#[test]
fn a_value_must_also_have_the_precision() {
    let loose = precise(ANY_PRECISION);
    let found = loose.best().expect("it can be met").precision.unwrap();
    // A little more than it has: another value, or none.
    let strict = precise(found.low + 1e-6);
    assert!(strict.best().is_none_or(|best| best.precision.unwrap().low > found.low));
    assert_ne!(strict.best(), loose.best());
}

#[test]
fn the_text_names_the_precision_that_no_value_has() {
    let text = render(&precise(0.9999), WIDTH);
    for part in ["--precision", "precision of at least 0.9999"] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn few_clips_are_called_few() {
    let text = render(&precise(ANY_PRECISION), WIDTH);
    assert!(text.contains("Only 1 clip of 600"), "{text}");
}

#[test]
fn the_text_of_a_target_that_is_not_met_fits_a_narrow_terminal() {
    let text = render(&precise(0.9999), 60);
    for line in text.lines() {
        assert!(line.chars().count() <= 60, "{line}");
    }
}
