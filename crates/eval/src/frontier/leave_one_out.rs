//! Whether a setting was fitted to the recordings it is judged on: leave-one-sequence-out.
//!
//! A setting is tried at several values. For every clip the value is taken that is best on all *other*
//! clips, and the clip is judged with that. If the mean over the clips so judged keeps up with the best
//! single value, the choice of the value generalises; if it falls behind, the value was fitted to single
//! clips. Clips of one name, those that a thinned video can begin as, are one clip, with the mean of their figures.

use super::operating_point::{Candidate, ClipFigures, FrontierError, averaged};
use super::view::ViewedClip;
use crate::statistics::mean;
use albireo_core::policy::ExpectedLoss;
use serde::Serialize;
use std::fmt::Write;

/// How the values of a setting are judged.
#[derive(Clone, Debug)]
pub struct Judging {
    policy: &'static str,
    /// The figure's name.
    figure: &'static str,
    of: fn(&ClipFigures) -> f64,
    skip_rates: Vec<f64>,
}

impl Judging {
    /// On detections alone: expected-loss, by its mean AP@50 over six skip rates.
    pub fn of_boxes() -> Self {
        Self {
            policy: ExpectedLoss::NAME,
            figure: "AP@50",
            of: |clip| clip.ap50,
            skip_rates: vec![0.24, 0.38, 0.49, 0.60, 0.70, 0.80],
        }
    }

    /// With pictures: expected-loss with optical flow, by its mean AP@75 over these skip rates.
    pub fn of_flow(skip_rates: Vec<f64>) -> Self {
        Self {
            policy: ExpectedLoss::FLOW_NAME,
            figure: "AP@75",
            of: |clip| clip.ap75,
            skip_rates,
        }
    }

    /// Number of operating points found for `variation`, for a progress bar.
    pub fn steps(&self, variation: &Variation) -> usize {
        variation.values.len() * self.skip_rates.len()
    }
}

impl std::fmt::Display for Judging {
    /// `AP@50 of expected-loss`.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} of {}", self.figure, self.policy)
    }
}

/// A setting of expected-loss and the values to try.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Variation {
    /// Its path in `[policy.expected_loss]`, such as `life.least_visible`.
    pub setting: String,
    /// The values, as in the configuration.
    pub values: Vec<serde_json::Value>,
}

/// A [`Variation`] that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not of the form SETTING=VALUE,VALUE with at least two values")]
pub struct NotAVariation(String);

impl std::str::FromStr for Variation {
    type Err = NotAVariation;

    /// `SETTING=VALUE,VALUE,…`; what is no number or truth value is a name.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || NotAVariation(text.to_owned());
        let (setting, values) = text.split_once('=').ok_or_else(wrong)?;
        let values: Vec<_> = values
            .split(',')
            .map(|value| serde_json::from_str(value).unwrap_or_else(|_| value.into()))
            .collect();
        if setting.is_empty() || values.len() < 2 || values.contains(&"".into()) {
            return Err(wrong());
        }
        Ok(Self {
            setting: setting.to_owned(),
            values,
        })
    }
}

/// One value of the setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tried {
    /// The value.
    pub value: serde_json::Value,
    /// The mean figure over all clips at each of the skip rates.
    pub figure: Vec<f64>,
    /// Number of clips for which it is the best on all others.
    pub chosen: usize,
}

/// What leaving one clip out at a time tells of a setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeaveOneOut {
    /// The setting.
    pub setting: String,
    /// The skip rates.
    pub skip_rates: Vec<f64>,
    /// Its values.
    pub tried: Vec<Tried>,
    /// The mean figure at each skip rate when the value for each clip is chosen on all others.
    pub held_out: Vec<f64>,
}

/// The figure of one value: of each skip rate, of each clip.
type Reached = Vec<Vec<f64>>;

