//! The search for the candidate that meets a target best.

use super::estimate::Estimate;
use super::recording::Recording;
use super::target::Target;
use super::trial::{AdviceError, Prepared, Rates, Screen, Settings, Trial, try_out};
use albireo_core::policy::{Albireo, ExpectedLoss, Knob, PolicyConfig, short};
use rayon::iter::{IndexedParallelIterator, IntoParallelRefIterator, ParallelIterator};
use rayon::slice::ParallelSlice;
use serde::Serialize;

/// Policies that are tried unless others are named: the paper's, our own, and calls by the calendar.
const POLICIES: [&str; 3] = [
    Albireo::NAME,
    ExpectedLoss::NAME,
    ExpectedLoss::EVEN_SKIP_NAME,
];

/// Values of a knob that are tried, over its useful range.
const GRID: usize = 16;

/// Values that are tried between the last that meets the target and the first that does not.
const REFINEMENTS: usize = 6;

/// What a node would do with one candidate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Proposal {
    /// Name of the policy.
    pub policy: String,
    /// Name of its knob.
    pub knob: &'static str,
    /// The knob's value.
    pub value: f64,
    /// The screen beside it.
    pub screen: Screen,
    /// Whether the target is met; if not, this is the nearest that the knob's useful range has.
    pub meets_target: bool,
    /// Share of frames without the detector.
    pub skip_rate: Option<Estimate>,
    /// Share of the detector's boxes on these frames that are shown.
    pub recall: Option<Estimate>,
    /// Share of the boxes shown on these frames that the detector confirms.
    pub precision: Option<Estimate>,
    /// Milliseconds of detector a second.
    pub detector_ms_per_s: Option<Estimate>,
    /// Watts a camera, projected with the energy model.
    pub watts: Option<Estimate>,
    /// Share of the energy on frames that is saved against the detector on every frame, projected.
    pub energy_saved: Option<Estimate>,
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

/// All candidates, the proposed one first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// What was asked for.
    pub target: Target,
    /// Clips of the recording.
    pub clips: usize,
    /// Frames of the recording.
    pub frames: usize,
    /// Its length, where the frame rate is known.
    pub seconds: Option<f64>,
    /// The detector's boxes in it.
    pub boxes: usize,
    /// Detections below this were not used.
    pub confidence: f64,
    /// Where watts and joules come from.
    pub energy_model: Option<String>,
    /// The candidates, the best first.
    pub proposals: Vec<Proposal>,
}

impl Advice {
    /// The candidate to take, if one meets the target.
    pub fn best(&self) -> Option<&Proposal> {
        self.proposals.first().filter(|best| best.meets_target)
    }
}

struct Candidate {
    config: PolicyConfig,
    knob: Knob,
    screen: Screen,
}

