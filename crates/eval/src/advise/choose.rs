//! The search for the value of the threshold that meets a target.

use super::estimate::Estimate;
use super::target::Target;
use super::trial::{AdviceError, Screen, Settings, Trial, try_out};
use crate::data::Clip;
use albireo_core::policy::{ExpectedLoss, Knob, PolicyConfig, short};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::Serialize;

/// Values of the threshold that are tried, over its useful range.
const GRID: usize = 16;

/// Values that are tried between the last that meets the target and the first that does not.
const REFINEMENTS: usize = 6;

/// What a node would do with one value and one screen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Proposal {
    /// Name of the policy.
    pub policy: String,
    /// Name of its threshold.
    pub knob: &'static str,
    /// The threshold's value.
    pub value: f64,
    /// The screen beside it.
    pub screen: Screen,
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
/// [`AdviceError`] when the policy cannot be built or has no threshold, or there is nothing to learn from.
pub fn advise(
    clips: &[Clip],
    target: Target,
    policy: &str,
    settings: &Settings,
) -> Result<Advice, AdviceError> {
    let detections = clips
        .iter()
        .flat_map(|clip| clip.detections.iter().flatten());
    let sure = |frame: &Vec<crate::data::StoredDetection>| {
        let boxes = frame.iter();
        boxes
            .filter(|found| found.confidence >= settings.confidence)
            .count()
    };
    let boxes = detections.map(sure).sum();
    if boxes == 0 {
        return Err(AdviceError::Nothing);
    }
    let mut config = PolicyConfig::default();
    config.select(policy)?;
    let knob = config.build()?.knob().ok_or_else(|| AdviceError::NoKnob {
        policy: policy.to_owned(),
    })?;
    let mut screens = vec![Screen::None];
    if clips.iter().all(|clip| clip.screen.is_some()) {
        screens.push(Screen::Model);
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

/// With three digits, enough for a configuration.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

fn between(low: f64, high: f64, share: f64) -> f64 {
    three_digits(low * (high / low).powf(share))
}

struct Search<'a> {
    clips: &'a [Clip],
    config: &'a PolicyConfig,
    knob: Knob,
    screen: Screen,
    settings: &'a Settings,
    target: Target,
}

/// Where the target ends to be met: the trial that meets it, and the one beyond that does not, if there is one.
struct Edge {
    meets: Option<usize>,
    fails: Option<usize>,
}

impl Search<'_> {
    fn try_out(&self, value: f64) -> Result<Trial, AdviceError> {
        try_out(self.clips, self.config, value, self.screen, self.settings)
    }

    /// Among `trials`, by rising threshold. A recall is met as far as none before falls below it: a single lucky value
    /// behind bad ones is no reason. (Where little is skipped its interval is wide for want of frames, and only later says
    /// something.) A skip rate is met from the first value that meets it.
    fn edge(&self, trials: &[Trial]) -> Edge {
        let meets = |trial: &Trial| trial.meets(self.target);
        match self.target {
            Target::SkipRate(_) => {
                let first = trials.iter().position(meets);
                Edge {
                    meets: first,
                    fails: first.and_then(|first| first.checked_sub(1)),
                }
            }
            Target::Recall(least) => {
                let reaches =
                    |trial: &&Trial| trial.recall().is_none_or(|recall| recall.value >= least);
                let run = trials.iter().take_while(reaches).count();
                let meets = trials[..run].iter().rposition(meets);
                let next = meets.map(|meets| meets + 1);
                Edge {
                    meets,
                    fails: next.filter(|next| *next < trials.len()),
                }
            }
        }
    }

    fn propose(&self) -> Result<Proposal, AdviceError> {
        // Evenly spaced in the logarithm over the useful range.
        let trials = (0..GRID)
            .into_par_iter()
            .map(|step| {
                let share = step as f64 / (GRID - 1) as f64;
                let (low, high) = (self.knob.useful_minimum, self.knob.useful_maximum);
                self.try_out(between(low, high, share))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let edge = self.edge(&trials);
        let chosen = match (edge.meets, edge.fails) {
            (Some(meets), Some(fails)) => {
                self.refine(trials[meets].clone(), trials[fails].value)?
            }
            (Some(meets), None) => trials[meets].clone(),
            // The end of the range that comes nearest.
            (None, _) => match self.target {
                Target::Recall(_) => trials[0].clone(),
                Target::SkipRate(_) => trials[GRID - 1].clone(),
            },
        };
        Ok(Proposal {
            policy: self.config.name.clone(),
            knob: self.knob.name,
            value: chosen.value,
            screen: self.screen,
            meets_target: edge.meets.is_some(),
            skip_rate: chosen.skip_rate(),
            recall: chosen.recall(),
            precision: chosen.precision(),
            held_out: self.held_out(&trials),
            node_toml: self.node_toml(chosen.value),
        })
    }

    /// The value nearest to the target's edge, of two digits, and on the side that meets it.
    fn refine(&self, mut meets: Trial, mut fails: f64) -> Result<Trial, AdviceError> {
        for _ in 0..REFINEMENTS {
            let trial = self.try_out(between(meets.value, fails, 0.5))?;
            if trial.meets(self.target) {
                meets = trial;
            } else {
                fails = trial.value;
            }
        }
        let up = matches!(self.target, Target::SkipRate(_));
        let value = two_digits(meets.value, up).clamp(self.knob.minimum, self.knob.maximum);
        let rounded = self.try_out(value)?;
        Ok(if rounded.meets(self.target) {
            rounded
        } else {
            meets
        })
    }

    /// The search on one half of the blocks, tried on the other, both ways.
    fn held_out(&self, trials: &[Trial]) -> Option<HeldOut> {
        let mut joined: Option<Trial> = None;
        for parity in [0, 1] {
            let seen: Vec<_> = trials.iter().map(|trial| trial.half(parity)).collect();
            let chosen = self.edge(&seen).meets?;
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
        if self.screen == Screen::Model {
            text.push_str("[screen]\nmodel = \"the model whose verdicts were recorded\"\n");
        }
        text
    }
}

/// `value` with two digits, rounded up or down.
fn two_digits(value: f64, up: bool) -> f64 {
    if value <= 0.0 || !value.is_finite() {
        return value;
    }
    let exponent = value.log10().floor() as i32 - 1;
    let steps = value / 10f64.powi(exponent);
    // What is two digits already stays, whatever its last bit.
    let steps = if (steps - steps.round()).abs() < 1e-9 {
        steps.round()
    } else if up {
        steps.ceil()
    } else {
        steps.floor()
    };
    // By way of text, so that 3 · 1e-5 is 3e-5 and not its neighbour.
    format!("{steps}e{exponent}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests;
