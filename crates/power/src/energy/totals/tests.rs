use super::*;
use crate::tests::reading;
use proptest::prelude::*;

/// Seconds before the first step of a history, so that spans may start before it.
const START: f64 = 2000.0;

/// The interval at which the meter is read.
const INTERVAL: Duration = Duration::from_millis(100);

/// Rounds to whole nanoseconds, as an `Instant` has them.
fn in_nanoseconds(seconds: f64) -> f64 {
    Duration::from_secs_f64(seconds).as_secs_f64()
}

/// Watts of a power, or joules of a counter, at a time in seconds.
#[derive(Clone, Copy)]
struct Point {
    at: f64,
    value: f64,
}

/// The integral over a span: between two samples, power changes evenly or a counter rises evenly.
fn integral(samples: &[Point], is_counter: bool, start: f64, end: f64) -> Sum {
    let mut sum = Sum::default();
    // The longest gap that is joined, seconds.
    let longest = if is_counter { 60.0 } else { 1.0 };
    for pair in samples.windows(2) {
        let before = pair[0];
        let after = pair[1];
        let from = before.at.max(start);
        let to = after.at.min(end);
        if after.at - before.at <= longest && to > from {
            let slope = (after.value - before.value) / (after.at - before.at);
            let middle = before.value + slope * (0.5 * (from + to) - before.at);
            let watts = if is_counter { slope } else { middle };
            sum.joules += watts * (to - from);
            sum.seconds += to - from;
        }
    }
    sum
}

fn close(a: f64, b: f64) -> bool {
    // An `Instant` has whole nanoseconds, and the sums are of many differences of them.
    (a - b).abs() <= 1e-6 * b.abs().max(1.0)
}

/// Seconds between samples: some gaps are too long for power, and some even for a counter.
fn seconds() -> impl Strategy<Value = f64> {
    prop_oneof![9 => 0.01..2.5_f64, 1 => 2.5..120.0_f64]
}

/// An end of a span: 0 at the first sample, 1 at the last.
fn place() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -0.2..1.2_f64, 1 => Just(0.0), 1 => Just(1.0)]
}

proptest! {
    #[test]
    fn the_difference_of_two_sums_is_the_integral_over_the_span(
        steps in prop::collection::vec((seconds(), 0.0..100.0_f64), 0..60),
        one_end in place(),
        other_end in place(),
    ) {
        let zero = Instant::now();
        let moment = |seconds: f64| zero + Duration::from_secs_f64(seconds);
        for is_counter in [false, true] {
            let mut history = History::new(INTERVAL);
            let mut at = START;
            let mut joules = 0.0;
            let mut samples = Vec::new();
            // A step adds these joules to a counter, or is a power of as many watts.
            for (seconds, number) in &steps {
                at = in_nanoseconds(at + seconds);
                joules += number;
                if is_counter {
                    history.add(moment(at), &reading(Value::Counter(joules)), |_, _| Vec::new());
                    samples.push(Point { at, value: joules });
                } else {
                    history.add(moment(at), &reading(Value::Power(*number)), |_, _| Vec::new());
                    samples.push(Point { at, value: *number });
                }
            }
            let first = samples.first().map_or(START, |point| point.at);
            let second_at = |share: f64| in_nanoseconds(first + share * (at - first).max(1.0));
            let start = second_at(one_end.min(other_end));
            let end = second_at(one_end.max(other_end));
            let from = history.at(moment(start)).total();
            let to = history.at(moment(end)).total();
            let expected = integral(&samples, is_counter, start, end);
            let found = Sum {
                joules: to.joules - from.joules,
                seconds: to.seconds - from.seconds,
            };
            let is_right = close(found.joules, expected.joules) && close(found.seconds, expected.seconds);
            prop_assert!(is_right, "{:?}, not {:?}, counter: {}", found, expected, is_counter);
        }
    }
}
