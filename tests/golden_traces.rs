//! With profile `reference`, the policies decide as the published code does, frame by frame.
//!
//! The traces are those of the shared data, on its recorded detections; `fixtures/golden` has excerpts.

use crate::support::text;
use albireo_core::geometry::PictureSize;
use replay::{Screen, compare, compare_excerpt};
use rstest::rstest;
use shared_data::{detections, golden, sequences};

pub(crate) mod replay;
pub(crate) mod shared_data;

/// The policy and the screen named `label` in the golden traces.
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

#[rstest]
#[case::all_five_frame_states("albireo-u3e-4-erd-detections.kitti-0018", [1238, 374])]
#[case::runs_of_predicted_frames("albireo-u1e-3-erd-nonempty.kitti-0008", [1242, 375])]
#[case::rescues_and_removals("albireo-u3e-4-erd-nonempty.PETS09-S2L1", [768, 576])]
#[case::fixed_skip("fixedskip-2.kitti-0008", [1242, 375])]
#[case::ctd("ctd-0.50.kitti-0008", [1242, 375])]
fn golden_excerpt(#[case] name: &str, #[case] size: [u32; 2]) {
    let (label, _) = name.rsplit_once('.').unwrap();
    let (asked, screen) = labelled(label);
    let lines = text(&format!("tests/fixtures/golden/{name}.jsonl"));
    compare_excerpt(&lines, &asked, screen, PictureSize::new(size[0], size[1]));
}

#[rstest]
#[ignore = "needs ../shared"]
fn shared_golden_traces(
    #[values(
        "albireo-u3e-4-erd-nonempty",
        "albireo-u3e-4-erd-detections",
        "albireo-u1e-3-erd-nonempty",
        "fixedskip-2",
        "ctd-0.50"
    )]
    label: &str,
) {
    let (asked, screen) = labelled(label);
    for sequence in sequences() {
        let what = format!("{label}/{}", sequence.name);
        let (detections, golden) = (detections(&sequence), golden(&sequence, label));
        assert_eq!(golden.lines().count(), sequence.frames, "{what}");
        compare(
            &what,
            &asked,
            screen,
            sequence.picture,
            &detections,
            &golden,
        );
    }
}
