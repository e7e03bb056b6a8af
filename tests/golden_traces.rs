//! With profile `reference`, the policies decide as the published code does, frame by frame.
//!
//! The traces are those of the shared data, over its recorded detections; excerpts are in
//! `fixtures/golden`.

#![allow(clippy::unwrap_used, clippy::panic)]

use albireo_core::geometry::PictureSize;
use albireo_core::policy::{FrameState, Outcome};
use replay::{Screen, compare, compare_excerpt, decide, reference};
use shared_data::{sequences, summary};
use std::collections::BTreeMap;

pub(crate) mod replay;
pub(crate) mod shared_data;

/// Compares the golden traces in `folder` with the policy `asked` for.
fn compare_all(folder: &str, asked: &str, screen: Screen) {
    for sequence in sequences() {
        let what = format!("{folder}/{}", sequence.name);
        let detections = sequence.detections();
        let golden = sequence.golden(folder);
        let frames = compare(
            &what,
            asked,
            screen,
            sequence.picture(),
            &detections,
            &golden,
        );
        assert_eq!(frames, sequence.frames, "{what}");
    }
}

/// The policy and the screen that go by the name `label` in the golden traces.
fn labelled(label: &str) -> (String, Screen) {
    if let Some(n) = label.strip_prefix("fixedskip-") {
        return (format!("fixed-skip:{n}"), Screen::NeverEmpty);
    }
    if let Some(threshold) = label.strip_prefix("ctd-") {
        return (format!("ctd:{threshold}"), Screen::NeverEmpty);
    }
    let Some(rest) = label.strip_prefix("albireo-u") else {
        return (label.to_owned(), Screen::NeverEmpty);
    };
    let (u, screen) = rest.split_once("-erd-").unwrap();
    let screen = match screen {
        "nonempty" => Screen::NeverEmpty,
        "detections" => Screen::EmptyWithoutDetections,
        other => panic!("{label}: there is no screen `{other}`"),
    };
    (format!("albireo:{u}"), screen)
}

#[test]
fn golden_excerpt_with_all_five_frame_states() {
    compare_excerpt(
        include_str!("fixtures/golden/albireo-u3e-4-erd-detections.kitti-0018.jsonl"),
        "albireo:3e-4",
        Screen::EmptyWithoutDetections,
        PictureSize::new(1238, 374),
    );
}

#[test]
fn golden_excerpt_with_runs_of_predicted_frames() {
    compare_excerpt(
        include_str!("fixtures/golden/albireo-u1e-3-erd-nonempty.kitti-0008.jsonl"),
        "albireo:1e-3",
        Screen::NeverEmpty,
        PictureSize::new(1242, 375),
    );
}

#[test]
fn golden_excerpt_with_rescues_and_removals() {
    compare_excerpt(
        include_str!("fixtures/golden/albireo-u3e-4-erd-nonempty.PETS09-S2L1.jsonl"),
        "albireo:3e-4",
        Screen::NeverEmpty,
        PictureSize::new(768, 576),
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_golden_traces_at_3e_4_with_a_screen_that_is_never_empty() {
    compare_all(
        "albireo-u3e-4-erd-nonempty",
        "albireo:3e-4",
        Screen::NeverEmpty,
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_golden_traces_at_3e_4_with_a_screen_that_is_always_right() {
    compare_all(
        "albireo-u3e-4-erd-detections",
        "albireo:3e-4",
        Screen::EmptyWithoutDetections,
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_golden_traces_at_1e_3_with_a_screen_that_is_never_empty() {
    compare_all(
        "albireo-u1e-3-erd-nonempty",
        "albireo:1e-3",
        Screen::NeverEmpty,
    );
}

#[test]
fn golden_excerpt_of_fixed_skip() {
    compare_excerpt(
        include_str!("fixtures/golden/fixedskip-2.kitti-0008.jsonl"),
        "fixed-skip:2",
        Screen::NeverEmpty,
        PictureSize::new(1242, 375),
    );
}

#[test]
fn golden_excerpt_of_ctd() {
    compare_excerpt(
        include_str!("fixtures/golden/ctd-0.50.kitti-0008.jsonl"),
        "ctd:0.5",
        Screen::NeverEmpty,
        PictureSize::new(1242, 375),
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_golden_traces_of_fixed_skip() {
    compare_all("fixedskip-2", "fixed-skip:2", Screen::NeverEmpty);
}

#[test]
#[ignore = "needs ../shared"]
fn shared_golden_traces_of_ctd() {
    compare_all("ctd-0.50", "ctd:0.5", Screen::NeverEmpty);
}

/// Every row of the table of figures, those without a trace included: each policy and setting, and
/// each sequence.
#[test]
#[ignore = "needs ../shared"]
fn shared_summary_has_the_same_shares_of_frame_states_and_as_many_boxes() {
    let sequences: BTreeMap<_, _> = sequences()
        .into_iter()
        .map(|sequence| (sequence.name.clone(), (sequence.detections(), sequence)))
        .collect();
    let rows = summary();
    assert_eq!(rows.len(), 16 * sequences.len());
    for row in rows {
        let (recorded, sequence) = &sequences[&row.sequence];
        let (asked, screen) = labelled(&row.policy);
        let mut policy = reference(&asked);
        let mut outcome = Outcome::default();
        let mut frames: BTreeMap<FrameState, u64> = BTreeMap::new();
        let mut boxes = 0;
        for index in 0..sequence.frames {
            let detections = recorded.get(&index).map_or(&[][..], Vec::as_slice);
            let picture = sequence.picture();
            decide(
                &mut *policy,
                index,
                screen,
                picture,
                detections,
                &mut outcome,
            );
            *frames.entry(outcome.state).or_default() += 1;
            boxes += outcome.boxes.len();
        }
        let what = format!("{} on {}", row.policy, row.sequence);
        let share = |state| *frames.get(&state).unwrap_or(&0) as f64 / sequence.frames as f64;
        let shares = FrameState::ALL.map(share);
        for (found, expected) in shares.iter().zip(row.shares) {
            assert!((found - expected).abs() < 1e-12, "{what}: {shares:?}");
        }
        let skipped = FrameState::ALL
            .into_iter()
            .filter(|state| state.is_skipped());
        let skip_rate: f64 = skipped.map(share).sum();
        assert!((skip_rate - row.skip_rate).abs() < 1e-12, "{what}");
        assert_eq!(boxes, row.boxes, "{what}");
    }
}
