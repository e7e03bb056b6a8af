//! Energy from samples: trapezoids over power, differences of counters, exactly clipped to a span.
//!
//! Times are seconds on any common scale. Two rules hold for both kinds of samples:
//!
//! - A gap between two samples longer than `longest_gap` is not bridged: its time is not covered and adds
//!   no energy. A counter, though, counts on while nobody looks: a gap of its samples that lies wholly
//!   inside the span is exact, and covered.
//! - Where the span reaches beyond the first or the last sample known by at most `longest_gap`, the power
//!   at that edge is taken to hold. It is so when a clip has just ended and the next sample is not in yet.

/// What came out of an integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integral {
    /// Energy over the covered part of the span, joules.
    pub joules: f64,
    /// Length of the covered part, seconds.
    pub covered_s: f64,
}

/// Integrates power samples `(seconds, watts)`, in order of time, over `[start, end]`.
pub fn power(
    samples: impl IntoIterator<Item = (f64, f64)>,
    start: f64,
    end: f64,
    longest_gap: f64,
) -> Integral {
    let mut sum = ClippedSum::new(start, end);
    let mut before: Option<(f64, f64)> = None;
    for (at, watts) in samples {
        match before {
            None => {
                if at - start <= longest_gap {
                    sum.constant(start, at, watts);
                }
            }
            Some((then, previous)) if at - then <= longest_gap && at > then => {
                let (from, to) = (then.max(start), at.min(end));
                if to > from {
                    let slope = (watts - previous) / (at - then);
                    let middle = previous + slope * (0.5 * (from + to) - then);
                    sum.constant(from, to, middle);
                }
            }
            Some(_) => {}
        }
        before = Some((at, watts));
    }
    if let Some((last, watts)) = before
        && end - last <= longest_gap
    {
        sum.constant(last, end, watts);
    }
    sum.integral
}

/// Integrates counter samples `(seconds, joules counted so far)`, in order of time, over `[start, end]`.
/// Between two samples the counter is taken to rise evenly.
pub fn counter(
    samples: impl IntoIterator<Item = (f64, f64)>,
    start: f64,
    end: f64,
    longest_gap: f64,
) -> Integral {
    let mut sum = ClippedSum::new(start, end);
    let mut first_edge: Option<f64> = None;
    let mut before: Option<(f64, f64)> = None;
    let mut last_rate: Option<f64> = None;
    for (at, joules) in samples {
        match before {
            None => first_edge = Some(at),
            Some((then, counted)) if at > then => {
                let whole = then >= start && at <= end;
                if whole || at - then <= longest_gap {
                    let rate = (joules - counted) / (at - then);
                    sum.constant(then, at, rate);
                    if let Some(first) = first_edge.take()
                        && first - start <= longest_gap
                    {
                        sum.constant(start, first, rate);
                    }
                    last_rate = Some(rate);
                } else {
                    last_rate = None;
                    first_edge = None;
                }
            }
            Some(_) => {}
        }
        before = Some((at, joules));
    }
    if let (Some((last, _)), Some(rate)) = (before, last_rate)
        && end - last <= longest_gap
    {
        sum.constant(last, end, rate);
    }
    sum.integral
}

/// Adds up rectangles clipped to a span.
struct ClippedSum {
    start: f64,
    end: f64,
    integral: Integral,
}

impl ClippedSum {
    fn new(start: f64, end: f64) -> Self {
        Self {
            start,
            end,
            integral: Integral::default(),
        }
    }

