//! Runs every policy over every clip in parallel, and computes the figures of each.

mod against_detector;
mod figures;
pub mod streams;
mod worst;

pub use against_detector::against_detector;
pub use worst::attach_pictures;
pub(crate) use worst::shown_policies;

use crate::data::Clip;
use crate::error::EvalError;
use crate::judge::{Truth, only_unlabelled};
use crate::replay::{StoredEvidence, replay, trace};
use crate::result::ClipResult;
use crate::settings::Settings;
use crate::spec::PolicySpec;
use albireo_core::policy::{ExpectedLoss, Profile};
use rayon::iter::{ParallelBridge, ParallelIterator};
use std::borrow::Cow;

/// Runs `policies` over `clips`. The results are in order of policies, then clips. `done` is called after each
/// policy on each clip, from any thread.
///
/// # Errors
/// The first [`EvalError`]; the other threads stop at their next step.
pub fn run<'a>(
    clips: impl IntoIterator<Item = &'a Clip>,
    policies: &[PolicySpec],
    settings: &Settings,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<ClipResult>, EvalError> {
    in_parallel(clips, policies, settings, done, &run_policy)
}

/// A policy on a clip, by their indices.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Step {
    policy: usize,
    clip: usize,
}

/// Calls `work` for every policy on every clip, on as many threads as `settings` say, and `done` after each call. The
/// results are in order of policies, then clips.
///
/// # Errors
/// An [`EvalError`] of `work`; after one, no thread begins another step.
fn in_parallel<'a>(
    clips: impl IntoIterator<Item = &'a Clip>,
    policies: &[PolicySpec],
    settings: &Settings,
    done: &(dyn Fn() + Sync),
    work: &(dyn Fn(&'a Clip, &PolicySpec, &Settings) -> Result<ClipResult, EvalError> + Sync),
) -> Result<Vec<ClipResult>, EvalError> {
    let clips: Vec<&Clip> = clips.into_iter().collect();
    let mut steps = Vec::with_capacity(policies.len() * clips.len());
    for policy in 0..policies.len() {
        for clip in 0..clips.len() {
            steps.push(Step { policy, clip });
        }
    }
    // The longest clips come first, so that no thread is left with one at the end.
    steps.sort_by_key(|step| std::cmp::Reverse(clips[step.clip].frames));
    let no_threads = |error| {
        EvalError::new(format!(
            "the threads of the evaluation cannot be started: {error}; try fewer with --threads"
        ))
    };
    // More threads than steps would only search for work, each with all others.
    let threads = settings.threads.min(steps.len());
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(no_threads)?;
    let take = |step: &Step| -> Result<(Step, ClipResult), EvalError> {
        let result = work(clips[step.clip], &policies[step.policy], settings);
        done();
        Ok((*step, result?))
    };
    // The bridge hands the steps out in this order; their results come back in any.
    let taken: Result<Vec<_>, EvalError> =
        pool.install(|| steps.iter().par_bridge().map(take).collect());
    let mut results = taken?;
    results.sort_by_key(|(step, _)| *step);
    Ok(results.into_iter().map(|(_, result)| result).collect())
}

/// Says under which policy and on which clip an error occurred.
fn on_clip(error: EvalError, policy: &PolicySpec, clip: &Clip) -> EvalError {
    error.context(format!("policy {}, clip {}", policy.label, clip.name))
}

/// Computes the figures of one policy over one clip, and writes its trace if `settings` name a folder for it.
///
/// # Errors
/// [`EvalError`] when the policy cannot be built, needs what the clip does not have, or the trace cannot be written.
fn run_policy(
    clip: &Clip,
    policy: &PolicySpec,
    settings: &Settings,
) -> Result<ClipResult, EvalError> {
    let mut decider = policy.build(clip.frame_rate)?;
    let profile = profile_of(decider.name(), settings.profile);
    let mut source =
        StoredEvidence::new(clip, settings).map_err(|error| on_clip(error, policy, clip))?;
    let replayed = replay(
        decider.as_mut(),
        &mut source,
        profile,
        settings.min_confidence(),
        settings.traces.is_some(),
    )
    .map_err(|error| on_clip(error, policy, clip))?;
    if let (Some(folder), Some(frames)) = (&settings.traces, &replayed.trace) {
        let file = format!("{}.jsonl.gz", clip.name);
        trace::write(&folder.join(&policy.label).join(file), frames)?;
    }

    let mut result = figures::of_replay(clip, &policy.label, &replayed);
    if let Some(objects) = &clip.truth {
        let mut ignored = Cow::Borrowed(&clip.ignored);
        if profile == Profile::Reference {
            // The published evaluator knows no ignored regions; frames that nobody labelled are left out all the same.
            only_unlabelled(ignored.to_mut());
        }
        let truth = Truth {
            objects,
            ignored: &ignored,
        };
        figures::judge(&mut result, truth, &replayed, &clip.classes, settings);
    }
    if settings.keep_worst {
        result.worst = worst::worst_frames(clip, &replayed, settings.confidence);
    }
    if let Some(pass) = &clip.pass {
        figures::time(
            &mut result,
            pass,
            &replayed,
            &source,
            decider.pictures(),
            settings,
        );
    }
    // The model of a board projects time too, because times measured here are another machine's.
    if let Some(model) = &settings.energy_model {
        model.apply(&mut result);
    }
    Ok(result)
}

/// Returns the profile by which a policy is judged in a run of `profile`. Policies that are not from the paper have no
/// published definition of their boxes and confidences, so they are judged by the boxes that they report: under the profile
/// `paper`.
fn profile_of(policy: &str, profile: Profile) -> Profile {
    match policy {
        ExpectedLoss::NAME | ExpectedLoss::FIXED_SKIP_NAME | ExpectedLoss::EVEN_SKIP_NAME => {
            Profile::Paper
        }
        _ => profile,
    }
}
