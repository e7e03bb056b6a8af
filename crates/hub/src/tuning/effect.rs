//! Estimates what a change did: nodes that got it beside nodes that did not, over the same hours.
//!
//! Gates of rollouts and trials use this one estimator. It works in four steps.
//!
//! 1. **One number per node.** A node's change is `ln(after / before)` of its mean over a window before and a window after, or
//!    `after - before` for a figure that is a share. The logarithm matters: where a node's level varies by σ from hour to hour, the
//!    mean of `after / before` is `exp(σ²)` without any effect, 17 % too much at σ = 0.4. The mean of the logarithm is 0. The
//!    clips of a node never count one by one, because neighbouring clips show the same road.
//! 2. **Less what happened anyway.** The same number is taken of nodes that were not asked yet, over the same hours. Their
//!    typical change is subtracted, and with it rush hour, weather and season.
//! 3. **Typical, not mean.** A node that reports nonsense must not decide. The typical change of a group is its mean without
//!    the lowest and highest fifth. Its variance is the winsorised one (those fifths pulled in to their neighbours), after
//!    Tukey and McLaughlin; the difference of two groups is judged by Yuen's t, degrees of freedom after Welch. With more
//!    liars than the fifth holds the variance explodes and nothing is decided, which is the safe side.
//! 4. **Nodes that fall silent** report nothing to step 1, so they are compared by themselves: how many of the nodes that were in
//!    reach when they were asked are silent now, and how many of the others, by Fisher's exact test.
//!
//! With fewer than [`FEWEST_NODES`] measured nodes in a group there is no estimate: the variance between nodes cannot be known.

use super::metric::{BeforeAfter, Figure};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, DiscreteCDF, Hypergeometric, StudentsT};
use utoipa::ToSchema;

/// Fewest measured nodes in each group.
pub(crate) const FEWEST_NODES: usize = 8;

/// Share of a group's nodes that is left out at each end.
const TRIMMED: f64 = 0.2;

/// How the change of one node is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// `ln(after / before)`.
    Relative,
    /// `after - before`.
    Absolute,
}

impl Scale {
    /// The change of one node from its means; `None` where it is not defined.
    pub fn change(self, before: f64, after: f64) -> Option<f64> {
        let change = match self {
            Self::Relative if before > 0.0 && after > 0.0 => (after / before).ln(),
            Self::Relative => return None,
            Self::Absolute => after - before,
        };
        change.is_finite().then_some(change)
    }

    /// An estimate on this scale as people read it: a share of the value before, or the figure's unit.
    fn shown(self, change: f64) -> f64 {
        match self {
            Self::Relative => change.exp_m1(),
            Self::Absolute => change,
        }
    }
}

/// Where a change lies: a share of the value before, or in the figure's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Interval {
    /// The estimate.
    pub estimate: f64,
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

/// The typical change of one group over that of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    scale: Scale,
    change: f64,
    /// Standard error of `change`.
    error: f64,
    /// Degrees of freedom of `error`.
    freedom: f64,
}

impl Effect {
    /// Compares the changes of nodes that got the new value with those of nodes that did not. `None` with fewer than
    /// [`FEWEST_NODES`] in either group.
    pub fn of(scale: Scale, changed: &[f64], unchanged: &[f64]) -> Option<Self> {
        let (a, b) = (Typical::of(changed)?, Typical::of(unchanged)?);
        let variance = a.variance + b.variance;
        let freedom = if variance > 0.0 {
            variance * variance / (a.variance.powi(2) / a.freedom + b.variance.powi(2) / b.freedom)
        } else {
            a.freedom + b.freedom
        };
        Some(Self {
            scale,
            change: a.mean - b.mean,
            error: variance.sqrt(),
            freedom,
        })
    }

    /// The interval that leaves out the truth with a probability of `miss` on each side.
    pub fn interval(&self, miss: f64) -> Interval {
        let t = StudentsT::new(0.0, 1.0, self.freedom)
            .map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - miss));
        let half = if self.error > 0.0 {
            t * self.error
        } else {
            0.0
        };
        Interval {
            estimate: self.scale.shown(self.change),
            lower: self.scale.shown(self.change - half),
            upper: self.scale.shown(self.change + half),
        }
    }
}

