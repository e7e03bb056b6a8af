//! Promises of the history of samples.

use super::*;

fn reading(values: &[(Domain, Value)]) -> Reading {
    let mut all = Values::default();
    for (domain, value) in values {
        all.set(*domain, *value);
    }
    Reading {
        at: None,
        values: all,
        total_from: "sum_of_rails".into(),
        rails: Vec::new(),
    }
}

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

#[test]
fn a_domain_of_power_and_counters_is_their_sum() {
    let mut history = History::new(ms(600_000));
    let start = Instant::now();
    for i in 0..=100 {
        let seconds = i as f64 * 0.1;
        let both = Value::power(30.0).plus(Value::counter(12.0 * seconds));
        history.push(start + ms(i * 100), &reading(&[(Domain::Total, both)]));
    }
    let found = history.energy(
        start + ms(1050),
        start + ms(9050),
        "sum",
        EnergyQuality::Measured,
    );
    assert!((found.total_joules().unwrap() - 42.0 * 8.0).abs() < 1e-6);
    let total = &found.domains[0];
    assert!((total.peak_watts.unwrap() - 42.0).abs() < 1e-6);
    assert!((total.mean_watts - 42.0).abs() < 1e-6);
    assert_eq!(
        (found.quality, found.samples),
        (EnergyQuality::Measured, 80)
    );
    assert!((history.watts(start + ms(10_000))[0].watts - 42.0).abs() < 1e-6);
}

#[test]
fn a_part_that_goes_missing_makes_the_energy_partial_and_not_smaller_in_silence() {
    let mut history = History::new(ms(600_000));
    let start = Instant::now();
    for i in 0..=100 {
        let counted = Value::counter(i as f64);
        let value = if i < 50 {
            counted.plus(Value::power(5.0))
        } else {
            counted
        };
        history.push(start + ms(i * 100), &reading(&[(Domain::Total, value)]));
    }
    let found = history.energy(start, start + ms(10_000), "sum", EnergyQuality::Measured);
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!((found.coverage - 0.49).abs() < 1e-9, "{}", found.coverage);
}

#[test]
fn a_span_before_the_history_is_unavailable() {
    let mut history = History::new(ms(1000));
    let start = Instant::now();
    for i in 0..100 {
        history.push(
            start + ms(i * 100),
            &reading(&[(Domain::Total, Value::power(1.0))]),
        );
    }
    assert!(history.samples.len() <= 11, "the history is bounded");
    let found = history.energy(start, start + ms(2000), "test", EnergyQuality::Measured);
    assert_eq!(found.quality, EnergyQuality::Unavailable);
    assert!(found.domains.is_empty());
}

#[test]
fn an_old_sample_is_not_told_as_power_now() {
    let mut history = History::new(ms(600_000));
    let start = Instant::now();
    history.push(start, &reading(&[(Domain::Total, Value::power(1.0))]));
    assert_eq!(history.watts(start + ms(900)).len(), 1);
    assert!(history.watts(start + ms(1100)).is_empty());
}

#[test]
fn a_change_of_rule_is_told() {
    let mut history = History::new(ms(600_000));
    let start = Instant::now();
    let mut one = reading(&[(Domain::Total, Value::power(1.0))]);
    for i in 0..10 {
        if i == 5 {
            one.total_from = "input_rail".into();
        }
        history.push(start + ms(i * 100), &one);
    }
    let found = history.energy(start, start + ms(900), "test", EnergyQuality::Measured);
    assert_eq!(found.total_from, "sum_of_rails, then input_rail");
}
