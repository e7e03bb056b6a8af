//! Tests of the totals against a direct integration over the whole span.

use super::*;
use proptest::prelude::*;

/// The integral of power: trapezoids clipped to the span.
fn power(samples: &[(f64, f64)], start: f64, end: f64, gap: f64) -> Sum {
    let mut sum = Sum::default();
    let mut add = |from: f64, to: f64, watts: f64| {
        let (from, to) = (from.max(start), to.min(end));
        if to > from {
            sum.joules += watts * (to - from);
            sum.covered_s += to - from;
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
    sum
}

fn reading(value: Value) -> Reading {
    Reading {
        at: None,
        values: [Some(value), None, None, None],
        total_from: "sum_of_rails".into(),
        rails: Vec::new(),
    }
}

/// The totals of these samples, with gaps of up to 1 s bridged.
fn history(samples: &[(f64, f64)], value: fn(f64) -> Value) -> (History, Instant) {
    let start = Instant::now() + Duration::from_secs(1000);
    let mut history = History::new(Duration::from_millis(100));
    for (at, number) in samples {
        let at = start + Duration::from_secs_f64(*at);
        history.add(at, &reading(value(*number)), |_, _| Vec::new());
    }
    (history, start)
}

impl History {
    fn span(&self, zero: Instant, start: f64, end: f64) -> Sum {
        let moment = |seconds: f64| {
            if seconds >= 0.0 {
                zero + Duration::from_secs_f64(seconds)
            } else {
                zero - Duration::from_secs_f64(-seconds)
            }
        };
        let (from, to) = (self.at(moment(start)).total(), self.at(moment(end)).total());
        Sum {
            joules: to.joules - from.joules,
            covered_s: to.covered_s - from.covered_s,
        }
    }
}

fn close(a: f64, b: f64) -> bool {
    // An `Instant` has whole nanoseconds.
    (a - b).abs() <= 1e-6 * b.abs().max(1.0)
}

#[test]
fn a_counter_is_interpolated_between_samples_and_across_a_short_gap_but_not_a_long_one() {
    let (found, zero) = history(&[(0.0, 5.0), (1.0, 15.0)], Value::Counter);
    let found = found.span(zero, 0.4, 0.6);
    assert!(
        close(found.joules, 2.0) && close(found.covered_s, 0.2),
        "{found:?}"
    );
    let (found, zero) = history(
        &[(0.0, 0.0), (0.5, 1.0), (5.0, 46.0), (5.5, 47.0)],
        Value::Counter,
    );
    let inside = found.span(zero, 0.25, 5.25);
    assert!(close(inside.joules, 0.5 + 45.0 + 0.5) && close(inside.covered_s, 5.0));
    let across = found.span(zero, 3.0, 5.5);
    assert!(
        close(across.joules, 20.0 + 1.0) && close(across.covered_s, 2.5),
        "{across:?}"
    );
    let (found, zero) = history(&[(0.0, 0.0), (61.0, 610.0)], Value::Counter);
    assert_eq!(
        found.span(zero, 0.0, 61.0),
        Sum::default(),
        "it may have wrapped"
    );
}

#[test]
fn a_counter_says_nothing_of_the_time_before_its_first_sample_or_after_its_last() {
    let (found, zero) = history(&[(0.0, 0.0), (0.5, 3.0)], Value::Counter);
    let held = found.span(zero, -0.25, 1.0);
    assert!(close(held.joules, 3.0) && close(held.covered_s, 0.5));
}

#[test]
fn a_span_without_samples_is_not_covered() {
    let (found, zero) = history(&[], Value::Power);
    assert_eq!(found.span(zero, 0.0, 1.0), Sum::default());
    let (found, zero) = history(&[(0.5, 3.0)], Value::Counter);
    assert_eq!(found.span(zero, 0.0, 1.0), Sum::default());
    let (found, zero) = history(&[(5.0, 3.0)], Value::Power);
    assert_eq!(found.span(zero, 0.0, 1.0), Sum::default());
}

fn uneven_samples() -> impl Strategy<Value = Vec<(f64, f64)>> {
    prop::collection::vec((0.01..2.5_f64, 0.0..100.0_f64), 2..60).prop_map(|steps| {
        let mut at = 0.0;
        steps
            .into_iter()
            .map(|(dt, watts)| {
                at += dt;
                // Whole nanoseconds, like an `Instant`.
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
        let (summed, zero) = history(&samples, Value::Power);
        let (found, expected) = (summed.span(zero, start, end), power(&samples, start, end, 1.0));
        prop_assert!(close(found.joules, expected.joules), "{:?} {:?}", found, expected);
        prop_assert!(close(found.covered_s, expected.covered_s), "{:?} {:?}", found, expected);
    }

    #[test]
    fn a_counter_read_at_both_ends_gives_the_difference(samples in uneven_samples()) {
        let mut total = 0.0;
        let counted: Vec<_> = samples
            .iter()
            .map(|&(at, joules)| { total += joules; (at, total) })
            .collect();
        let (first, last) = (counted[0], counted[counted.len() - 1]);
        let (summed, zero) = history(&counted, Value::Counter);
        let found = summed.span(zero, first.0, last.0);
        prop_assert!(close(found.joules, last.1 - first.1));
        prop_assert!(close(found.covered_s, last.0 - first.0));
    }
}
