use super::*;
use crate::boxes::ScoredBox;
use crate::judge::Accuracy;
use crate::judge::average_precision::tests::{at, pooled};
use crate::judge::{Interpolation, Newcomers, Truth};
use albireo_core::policy::FrameState;

/// The result of a policy on a clip with these frame states.
pub(crate) fn of_states(clip: &str, policy: &str, states: &[FrameState]) -> ClipResult {
    let mut result = ClipResult {
        clip: clip.to_owned(),
        policy: policy.to_owned(),
        frames: states.len(),
        ..ClipResult::default()
    };
    for state in states {
        result.states.count(*state);
    }
    result
}

/// The result of a policy on a clip of ten frames.
fn result(clip: &str, policy: &str, ap50: Option<f64>, skipped: usize) -> ClipResult {
    let mut states = [FrameState::I; 10];
    states[..skipped].fill(FrameState::P);
    let mut result = of_states(clip, policy, &states);
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
    assert_eq!(albireo.clips, 2);
    assert_eq!(albireo.clips_without_truth, 1);
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
    let on_frontier: Vec<_> = summaries.iter().map(|summary| summary.on_skip_frontier).collect();
    assert_eq!(on_frontier, [true, true, false]);
}

#[test]
fn pooled_figures_are_those_of_the_clips_as_one() {
    let truth = |frames: usize| vec![vec![at(0.0, 1.0)]; frames];
    // The surest box is wrong. It is one of two boxes of the first clip, and one of eight of both, so that it costs the mean of
    // the clips more than the figure of both as one.
    let found = [
        vec![vec![at(50.0, 0.9)], vec![at(0.0, 0.8)]],
        vec![vec![at(0.0, 0.7)]; 6],
    ];
    let result_of = |clip: &str, found: &[Vec<ScoredBox>]| {
        let objects = truth(found.len());
        let matches = Matches::of(found, Truth::from(&objects), Interpolation::AllPoints);
        let states = vec![FrameState::P; found.len()];
        ClipResult {
            accuracy: matches.accuracy(),
            matches: Some(matches),
            newcomers: Some(Newcomers {
                objects: found.len(),
                never_found: 1,
                delay_frames: found.len() as f64,
            }),
            ..of_states(clip, "vanilla", &states)
        }
    };
    let results = [result_of("a", &found[0]), result_of("b", &found[1])];
    let summary = &summarise(&results)[0];
    let as_one = pooled(&found.concat(), &truth(8));
    let pooled = summary.pooled.expect("two clips");
    assert_eq!(pooled.ap50, as_one.ap50);
    assert_eq!(pooled.map, as_one.map);
    assert_eq!(pooled.truths, 8);
    // The mean over the clips is another one.
    assert!((summary.ap50.unwrap() - pooled.ap50).abs() > 0.05);
    assert_eq!(pooled.objects, 8);
    assert_eq!(pooled.never_found, 2);
    assert_eq!(pooled.delay_frames, Some((2.0 * 2.0 + 6.0 * 6.0) / 8.0));
    assert_eq!(summarise(&results[..1])[0].pooled, None);
}
