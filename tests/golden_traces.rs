//! With profile `reference`, the policies decide as the published code does, frame by frame.
//!
//! The traces are those of the shared data, on its recorded detections; `fixtures/golden` has excerpts.

use crate::support::{shared, text};
use albireo_core::geometry::PictureSize;
use albireo_eval::replay::trace;
use replay::Screen::{self, EmptyWithoutDetections, NeverEmpty};
use replay::{compare, compare_excerpt};
use shared_data::{detections, sequences};

pub(crate) mod replay;
pub(crate) mod shared_data;

const SCREENED: &str = "albireo-u3e-4-erd-detections";

/// The runs of the published code: the name of the traces, the policy, and the verdicts of the empty-scene screen.
pub(crate) const RUNS: [(&str, &str, Screen); 5] = [
    ("albireo-u3e-4-erd-nonempty", "albireo:3e-4", NeverEmpty),
    (SCREENED, "albireo:3e-4", EmptyWithoutDetections),
    ("albireo-u1e-3-erd-nonempty", "albireo:1e-3", NeverEmpty),
    ("fixedskip-2", "fixed-skip:2", NeverEmpty),
    ("ctd-0.50", "ctd:0.50", NeverEmpty),
];

#[rstest::rstest]
#[case::all_five_frame_states("albireo-u3e-4-erd-detections.kitti-0018", [1238, 374])]
#[case::runs_of_predicted_frames("albireo-u1e-3-erd-nonempty.kitti-0008", [1242, 375])]
#[case::rescues_and_removals("albireo-u3e-4-erd-nonempty.PETS09-S2L1", [768, 576])]
#[case::fixed_skip("fixedskip-2.kitti-0008", [1242, 375])]
#[case::ctd("ctd-0.50.kitti-0008", [1242, 375])]
fn golden_excerpt(#[case] name: &str, #[case] size: [u32; 2]) {
    let (_, asked, screen) = RUNS.into_iter().find(|(label, ..)| name.starts_with(label)).unwrap();
    let lines = text(&format!("tests/fixtures/golden/{name}.jsonl"));
    compare_excerpt(&lines, asked, screen, PictureSize::new(size[0], size[1]));
}

#[test]
#[ignore = "needs ../shared"]
fn shared_golden_traces() {
    for sequence in sequences() {
        let recorded = detections(&sequence);
        for (label, asked, screen) in RUNS {
            let what = format!("{label}/{}", sequence.name);
            let golden = trace::read(&shared(&format!("golden/{what}.jsonl.gz"))).unwrap();
            compare(&what, asked, screen, sequence.picture, &recorded, &golden);
        }
    }
}
