use super::*;
use crate::tests::reading;
use proptest::prelude::*;

/// Seconds before the first step of a history, so that spans may start before it.
const START: f64 = 2000.0;

/// Whole nanoseconds, like an `Instant`.
fn whole(seconds: f64) -> f64 {
    Duration::from_secs_f64(seconds).as_secs_f64()
}

/// The integral over a span: between two samples, power changes evenly or a counter rises evenly.
fn integral(samples: &[(f64, f64)], counted: bool, start: f64, end: f64) -> Sum {
    let mut sum = Sum::default();
    let longest = if counted { 60.0 } else { 1.0 };
    for pair in samples.windows(2) {
        let ((then, before), (at, value)) = (pair[0], pair[1]);
        let (from, to) = (then.max(start), at.min(end));
        if at - then <= longest && to > from {
            let slope = (value - before) / (at - then);
            let middle = before + slope * (0.5 * (from + to) - then);
            let watts = if counted { slope } else { middle };
            sum.joules += watts * (to - from);
            sum.seconds += to - from;
        }
    }
    sum
}

fn close(a: f64, b: f64) -> bool {
    // An `Instant` has whole nanoseconds.
    (a - b).abs() <= 1e-6 * b.abs().max(1.0)
}

/// Seconds between samples: some gaps are too long for power, and some even for a counter.
fn seconds() -> impl Strategy<Value = f64> {
    prop_oneof![9 => 0.01..2.5_f64, 1 => 2.5..120.0_f64]
}

/// A place relative to the first and the last sample.
fn place() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -0.2..1.2_f64, 1 => Just(0.0), 1 => Just(1.0)]
}

proptest! {
    #[test]
    fn the_difference_of_two_sums_is_the_integral_over_the_span(
        steps in prop::collection::vec((seconds(), 0.0..100.0_f64), 0..60),
        a in place(),
        b in place(),
    ) {
        let zero = Instant::now();
        let moment = |seconds: f64| zero + Duration::from_secs_f64(seconds);
        for counted in [false, true] {
            let mut history = History::new(Duration::from_millis(100));
            let (mut at, mut joules) = (START, 0.0);
            let mut samples = Vec::new();
            for (seconds, number) in &steps {
                at = whole(at + seconds);
                joules += number;
                let value = if counted { Value::Counter(joules) } else { Value::Power(*number) };
                history.add(moment(at), &reading(value), |_, _| Vec::new());
                samples.push((at, if counted { joules } else { *number }));
            }
            let first = samples.first().map_or(START, |(at, _)| *at);
            let place = |share: f64| whole(first + share * (at - first).max(1.0));
            let (start, end) = (place(a.min(b)), place(a.max(b)));
            let total = |at: f64| history.at(moment(at)).total();
            let (from, to) = (total(start), total(end));
            let expected = integral(&samples, counted, start, end);
            let found = (to.joules - from.joules, to.seconds - from.seconds);
            let right = close(found.0, expected.joules) && close(found.1, expected.seconds);
            prop_assert!(right, "{:?}, not {:?}, counted: {}", found, expected, counted);
        }
    }
}
