//! The frames whose cost must not grow unseen, for a count of their instructions by `benches/counted.sh`:
//!
//! ```text
//! counted CASE OBJECTS LAPS
//! ```
//!
//! A case is a policy and what it does: `albireo/detector`, `albireo-reference/detector` (the profile `reference`) and
//! `expected-loss/detector` match detections to objects, `albireo/predicted` predicts all, and `albireo/answered` is what a
//! node does about a predicted frame but for the ring and Zenoh: its attachment is read, the frame predicted, and the answer
//! written. A lap has [`LAP`] frames. Runs of one case differ by whole laps, so the difference of their counts is free of
//! start and set-up.

#![allow(clippy::expect_used, clippy::print_stdout)]

use albireo_core::policy::{
    Albireo, AlbireoSettings, ExpectedLoss, ExpectedLossSettings, Outcome, Policy, Profile, Trigger,
};
use albireo_scene::{Camera, PICTURE, Scene};
use albireo_wire::{
    DetectionsMessage, FrameAttachment, Latency, VERSION, box_messages, significant,
};
use std::hint::black_box;

/// The frames of a film; a lap is the film forwards and backwards, so that it has no cut.
const FILM: usize = 50;
const LAP: usize = 2 * FILM;
/// Few enough predicted frames in a row that no uncertainty reaches the highest threshold.
const IN_A_ROW: usize = 10;

fn albireo(settings: AlbireoSettings) -> Albireo {
    Albireo::new(settings, 1e-9).expect("the settings can be used")
}

/// Plays `laps` laps to a policy that calls the detector on each frame, which misses 1 object in 20.
fn detector_frames(policy: impl Policy, objects: usize, laps: usize) {
    let mut camera = Camera::new(policy);
    let film = Scene::new(objects).film(FILM, objects / 20);
    // The first lap is part of the set-up: buffers grow in it.
    for _ in 0..=laps {
        for detections in film.iter().chain(film.iter().rev()) {
            camera.frame(black_box(detections));
        }
    }
    assert!(!camera.outcome.state.is_skipped());
    assert!(camera.outcome.boxes.len() >= objects * 9 / 10);
}

/// Plays `laps` laps of frames that are predicted, each followed by `then`.
fn predicted_frames(objects: usize, laps: usize, mut then: impl FnMut(&Outcome)) {
    let mut settings = AlbireoSettings::of(Profile::Paper);
    settings.t_max = u32::MAX;
    settings.periodic_cap = u32::MAX;
    settings.objects.life_cycle.boundary_margin = 10.0;
    let mut camera = Camera::new(albireo(settings));
    for detections in Scene::new(objects).film(10, 0) {
        camera.frame(&detections);
    }
    camera.policy.set_threshold(1.0).expect("the threshold goes so far");
    let start = camera.policy.clone();
    for _ in 0..(1 + laps) * LAP / IN_A_ROW {
        camera.policy.clone_from(&start);
        for _ in 0..IN_A_ROW {
            camera.frame(&[]);
            then(&camera.outcome);
        }
    }
    assert!(camera.outcome.state.is_skipped());
    assert_eq!(camera.outcome.boxes.len(), objects);
}

fn attachment() -> Vec<u8> {
    let attachment = FrameAttachment {
        v: VERSION,
        seq: Some(70_123),
        t_ns: Some(1_795_000_000_123_456_789),
        clip: Some("drive-7".to_owned()),
        ..FrameAttachment::default()
    };
    serde_json::to_vec(&attachment).expect("an attachment is JSON")
}

/// Reads the attachment of a frame and writes the answer to it.
fn answer(attachment: &[u8], outcome: &Outcome, class_names: &[String]) -> Vec<u8> {
    let attachment: FrameAttachment =
        serde_json::from_slice(black_box(attachment)).expect("it is an attachment");
    let message = DetectionsMessage {
        v: VERSION,
        seq: attachment.seq.unwrap_or_default(),
        t_ns: attachment.t_ns.unwrap_or_default(),
        clip: attachment.clip.unwrap_or_default(),
        state: outcome.state,
        pending: false,
        degraded: outcome.degraded,
        cause: outcome.cause,
        passed: outcome.passed,
        tau_max: outcome.tau_max.map(|tau| significant(tau, 6)),
        threshold: None,
        width: PICTURE.width,
        height: PICTURE.height,
        boxes: box_messages(&outcome.boxes, PICTURE, class_names),
        latency_ms: Latency::default(),
    };
    serde_json::to_vec(&message).expect("a message is JSON")
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |place: usize| arguments.get(place).and_then(|text| text.parse::<usize>().ok());
    // `cargo bench` and `cargo test` call every bench with words of their own.
    let (Some(case), Some(objects), Some(laps)) = (arguments.get(1), number(2), number(3)) else {
        println!("counted CASE OBJECTS LAPS: see benches/counted.sh");
        return;
    };
    match case.as_str() {
        "albireo/detector" => {
            let policy = albireo(AlbireoSettings::of(Profile::Paper));
            detector_frames(policy, objects, laps);
        }
        "albireo-reference/detector" => {
            let policy = albireo(AlbireoSettings::of(Profile::Reference));
            detector_frames(policy, objects, laps);
        }
        "expected-loss/detector" => {
            let trigger = Trigger::ExpectedLoss { lambda: 0.0 };
            let policy = ExpectedLoss::new(ExpectedLossSettings::default(), trigger)
                .expect("the settings can be used");
            detector_frames(policy, objects, laps);
        }
        "albireo/predicted" => predicted_frames(objects, laps, |outcome| {
            black_box(outcome);
        }),
        "albireo/answered" => {
            let attachment = attachment();
            let class_names = ["person", "bicycle", "car"].map(str::to_owned);
            predicted_frames(objects, laps, |outcome| {
                black_box(answer(&attachment, black_box(outcome), &class_names));
            });
        }
        other => {
            println!("there is no case {other}");
            std::process::exit(2);
        }
    }
}