/// Finds the best candidate for `target` on `recordings`; `policies` are those to try, or none for the usual ones.
/// `begun` is told how many steps there are, `done` is called after each, from any thread.
///
/// # Errors
/// [`AdviceError`] when a policy cannot be built, a figure that the target is about is unknown, or there is nothing to
/// learn from.
pub fn advise(
    recordings: &[Recording],
    target: Target,
    policies: &[String],
    settings: &Settings,
    begun: &dyn Fn(usize),
    done: &(dyn Fn() + Sync),
) -> Result<Advice, AdviceError> {
    let prepared: Vec<_> = (recordings.iter())
        .map(|recording| Prepared::new(recording, settings.confidence))
        .collect();
    let frames = prepared.iter().map(Prepared::frames).sum();
    let boxes = prepared.iter().map(Prepared::boxes).sum();
    if boxes == 0 {
        return Err(AdviceError::Nothing);
    }
    let rates = Rates::new(&settings.costs, recordings);
    rates.suffice_for(target)?;
    let candidates = candidates(recordings, policies)?;
    begun(candidates.len() * (GRID + REFINEMENTS + 1));
    let search = Search {
        prepared: &prepared,
        settings,
        rates: &rates,
        target,
        done,
    };
    let steps: Vec<(usize, usize)> = (0..candidates.len())
        .flat_map(|candidate| (0..GRID).map(move |step| (candidate, step)))
        .collect();
    let trials = steps
        .par_iter()
        .map(|&(candidate, step)| {
            let candidate = &candidates[candidate];
            search.try_out(candidate, grid(&candidate.knob, step))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut proposals = candidates
        .par_iter()
        .zip(trials.par_chunks(GRID))
        .map(|(candidate, trials)| search.propose(candidate, trials))
        .collect::<Result<Vec<_>, _>>()?;
    proposals.sort_by(|(a, a_worth), (b, b_worth)| {
        (b.meets_target.cmp(&a.meets_target)).then(b_worth.total_cmp(a_worth))
    });
    Ok(Advice {
        target,
        clips: recordings.len(),
        frames,
        seconds: rates.frame_rate.map(|rate| frames as f64 / rate),
        boxes,
        confidence: settings.confidence,
        energy_model: rates
            .model
            .as_ref()
            .map(|model| format!("{} with {}", model.board, model.detector)),
        proposals: proposals
            .into_iter()
            .map(|(proposal, _)| proposal)
            .collect(),
    })
}

fn candidates(
    recordings: &[Recording],
    policies: &[String],
) -> Result<Vec<Candidate>, AdviceError> {
    let mut screens = vec![Screen::None];
    if recordings.iter().all(|known| known.clip.screen.is_some()) {
        screens.push(Screen::Model);
    }
    let usual = POLICIES.map(str::to_owned);
    let asked = if policies.is_empty() {
        &usual[..]
    } else {
        policies
    };
    let mut candidates = Vec::new();
    for name in asked {
        let refused = |source| AdviceError::Policy {
            policy: name.clone(),
            source,
        };
        let mut config = PolicyConfig::default();
        config.select(name).map_err(refused)?;
        let policy = config.build().map_err(refused)?;
        let knob = policy.knob().ok_or_else(|| AdviceError::NoKnob {
            policy: name.clone(),
        })?;
        candidates.extend(screens.iter().map(|&screen| Candidate {
            config: config.clone(),
            knob,
            screen,
        }));
    }
    Ok(candidates)
}

/// The value at a step of the search, evenly spaced in its logarithm over the useful range.
fn grid(knob: &Knob, step: usize) -> f64 {
    let share = step as f64 / (GRID - 1) as f64;
    between(knob.useful_minimum, knob.useful_maximum, share)
}

/// With three digits: nobody wants to put more into a configuration.
fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

fn between(low: f64, high: f64, share: f64) -> f64 {
    three_digits(low * (high / low).powf(share))
}

struct Search<'a> {
    prepared: &'a [Prepared<'a>],
    settings: &'a Settings,
    rates: &'a Rates,
    target: Target,
    done: &'a (dyn Fn() + Sync),
}

/// Where the target ends to be met: the trial that meets it, and the one beyond that does not, if there is one.
struct Edge {
    meets: Option<usize>,
    fails: Option<usize>,
}

