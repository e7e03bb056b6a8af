//! Means with confidence intervals: of values, of paired differences, and of the difference of two groups.
//!
//! Student's t throughout (Welch and Satterthwaite where variances differ); the tests compare with SciPy 1.17.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};
use utoipa::ToSchema;

/// Number, mean and spread of some values, from which those of a union follow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Moments {
    /// How many.
    pub count: u64,
    /// Arithmetic mean; 0 without values.
    pub mean: f64,
    /// Sum of the squared deviations from the mean.
    pub squares: f64,
}

impl Moments {
    /// Those of `values`; values that are not finite are left out.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut moments = Self::default();
        values.into_iter().for_each(|value| moments.add(value));
        moments
    }

    /// Those of `count` values from their sum and the sum of their squares.
    pub fn of_sums(count: u64, sum: f64, squares: f64) -> Self {
        if count == 0 {
            return Self::default();
        }
        let mean = sum / count as f64;
        Self {
            count,
            mean,
            // Rounding can leave a little less than nothing.
            squares: (squares - sum * mean).max(0.0),
        }
    }

    /// Takes the values of another group too (Chan's formula).
    pub fn merge(&mut self, other: &Self) {
        let count = self.count + other.count;
        if other.count == 0 {
            return;
        }
        let delta = other.mean - self.mean;
        let share = other.count as f64 / count as f64;
        self.squares += other.squares + delta * delta * self.count as f64 * share;
        self.mean += delta * share;
        self.count = count;
    }

    /// Takes one value more (Welford's recurrence); one that is not finite is left out.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.count += 1;
        let from_old = value - self.mean;
        self.mean += from_old / self.count as f64;
        self.squares += from_old * (value - self.mean);
    }

    /// Variance of the mean; `None` for fewer than two values.
    fn variance_of_mean(&self) -> Option<f64> {
        let count = self.count as f64;
        (self.count >= 2).then(|| self.squares / (count - 1.0) / count)
    }

    /// The mean with its interval at `level` (0.95 for 95 %); `None` for fewer than two values.
    pub fn interval(&self, level: f64) -> Option<Interval> {
        let variance = self.variance_of_mean()?;
        Interval::around(self.mean, variance, self.count as f64 - 1.0, level)
    }
}

/// A mean and where it lies with the confidence asked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Interval {
    /// The mean.
    pub mean: f64,
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

impl Interval {
    fn around(mean: f64, variance: f64, freedom: f64, level: f64) -> Option<Self> {
        if !(mean.is_finite() && variance.is_finite() && variance >= 0.0) {
            return None;
        }
        let half = if variance == 0.0 {
            0.0
        } else {
            let t = StudentsT::new(0.0, 1.0, freedom).ok()?;
            t.inverse_cdf(0.5 + level / 2.0) * variance.sqrt()
        };
        Some(Self {
            mean,
            lower: mean - half,
            upper: mean + half,
        })
    }
}

/// An estimate that is a sum of independent ones: each has a value, the variance of that value, and the degrees of
/// freedom that the variance was computed with.
pub(crate) struct Component {
    pub(crate) value: f64,
    /// Variance and degrees of freedom of each of its sources.
    pub(crate) sources: [(f64, f64); 2],
}

/// The mean of `components` with its interval, degrees of freedom after Welch and Satterthwaite. It speaks about
/// these components, not about others of their kind. `None` without one.
pub(crate) fn mean_of_components(components: &[Component], level: f64) -> Option<Interval> {
    let count = components.len() as f64;
    if components.is_empty() {
        return None;
    }
    let mean = components.iter().map(|c| c.value).sum::<f64>() / count;
    let (mut variance, mut denominator) = (0.0, 0.0);
    for (source, freedom) in components.iter().flat_map(|c| c.sources) {
        let part = source / (count * count);
        variance += part;
        denominator += part * part / freedom;
    }
    let freedom = if denominator > 0.0 {
        variance * variance / denominator
    } else {
        1.0
    };
    Interval::around(mean, variance, freedom, level)
}

