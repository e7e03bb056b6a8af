//! The search for the value of the threshold that meets a target.

use super::estimate::Estimate;
use super::target::Target;
use super::trial::{Trial, refused, try_out};
use crate::average_precision::ScoredBox;
use crate::data::Clip;
use crate::error::EvalError;
use crate::run::Settings;
use crate::source::ScreenRule;
use albireo_core::policy::{ExpectedLoss, Knob, PolicyConfig, short};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

/// Values of the threshold that are tried, over its useful range.
const VALUES: usize = 64;

/// What a node would do with one value and one screen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Proposal {
    /// Name of the policy.
    pub policy: String,
    /// Name of its threshold.
    pub knob: &'static str,
    /// The threshold's value.
    pub value: f64,
    /// What the empty-scene screen says: never "empty", or what a model said.
    pub screen: ScreenRule,
    /// Whether the target is met; if not, this is the nearest that the threshold's useful range has.
    pub meets_target: bool,
    /// Share of frames without the detector.
    pub skip_rate: Option<Estimate>,
    /// Share of the detector's boxes on these frames that are shown.
    pub recall: Option<Estimate>,
    /// Share of the boxes shown on these frames that the detector confirms.
    pub precision: Option<Estimate>,
    /// The same target sought on every second block of the recording, and what its value did on the blocks between.
    pub held_out: Option<HeldOut>,
    /// The lines for `node.toml`.
    pub node_toml: String,
}

/// What a value does on frames that it was not chosen on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HeldOut {
    /// Recall against the detector.
    pub recall: Option<Estimate>,
    /// Share of frames without the detector.
    pub skip_rate: Option<Estimate>,
}

/// The policy without a screen and, where its verdicts were recorded, with it; the proposed one first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// What was asked for.
    pub target: Target,
    /// Clips of the recording.
    pub clips: usize,
    /// Frames of the recording.
    pub frames: usize,
    /// The detector's boxes in it.
    pub boxes: usize,
    /// Detections below this were not used.
    pub confidence: f64,
    /// The candidates, the best first.
    pub proposals: Vec<Proposal>,
}

impl Advice {
    /// The candidate to take, if one meets the target.
    pub fn best(&self) -> Option<&Proposal> {
        self.proposals.first().filter(|best| best.meets_target)
    }
}

/// Finds the value of the threshold of `policy` that meets `target` on `clips`.
///
/// # Errors
/// [`EvalError`] when the policy cannot be built or has no threshold, or there is nothing to learn from.
pub fn advise(
    clips: &[Clip],
    target: Target,
    policy: &str,
    settings: &Settings,
) -> Result<Advice, EvalError> {
    let detections = clips.iter().flat_map(|clip| &clip.detections).flatten();
    let sure = |found: &&ScoredBox| found.confidence >= settings.confidence;
    let boxes = detections.flatten().filter(sure).count();
    if boxes == 0 {
        return Err(EvalError::new(
            "the recording has no frame, or the detector found nothing in it at this --confidence",
        ));
    }
    let mut config = PolicyConfig::default();
    config.select(policy).map_err(refused)?;
    let knob = config.build().map_err(refused)?.knob();
    let knob = knob.ok_or_else(|| {
        refused(format!(
            "{policy}: it has no threshold to meet a target with"
        ))
    })?;
    let mut screens = vec![ScreenRule::Nonempty];
    if clips.iter().all(|clip| clip.screen.is_some()) {
        screens.push(ScreenRule::Recorded);
    }
    let propose = |screen| {
        let search = Search {
            clips,
            config: &config,
            knob,
            screen,
            settings,
            target,
        };
        search.propose()
    };
    let mut proposals = screens
        .into_iter()
        .map(propose)
        .collect::<Result<Vec<_>, _>>()?;
    let worth = |proposal: &Proposal| {
        let figure = match target {
            Target::Recall(_) => proposal.skip_rate,
            Target::SkipRate(_) => proposal.recall,
        };
        (
            proposal.meets_target,
            figure.map_or(0.0, |figure| figure.value),
        )
    };
    proposals.sort_by(|a, b| {
        let ((a_meets, a), (b_meets, b)) = (worth(a), worth(b));
        b_meets.cmp(&a_meets).then(b.total_cmp(&a))
    });
    Ok(Advice {
        target,
        clips: clips.len(),
        frames: clips.iter().map(|clip| clip.frames).sum(),
        boxes,
        confidence: settings.confidence,
        proposals,
    })
}

