//! Estimates ratios over a recording with their confidence intervals.
//!
//! Consecutive frames are alike, so a thousand of them carry less information than a thousand independent ones. The
//! recording is therefore cut into blocks of consecutive frames. Every figure is a ratio of sums over the blocks, and
//! its interval follows from the spread between the blocks (the variance of a ratio estimator, with Student's t).

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// A figure with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The figure.
    #[serde(serialize_with = "rounded")]
    pub value: f64,
    /// Lower end of the interval.
    #[serde(serialize_with = "rounded")]
    pub low: f64,
    /// Upper end of the interval.
    #[serde(serialize_with = "rounded")]
    pub high: f64,
}

/// Rounds to four digits: no recording is more precise.
fn rounded<S: serde::Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    let rounded = format!("{value:.3e}").parse().unwrap_or(*value);
    serializer.serialize_f64(rounded)
}

impl Estimate {
    /// Estimates the ratio of two sums over `parts`, each a numerator and a denominator; `None` if the denominators sum
    /// to zero. A single part has no spread, so its interval is 0 to 1.
    pub(super) fn ratio(parts: impl Iterator<Item = [f64; 2]> + Clone) -> Option<Self> {
        let mut count = 0.0;
        let mut numerator = 0.0;
        let mut denominator = 0.0;
        for [above, below] in parts.clone() {
            // A part without a denominator carries no information.
            if below > 0.0 {
                count += 1.0;
                numerator += above;
                denominator += below;
            }
        }
        if denominator <= 0.0 {
            return None;
        }
        let value = numerator / denominator;
        let squares: f64 = parts
            .filter(|[_, below]| *below > 0.0)
            .map(|[above, below]| (above - value * below).powi(2))
            .sum();
        let mut estimate = Self {
            value,
            low: 0.0,
            high: 1.0,
        };
        if let Ok(t) = StudentsT::new(0.0, 1.0, count - 1.0) {
            let standard_error = (squares * count / (count - 1.0)).sqrt() / denominator;
            let reach = t.inverse_cdf(0.975) * standard_error;
            if reach.is_finite() {
                estimate.low = (value - reach).max(0.0);
                estimate.high = (value + reach).min(1.0);
            }
        }
        Some(estimate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_json_has_only_significant_digits() {
        let found = Estimate {
            value: 2.0 / 3.0,
            low: 0.0,
            high: 20_123.456,
        };
        let text = serde_json::to_string(&found).unwrap();
        assert_eq!(text, r#"{"value":0.6667,"low":0.0,"high":20120.0}"#);
    }

    #[test]
    fn the_interval_is_narrow_for_agreeing_blocks_and_wide_for_others() {
        let alike = [[9.0, 10.0], [18.0, 20.0], [9.0, 10.0], [9.0, 10.0]];
        let sure = Estimate::ratio(alike.into_iter()).unwrap();
        assert!((sure.value - 0.9).abs() < 1e-12);
        assert!(sure.high - sure.low < 1e-9);
        let apart = [[10.0, 10.0], [14.0, 20.0], [10.0, 10.0], [11.0, 10.0]];
        let unsure = Estimate::ratio(apart.into_iter()).unwrap();
        assert!(unsure.low < 0.7, "{unsure:?}");
        assert_eq!(unsure.high, 1.0);
    }

    #[test]
    fn the_interval_is_students() {
        // Of equal weight: mean .5, standard error 0.020412, t(3) = 3.182446.
        let parts = [0.45, 0.5, 0.5, 0.55].map(|value| [value, 1.0]);
        let found = Estimate::ratio(parts.into_iter()).unwrap();
        let low = 0.5 - 3.182_446 * 0.020_412;
        assert!((found.low - low).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn one_block_beside_others_without_a_denominator_has_the_interval_from_0_to_1() {
        let one = Estimate::ratio([[9.0, 10.0], [0.0, 0.0]].into_iter()).unwrap();
        assert_eq!(one.low, 0.0);
        assert_eq!(one.high, 1.0);
    }

    #[test]
    fn there_is_no_ratio_without_a_denominator() {
        assert_eq!(Estimate::ratio([[0.0, 0.0]].into_iter()), None);
    }
}