impl Search<'_> {
    fn try_out(&self, candidate: &Candidate, value: f64) -> Result<Trial, AdviceError> {
        let (config, screen) = (&candidate.config, candidate.screen);
        let trial = try_out(self.prepared, config, value, screen, self.settings);
        (self.done)();
        trial
    }

    /// Whether a higher knob, which saves more, is what meets the target.
    fn wants_saving(&self) -> bool {
        !matches!(self.target, Target::Recall(_))
    }

    fn meets(&self, trial: &Trial) -> bool {
        trial.meets(self.target, self.rates)
    }

    /// Whether the recall itself reaches what its interval is to reach.
    fn may_meet(&self, trial: &Trial) -> bool {
        match self.target {
            Target::Recall(least) => trial.recall().is_none_or(|recall| recall.value >= least),
            _ => self.meets(trial),
        }
    }

    /// Among `trials`, by rising knob. A recall is met as far as none before falls below it: a single lucky value behind bad
    /// ones is no reason. (Where little is skipped its interval is wide for want of frames, and only later says something.)
    /// A load is met from the first value that meets it.
    fn edge(&self, trials: &[Trial]) -> Edge {
        if self.wants_saving() {
            let first = trials.iter().position(|trial| self.meets(trial));
            Edge {
                meets: first,
                fails: first.and_then(|first| first.checked_sub(1)),
            }
        } else {
            let run = trials
                .iter()
                .take_while(|trial| self.may_meet(trial))
                .count();
            let meets = trials[..run].iter().rposition(|trial| self.meets(trial));
            let next = meets.map(|meets| meets + 1);
            Edge {
                meets,
                fails: next.filter(|next| *next < trials.len()),
            }
        }
    }

    /// The proposal, and what it is worth among those that meet the target.
    fn propose(
        &self,
        candidate: &Candidate,
        trials: &[Trial],
    ) -> Result<(Proposal, f64), AdviceError> {
        let edge = self.edge(trials);
        let chosen = match edge.meets {
            // The end of the range that comes nearest.
            None if self.wants_saving() => trials.last().cloned(),
            None => trials.first().cloned(),
            Some(index) => {
                let meets = trials[index].clone();
                Some(match edge.fails {
                    None => meets,
                    Some(fails) => self.refine(candidate, meets, trials[fails].value)?,
                })
            }
        };
        let chosen = chosen.ok_or(AdviceError::Nothing)?;
        let model = self.rates.model.as_ref();
        let joules = model.and_then(|model| chosen.joules_per_frame(model));
        let energy_saved = model.zip(joules).map(|(model, joules)| {
            let whole = model.energy_j.detector;
            Estimate {
                value: 1.0 - joules.value / whole,
                low: 1.0 - joules.high / whole,
                high: 1.0 - joules.low / whole,
            }
        });
        let skip_rate = chosen.skip_rate();
        let worth = match self.target {
            Target::Recall(_) => energy_saved.or(skip_rate).map_or(0.0, |saved| saved.value),
            // Not by precision: a policy that rescues shows what the detector misses, and is right more often than not.
            _ => chosen.recall().map_or(1.0, |recall| recall.value),
        };
        let proposal = Proposal {
            policy: candidate.config.name.clone(),
            knob: candidate.knob.name,
            value: chosen.value,
            screen: candidate.screen,
            meets_target: edge.meets.is_some(),
            skip_rate,
            recall: chosen.recall(),
            precision: chosen.precision(),
            detector_ms_per_s: chosen.detector_ms_per_s(self.rates),
            watts: chosen.watts(self.rates),
            energy_saved,
            held_out: self.held_out(trials),
            node_toml: node_toml(candidate, chosen.value),
        };
        Ok((proposal, worth))
    }

    /// The value nearest to the target's edge, of two digits, and on the side that meets it.
    fn refine(
        &self,
        candidate: &Candidate,
        mut meets: Trial,
        mut fails: f64,
    ) -> Result<Trial, AdviceError> {
        for _ in 0..REFINEMENTS {
            let trial = self.try_out(candidate, between(meets.value, fails, 0.5))?;
            if self.meets(&trial) {
                meets = trial;
            } else {
                fails = trial.value;
            }
        }
        let value = two_digits(meets.value, self.wants_saving());
        let value = value.clamp(candidate.knob.minimum, candidate.knob.maximum);
        let rounded = self.try_out(candidate, value)?;
        Ok(if self.meets(&rounded) { rounded } else { meets })
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
}

/// `value` with two digits, rounded up or down.
fn two_digits(value: f64, up: bool) -> f64 {
    if value <= 0.0 || !value.is_finite() {
        return value;
    }
    let unit = 10f64.powi(value.log10().floor() as i32 - 1);
    let steps = value / unit;
    // What is two digits already stays, whatever its last bit.
    let steps = if (steps - steps.round()).abs() < 1e-9 {
        steps.round()
    } else if up {
        steps.ceil()
    } else {
        steps.floor()
    };
    // By way of text, so that 3 · 1e-5 is 3e-5 and not its neighbour.
    let exponent = value.log10().floor() as i32 - 1;
    format!("{steps}e{exponent}").parse().unwrap_or(value)
}

/// Where the knob stands in `[policy]`.
fn key(candidate: &Candidate) -> String {
    let table = match candidate.config.name.as_str() {
        ExpectedLoss::FIXED_SKIP_NAME | ExpectedLoss::EVEN_SKIP_NAME => "in_tracker.",
        "fixed-skip" => "fixed_skip.",
        "ctd" => "ctd.",
        "adaptive-rate" => "adaptive_rate.",
        _ => "",
    };
    format!("{table}{}", candidate.knob.name)
}

fn node_toml(candidate: &Candidate, value: f64) -> String {
    let mut text = format!(
        "[policy]\nname = \"{}\"\n{} = {}\n",
        candidate.config.name,
        key(candidate),
        toml_number(value)
    );
    match candidate.screen {
        Screen::None => {}
        Screen::Model => {
            text.push_str("[screen]\nmodel = \"the model whose verdicts were recorded\"\n")
        }
    }
    text
}

/// A number that TOML takes for one with a fraction.
fn toml_number(value: f64) -> String {
    let text = short(value);
    if text.contains(['.', 'e']) {
        text
    } else {
        format!("{text}.0")
    }
}

#[cfg(test)]
mod tests;
