//! Computes means over clips and their confidence intervals.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Half the width of the 95 % confidence interval of the mean of `values`, by Student's t. `None` for fewer than two values,
/// for one that is not finite, or when all are zero (t is 0/0 then).
pub(crate) fn half_interval(values: &[f64]) -> Option<f64> {
    let (_, standard_error, t) = students_t(values)?;
    Some(t.inverse_cdf(0.975) * standard_error)
}

/// The two-sided p of the hypothesis that the mean of `values` is zero, by Student's t; `None` as for [`half_interval`].
pub(crate) fn p_value(values: &[f64]) -> Option<f64> {
    let (mean, standard_error, t) = students_t(values)?;
    Some(2.0 * t.cdf(-(mean / standard_error).abs()))
}

/// Returns the mean of `values`, its standard error, and the distribution of their quotient.
fn students_t(values: &[f64]) -> Option<(f64, f64, StudentsT)> {
    let count = values.len() as f64;
    if values.len() < 2 || values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean).powi(2));
    let variance = squares.sum::<f64>() / (count - 1.0);
    let standard_error = (variance / count).sqrt();
    if standard_error == 0.0 && mean == 0.0 {
        return None;
    }
    Some((
        mean,
        standard_error,
        StudentsT::new(0.0, 1.0, count - 1.0).ok()?,
    ))
}

/// The mean of `values`; `None` if there are none.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.into_iter().fold((0.0, 0_usize), |(sum, count), value| {
        (sum + value, count + 1)
    });
    (count > 0).then(|| sum / count as f64)
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
    fn undefined_figures_are_absent_and_equal_differences_certain() {
        assert_eq!(half_interval(&[0.5, 0.5, 0.5]), Some(0.0));
        assert_eq!(half_interval(&[1.0]), None);
        assert_eq!(half_interval(&[0.0, 0.0, 0.0]), None);
        assert_eq!(half_interval(&[1.0, f64::NAN]), None);
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
