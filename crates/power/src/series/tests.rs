//! Promises of the sums, checked against the rule written out for a whole span at once.

use super::*;
use proptest::prelude::*;

/// The rule for power: trapezoids clipped to the span.
fn power(samples: &[(f64, f64)], start: f64, end: f64, gap: f64) -> Sum {
    let mut sum = Sum::default();
    let mut add = |from: f64, to: f64, watts: f64| {
        let (from, to) = (from.max(start), to.min(end));
        if to > from {
            sum = moved(sum, watts, to - from);
        }
    };
    for pair in samples.windows(2) {
        let ((then, before), (at, watts)) = (pair[0], pair[1]);
        let (from, to) = (then.max(start), at.min(end));
        if at - then <= gap && to > from {
            let slope = (watts - before) / (at - then);
            add(from, to, before + slope * (0.5 * (from + to) - then));
        }
    }
    if let (Some(first), Some(last)) = (samples.first(), samples.last()) {
        if first.0 - start <= gap {
            add(start, first.0, first.1);
        }
        if end - last.0 <= gap {
            add(last.0, end, last.1);
        }
    }
    sum
}

fn reading(value: Value) -> Reading {
    let mut values = Values::default();
    values.set(Domain::Total, value);
    Reading {
        at: None,
        values,
        total_from: "sum_of_rails".into(),
        rails: Vec::new(),
    }
}

/// A series with a gap of a second.
fn series(samples: &[(f64, f64)], value: fn(f64) -> Value) -> (Series, Instant) {
    let start = Instant::now() + Duration::from_secs(1000);
    let mut series = Series::new(Duration::from_millis(100));
    for (at, number) in samples {
        series.push(
            start + Duration::from_secs_f64(*at),
            &reading(value(*number)),
            true,
        );
    }
    (series, start)
}

impl Series {
    pub(crate) fn within_all(&self) -> usize {
        self.points.len()
    }

    fn span(&self, zero: Instant, start: f64, end: f64) -> Sum {
        let moment = |seconds: f64| {
            if seconds >= 0.0 {
                zero + Duration::from_secs_f64(seconds)
            } else {
                zero - Duration::from_secs_f64(-seconds)
            }
        };
        let (from, to) = (
            self.at(moment(start), Edge::Start),
            self.at(moment(end), Edge::End),
        );
        self.used(Domain::Total, &from, &to).unwrap_or_default()
    }
}

fn close(a: f64, b: f64) -> bool {
    // Moments are whole nanoseconds.
    (a - b).abs() <= 1e-6 * b.abs().max(1.0)
}

/// Samples of `watts` every 0.1 s from 0 to 10 s.
fn every_tenth(watts: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    (0..=100)
        .map(|i| f64::from(i) * 0.1)
        .map(|t| (t, watts(t)))
        .collect()
}

#[test]
fn a_constant_and_a_ramp_are_exact_when_the_span_cuts_between_samples() {
    let (constant, zero) = series(&every_tenth(|_| 7.0), Value::power);
    assert!(close(
        constant.span(zero, 0.237, 9.641).joules,
        7.0 * (9.641 - 0.237)
    ));
    let (ramp, zero) = series(&every_tenth(|t| 3.0 * t), Value::power);
    let found = ramp.span(zero, 0.237, 9.641);
    assert!(close(
        found.joules,
        1.5 * (9.641_f64.powi(2) - 0.237_f64.powi(2))
    ));
    assert!(close(found.covered_s, 9.641 - 0.237));
}

#[test]
fn a_span_between_two_samples_is_interpolated() {
    let (found, zero) = series(&[(0.0, 0.0), (1.0, 10.0)], Value::power);
    let found = found.span(zero, 0.4, 0.6);
    assert!(
        close(found.joules, 1.0) && close(found.covered_s, 0.2),
        "{found:?}"
    );
    let (found, zero) = series(&[(0.0, 5.0), (1.0, 15.0)], Value::counter);
    let found = found.span(zero, 0.4, 0.6);
    assert!(
        close(found.joules, 2.0) && close(found.covered_s, 0.2),
        "{found:?}"
    );
}

#[test]
fn a_counter_counts_on_through_a_gap_inside_the_span_and_a_gap_across_its_edge_is_not_guessed() {
    let (found, zero) = series(
        &[(0.0, 0.0), (0.5, 1.0), (5.0, 46.0), (5.5, 47.0)],
        Value::counter,
    );
    let inside = found.span(zero, 0.25, 5.25);
    assert!(close(inside.joules, 0.5 + 45.0 + 0.5) && close(inside.covered_s, 5.0));
    let across = found.span(zero, 3.0, 5.5);
    assert!(
        close(across.joules, 1.0) && close(across.covered_s, 0.5),
        "{across:?}"
    );
    assert_eq!(found.span(zero, 2.0, 3.0), Sum::default());
    let (found, zero) = series(&[(0.0, 0.0), (61.0, 610.0)], Value::counter);
    assert_eq!(
        found.span(zero, 0.0, 61.0),
        Sum::default(),
        "it may have wrapped"
    );
}

