//! Searches for the value of the threshold that meets a target.

use super::estimate::Estimate;
use super::target::Target;
use super::trial::{Trial, refused, try_out};
use crate::boxes::ScoredBox;
use crate::data::Clip;
use crate::error::EvalError;
use crate::settings::ScreenRule;
use crate::settings::Settings;
use albireo_core::policy::{ExpectedLoss, PolicyConfig, ThresholdSpec, short};
use albireo_core::target::ThresholdRange;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;

/// The number of threshold values that are tried.
const VALUES: usize = 64;

/// A value of the threshold for one screen, and its figures on the recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Proposal {
    /// Name of the policy.
    pub policy: String,
    /// Name of its threshold.
    pub threshold: &'static str,
    /// The threshold's value.
    pub value: f64,
    /// The empty-scene screen: one that never says "empty", or the recorded one.
    pub screen: ScreenRule,
    /// True if target and precision are met; otherwise this value comes nearest to the target.
    pub meets_target: bool,
    /// Share of frames without the detector.
    pub skip_rate: Option<Estimate>,
    /// Share of the detector's boxes on these frames that are shown.
    pub recall: Option<Estimate>,
    /// Share of the boxes shown on these frames that the detector confirms.
    pub precision: Option<Estimate>,
    /// The figures when a value is chosen on each half of the recording's blocks and tried on the other half, both together.
    pub held_out: Option<HeldOut>,
    /// The lines for `node.toml`.
    pub node_toml: String,
}

/// The figures of values on frames that they were not chosen on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HeldOut {
    /// Recall against the detector.
    pub recall: Option<Estimate>,
    /// Share of frames without the detector.
    pub skip_rate: Option<Estimate>,
}

/// The result of the search: a proposal without a screen and, if verdicts were recorded, one with it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// The requested target.
    pub target: Target,
    /// The precision against the detector that a value must have, by the lower end of its interval.
    pub least_precision: f64,
    /// The number of clips of the recording.
    pub clips: usize,
    /// The number of frames of the recording.
    pub frames: usize,
    /// The number of the detector's boxes in the recording.
    pub boxes: usize,
    /// Detections below this confidence were not used.
    pub confidence: f64,
    /// The proposals, the best first.
    pub proposals: Vec<Proposal>,
}

impl Advice {
    /// The best proposal, if it meets the target.
    pub fn best(&self) -> Option<&Proposal> {
        self.proposals.first().filter(|best| best.meets_target)
    }
}

/// Finds the value of the threshold of `policy` that meets `target` on `clips` with a precision of at least
/// `least_precision`, within the range in which a controller would move it.
///
/// # Errors
/// [`EvalError`] when the policy cannot be built or has no threshold, or the recording has no detections.
pub fn advise(
    clips: &[Clip],
    target: Target,
    least_precision: f64,
    policy: &str,
    settings: &Settings,
) -> Result<Advice, EvalError> {
    let is_sure = |found: &&ScoredBox| found.confidence >= settings.confidence;
    let mut boxes = 0;
    for frames in clips.iter().filter_map(|clip| clip.detections.as_ref()) {
        for found in frames {
            boxes += found.iter().filter(is_sure).count();
        }
    }
    if boxes == 0 {
        return Err(EvalError::new(
            "the recording has no frame, or the detector found nothing in it at this --confidence",
        ));
    }
    let mut config = PolicyConfig::default();
    config.select(policy).map_err(refused)?;
    let Some(spec) = config.build().map_err(refused)?.threshold_spec() else {
        let what = format!("{policy}: it has no threshold to meet a target with");
        return Err(refused(what));
    };
    let mut screens = vec![ScreenRule::Nonempty];
    if clips.iter().all(|clip| clip.screen.is_some()) {
        screens.push(ScreenRule::Recorded);
    }
    let propose = |screen| {
        let search = Search {
            clips,
            config: &config,
            spec,
            screen,
            settings,
            target,
            least_precision,
        };
        search.propose()
    };
    let mut proposals = screens.into_iter().map(propose).collect::<Result<Vec<_>, _>>()?;
    // What a proposal gains beside the target that it has to meet.
    let gain = |proposal: &Proposal| {
        let figure = match target {
            Target::Recall(_) => proposal.skip_rate,
            Target::SkipRate(_) => proposal.recall,
        };
        figure.map_or(0.0, |figure| figure.value)
    };
    proposals.sort_by(|a, b| {
        let by_target = b.meets_target.cmp(&a.meets_target);
        by_target.then(gain(b).total_cmp(&gain(a)))
    });
    Ok(Advice {
        target,
        least_precision,
        clips: clips.len(),
        frames: clips.iter().map(|clip| clip.frames).sum(),
        boxes,
        confidence: settings.confidence,
        proposals,
    })
}

