//! Promises of the advice.

use super::*;
use crate::advise::{Costs, parse_target, render};
use crate::data::{Clip, StoredDetection};
use crate::energy_model::EnergyModel;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Two objects that drift with a speed that changes from clip to clip, in pixels a frame, and one that comes and goes.
fn recording(name: &str, speed: f64, frames: usize) -> Recording {
    let found = |x: f64, y: f64| StoredDetection {
        corners: Corners {
            x1: x,
            y1: y,
            x2: x + 50.0,
            y2: y + 50.0,
        },
        class: ClassId(0),
        confidence: 0.8,
    };
    // There and back, so that nothing leaves the picture; turning is what a filter gets wrong.
    let swing = |frame: usize, phase: f64| {
        let span = 400.0;
        let way = (speed * frame as f64 + phase).rem_euclid(2.0 * span);
        50.0 + way.min(2.0 * span - way)
    };
    let detections = (0..frames)
        .map(|frame| {
            let mut frame_boxes = vec![
                found(swing(frame, 0.0), 50.0),
                found(swing(frame, 130.0), 150.0),
            ];
            if frame % 40 < 25 {
                frame_boxes.push(found(300.0 + (frame % 40) as f64, 300.0));
            }
            frame_boxes
        })
        .collect();
    Recording::from(Clip {
        name: name.to_owned(),
        picture: PictureSize::new(640, 480),
        frame_rate: Some(10.0),
        camera: None,
        frames,
        detections: Some(detections),
        screen: None,
        truth: None,
        pictures: Vec::new(),
        ignored: Vec::new(),
    })
}

fn recordings() -> Vec<Recording> {
    vec![recording("slow", 3.0, 600), recording("fast", 11.0, 600)]
}

fn settings() -> Settings {
    Settings {
        confidence: 0.5,
        longest_empty_run: 100,
        costs: Costs {
            model: Some(EnergyModel::built_in().unwrap()),
            ..Costs::default()
        },
    }
}

fn advice(target: &str) -> Advice {
    let target = parse_target(target).unwrap();
    advise(&recordings(), target, &[], &settings(), &|_| (), &|| ()).unwrap()
}

#[test]
fn a_recall_is_met_by_its_lower_end_and_the_candidate_that_saves_most_is_proposed() {
    let advice = advice("recall=0.8");
    let best = advice.best().expect("it can be met");
    assert!(best.recall.unwrap().low >= 0.8, "{best:?}");
    assert!(best.skip_rate.unwrap().value > 0.1, "{best:?}");
    for other in advice.proposals.iter().filter(|other| other.meets_target) {
        assert!(other.recall.is_none_or(|recall| recall.low >= 0.8));
        assert!(other.energy_saved.unwrap().value <= best.energy_saved.unwrap().value);
    }
    // A stricter one cannot save more.
    let strict = self::advice("recall=0.9");
    let saved = |advice: &Advice| {
        advice
            .best()
            .map_or(0.0, |best| best.skip_rate.unwrap().value)
    };
    assert!(saved(&strict) <= saved(&advice) + 1e-12);
}

#[test]
fn loads_are_met_and_no_more_is_saved_than_they_ask_for() {
    for (target, load) in [("skip_rate=0.5", 0.5), ("skip_rate=0.7", 0.7)] {
        let advice = advice(target);
        let best = advice.best().expect("it can be met");
        let skipped = best.skip_rate.unwrap().value;
        assert!((load..load + 0.08).contains(&skipped), "{target}: {best:?}");
    }
    // 52 ms a frame at 10 frames a second: 300 ms is to skip 42 %.
    let advice = advice("detector_ms_per_s=300");
    let best = advice.best().expect("it can be met");
    assert!(best.detector_ms_per_s.unwrap().value <= 300.0);
    let skipped = best.skip_rate.unwrap().value;
    assert!((0.42..0.5).contains(&skipped), "{skipped}");
}

#[test]
fn what_cannot_be_met_is_said_and_nothing_is_proposed() {
    let advice = advice("watts=0.01");
    assert_eq!(advice.best(), None);
    assert!(
        advice
            .proposals
            .iter()
            .all(|proposal| !proposal.meets_target)
    );
    let text = render(&advice);
    assert!(text.contains("No candidate meets the target"), "{text}");
    assert!(!text.contains("node.toml"), "{text}");
}

#[test]
fn what_a_target_needs_and_nobody_knows_is_asked_for() {
    let mut recordings = recordings();
    for recording in &mut recordings {
        recording.clip.frame_rate = None;
    }
    let asked = |target: &str, settings: &Settings| {
        let target = parse_target(target).unwrap();
        let refused = advise(&recordings, target, &[], settings, &|_| (), &|| ());
        refused.unwrap_err().to_string()
    };
    assert!(asked("watts=3", &settings()).contains("--rate"));
    let mut bare = settings();
    bare.costs = Costs {
        frame_rate: Some(10.0),
        ..Costs::default()
    };
    assert!(asked("watts=3", &bare).contains("--energy-model"));
    assert!(asked("detector_ms_per_s=3", &bare).contains("--detector-ms"));
    let mut sure = settings();
    sure.confidence = 0.9;
    assert!(asked("recall=0.9", &sure).contains("--confidence"));
}

#[test]
fn the_lines_are_a_nodes_configuration_of_that_policy_and_value() {
    #[derive(serde::Deserialize)]
    struct Node {
        policy: PolicyConfig,
    }
    for proposal in advice("skip_rate=0.5").proposals {
        let node: Node = toml::from_str(&proposal.node_toml).unwrap();
        assert_eq!(node.policy.name, proposal.policy);
        let policy = node.policy.build().unwrap();
        assert_eq!(policy.knob_value(), Some(proposal.value));
    }
}

#[test]
fn the_text_fits_and_every_step_is_counted() {
    let target = parse_target("recall=0.8").unwrap();
    let (planned, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let begun = |steps| planned.store(steps, Ordering::Relaxed);
    let step = || {
        done.fetch_add(1, Ordering::Relaxed);
    };
    let advice = advise(&recordings(), target, &[], &settings(), &begun, &step).unwrap();
    let (planned, done) = (planned.into_inner(), done.into_inner());
    assert!(done <= planned && done >= 3 * GRID, "{done} of {planned}");
    let text = render(&advice);
    for line in text.lines() {
        assert!(line.chars().count() <= 100, "{line}");
    }
    for part in [
        "Proposed:",
        "[policy]\nname = ",
        "* ",
        "against the detector",
    ] {
        assert!(text.contains(part), "{part} is missing:\n{text}");
    }
}

#[test]
fn values_have_two_digits_on_the_side_that_meets() {
    for (value, down, up) in [
        (0.3456, 0.34, 0.35),
        (3.141e-4, 3.1e-4, 3.2e-4),
        (0.3, 0.3, 0.3),
        (0.069_999_999_999_9, 0.07, 0.07),
        (12.7, 12.0, 13.0),
    ] {
        assert_eq!(two_digits(value, false), down);
        assert_eq!(two_digits(value, true), up);
    }
}