/// `after` minus `before`, or that divided by `before`, as a component of a mean over nodes. `None` with fewer than two values on a
/// side, or where a relative change has nothing to relate to.
pub(crate) fn change(before: &Moments, after: &Moments, relative: bool) -> Option<Component> {
    let (var_b, var_a) = (before.variance_of_mean()?, after.variance_of_mean()?);
    let (free_b, free_a) = (before.count as f64 - 1.0, after.count as f64 - 1.0);
    if !relative {
        return Some(Component {
            value: after.mean - before.mean,
            sources: [(var_b, free_b), (var_a, free_a)],
        });
    }
    let base = before.mean;
    if base <= 0.0 {
        return None;
    }
    // The variance of a quotient of two independent means, to first order.
    let ratio = after.mean / base;
    Some(Component {
        value: ratio - 1.0,
        sources: [
            (var_b * ratio * ratio / (base * base), free_b),
            (var_a / (base * base), free_a),
        ],
    })
}

/// The difference of the means of two groups, `b` minus `a`, by Welch's t; `None` with fewer than two values in a group.
pub fn difference(a: &Moments, b: &Moments, level: f64) -> Option<Interval> {
    mean_of_components(&[change(a, b, false)?], level)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const A: [f64; 6] = [12.1, 11.4, 13.0, 12.2, 11.9, 12.7];
    const B: [f64; 5] = [10.2, 12.9, 11.1, 9.8, 10.4];

    fn near(found: Interval, expected: [f64; 3]) {
        for (found, expected) in [found.mean, found.lower, found.upper].iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn the_intervals_are_those_of_scipy() {
        // scipy.stats.t.interval(0.95, 5, numpy.mean(A), scipy.stats.sem(A))
        near(Moments::of(A).interval(0.95).unwrap(), SCIPY_MEAN);
        // scipy.stats.ttest_ind(B, A, equal_var=False).confidence_interval(0.9)
        near(
            difference(&Moments::of(A), &Moments::of(B), 0.9).unwrap(),
            SCIPY_WELCH,
        );
    }

    const SCIPY_MEAN: [f64; 3] = [12.216666666666667, 11.617783006971017, 12.815550326362317];
    const SCIPY_WELCH: [f64; 3] = [
        -1.3366666666666678,
        -2.5140031816738806,
        -0.15933015165945563,
    ];

    #[test]
    fn too_few_values_have_no_interval() {
        assert_eq!(Moments::of([1.0]).interval(0.95), None);
        assert_eq!(Moments::default().interval(0.95), None);
        assert_eq!(Moments::of([1.0, f64::NAN]).count, 1);
        let flat = Moments::of([2.0, 2.0]).interval(0.95).unwrap();
        assert_eq!((flat.lower, flat.upper), (2.0, 2.0));
    }

    #[test]
    fn a_relative_change_of_nothing_is_no_number() {
        let (zero, one) = (Moments::of([0.0, 0.0]), Moments::of([1.0, 1.1]));
        assert!(change(&zero, &one, true).is_none());
        assert!(change(&zero, &one, false).is_some());
    }

    proptest! {
        #[test]
        fn the_running_moments_are_those_of_the_textbook(values in prop::collection::vec(-1e3..1e3f64, 2..40)) {
            let moments = Moments::of(values.iter().copied());
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
            prop_assert!((moments.mean - mean).abs() < 1e-9);
            prop_assert!((moments.squares - squares).abs() <= 1e-9 * squares.max(1.0));
        }

        #[test]
        fn moments_of_parts_and_of_sums_are_those_of_the_whole(values in prop::collection::vec(1.0..1e3f64, 2..40), cut in 0usize..40) {
            let whole = Moments::of(values.iter().copied());
            let (a, b) = values.split_at(cut.min(values.len()));
            let mut merged = Moments::of(a.iter().copied());
            merged.merge(&Moments::of(b.iter().copied()));
            let (sum, squares) = values.iter().fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
            for found in [merged, Moments::of_sums(values.len() as u64, sum, squares)] {
                prop_assert_eq!(found.count, whole.count);
                prop_assert!((found.mean - whole.mean).abs() < 1e-9 * whole.mean);
                prop_assert!((found.squares - whole.squares).abs() < 1e-6 * squares);
            }
        }

        #[test]
        fn a_higher_level_never_makes_the_interval_narrower(values in prop::collection::vec(-1e3..1e3f64, 2..40), level in 0.5..0.98f64) {
            let moments = Moments::of(values);
            let (narrow, wide) = (moments.interval(level).unwrap(), moments.interval(level + 0.01).unwrap());
            prop_assert!(wide.lower <= narrow.lower && wide.upper >= narrow.upper);
            prop_assert!(narrow.lower <= narrow.mean && narrow.mean <= narrow.upper);
        }
    }
}
