//! Paired tests over clips: Student's t with its confidence interval, and Wilcoxon's signed ranks.
//!
//! Both ask whether the differences of a figure between two policies on the same clips are centred on
//! zero, two-sided. The conventions are those of SciPy 1.17 (`ttest_rel`, `wilcoxon` with its defaults),
//! against which the tests compare.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use statrs::function::beta::beta_reg;
use statrs::function::erf::erfc;

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

/// Result of a Wilcoxon signed-rank test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wilcoxon {
    /// Number of pairs that differ.
    pub pairs: usize,
    /// The smaller of the two rank sums.
    pub statistic: f64,
    /// Two-sided p-value.
    pub p: f64,
    /// Whether `p` is exact; else it is the normal approximation, corrected for ties.
    pub exact: bool,
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

/// The Wilcoxon signed-rank test of `differences` against zero. Zeros are left out (Wilcoxon's own rule).
/// The p-value is exact up to 50 pairs without zeros and ties, and up to 13 pairs with them; beyond, the
/// normal approximation with tie correction and without continuity correction is used.
///
/// `None` when no pair differs or a value is not finite.
pub fn wilcoxon(differences: &[f64]) -> Option<Wilcoxon> {
    if differences.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let mut ordered: Vec<f64> = differences
        .iter()
        .copied()
        .filter(|&value| value != 0.0)
        .collect();
    let pairs = ordered.len();
    if pairs == 0 {
        return None;
    }
    ordered.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    // Twice the ranks: whole numbers even where ties share the mean of their ranks.
    let mut double_ranks = Vec::with_capacity(pairs);
    let mut tie_term = 0.0;
    for group in ordered.chunk_by(|a, b| a.abs() == b.abs()) {
        let first = double_ranks.len() + 1;
        let last = double_ranks.len() + group.len();
        double_ranks.extend(std::iter::repeat_n(first + last, group.len()));
        let size = group.len() as f64;
        tie_term += size.powi(3) - size;
    }
    let total = pairs * (pairs + 1);
    let positive: usize = ordered
        .iter()
        .zip(&double_ranks)
        .filter(|(value, _)| **value > 0.0)
        .map(|(_, rank)| rank)
        .sum();
    let smaller = positive.min(total - positive);
    let clean = tie_term == 0.0 && pairs == differences.len();
    let exact = if clean {
        differences.len() <= 50
    } else {
        differences.len() <= 13
    };
    let p = if exact {
        (2.0 * lower_tail(&double_ranks, smaller)).min(1.0)
    } else {
        let count = pairs as f64;
        let mean = count * (count + 1.0) / 4.0;
        let variance = (count * (count + 1.0) * (2.0 * count + 1.0) - tie_term / 2.0) / 24.0;
        let z = (mean - smaller as f64 / 2.0) / variance.sqrt();
        erfc(z / std::f64::consts::SQRT_2)
    };
    Some(Wilcoxon {
        pairs,
        statistic: smaller as f64 / 2.0,
        p,
        exact,
    })
}

/// Probability that the sum of a random half-chance subset of `double_ranks` is at most `limit`.
fn lower_tail(double_ranks: &[usize], limit: usize) -> f64 {
    let mut probability = vec![0.0; limit + 1];
    probability[0] = 1.0;
    for &rank in double_ranks {
        for sum in (0..=limit).rev() {
            let with = if sum >= rank {
                probability[sum - rank]
            } else {
                0.0
            };
            probability[sum] = (probability[sum] + with) / 2.0;
        }
    }
    probability.iter().sum()
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
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
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
    const TIED: [f64; 8] = [1.0, -1.0, 2.0, 2.0, 3.0, 0.0, 4.0, 5.0];

    /// 60 values with ties and zeros, both signs.
    fn long() -> Vec<f64> {
        (0..60).map(|i| f64::from((i * 37) % 23) - 8.0).collect()
    }

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
    fn the_signed_rank_test_agrees_with_scipy_exact_tied_and_approximate() {
        let exact = wilcoxon(&SHORT).expect("the test is defined");
        assert!(exact.exact);
        close(exact.statistic, 5.0);
        close(exact.p, 0.078125);
        let tied = wilcoxon(&TIED).expect("the test is defined");
        assert!(tied.exact);
        close(tied.statistic, 1.5);
        close(tied.p, 0.046875);
        let approximate = wilcoxon(&long()).expect("the test is defined");
        assert!(!approximate.exact);
        close(approximate.statistic, 474.5);
        close(approximate.p, 0.0031533488349645717);
    }

    #[test]
    fn undefined_tests_give_nothing_instead_of_a_number() {
        assert_eq!(paired_t(&[1.0]), None);
        assert_eq!(paired_t(&[0.0, 0.0, 0.0]), None);
        assert_eq!(paired_t(&[1.0, f64::NAN]), None);
        assert_eq!(wilcoxon(&[0.0, 0.0]), None);
        assert_eq!(wilcoxon(&[]), None);
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