/// One figure of nodes that got the new value beside nodes that did not, over the same hours.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Comparison {
    /// Nodes that got it with enough clips before and after.
    pub(crate) nodes: usize,
    /// Nodes that did not with enough clips over the same hours.
    pub(crate) compared: usize,
    /// Mean over the nodes that got it, before and after.
    pub(crate) means: Option<(f64, f64)>,
    /// The change; absent with too few nodes.
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
        let measured = |nodes: &[&BeforeAfter]| -> (Vec<(f64, f64)>, Vec<f64>) {
            let means = nodes.iter().filter_map(|node| node.means(figure, fewest));
            let both = means.filter_map(|mean| Some((mean, scale.change(mean.0, mean.1)?)));
            both.unzip()
        };
        let (means, own) = measured(changed);
        let (_, others) = measured(unchanged);
        let average =
            |side: fn(&(f64, f64)) -> f64| means.iter().map(side).sum::<f64>() / means.len() as f64;
        Self {
            nodes: own.len(),
            compared: others.len(),
            means: (!own.is_empty()).then(|| (average(|mean| mean.0), average(|mean| mean.1))),
            effect: Effect::of(scale, &own, &others),
        }
    }
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
        let (lowest, highest) = (kept[0], kept[kept.len() - 1]);
        let mean = kept.iter().sum::<f64>() / kept.len() as f64;
        let pulled_in = || sorted.iter().map(|change| change.clamp(lowest, highest));
        let center = pulled_in().sum::<f64>() / count as f64;
        let squares: f64 = pulled_in().map(|change| (change - center).powi(2)).sum();
        let kept = kept.len() as f64;
        Some(Self {
            mean,
            variance: squares / (kept * (kept - 1.0)),
            freedom: kept - 1.0,
        })
    }
}

/// How many nodes of a group are silent, of those that were in reach when the change began.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Silence {
    /// Nodes in reach at the beginning.
    pub(crate) nodes: u64,
    /// Of these, silent now.
    pub(crate) silent: u64,
}