/// Tries all values on all clips; `done` is called after each operating point.
///
/// # Errors
/// [`FrontierError`] when the setting or a value does not exist, or a policy fails.
pub fn leave_one_out(
    variation: &Variation,
    judging: &Judging,
    clips: &[ViewedClip],
    done: &dyn Fn(),
) -> Result<LeaveOneOut, FrontierError> {
    let ours = Candidate::as_reported(judging.policy)?;
    // All values are checked before the first takes its minutes.
    let candidates: Vec<_> = (variation.values.iter())
        .map(|value| ours.with_expected_loss(&variation.setting, value.clone()))
        .collect::<Result<_, _>>()?;
    let at_rate = |candidate: &Candidate, skip_rate: f64| -> Result<Vec<f64>, FrontierError> {
        let point = candidate.at_skip_rate(skip_rate, clips)?;
        done();
        Ok(averaged(&point.clips).iter().map(judging.of).collect())
    };
    let reached: Vec<Reached> = (candidates.iter())
        .map(|candidate| {
            let rates = judging.skip_rates.iter();
            rates.map(|&rate| at_rate(candidate, rate)).collect()
        })
        .collect::<Result<_, _>>()?;
    let count = reached.first().and_then(|rates| rates.first());
    let chosen: Vec<usize> = (0..count.map_or(0, Vec::len))
        .map(|left_out| best_without(&reached, left_out))
        .collect();
    let held_out = (0..judging.skip_rates.len())
        .map(|rate| {
            let clips = chosen.iter().enumerate();
            mean(clips.map(|(clip, &value)| reached[value][rate][clip])).unwrap_or_default()
        })
        .collect();
    let over_clips = |clips: &Vec<f64>| mean(clips.iter().copied()).unwrap_or_default();
    let tried = (variation.values.iter().zip(&reached).enumerate())
        .map(|(index, (value, rates))| Tried {
            value: value.clone(),
            figure: rates.iter().map(over_clips).collect(),
            chosen: chosen.iter().filter(|&&best| best == index).count(),
        })
        .collect();
    Ok(LeaveOneOut {
        setting: variation.setting.clone(),
        skip_rates: judging.skip_rates.clone(),
        tried,
        held_out,
    })
}

/// Index of the value with the highest figure over all rates and all clips but `left_out`; the first of equals.
fn best_without(reached: &[Reached], left_out: usize) -> usize {
    let total = |rates: &Reached| -> f64 {
        let clips = rates.iter().flat_map(|clips| {
            let kept = clips.iter().enumerate();
            kept.filter(|(clip, _)| *clip != left_out)
        });
        clips.map(|(_, figure)| figure).sum()
    };
    let mut best = (0, f64::NEG_INFINITY);
    for (index, rates) in reached.iter().enumerate() {
        let reached = total(rates);
        if reached > best.1 {
            best = (index, reached);
        }
    }
    best.0
}

/// The table of one setting, as Markdown.
pub fn render(result: &LeaveOneOut) -> String {
    let mut text = format!("\n## {}\n\n| value | chosen |", result.setting);
    for rate in &result.skip_rates {
        // Writing to a string cannot fail.
        let _ = write!(text, " skip {rate:.2} |");
    }
    text.push_str(" mean |\n| --- | ---: |");
    text.push_str(&" ---: |".repeat(result.skip_rates.len() + 1));
    text.push('\n');
    for tried in &result.tried {
        let value = tried.value.to_string();
        let _ = write!(text, "| {} | {} |", value.trim_matches('"'), tried.chosen);
        row_of(&mut text, &tried.figure);
    }
    text.push_str("| left out | |");
    row_of(&mut text, &result.held_out);
    text
}

fn row_of(text: &mut String, figures: &[f64]) {
    for value in figures {
        let _ = write!(text, " {value:.4} |");
    }
    let _ = writeln!(
        text,
        " {:.4} |",
        mean(figures.iter().copied()).unwrap_or_default()
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_that_wins_by_one_clip_alone_is_not_chosen_for_that_clip() {
        let reached = [vec![vec![0.9, 0.5, 0.5]], vec![vec![0.5, 0.6, 0.6]]];
        assert_eq!(best_without(&reached, 0), 1);
        assert_eq!(best_without(&reached, 1), 0);
    }

    #[test]
    fn variations_are_read_as_the_configuration_has_them() {
        let numbers: Variation = "life.least_visible=0,0.2".parse().unwrap();
        assert_eq!(numbers.values, [0.into(), serde_json::json!(0.2)]);
        let names: Variation = "call.rule=pause,frame".parse().unwrap();
        assert_eq!(names.values, ["pause", "frame"]);
        for wrong in ["life.least_visible", "a=1", "=1,2", "a=1,"] {
            assert!(wrong.parse::<Variation>().is_err(), "{wrong}");
        }
    }
}
