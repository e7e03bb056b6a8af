use super::*;
use crate::judge::Accuracy;
use crate::judge::average_precision::tests::{at, pooled};
use albireo_core::policy::FrameState;

/// The result of a policy on a clip with these frame states.
pub(crate) fn of_states(clip: &str, policy: &str, states: &[FrameState]) -> ClipResult {
    let mut result = ClipResult {
        clip: clip.to_owned(),
        policy: policy.to_owned(),
        frames: states.len(),
        ..ClipResult::default()
    };
    states.iter().for_each(|state| result.states.count(*state));
    result
}

fn result(clip: &str, policy: &str, ap50: Option<f64>, skipped: usize) -> ClipResult {
    let states = [[FrameState::P; 10], [FrameState::I; 10]].concat();
    let mut result = of_states(clip, policy, &states[10 - skipped..][..10]);
    let boxes = [vec![at(0.0, 1.0)]];
    let perfect = pooled(&boxes, &boxes);
    result.accuracy = ap50.map(|ap50| Accuracy { ap50, ..perfect });
    result
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
    assert_eq!(summaries[0].ap50_change, None);
    let albireo = &summaries[1];
    assert_eq!((albireo.clips, albireo.clips_without_truth), (2, 1));
    assert!((albireo.skip_rate - 0.3).abs() < 1e-15);
    assert!((albireo.ap50.expect("two clips have it") - 0.6).abs() < 1e-15);
    let difference = albireo.ap50_change.expect("two clips are compared");
    assert_eq!(difference.clips, 2);
    assert!(difference.mean.abs() < 1e-15);
}

#[test]
fn the_skip_frontier_contains_every_unbeaten_policy() {
    let results = [
        result("a", "vanilla", Some(0.7), 0),
        result("a", "good", Some(0.6), 5),
        result("a", "bad", Some(0.5), 4),
    ];
    let summaries = summarise(&results);
    let on = summaries.iter().map(|summary| summary.on_skip_frontier);
    assert_eq!(on.collect::<Vec<_>>(), [true, true, false]);
}