    fn constant(&mut self, from: f64, to: f64, watts: f64) {
        let (from, to) = (from.max(self.start), to.min(self.end));
        if to > from {
            self.integral.joules += watts * (to - from);
            self.integral.covered_s += to - from;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-9 * b.abs().max(1.0)
    }

    /// Samples of `watts` every 0.1 s from 0 to 10 s.
    fn sampled(watts: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        (0..=100)
            .map(|i| f64::from(i) * 0.1)
            .map(|t| (t, watts(t)))
            .collect()
    }

    #[test]
    fn a_constant_and_a_ramp_are_exact_when_the_span_cuts_between_samples() {
        let constant = power(sampled(|_| 7.0), 0.237, 9.641, 1.0);
        assert!(close(constant.joules, 7.0 * (9.641 - 0.237)));
        let ramp = power(sampled(|t| 3.0 * t), 0.237, 9.641, 1.0);
        assert!(close(
            ramp.joules,
            1.5 * (9.641_f64.powi(2) - 0.237_f64.powi(2))
        ));
        assert!(close(ramp.covered_s, 9.641 - 0.237));
    }

    #[test]
    fn a_span_between_two_samples_is_interpolated() {
        let found = power([(0.0, 0.0), (1.0, 10.0)], 0.4, 0.6, 1.0);
        assert!(close(found.joules, 1.0) && close(found.covered_s, 0.2));
        let found = counter([(0.0, 5.0), (1.0, 15.0)], 0.4, 0.6, 1.0);
        assert!(close(found.joules, 2.0) && close(found.covered_s, 0.2));
    }

    #[test]
    fn a_long_gap_of_power_is_not_bridged() {
        let with_gap = sampled(|_| 10.0)
            .into_iter()
            .filter(|&(t, _)| !(3.95..6.05).contains(&t));
        let found = power(with_gap, 0.0, 10.0, 1.0);
        assert!(close(found.covered_s, 10.0 - 2.2), "{found:?}");
        assert!(close(found.joules, 78.0));
    }

    #[test]
    fn a_missing_sample_is_bridged() {
        let holes = sampled(|t| t)
            .into_iter()
            .enumerate()
            .filter(|(i, _)| i % 3 != 1)
            .map(|(_, s)| s);
        let found = power(holes, 0.5, 9.5, 1.0);
        assert!(close(found.joules, 0.5 * (9.5 * 9.5 - 0.25)));
        assert!(close(found.covered_s, 9.0));
    }

    #[test]
    fn a_counter_counts_on_through_a_gap_inside_the_span() {
        let found = counter(
            [(0.0, 0.0), (0.5, 1.0), (5.0, 46.0), (5.5, 47.0)],
            0.25,
            5.25,
            1.0,
        );
        assert!(close(found.joules, 0.5 + 45.0 + 0.5));
        assert!(close(found.covered_s, 5.0));
    }

    #[test]
    fn a_counter_gap_across_the_edge_is_not_guessed() {
        let found = counter([(0.0, 0.0), (5.0, 50.0), (5.5, 55.0)], 3.0, 5.5, 1.0);
        assert!(
            close(found.joules, 5.0) && close(found.covered_s, 0.5),
            "{found:?}"
        );
    }

    #[test]
    fn the_newest_power_holds_for_a_moment_but_not_for_longer_than_a_gap() {
        let held = power([(0.0, 4.0), (0.5, 6.0)], 0.0, 1.0, 1.0);
        assert!(close(held.joules, 2.5 + 3.0) && close(held.covered_s, 1.0));
        let stale = power([(0.0, 4.0), (0.5, 6.0)], 0.0, 2.0, 1.0);
        assert!(close(stale.joules, 2.5) && close(stale.covered_s, 0.5));
        let counted = counter([(0.0, 0.0), (0.5, 3.0)], -0.25, 1.0, 1.0);
        assert!(close(counted.joules, 1.25 * 6.0));
    }

    #[test]
    fn nothing_known_covers_nothing() {
        assert_eq!(power([], 0.0, 1.0, 1.0), Integral::default());
        assert_eq!(counter([(0.5, 3.0)], 0.0, 1.0, 1.0), Integral::default());
        assert_eq!(power([(5.0, 3.0)], 0.0, 1.0, 1.0), Integral::default());
    }

    fn uneven_samples() -> impl Strategy<Value = Vec<(f64, f64)>> {
        prop::collection::vec((0.01..2.5_f64, 0.0..100.0_f64), 2..60).prop_map(|steps| {
            let mut at = 0.0;
            steps
                .into_iter()
                .map(|(dt, watts)| {
                    at += dt;
                    (at, watts)
                })
                .collect()
        })
    }

    proptest! {
        #[test]
        fn spans_that_tile_add_up(samples in uneven_samples(), cut in 0.05..0.95_f64) {
            let (start, end) = (samples[0].0, samples[samples.len() - 1].0);
            let middle = start + cut * (end - start);
            let whole = power(samples.clone(), start, end, 1.0);
            let left = power(samples.clone(), start, middle, 1.0);
            let right = power(samples.clone(), middle, end, 1.0);
            prop_assert!(close(left.joules + right.joules, whole.joules));
            prop_assert!(close(left.covered_s + right.covered_s, whole.covered_s));
        }

        #[test]
        fn energy_lies_between_lowest_and_highest_power(samples in uneven_samples()) {
            let (start, end) = (samples[0].0, samples[samples.len() - 1].0);
            let found = power(samples.clone(), start, end, 1.0);
            let low = samples.iter().map(|s| s.1).fold(f64::MAX, f64::min);
            let high = samples.iter().map(|s| s.1).fold(0.0, f64::max);
            prop_assert!(found.joules >= low * found.covered_s - 1e-9);
            prop_assert!(found.joules <= high * found.covered_s + 1e-9);
            prop_assert!(found.covered_s <= end - start + 1e-9);
        }

        #[test]
        fn a_counter_read_at_both_ends_gives_its_difference(samples in uneven_samples()) {
            let mut total = 0.0;
            let counted: Vec<_> = samples
                .iter()
                .map(|&(at, joules)| { total += joules; (at, total) })
                .collect();
            let (first, last) = (counted[0], counted[counted.len() - 1]);
            let found = counter(counted, first.0, last.0, 1.0);
            prop_assert!(close(found.joules, last.1 - first.1));
            prop_assert!(close(found.covered_s, last.0 - first.0));
        }
    }
}
