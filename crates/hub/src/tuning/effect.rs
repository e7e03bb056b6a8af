//! Estimates the effect of a change: compares nodes that got it with nodes that did not, over the same hours.
//!
//! The gates of rollouts and the trials share this estimator. It works in four steps.
//!
//! 1. **One number per node.** A node's change is `ln(after / before)` of its mean over a window before and a window after, or
//!    `after - before` for a figure that is a share. The logarithm matters: if a node's level varies by σ from hour to hour,
//!    the mean of `after / before` is `exp(σ²)` without any effect, 17 % too much at σ = 0.4; the mean of the logarithm is 0.
//!    The clips of a node are never counted as independent, because neighbouring clips show the same road.
//! 2. **Minus the change of the others.** The same number is computed for nodes that were not given it yet, over the same hours,
//!    and their typical change is subtracted. This removes rush hour, weather and season.
//! 3. **Typical, not mean.** A node that reports nonsense must not decide. The typical change of a group is its mean without
//!    the lowest and highest fifth. Its variance is the winsorised one (those fifths moved to their neighbours), after
//!    Tukey and McLaughlin; the difference of two groups is tested by Yuen's t with Welch's degrees of freedom. If more than a
//!    fifth of the nodes lie, the variance grows and the verdict is undecided, which is the safe side.
//! 4. **Nodes that fall silent** contribute nothing to step 1, so they are compared separately: Fisher's exact test compares
//!    how many changed and how many unchanged nodes are silent, of those that were in reach when the change began.
//!
//! With fewer than [`FEWEST_NODES`] measured nodes in a group there is no estimate, because the variance between nodes is not
//! known.

use super::metric::{BeforeAfter, Figure, Means};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, DiscreteCDF, Hypergeometric, StudentsT};
use statrs::statistics::Statistics;
use utoipa::ToSchema;

/// Fewest measured nodes in each group.
pub(crate) const FEWEST_NODES: usize = 8;

/// Share of a group's nodes that is left out at each end.
const TRIMMED: f64 = 0.2;

/// The scale on which the change of one node is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// `ln(after / before)`.
    Relative,
    /// `after - before`.
    Absolute,
}

impl Scale {
    /// The change of one node from its means; `None` if it is not defined.
    pub fn change(self, before: f64, after: f64) -> Option<f64> {
        let change = match self {
            Self::Relative if before > 0.0 && after > 0.0 => (after / before).ln(),
            Self::Relative => return None,
            Self::Absolute => after - before,
        };
        change.is_finite().then_some(change)
    }

    /// Converts an estimate to a share of the value before, or to the figure's unit.
    fn shown(self, change: f64) -> f64 {
        match self {
            Self::Relative => change.exp_m1(),
            Self::Absolute => change,
        }
    }
}

/// The confidence interval of a change: a share of the value before, or in the figure's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Interval {
    /// The estimate.
    pub estimate: f64,
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

/// The difference between the typical changes of two groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    scale: Scale,
    change: f64,
    /// Standard error of `change`.
    error: f64,
    /// Degrees of freedom of `error`; not a number if that is zero.
    freedom: f64,
}

impl Effect {
    /// Compares the changes of two groups of nodes. `None` if either has fewer than [`FEWEST_NODES`].
    pub fn of(scale: Scale, changed: &[f64], unchanged: &[f64]) -> Option<Self> {
        let a = Typical::of(changed)?;
        let b = Typical::of(unchanged)?;
        let variance = a.variance + b.variance;
        Some(Self {
            scale,
            change: a.mean - b.mean,
            error: variance.sqrt(),
            freedom: variance * variance
                / (a.variance.powi(2) / a.freedom + b.variance.powi(2) / b.freedom),
        })
    }

    /// The interval that misses the true value with a probability of `miss` on each side.
    pub fn interval(&self, miss: f64) -> Interval {
        // Without any variance there are no degrees of freedom, and no doubt.
        let t = StudentsT::new(0.0, 1.0, self.freedom).map_or(0.0, |t| t.inverse_cdf(1.0 - miss));
        let half = t * self.error;
        Interval {
            estimate: self.scale.shown(self.change),
            lower: self.scale.shown(self.change - half),
            upper: self.scale.shown(self.change + half),
        }
    }
}

/// One figure of changed nodes compared with unchanged ones, over the same hours.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Comparison {
    /// The number of changed nodes with enough clips before and after.
    pub(crate) nodes: usize,
    /// The number of unchanged nodes with enough clips over the same hours.
    pub(crate) compared: usize,
    /// Means over the changed nodes.
    pub(crate) means: Option<Means>,
    /// The effect; `None` with too few nodes.
    pub(crate) effect: Option<Effect>,
}