/// Returns rising values in logarithmic steps, rounded to two digits: over the range of a controller, beyond which accuracy
/// is lost whatever the target says, or over the useful range of a threshold that no controller moves.
fn values(policy: &str, spec: &ThresholdSpec) -> Vec<f64> {
    let (low, high) = match ThresholdRange::of(policy, Some(spec), None, None) {
        Ok(range) => (range.least, range.most),
        Err(_) => (spec.useful_minimum, spec.useful_maximum),
    };
    let value_at = |step: usize| {
        let exact = low * (high / low).powf(step as f64 / (VALUES - 1) as f64);
        let rounded = format!("{exact:.1e}").parse().unwrap_or(exact);
        rounded.clamp(spec.minimum, spec.maximum)
    };
    let mut values: Vec<f64> = (0..VALUES).map(value_at).collect();
    values.dedup();
    values
}

struct Search<'a> {
    clips: &'a [Clip],
    config: &'a PolicyConfig,
    spec: ThresholdSpec,
    screen: ScreenRule,
    settings: &'a Settings,
    target: Target,
    least_precision: f64,
}

impl Search<'_> {
    /// Returns the index of the best trial that meets the target; `trials` begin with the one that skips least. For a skip
    /// rate, it is the first that meets it. For a recall, it is the last before the first whose recall is too low, so that one
    /// lucky value after bad ones is not chosen. (Trials that skip too few frames for a narrow interval do not stop it.)
    fn best_trial(&self, trials: &[Trial]) -> Option<usize> {
        let meets = |trial: &Trial| trial.meets(self.target, self.least_precision);
        match self.target {
            Target::SkipRate(_) => trials.iter().position(meets),
            Target::Recall(least) => {
                let reaches =
                    |trial: &&Trial| trial.recall().is_none_or(|recall| recall.value >= least);
                let run = trials.iter().take_while(reaches).count();
                trials[..run].iter().rposition(meets)
            }
        }
    }

    fn propose(&self) -> Result<Proposal, EvalError> {
        let mut values = values(&self.config.name, &self.spec);
        let mut trials = values
            .par_iter()
            .map(|&value| try_out(self.clips, self.config, value, self.screen, self.settings))
            .collect::<Result<Vec<_>, _>>()?;
        let skip_rate = |trial: &Trial| trial.skip_rate().map_or(0.0, |rate| rate.value);
        // Of some policies (`ctd`) a lower threshold skips more.
        if skip_rate(&trials[0]) > skip_rate(&trials[trials.len() - 1]) {
            values.reverse();
            trials.reverse();
        }
        let best = self.best_trial(&trials);
        // If no trial meets the target, propose the one that comes nearest.
        let nearest = match self.target {
            Target::Recall(_) => 0,
            Target::SkipRate(least) => {
                let enough = trials.iter().position(|trial| skip_rate(trial) >= least);
                enough.unwrap_or(trials.len() - 1)
            }
        };
        let chosen = best.unwrap_or(nearest);
        let value = values[chosen];
        let trial = &trials[chosen];
        Ok(Proposal {
            policy: self.config.name.clone(),
            threshold: self.spec.name,
            value,
            screen: self.screen,
            meets_target: best.is_some(),
            skip_rate: trial.skip_rate(),
            recall: trial.recall(),
            precision: trial.precision(),
            held_out: self.held_out(&trials),
            node_toml: self.node_toml(value),
        })
    }

    /// Chooses a value on each half of the blocks and tries it on the other half.
    fn held_out(&self, trials: &[Trial]) -> Option<HeldOut> {
        let mut unseen = Trial::default();
        for parity in [0, 1] {
            let seen: Vec<_> = trials.iter().map(|trial| trial.half(parity)).collect();
            let chosen = self.best_trial(&seen)?;
            unseen.extend(trials[chosen].half(1 - parity));
        }
        Some(HeldOut {
            recall: unseen.recall(),
            skip_rate: unseen.skip_rate(),
        })
    }

    fn node_toml(&self, value: f64) -> String {
        let name = &self.config.name;
        let table = match name.as_str() {
            ExpectedLoss::FIXED_SKIP_NAME | ExpectedLoss::EVEN_SKIP_NAME => "in_tracker.",
            "fixed-skip" => "fixed_skip.",
            "ctd" => "ctd.",
            _ => "",
        };
        let mut number = short(value);
        // TOML reads a number without a fraction as an integer.
        if !number.contains(['.', 'e']) {
            number.push_str(".0");
        }
        let mut text = format!(
            "[policy]\nname = \"{name}\"\n{table}{} = {number}\n",
            self.spec.name
        );
        if self.screen == ScreenRule::Recorded {
            text.push_str("[screen]\nmodel = \"the model whose verdicts were recorded\"\n");
        }
        text
    }
}

#[cfg(test)]
mod tests;
