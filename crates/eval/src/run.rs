//! Runs every policy over every clip in parallel, and computes the figures of each.

use crate::average_precision::{
    Accuracy, Classes, Interpolation, ScoredBox, accuracy, accuracy_by_class, outside_ignored,
};
use crate::data::{Clip, classes};
use crate::energy_model::EnergyModel;
use crate::error::EvalError;
use crate::replay::replay;
use crate::result::{ClipResult, FrameTime, Provenance, Spread};
use crate::source::{ScreenRule, StoredEvidence};
use crate::spec::PolicySpec;
use crate::trace;
use crate::tracking::tracking;
use crate::worst::worst_frames;
use albireo_core::policy::{ExpectedLoss, FrameState, MinConfidence, Policy, Profile};
use clap::builder::{BoolValueParser, PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, Args};
use rayon::iter::{ParallelBridge, ParallelIterator};
use std::path::PathBuf;

/// The heading in the help of arguments that decide how boxes are judged.
pub const JUDGED: &str = "How it is judged";

/// The settings of a run, which are arguments of `albireo eval`.
#[derive(Clone, Debug, Args)]
pub struct Settings {
    /// The definitions that apply where the published code and the paper's text differ.
    #[arg(long, default_value = "paper", value_parser = profile_parser())]
    pub profile: Profile,
    /// The source of the empty-scene screen's verdicts.
    #[arg(long, help_heading = JUDGED, value_enum, default_value_t = ScreenRule::Nonempty)]
    pub screen: ScreenRule,
    /// Frames in a row that the screen may call empty before the detector runs anyway; 0 for any number.
    #[arg(long, help_heading = JUDGED, value_name = "COUNT", default_value_t = 100)]
    pub longest_empty_run: u32,
    /// Detections below this confidence are not used.
    #[arg(long, help_heading = JUDGED, default_value_t = 0.5, allow_negative_numbers = true)]
    pub confidence: f64,
    /// Boxes below this confidence are not judged, as a node with this `report.confidence` does not publish them
    /// [default: --confidence for detected boxes, half of it for predicted ones].
    #[arg(long, help_heading = JUDGED)]
    pub report_confidence: Option<f64>,
    /// Judge every class by itself instead of all as one.
    #[arg(long = "per-class", help_heading = JUDGED, action = ArgAction::SetTrue, value_parser = flag(Classes::Separate, Classes::Pooled))]
    pub classes: Classes,
    /// Area under the precision-recall curve at COCO's 101 recall levels instead of all points.
    #[arg(long = "coco-interpolation", help_heading = JUDGED, action = ArgAction::SetTrue, value_parser = flag(Interpolation::Coco101, Interpolation::AllPoints))]
    pub interpolation: Interpolation,
    /// Write what each policy did, frame by frame, to DIR/POLICY/SEQUENCE.jsonl.gz.
    #[arg(long, help_heading = "What is written", value_name = "DIR")]
    pub traces: Option<PathBuf>,
    /// The number of threads; 0 for as many as the machine has.
    #[arg(long, default_value_t = 0)]
    pub threads: usize,
    /// True to keep the frames with the most lost objects, with their boxes.
    #[arg(skip)]
    pub keep_worst: bool,
    /// The model that projects energy and frame time, if any.
    #[arg(skip)]
    pub energy_model: Option<EnergyModel>,
}

/// Parses the name of a profile.
fn profile_parser() -> impl TypedValueParser<Value = Profile> {
    PossibleValuesParser::new(["reference", "paper"]).map(|name| match name.as_str() {
        "reference" => Profile::Reference,
        _ => Profile::Paper,
    })
}

/// Gives the value of a flag that is `set`, or `unset`.
fn flag<T: Copy + Send + Sync + 'static>(set: T, unset: T) -> impl TypedValueParser<Value = T> {
    BoolValueParser::new().map(move |is_set| if is_set { set } else { unset })
}

impl Default for Settings {
    /// The defaults of `albireo eval`.
    fn default() -> Self {
        Self {
            profile: Profile::Paper,
            confidence: 0.5,
            report_confidence: None,
            screen: ScreenRule::Nonempty,
            longest_empty_run: 100,
            classes: Classes::Pooled,
            interpolation: Interpolation::AllPoints,
            traces: None,
            keep_worst: false,
            energy_model: None,
            threads: 0,
        }
    }
}

impl Settings {
    /// The confidence that a box needs to be published.
    pub(super) fn min_confidence(&self) -> MinConfidence {
        MinConfidence::new(self.report_confidence, self.confidence)
    }
}

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