/// Values of two digits over the useful range, evenly spaced in the logarithm, rising.
fn values(knob: &Knob) -> Vec<f64> {
    let (low, high) = (knob.useful_minimum, knob.useful_maximum);
    let value = |step: usize| {
        let value = low * (high / low).powf(step as f64 / (VALUES - 1) as f64);
        let rounded = format!("{value:.1e}").parse().unwrap_or(value);
        rounded.clamp(knob.minimum, knob.maximum)
    };
    let mut values: Vec<f64> = (0..VALUES).map(value).collect();
    values.dedup();
    values
}

struct Search<'a> {
    clips: &'a [Clip],
    config: &'a PolicyConfig,
    knob: Knob,
    screen: ScreenRule,
    settings: &'a Settings,
    target: Target,
}

impl Search<'_> {
    /// Which of `trials`, by rising threshold, meets the target and saves most. A recall is met as far as none before falls
    /// below it: a single lucky value behind bad ones is no reason. (Where little is skipped its interval is wide for want
    /// of frames, and only later says something.) A skip rate is met from the first value that meets it.
    fn edge(&self, trials: &[Trial]) -> Option<usize> {
        let meets = |trial: &Trial| trial.meets(self.target);
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
        let trials = (values(&self.knob).into_par_iter())
            .map(|value| try_out(self.clips, self.config, value, self.screen, self.settings))
            .collect::<Result<Vec<_>, _>>()?;
        let edge = self.edge(&trials);
        // Where none meets it, the end of the range that comes nearest.
        let nearest = match self.target {
            Target::Recall(_) => 0,
            Target::SkipRate(_) => trials.len() - 1,
        };
        let chosen = &trials[edge.unwrap_or(nearest)];
        Ok(Proposal {
            policy: self.config.name.clone(),
            knob: self.knob.name,
            value: chosen.value,
            screen: self.screen,
            meets_target: edge.is_some(),
            skip_rate: chosen.skip_rate(),
            recall: chosen.recall(),
            precision: chosen.precision(),
            held_out: self.held_out(&trials),
            node_toml: self.node_toml(chosen.value),
        })
    }

    /// The search on one half of the blocks, tried on the other, both ways.
    fn held_out(&self, trials: &[Trial]) -> Option<HeldOut> {
        let mut joined: Option<Trial> = None;
        for parity in [0, 1] {
            let seen: Vec<_> = trials.iter().map(|trial| trial.half(parity)).collect();
            let chosen = self.edge(&seen)?;
            let unseen = trials[chosen].half(1 - parity);
            match &mut joined {
                Some(joined) => joined.blocks.extend(unseen.blocks),
                None => joined = Some(unseen),
            }
        }
        let joined = joined?;
        Some(HeldOut {
            recall: joined.recall(),
            skip_rate: joined.skip_rate(),
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
        // TOML takes a number without a fraction for a whole one.
        if !number.contains(['.', 'e']) {
            number.push_str(".0");
        }
        let mut text = format!(
            "[policy]\nname = \"{name}\"\n{table}{} = {number}\n",
            self.knob.name
        );
        if self.screen == ScreenRule::Recorded {
            text.push_str("[screen]\nmodel = \"the model whose verdicts were recorded\"\n");
        }
        text
    }
}

#[cfg(test)]
mod tests;
