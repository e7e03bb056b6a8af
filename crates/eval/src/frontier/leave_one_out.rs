//! Whether a setting was fitted to the recordings it is judged on: leave-one-sequence-out.
//!
//! A setting is tried at several values. For every clip the value is taken that is best on all *other*
//! clips, and the clip is judged with that. If the mean over the clips so judged keeps up with the best
//! single value, the choice of the value generalises; if it falls behind, the value was fitted to single
//! clips.

use super::operating_point::{Candidate, FrontierError, OperatingPoint};
use super::view::ViewedClip;
use crate::statistics::mean;
use albireo_core::policy::ExpectedLoss;
use serde::Serialize;
use std::fmt::Write;

/// Skip rates over which a value is judged, by its mean AP@50.
const SKIP_RATES: [f64; 6] = [0.24, 0.38, 0.49, 0.60, 0.70, 0.80];

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
    /// Mean AP@50 over all clips at each of the skip rates.
    pub ap50: Vec<f64>,
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
    /// Mean AP@50 at each skip rate when the value for each clip is chosen on all others.
    pub held_out: Vec<f64>,
}

impl LeaveOneOut {
    /// Number of operating points found for `variation`, for a progress bar.
    pub fn steps(variation: &Variation) -> usize {
        variation.values.len() * SKIP_RATES.len()
    }
}

/// Tries all values on all clips; `done` is called after each operating point.
///
/// # Errors
/// [`FrontierError`] when the setting or a value does not exist, or a policy fails.
pub fn leave_one_out(
    variation: &Variation,
    clips: &[ViewedClip],
    done: &dyn Fn(),
) -> Result<LeaveOneOut, FrontierError> {
    let ours = Candidate::as_reported(ExpectedLoss::NAME)?;
    let candidates: Vec<_> = variation
        .values
        .iter()
        .map(|value| ours.with_expected_loss(&variation.setting, value.clone()))
        .collect::<Result<_, _>>()?;
    let mut points = Vec::with_capacity(candidates.len());
    for candidate in &candidates {
        let at_rates: Vec<OperatingPoint> = SKIP_RATES
            .iter()
            .map(|&skip_rate| {
                let point = candidate.at_skip_rate(skip_rate, clips);
                done();
                point
            })
            .collect::<Result<_, _>>()?;
        points.push(at_rates);
    }
    let chosen: Vec<usize> = (0..clips.len())
        .map(|left_out| best_without(&points, left_out))
        .collect();
    let held_out = (0..SKIP_RATES.len())
        .map(|rate| {
            let clips = chosen.iter().enumerate();
            let ap50 = clips.map(|(clip, &value)| points[value][rate].clips[clip].ap50);
            mean(ap50).unwrap_or_default()
        })
        .collect();
    let tried = (variation.values.iter().zip(&points).enumerate())
        .map(|(index, (value, at_rates))| Tried {
            value: value.clone(),
            ap50: at_rates.iter().map(|point| point.ap50).collect(),
            chosen: chosen.iter().filter(|&&best| best == index).count(),
        })
        .collect();
    Ok(LeaveOneOut {
        setting: variation.setting.clone(),
        skip_rates: SKIP_RATES.to_vec(),
        tried,
        held_out,
    })
}

/// Index of the value with the highest AP@50 over all rates and all clips but `left_out`; the first of
/// equals.
fn best_without(points: &[Vec<OperatingPoint>], left_out: usize) -> usize {
    let total = |at_rates: &Vec<OperatingPoint>| -> f64 {
        let clips = at_rates.iter().flat_map(|point| {
            let kept = point.clips.iter().enumerate();
            kept.filter(|(clip, _)| *clip != left_out)
        });
        clips.map(|(_, figures)| figures.ap50).sum()
    };
    let mut best = (0, f64::NEG_INFINITY);
    for (index, at_rates) in points.iter().enumerate() {
        let reached = total(at_rates);
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
        row_of(&mut text, &tried.ap50);
    }
    text.push_str("| left out | |");
    row_of(&mut text, &result.held_out);
    text
}

fn row_of(text: &mut String, ap50: &[f64]) {
    for value in ap50 {
        let _ = write!(text, " {value:.4} |");
    }
    let _ = writeln!(
        text,
        " {:.4} |",
        mean(ap50.iter().copied()).unwrap_or_default()
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frontier::ClipFigures;

    fn point(ap50: &[f64]) -> OperatingPoint {
        let clips = ap50.iter().map(|&ap50| ClipFigures {
            clip: "a clip".to_owned(),
            skip_rate: 0.5,
            ap50,
            ..ClipFigures::default()
        });
        OperatingPoint {
            policy: "a policy".to_owned(),
            value: None,
            skip_rate: 0.5,
            ap50: 0.0,
            map: 0.0,
            clips: clips.collect(),
        }
    }

    #[test]
    fn a_value_that_wins_by_one_clip_alone_is_not_chosen_for_that_clip() {
        let points = [vec![point(&[0.9, 0.5, 0.5])], vec![point(&[0.5, 0.6, 0.6])]];
        assert_eq!(best_without(&points, 0), 1);
        assert_eq!(best_without(&points, 1), 0);
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
