use super::*;
use crate::average_precision::Accuracy;
use crate::replay::Replay;
use albireo_core::policy::FrameState;

fn result(clip: &str, policy: &str, ap50: Option<f64>, skipped: usize) -> ClipResult {
    let replay = Replay {
        frames: Vec::new(),
        boxes: Vec::new(),
        boxes_last_confidence: None,
        rejected_detections: 0,
        trace: None,
    };
    let mut result = ClipResult::from_replay(clip, policy, &replay);
    result.frames = 10;
    for frame in 0..10 {
        result.states.count(if frame < skipped {
            FrameState::P
        } else {
            FrameState::I
        });
    }
    result.accuracy = ap50.map(|ap50| Accuracy {
        ap50,
        map: ap50 / 2.0,
        ap75: ap50 / 2.0,
        f1_50: ap50,
        f1_50_shown: ap50,
        precision: 1.0,
        recall: 1.0,
        predictions: 1,
        truths: 1,
    });
    result
}

fn energy(joules: f64, provenance: Provenance) -> Option<Energy> {
    Some(Energy::new(joules, 1.0, 10, provenance))
}

#[test]
fn differences_are_taken_clip_by_clip_over_the_clips_with_ground_truth() {
    let results = [
        result("a", "vanilla", Some(0.5), 0),
        result("b", "vanilla", Some(0.7), 0),
        result("c", "vanilla", None, 0),
        result("a", "albireo", Some(0.6), 2),
        result("b", "albireo", Some(0.6), 4),
        result("c", "albireo", None, 6),
    ];
    let summaries = summarise(&results);
    assert_eq!(summaries[0].policy, "vanilla");
    assert_eq!(summaries[0].against_baseline, None);
    let albireo = &summaries[1];
    assert_eq!((albireo.clips, albireo.clips_without_truth), (2, 1));
    assert!((albireo.skip_rate - 0.3).abs() < 1e-15);
    assert!((albireo.ap50.expect("two clips have it") - 0.6).abs() < 1e-15);
    let comparison = albireo.against_baseline.expect("there is a baseline");
    assert_eq!(comparison.clips_keeping_ap50, 1);
    let difference = comparison.ap50.expect("two clips are compared");
    assert_eq!(difference.clips, 2);
    assert!(difference.mean.abs() < 1e-15);
    assert_eq!(comparison.energy, None);
}

#[test]
fn measured_and_projected_energies_are_never_compared() {
    let mut vanilla = result("a", "vanilla", None, 0);
    let mut albireo = result("a", "albireo", None, 0);
    vanilla.energy = energy(10.0, Provenance::Measured);
    albireo.energy = energy(8.0, Provenance::Projected);
    let summaries = summarise(&[vanilla.clone(), albireo.clone()]);
    let comparison = summaries[1].against_baseline.expect("there is a baseline");
    assert_eq!(comparison.energy, None);
    albireo.energy = energy(8.0, Provenance::Measured);
    let summaries = summarise(&[vanilla, albireo]);
    let comparison = summaries[1].against_baseline.expect("there is a baseline");
    assert_eq!(comparison.energy.map(|energy| energy.mean), Some(-2.0));
}

#[test]
fn the_skip_frontier_holds_who_is_not_beaten() {
    let results = [
        result("a", "vanilla", Some(0.7), 0),
        result("a", "good", Some(0.6), 5),
        result("a", "bad", Some(0.5), 4),
    ];
    let on: Vec<bool> = summarise(&results)
        .iter()
        .map(|summary| summary.on_skip_frontier)
        .collect();
    assert_eq!(on, [true, true, false]);
}
