//! Student's paired t-test over clips with its confidence interval, by the conventions of SciPy's `ttest_rel`.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use statrs::function::beta::beta_reg;

/// Result of a paired t-test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PairedT {
    /// Number of pairs.
    pub pairs: usize,
    /// Mean difference.
    pub mean: f64,
    /// Lower end of the 95 % confidence interval of the mean difference.
    pub lower: f64,
    /// Upper end of it.
    pub upper: f64,
    /// Student's t; its sign is that of the mean difference. Infinite when all differences are equal.
    pub t: f64,
    /// Two-sided p-value.
    pub p: f64,
}

/// The paired t-test of `differences` against zero. `None` for fewer than two pairs, for a value that is
/// not finite, or when all differences are zero (t is 0/0 then).
pub(crate) fn paired_t(differences: &[f64]) -> Option<PairedT> {
    let pairs = differences.len();
    if pairs < 2 || differences.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let count = pairs as f64;
    let mean = differences.iter().sum::<f64>() / count;
    let variance = differences
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>()
        / (count - 1.0);
    let standard_error = (variance / count).sqrt();
    if standard_error == 0.0 && mean == 0.0 {
        return None;
    }
    let freedom = count - 1.0;
    let t = mean / standard_error;
    // P(|T| > t) as an incomplete beta function: exact far out, where 1 - CDF would be rounding noise.
    let p = beta_reg(freedom / 2.0, 0.5, freedom / (freedom + t * t));
    let half = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(0.975) * standard_error;
    Some(PairedT {
        pairs,
        mean,
        lower: mean - half,
        upper: mean + half,
        t,
        p,
    })
}

/// Mean of `values`; `None` if there are none.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values
        .into_iter()
        .fold((0.0, 0_usize), |(sum, count), value| {
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

    fn close(value: f64, expected: f64) {
        assert!(
            (value - expected).abs() <= 1e-9 * expected.abs(),
            "{value:e} is not {expected:e}"
        );
    }

    const SHORT: [f64; 8] = [1.5, -0.3, 2.2, 0.7, 3.1, -1.1, 0.4, 2.8];
    #[test]
    fn the_paired_t_test_agrees_with_scipy() {
        let result = paired_t(&SHORT).expect("the test is defined");
        close(result.t, 2.1970060731010204);
        close(result.p, 0.06401329152788986);
        close(result.lower, -0.08869166766646241);
        close(result.upper, 2.4136916676664626);
        let far: Vec<f64> = (0..200).map(|i| 10.0 + f64::from(i % 7)).collect();
        let result = paired_t(&far).expect("the test is defined");
        close(result.t, 91.6070826242402);
        close(result.p, 1.1382910209936304e-164);
    }

    #[test]
    fn undefined_tests_give_nothing_instead_of_a_number() {
        assert_eq!(paired_t(&[1.0]), None);
        assert_eq!(paired_t(&[0.0, 0.0, 0.0]), None);
        assert_eq!(paired_t(&[1.0, f64::NAN]), None);
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(mean([]), None);
    }

    #[test]
    fn differences_that_are_all_equal_are_certain() {
        let result = paired_t(&[0.5, 0.5, 0.5]).expect("the test is defined");
        assert!(result.t.is_infinite());
        assert_eq!(result.p, 0.0);
        assert_eq!((result.lower, result.upper), (0.5, 0.5));
    }

    #[test]
    fn quantiles_lie_between_neighbours() {
        let values = [1.0, 2.0, 4.0, 8.0];
        assert_eq!(quantile(&values, 0.5), Some(3.0));
        assert_eq!(quantile(&values, 1.0), Some(8.0));
    }
}