impl Comparison {
    /// Compares the nodes that have at least `fewest` clips of `figure` before and after.
    pub(crate) fn of(
        figure: Figure,
        scale: Scale,
        changed: &[&BeforeAfter],
        unchanged: &[&BeforeAfter],
        fewest: u64,
    ) -> Self {
        let measured = |nodes: &[&BeforeAfter]| {
            let mut all = MeasuredNodes::default();
            for node in nodes {
                if let Some(means) = node.means(figure, fewest)
                    && let Some(change) = scale.change(means.before, means.after)
                {
                    all.before.push(means.before);
                    all.after.push(means.after);
                    all.changes.push(change);
                }
            }
            all
        };
        let own = measured(changed);
        let others = measured(unchanged);
        let means = if own.changes.is_empty() {
            None
        } else {
            Some(Means {
                before: own.before.iter().mean(),
                after: own.after.iter().mean(),
            })
        };
        Self {
            nodes: own.changes.len(),
            compared: others.changes.len(),
            means,
            effect: Effect::of(scale, &own.changes, &others.changes),
        }
    }
}

/// The means before and after, and the changes, of the nodes that have all three.
#[derive(Default)]
struct MeasuredNodes {
    before: Vec<f64>,
    after: Vec<f64>,
    changes: Vec<f64>,
}

/// A group's trimmed mean, with the variance of that mean.
struct Typical {
    mean: f64,
    variance: f64,
    freedom: f64,
}

impl Typical {
    fn of(changes: &[f64]) -> Option<Self> {
        let count = changes.len();
        if count < FEWEST_NODES {
            return None;
        }
        let mut sorted = changes.to_vec();
        sorted.sort_by(f64::total_cmp);
        let trimmed = (TRIMMED * count as f64) as usize;
        let kept = &sorted[trimmed..count - trimmed];
        let pulled_in = sorted.iter().map(|change| change.clamp(kept[0], kept[kept.len() - 1]));
        let freedom = kept.len() as f64 - 1.0;
        Some(Self {
            mean: kept.mean(),
            // By the numbers kept: k·(k − 1), of which the degrees of freedom are k − 1.
            variance: pulled_in.variance() * (count as f64 - 1.0) / (freedom * (freedom + 1.0)),
            freedom,
        })
    }
}

/// The silent nodes of a group, of those that were in reach when the change began.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Silence {
    /// The number of nodes in reach at the beginning.
    pub(crate) nodes: u64,
    /// The number of these that are silent now.
    pub(crate) silent: u64,
}

impl Silence {
    /// The probability that at least this many nodes of the group are silent by chance: Fisher's exact test, one-sided. It
    /// is 1 without nodes to compare with.
    pub(crate) fn by_chance(self, others: Self) -> f64 {
        if self.silent == 0 || others.nodes == 0 {
            return 1.0;
        }
        let all = self.nodes + others.nodes;
        let silent = self.silent + others.silent;
        Hypergeometric::new(all, silent, self.nodes).map_or(1.0, |drawn| drawn.sf(self.silent - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: f64, expected: f64) {
        let most = 1e-9 * expected.abs().max(1.0);
        assert!((found - expected).abs() < most, "{found} {expected}");
    }

    #[test]
    fn the_interval_equals_an_independent_computation() {
        // SciPy 1.17: ttest_ind(a, b, equal_var=False, trim=0.2), its df and confidence_interval(0.95).
        let a: Vec<f64> = (0..11).map(|i| f64::from(i * i % 13) / 10.0).collect();
        let b: Vec<f64> = (0..9).map(|i| f64::from(i * 7 % 11) / 20.0).collect();
        let effect = Effect::of(Scale::Absolute, &a, &b).unwrap();
        near(effect.change / effect.error, 2.495504630346904);
        near(effect.freedom, 8.042976729627537);
        let interval = effect.interval(0.025);
        near(interval.lower, 0.034557974384710644);
        near(interval.upper, 0.8654420256152893);
    }

    #[test]
    fn a_relative_change_from_or_to_zero_is_no_number() {
        assert_eq!(Scale::Relative.change(0.0, 1.0), None);
        assert_eq!(Scale::Relative.change(1.0, 0.0), None);
        assert_eq!(Scale::Relative.change(1.0, f64::INFINITY), None);
        assert_eq!(Scale::Absolute.change(0.0, 0.5), Some(0.5));
    }

    #[test]
    fn silence_is_judged_by_fishers_test() {
        let silence = |nodes, silent| Silence { nodes, silent };
        // scipy.stats.fisher_exact([[5, 5], [10, 80]], alternative="greater")
        let half = silence(10, 5).by_chance(silence(90, 10));
        near(half, 0.00631392472093203);
        assert_eq!(silence(10, 0).by_chance(silence(90, 10)), 1.0);
        assert_eq!(silence(1, 1).by_chance(silence(0, 0)), 1.0);
        assert!(silence(9, 9).by_chance(silence(90, 18)) < 1e-5);
    }
}
