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
pub(crate) fn result(clip: &str, policy: &str, ap50: Option<f64>, skipped: usize) -> ClipResult {
    let mut states = [FrameState::I; 10];
    states[..skipped].fill(FrameState::P);
    let mut result = of_states(clip, policy, &states);
    let boxes = [vec![at(0.0, 1.0)]];
    let perfect = pooled(&boxes, &boxes);
    result.accuracy = ap50.map(|ap50| Accuracy { ap50, ..perfect });
    result
}

/// The summaries of vanilla and albireo over three clips, of which the last has no ground truth.
fn vanilla_and_albireo() -> [PolicySummary; 2] {
    let results = [
        result("a", "vanilla", Some(0.5), 0),
        result("b", "vanilla", Some(0.7), 0),
        result("c", "vanilla", None, 0),
        result("a", "albireo", Some(0.6), 2),
        result("b", "albireo", Some(0.6), 4),
        result("c", "albireo", None, 6),
    ];
    summarise(&results).try_into().expect("one summary for each policy")
}

#[test]
fn means_are_taken_over_the_clips_with_ground_truth() {
    let [_, albireo] = vanilla_and_albireo();
    assert_eq!(albireo.clips, 2);
    assert_eq!(albireo.clips_without_truth, 1);
    assert!((albireo.skip_rate - 0.3).abs() < 1e-15);
    assert!((albireo.ap50.expect("two clips have it") - 0.6).abs() < 1e-15);
}

#[test]
fn differences_are_taken_clip_by_clip_over_the_clips_with_ground_truth() {
    let [vanilla, albireo] = vanilla_and_albireo();
    assert_eq!(vanilla.policy, "vanilla");
    assert_eq!(vanilla.ap50_change, None);
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

/// The objects of a clip, one on each frame.
fn one_on_each(frames: usize) -> Vec<Vec<ScoredBox>> {
    vec![vec![at(0.0, 1.0)]; frames]
}

/// The result of vanilla on a clip with [`one_on_each`] frame, of whose objects one is never found.
fn judged(clip: &str, found: &[Vec<ScoredBox>]) -> ClipResult {
    let objects = one_on_each(found.len());
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
}

/// The boxes of a clip of two frames, of which the surer is wrong.
fn surest_is_wrong() -> Vec<Vec<ScoredBox>> {
    vec![vec![at(50.0, 0.9)], vec![at(0.0, 0.8)]]
}

/// The boxes of a clip of six frames, which are all right.
fn all_right() -> Vec<Vec<ScoredBox>> {
    vec![vec![at(0.0, 0.7)]; 6]
}

#[test]
fn pooled_accuracy_is_that_of_the_clips_as_one() {
    let results = [judged("a", &surest_is_wrong()), judged("b", &all_right())];
    let summary = &summarise(&results)[0];
    let as_one = pooled(&[surest_is_wrong(), all_right()].concat(), &one_on_each(8));
    let figures = summary.pooled.expect("two clips");
    assert_eq!(figures.ap50, as_one.ap50);
    assert_eq!(figures.map, as_one.map);
    assert_eq!(figures.truths, 8);
    // The wrong box is one of two of its clip, and one of eight of both, so that it costs the mean over the clips more.
    assert!((summary.ap50.unwrap() - figures.ap50).abs() > 0.05);
}

#[test]
fn pooled_delays_count_each_object_once() {
    let results = [judged("a", &surest_is_wrong()), judged("b", &all_right())];
    let figures = summarise(&results)[0].pooled.expect("two clips");
    assert_eq!(figures.objects, 8);
    assert_eq!(figures.never_found, 2);
    assert_eq!(figures.delay_frames, Some((2.0 * 2.0 + 6.0 * 6.0) / 8.0));
}

#[test]
fn one_clip_has_no_pooled_figures() {
    let results = [judged("a", &surest_is_wrong())];
    assert_eq!(summarise(&results)[0].pooled, None);
}
