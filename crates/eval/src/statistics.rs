//! Computes means over clips and their confidence intervals.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Half the width of the 95 % confidence interval of the mean of `values`, by Student's t. `None` for fewer than two
/// values, for one that is not finite, or when all are zero (t is 0/0 then).
pub(crate) fn half_interval(values: &[f64]) -> Option<f64> {
    let mean = MeanEstimate::of(values)?;
    Some(mean.t.inverse_cdf(0.975) * mean.standard_error)
}

/// The two-sided p of the hypothesis that the mean of `values` is zero, by Student's t; `None` as for
/// [`half_interval`].
pub(crate) fn p_value(values: &[f64]) -> Option<f64> {
    let mean = MeanEstimate::of(values)?;
    Some(2.0 * mean.t.cdf(-(mean.value / mean.standard_error).abs()))
}

/// A mean that is estimated from a sample.
struct MeanEstimate {
    value: f64,
    standard_error: f64,
    /// The distribution of the value divided by its standard error, if the true mean is zero.
    t: StudentsT,
}

impl MeanEstimate {
    fn of(values: &[f64]) -> Option<Self> {
        let count = values.len() as f64;
        if values.len() < 2 || values.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let value = values.iter().sum::<f64>() / count;
        let squares = values.iter().map(|one| (one - value).powi(2));
        let variance = squares.sum::<f64>() / (count - 1.0);
        let standard_error = (variance / count).sqrt();
        if standard_error == 0.0 && value == 0.0 {
            return None;
        }
        Some(Self {
            value,
            standard_error,
            t: StudentsT::new(0.0, 1.0, count - 1.0).ok()?,
        })
    }
}

/// The mean of `values`; `None` if there are none.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sum = 0.0;
    let mut count = 0;
    for value in values {
        sum += value;
        count += 1;
    }
    if count == 0 {
        return None;
    }
    Some(sum / f64::from(count))
}

/// The `share` quantile (0 to 1) of `sorted`, linear between neighbours as NumPy's default; `None` if
/// there are no values.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let position = share.clamp(0.0, 1.0) * last as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(last);
    let weight = position - below as f64;
    Some(sorted[below] * (1.0 - weight) + sorted[above] * weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_of_the_paired_t_test_agrees_with_scipy() {
        let values = [1.5, -0.3, 2.2, 0.7, 3.1, -1.1, 0.4, 2.8];
        let mean = mean(values).unwrap();
        let half = half_interval(&values).unwrap();
        for (found, expected) in [
            (mean - half, -0.08869166766646241),
            (mean + half, 2.4136916676664626),
            (p_value(&values).unwrap(), 0.06401329152788986),
        ] {
            let off = (found / expected - 1.0).abs();
            assert!(off <= 1e-9, "{found:e} is not {expected:e}");
        }
    }

    #[test]
    fn the_interval_of_equal_values_has_no_width() {
        assert_eq!(half_interval(&[0.5, 0.5, 0.5]), Some(0.0));
    }

    #[test]
    fn the_interval_is_absent_for_one_value_for_zeros_and_for_one_that_is_not_finite() {
        assert_eq!(half_interval(&[1.0]), None);
        assert_eq!(half_interval(&[0.0, 0.0, 0.0]), None);
        assert_eq!(half_interval(&[1.0, f64::NAN]), None);
    }

    #[test]
    fn without_values_there_is_neither_a_quantile_nor_a_mean() {
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(mean([]), None);
    }

    #[test]
    fn quantiles_lie_between_neighbours() {
        let values = [1.0, 2.0, 4.0, 8.0];
        assert_eq!(quantile(&values, 0.5), Some(3.0));
        assert_eq!(quantile(&values, 1.0), Some(8.0));
    }
}