/// Calls `work` for every policy on every clip, on as many threads as `settings` say.
///
/// # Errors
/// An [`EvalError`] of `work`; after one, no thread begins another step.
pub(super) fn in_parallel<'a>(
    clips: impl IntoIterator<Item = &'a Clip>,
    policies: &[PolicySpec],
    settings: &Settings,
    done: &(dyn Fn() + Sync),
    work: &(dyn Fn(&'a Clip, &PolicySpec, &Settings) -> Result<ClipResult, EvalError> + Sync),
) -> Result<Vec<ClipResult>, EvalError> {
    let clips: Vec<&Clip> = clips.into_iter().collect();
    let mut steps: Vec<(usize, usize)> = (0..policies.len())
        .flat_map(|policy| (0..clips.len()).map(move |clip| (policy, clip)))
        .collect();
    // The longest clips come first, so that no thread is left with one at the end.
    steps.sort_by_key(|&(_, clip)| std::cmp::Reverse(clips[clip].frames));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(settings.threads).build().map_err(
        |error| {
            EvalError::new(format!(
                "the threads of the evaluation cannot be started: {error}; try fewer with --threads"
            ))
        },
    )?;
    // A bridge keeps the order of the steps.
    let results: Result<Vec<_>, EvalError> = pool.install(|| {
        let steps = steps.iter().par_bridge();
        steps
            .map(|&(policy, clip)| {
                let result = work(clips[clip], &policies[policy], settings);
                done();
                Ok(((policy, clip), result?))
            })
            .collect()
    });
    let mut results = results?;
    results.sort_by_key(|(step, _)| *step);
    Ok(results.into_iter().map(|(_, result)| result).collect())
}

/// Builds a policy.
///
/// # Errors
/// When its configuration is invalid.
pub(super) fn build(policy: &PolicySpec) -> Result<Box<dyn Policy>, EvalError> {
    let label = &policy.label;
    (policy.config.build()).map_err(|error| EvalError::new(format!("policy {label}: {error}")))
}

/// Creates the error for a clip that lacks the evidence that a policy needs.
pub(super) fn no_evidence(clip: &Clip, policy: &PolicySpec, source: EvalError) -> EvalError {
    source.context(format!("policy {}, clip {}", policy.label, clip.name))
}

/// Computes the figures of one policy over one clip.
///
/// # Errors
/// [`EvalError`] when the policy cannot be built, needs what the clip does not have, or the trace cannot be written.
fn run_policy(
    clip: &Clip,
    policy: &PolicySpec,
    settings: &Settings,
) -> Result<ClipResult, EvalError> {
    let mut decider = build(policy)?;
    let profile = profile_of(decider.name(), settings.profile);
    let mut source =
        StoredEvidence::new(clip, settings).map_err(|source| no_evidence(clip, policy, source))?;
    let replayed = replay(
        decider.as_mut(),
        &mut source,
        profile,
        settings.min_confidence(),
        settings.traces.is_some(),
    )
    .map_err(|source| no_evidence(clip, policy, source))?;
    if let (Some(folder), Some(frames)) = (&settings.traces, &replayed.trace) {
        let file = format!("{}.jsonl.gz", clip.name);
        trace::write(&folder.join(&policy.label).join(file), frames)?;
    }
    let mut result = ClipResult::from_replay(&clip.name, &policy.label, &replayed);
    result.camera.clone_from(&clip.camera);
    result.frame_rate = clip.frame_rate;
    if let Some(truth) = &clip.truth {
        // The published evaluator has no ignored regions.
        let boxes = match profile {
            Profile::Paper => outside_ignored(&replayed.boxes, truth, &clip.ignored),
            Profile::Reference => replayed.boxes.clone(),
        };
        let judge = |boxes: &[Vec<ScoredBox>]| {
            accuracy(boxes, truth, settings.classes, settings.interpolation)
        };
        result.accuracy = judge(&boxes);
        result.tracking = tracking(&boxes, truth);
        if let Some(all) = &replayed.boxes_all {
            let all = outside_ignored(all, truth, &clip.ignored);
            result.accuracy_all = judge(&all);
            result.tracking_all = tracking(&all, truth);
        }
        let last = replayed.boxes_last_confidence.as_ref();
        result.accuracy_last_confidence = last.and_then(|boxes| judge(boxes));
        result.classes = accuracy_by_class(&boxes, truth, settings.interpolation)
            .into_iter()
            .map(|(class, accuracy)| {
                let name = classes::name(class)
                    .map_or_else(|| format!("class {}", class.0), str::to_owned);
                (name, accuracy)
            })
            .collect();
    }
    if settings.keep_worst {
        result.worst = worst_frames(clip, &replayed, settings.confidence);
    }
    if let Some(pass) = &clip.pass {
        let occupied = source.all_detections().iter().map(|found| !found.is_empty());
        let states = result.states_by_frame.iter().zip(occupied);
        let occupied = states.filter(|(_, occupied)| *occupied);
        result.occupied_frames = occupied.clone().count();
        result.false_empty_frames = occupied.filter(|(state, _)| **state == FrameState::E).count();
        let screened = settings.screen == ScreenRule::Recorded;
        let times = pass.frame_times(&replayed.frames, decider.pictures(), screened);
        result.frame_time = Spread::of(times).map(|milliseconds| FrameTime {
            milliseconds,
            provenance: Provenance::Composed,
        });
    }
    // The model of a board projects time too, because times measured here are another machine's.
    if let Some(model) = &settings.energy_model {
        model.apply(&mut result);
    }
    Ok(result)
}

/// Returns the profile by which a policy is judged in a run of `profile`. Policies that are not from the paper have no
/// published definition of their boxes and confidences, so they are judged by the boxes that they report.
fn profile_of(policy: &str, profile: Profile) -> Profile {
    match policy {
        ExpectedLoss::NAME | ExpectedLoss::FIXED_SKIP_NAME | ExpectedLoss::EVEN_SKIP_NAME => {
            Profile::Paper
        }
        _ => profile,
    }
}

/// Computes the accuracy of `boxes`, without those in ignored regions.
pub(super) fn judge(
    clip: &Clip,
    boxes: &[Vec<ScoredBox>],
    settings: &Settings,
) -> Option<Accuracy> {
    let truth = clip.truth.as_ref()?;
    let boxes = outside_ignored(boxes, truth, &clip.ignored);
    accuracy(&boxes, truth, settings.classes, settings.interpolation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        settings: Settings,
    }

    #[test]
    fn without_arguments_the_settings_are_the_defaults() {
        let parsed = |arguments: &[&str]| Command::parse_from(arguments).settings;
        let none = parsed(&["eval"]);
        assert_eq!(format!("{none:?}"), format!("{:?}", Settings::default()));
        let set = parsed(&["eval", "--per-class", "--coco-interpolation"]);
        assert_eq!(set.classes, Classes::Separate);
        assert_eq!(set.interpolation, Interpolation::Coco101);
    }
}