#[test]
fn the_power_at_the_edges_holds_for_a_moment_but_not_for_longer_than_a_gap() {
    let (found, zero) = series(&[(0.0, 4.0), (0.5, 6.0)], Value::power);
    let held = found.span(zero, -0.5, 1.0);
    assert!(close(held.joules, 2.0 + 2.5 + 3.0) && close(held.covered_s, 1.5));
    let stale = found.span(zero, -2.0, 2.0);
    assert!(close(stale.joules, 2.5) && close(stale.covered_s, 0.5));
    let (found, zero) = series(&[(0.0, 0.0), (0.5, 3.0)], Value::counter);
    assert!(close(found.span(zero, -0.25, 1.0).joules, 1.25 * 6.0));
}

#[test]
fn nothing_known_covers_nothing() {
    let (found, zero) = series(&[], Value::power);
    assert_eq!(found.span(zero, 0.0, 1.0), Sum::default());
    let (found, zero) = series(&[(0.5, 3.0)], Value::counter);
    assert_eq!(found.span(zero, 0.0, 1.0), Sum::default());
    let (found, zero) = series(&[(5.0, 3.0)], Value::power);
    assert_eq!(found.span(zero, 0.0, 1.0), Sum::default());
}

#[test]
fn the_gap_that_is_bridged_follows_from_the_interval() {
    let gap = |ms| longest_gap(Duration::from_millis(ms));
    assert_eq!(gap(10), Duration::from_secs(1));
    assert_eq!(gap(100), Duration::from_secs(1));
    assert_eq!(gap(1000), Duration::from_millis(2500));
    assert_eq!(gap(10_000), Duration::from_secs(25));
}

fn uneven_samples() -> impl Strategy<Value = Vec<(f64, f64)>> {
    prop::collection::vec((0.01..2.5_f64, 0.0..100.0_f64), 2..60).prop_map(|steps| {
        let mut at = 0.0;
        steps
            .into_iter()
            .map(|(dt, watts)| {
                at += dt;
                // Whole nanoseconds, as an Instant has.
                (Duration::from_secs_f64(at).as_secs_f64(), watts)
            })
            .collect()
    })
}

proptest! {
    #[test]
    fn the_difference_of_two_sums_is_the_integral_over_the_span(
        samples in uneven_samples(), a in -0.2..1.2_f64, b in -0.2..1.2_f64,
    ) {
        let (first, last) = (samples[0].0, samples[samples.len() - 1].0);
        let place = |share: f64| first + share * (last - first);
        let (start, end) = (place(a.min(b)), place(a.max(b)));
        let (summed, zero) = series(&samples, Value::power);
        let (found, expected) = (summed.span(zero, start, end), power(&samples, start, end, 1.0));
        prop_assert!(close(found.joules, expected.joules), "{:?} {:?}", found, expected);
        prop_assert!(close(found.covered_s, expected.covered_s), "{:?} {:?}", found, expected);
    }

    #[test]
    fn spans_that_tile_add_up(samples in uneven_samples(), cut in 0.05..0.95_f64) {
        let (start, end) = (samples[0].0, samples[samples.len() - 1].0);
        let middle = start + cut * (end - start);
        let (summed, zero) = series(&samples, Value::power);
        let whole = summed.span(zero, start, end);
        let (left, right) = (summed.span(zero, start, middle), summed.span(zero, middle, end));
        prop_assert!(close(left.joules + right.joules, whole.joules));
        prop_assert!(close(left.covered_s + right.covered_s, whole.covered_s));
    }

    #[test]
    fn a_counter_read_at_both_ends_gives_its_difference(samples in uneven_samples()) {
        let mut total = 0.0;
        let counted: Vec<_> = samples
            .iter()
            .map(|&(at, joules)| { total += joules; (at, total) })
            .collect();
        let (first, last) = (counted[0], counted[counted.len() - 1]);
        let (summed, zero) = series(&counted, Value::counter);
        let found = summed.span(zero, first.0, last.0);
        prop_assert!(close(found.joules, last.1 - first.1));
        prop_assert!(close(found.covered_s, last.0 - first.0));
    }
}