impl Silence {
    /// The probability that this many of this group are silent, or more, if the change has nothing to do with it: Fisher's
    /// exact test, one side. 1 without nodes to compare with.
    pub(crate) fn by_chance(self, others: Self) -> f64 {
        if self.silent == 0 || others.nodes == 0 {
            return 1.0;
        }
        let (all, silent) = (self.nodes + others.nodes, self.silent + others.silent);
        Hypergeometric::new(all, silent, self.nodes).map_or(1.0, |drawn| drawn.sf(self.silent - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_core::{RngCore, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn near(found: f64, expected: f64) {
        assert!(
            (found - expected).abs() < 1e-9 * expected.abs().max(1.0),
            "{found} {expected}"
        );
    }

    #[test]
    fn the_interval_is_that_of_an_independent_computation() {
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
    fn fewer_than_eight_nodes_are_no_estimate() {
        let (seven, eight) = ([0.1; 7], [0.1; 8]);
        assert!(Effect::of(Scale::Relative, &seven, &eight).is_none());
        assert!(Effect::of(Scale::Relative, &eight, &seven).is_none());
        let same = Effect::of(Scale::Relative, &eight, &eight).unwrap();
        let interval = same.interval(0.001);
        assert!(interval.lower.abs() < 1e-12 && interval.upper.abs() < 1e-12);
    }

    #[test]
    fn a_relative_change_of_nothing_or_to_nothing_is_no_number() {
        assert_eq!(Scale::Relative.change(0.0, 1.0), None);
        assert_eq!(Scale::Relative.change(1.0, 0.0), None);
        assert_eq!(Scale::Relative.change(1.0, f64::INFINITY), None);
        assert_eq!(Scale::Absolute.change(0.0, 0.5), Some(0.5));
    }

    #[test]
    fn silence_is_judged_as_fishers_test_does() {
        let silence = |nodes, silent| Silence { nodes, silent };
        // scipy.stats.fisher_exact([[5, 5], [10, 80]], alternative="greater")
        near(
            silence(10, 5).by_chance(silence(90, 10)),
            0.00631392472093203,
        );
        assert_eq!(silence(10, 0).by_chance(silence(90, 10)), 1.0);
        assert_eq!(silence(1, 1).by_chance(silence(0, 0)), 1.0);
        assert!(silence(9, 9).by_chance(silence(90, 18)) < 1e-5);
    }

    /// A fleet whose nodes vary from hour to hour and agree within one.
    struct Road(Pcg64Mcg);

    impl Road {
        fn uniform(&mut self) -> f64 {
            (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
        }

        fn normal(&mut self) -> f64 {
            let (a, b) = (1.0 - self.uniform(), self.uniform());
            (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
        }

        /// Mean of a figure over `hours` in which the node may drive: ten clips an hour, hour-to-hour deviation of the
        /// logarithm 0.4, correlation of clips within an hour 0.9; one hour in five is parked. `None` if all are.
        fn mean(&mut self, level: f64, hours: usize) -> Option<f64> {
            let (mut sum, mut clips) = (0.0, 0);
            for _ in 0..hours {
                let hour = level + 0.4 * self.normal();
                if self.uniform() < 0.2 {
                    continue;
                }
                for _ in 0..10 {
                    sum += (hour + 0.4 / 3.0 * self.normal()).exp();
                    clips += 1;
                }
            }
            (clips > 0).then(|| sum / f64::from(clips))
        }

        /// The changes of `nodes` over `hours` before and after; one in twenty makes its figures up.
        fn changes(&mut self, nodes: usize, hours: usize, effect: f64) -> Vec<f64> {
            let one = |road: &mut Self| {
                let level = road.normal();
                let (before, after) = (road.mean(level, hours)?, road.mean(level + effect, hours)?);
                if road.uniform() < 0.05 {
                    return Some(30.0 * (road.uniform() - 0.5));
                }
                Scale::Relative.change(before, after)
            };
            (0..nodes).filter_map(|_| one(self)).collect()
        }

        /// The share of `repeats` in which the change of `nodes` beside `others` is judged beyond `bound`, and within.
        fn judged(
            &mut self,
            nodes: [usize; 2],
            hours: usize,
            change: f64,
            bound: f64,
            miss: f64,
            repeats: u32,
        ) -> [f64; 2] {
            let (mut beyond, mut within) = (0, 0);
            for _ in 0..repeats {
                let changed = self.changes(nodes[0], hours, change.ln_1p());
                let others = self.changes(nodes[1], hours, 0.0);
                let Some(effect) = Effect::of(Scale::Relative, &changed, &others) else {
                    continue;
                };
                let interval = effect.interval(miss);
                beyond += u32::from(interval.lower > bound);
                within += u32::from(interval.upper <= bound);
            }
            [beyond, within].map(|count| f64::from(count) / f64::from(repeats))
        }
    }

    #[test]
    fn no_effect_is_judged_one_as_seldom_as_was_asked_from_8_to_5000_nodes() {
        let mut road = Road(Pcg64Mcg::seed_from_u64(7));
        for (nodes, hours, repeats) in [
            ([10, 10], 4, 2000),
            ([10, 90], 8, 600),
            ([50, 50], 8, 600),
            ([500, 4500], 1, 60),
            ([2500, 2500], 1, 60),
        ] {
            let [beyond, within] = road.judged(nodes, hours, 0.0, 0.0, 0.05, repeats);
            let most = 0.05 + 3.0 * (0.05 * 0.95 / f64::from(repeats)).sqrt();
            assert!(
                beyond <= most && within <= most,
                "{nodes:?}: {beyond} {within}"
            );
        }
    }

    #[test]
    fn a_change_of_a_quarter_is_found_in_half_of_a_hundred_nodes_over_eight_hours() {
        let mut road = Road(Pcg64Mcg::seed_from_u64(8));
        let [beyond, within] = road.judged([40, 50], 8, 0.25, 0.05, 0.005, 200);
        assert!(beyond > 0.6 && within == 0.0, "{beyond} {within}");
    }
}
