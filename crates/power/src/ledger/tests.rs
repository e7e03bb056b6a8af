//! Promises of the account of energy.

use super::*;
use crate::{Value, Values};
use proptest::prelude::*;

const METER: Meta<'_> = Meta {
    source: "test",
    quality: EnergyQuality::Measured,
};

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

/// The account of a meter that is read every 100 ms, and a clock that begins with them.
struct Bench {
    ledger: Ledger,
    start: Instant,
    now: u64,
}

impl Bench {
    fn new() -> Self {
        let ledger = Ledger::new(ms(100));
        Self {
            ledger,
            start: Instant::now(),
            now: 0,
        }
    }

    fn at(&self, at: u64) -> Instant {
        self.start + ms(at)
    }

    /// Samples of the total until then, and including that moment.
    fn sample_until(&mut self, until: u64, watts: impl Fn(f64) -> f64) {
        while self.now <= until {
            let value = Value::power(watts(self.now as f64 / 1e3));
            let reading = reading(&[(Domain::Total, value)]);
            self.ledger.sampled(self.at(self.now), &reading, true);
            self.now += 100;
        }
    }

    fn close(&mut self, span: u64, end: u64) -> Spent {
        self.ledger.close(span, self.at(end), METER).unwrap()
    }
}

#[test]
fn a_clip_of_any_length_is_exact_in_constant_memory() {
    let mut bench = Bench::new();
    let user = bench.ledger.user("front");
    let span = bench.ledger.open(user, bench.at(250));
    let mut most = 0;
    // Three hours, up and down a triangle of ten seconds.
    let watts = |t: f64| 10.0 + (t % 10.0 - 5.0).abs();
    for second in 1..=10_800 {
        bench.sample_until(second * 1000, watts);
        bench.ledger.until(span, bench.at(second * 1000));
        bench
            .ledger
            .looked(bench.at(second * 1000), Condition::default());
        most = most.max(bench.ledger.footprint());
    }
    let spent = bench.close(span, 10_800_000);
    let exact = 12.5 * 10_800.0 - 0.25 * (15.0 - 0.125);
    let joules = spent.node.total_joules().unwrap();
    assert!((joules - exact).abs() < 1e-3, "{joules}, not {exact}");
    assert!((spent.joules.unwrap() - joules).abs() < 1e-3);
    assert_eq!(spent.node.quality, EnergyQuality::Measured);
    assert!((spent.node.coverage - 1.0).abs() < 1e-9);
    assert_eq!(spent.node.samples, 107_998);
    assert_eq!(spent.node.domains[0].peak_watts, Some(15.0));
    assert!(most < 1000, "{most} entries");
}

#[test]
fn an_end_that_is_noticed_an_hour_later_is_exact() {
    let mut bench = Bench::new();
    let user = bench.ledger.user("front");
    let span = bench.ledger.open(user, bench.at(0));
    bench.sample_until(100_000, |_| 10.0);
    bench.ledger.until(span, bench.at(100_030));
    bench.sample_until(3_700_000, |_| 50.0);
    let spent = bench.close(span, 100_030);
    // The 30 ms are on the way from 10 W to 50 W.
    let exact = 1000.0 + 0.03 * 10.0 + 0.5 * 0.03 * 0.03 * 400.0;
    let joules = spent.node.total_joules().unwrap();
    assert!((joules - exact).abs() < 1e-6, "{joules}, not {exact}");
    assert_eq!(spent.node.samples, 1001);
    assert_eq!(spent.node.domains[0].peak_watts, Some(10.0));
}

#[test]
fn a_clip_that_goes_on_after_a_long_pause_has_the_pause_too() {
    let mut bench = Bench::new();
    let user = bench.ledger.user("front");
    let span = bench.ledger.open(user, bench.at(0));
    bench.sample_until(10_000, |_| 10.0);
    bench.ledger.until(span, bench.at(10_000));
    bench.sample_until(600_000, |_| 20.0);
    bench.ledger.until(span, bench.at(600_000));
    bench.sample_until(601_000, |_| 10.0);
    let spent = bench.close(span, 601_000);
    let joules = spent.node.total_joules().unwrap();
    let exact = 100.0 + 1.5 + 589.9 * 20.0 + 1.5 + 0.9 * 10.0;
    assert!((joules - exact).abs() < 1e-6, "{joules}, not {exact}");
    assert_eq!(spent.node.samples, 6011);
    assert_eq!(spent.node.domains[0].peak_watts, Some(20.0));
}

#[test]
fn a_span_older_than_what_is_kept_is_told_as_not_covered() {
    let mut bench = Bench::new();
    bench.sample_until(200_000, |_| 10.0);
    let (start, end) = (bench.at(0), bench.at(200_000));
    let found = bench.ledger.energy(start, end, METER);
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!((found.coverage - 0.3).abs() < 0.01, "{}", found.coverage);
    let end = bench.at(50_000);
    let found = bench.ledger.energy(start, end, METER);
    assert_eq!(found.quality, EnergyQuality::Unavailable);
}

#[test]
fn a_domain_of_power_and_counters_is_their_sum() {
    let mut bench = Bench::new();
    for i in 0..=100 {
        let seconds = i as f64 * 0.1;
        let both = Value::power(30.0).plus(Value::counter(12.0 * seconds));
        let at = bench.at(i * 100);
        bench
            .ledger
            .sampled(at, &reading(&[(Domain::Total, both)]), true);
    }
    let found = bench.ledger.energy(bench.at(1050), bench.at(9050), METER);
    assert!((found.total_joules().unwrap() - 42.0 * 8.0).abs() < 1e-6);
    let total = &found.domains[0];
    assert!((total.peak_watts.unwrap() - 42.0).abs() < 1e-6);
    assert!((total.mean_watts - 42.0).abs() < 1e-6);
    assert_eq!(
        (found.quality, found.samples),
        (EnergyQuality::Measured, 80)
    );
    let watts = bench.ledger.watts(bench.at(10_000));
    assert!((watts[0].watts - 42.0).abs() < 1e-6);
    let so_far = bench.ledger.since_start();
    assert!((so_far[0].1 - 420.0).abs() < 1e-6 && (so_far[0].2 - 10.0).abs() < 1e-9);
}

#[test]
fn a_part_that_goes_missing_makes_the_energy_partial_and_not_smaller_in_silence() {
    let mut bench = Bench::new();
    for i in 0..=100 {
        let counted = Value::counter(i as f64);
        let value = if i < 50 {
            counted.plus(Value::power(5.0))
        } else {
            counted
        };
        let at = bench.at(i * 100);
        bench
            .ledger
            .sampled(at, &reading(&[(Domain::Total, value)]), true);
    }
    let found = bench.ledger.energy(bench.at(0), bench.at(10_000), METER);
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!((found.coverage - 0.49).abs() < 1e-9, "{}", found.coverage);
    assert!(bench.ledger.watts(bench.at(10_000)).is_empty());
}

#[test]
fn an_old_sample_is_not_told_as_power_now() {
    let mut bench = Bench::new();
    bench.sample_until(0, |_| 1.0);
    assert_eq!(bench.ledger.watts(bench.at(900)).len(), 1);
    assert!(bench.ledger.watts(bench.at(1100)).is_empty());
}

#[test]
fn a_change_of_rule_is_told() {
    let mut bench = Bench::new();
    let mut one = reading(&[(Domain::Total, Value::power(1.0))]);
    for i in 0..10 {
        if i == 5 {
            one.total_from = "input_rail".into();
        }
        bench.ledger.sampled(bench.at(i * 100), &one, true);
    }
    let found = bench.ledger.energy(bench.at(0), bench.at(900), METER);
    assert_eq!(found.total_from, "sum_of_rails, then input_rail");
}

/// What happens to a node.
#[derive(Clone, Debug)]
enum Event {
    /// The meter is read.
    Sample { watts: f64 },
    /// A camera sends a frame.
    Frame { user: usize },
    /// The detector has run for so long, for so many pictures of these cameras.
    Run { took: u64, pictures: Vec<usize> },
    /// A camera's clip ends, and its next begins.
    Cut { user: usize },
}

const USERS: usize = 3;

fn events() -> impl Strategy<Value = Vec<(u64, Event)>> {
    let event = prop_oneof![
        6 => (0.0..60.0_f64).prop_map(|watts| Event::Sample { watts }),
        4 => (0..USERS).prop_map(|user| Event::Frame { user }),
        4 => (1..3000_u64, prop::collection::vec(0..USERS, 1..5))
            .prop_map(|(took, pictures)| Event::Run { took, pictures }),
        2 => (0..USERS).prop_map(|user| Event::Cut { user }),
    ];
    prop::collection::vec((0..200_u64, event), 0..400)
}

proptest! {
    #[test]
    fn the_clips_of_all_cameras_add_up_to_the_nodes_total(
        events in events(),
        counted in any::<bool>(),
    ) {
        let mut bench = Bench::new();
        // Long enough to be bridged whatever comes between two samples.
        bench.ledger = Ledger::new(ms(100_000));
        let users: Vec<usize> = (0..USERS)
            .map(|user| bench.ledger.user(&user.to_string()))
            .collect();
        let mut joules = 0.0;
        let mut sample = |bench: &mut Bench, watts: f64, seconds: f64| {
            joules += watts * seconds;
            let value = if counted { Value::counter(joules) } else { Value::power(watts) };
            let reading = reading(&[(Domain::Total, value)]);
            bench.ledger.sampled(bench.at(bench.now), &reading, true);
        };
        sample(&mut bench, 10.0, 0.0);
        let whole = bench.ledger.open(users[0], bench.at(0));
        let mut open: Vec<u64> = users.iter().map(|user| bench.ledger.open(*user, bench.at(0))).collect();
        // Clips that have ended and wait for a sample after their end.
        let mut ended: Vec<(u64, u64)> = Vec::new();
        let mut shares = Vec::new();
        let mut free_at = 0;
        for (wait, event) in events {
            bench.now += wait;
            let now = bench.now;
            match event {
                Event::Sample { watts } => {
                    sample(&mut bench, watts, wait as f64 / 1e3);
                    for (span, end) in ended.drain(..) {
                        shares.push(bench.close(span, end));
                    }
                }
                Event::Frame { user } => {
                    bench.ledger.frame(users[user], bench.at(now));
                    bench.ledger.until(open[user], bench.at(now));
                }
                Event::Run { took, pictures } => {
                    // One run after another; what is asked meanwhile waits.
                    let start = now.saturating_sub(took).max(free_at);
                    free_at = now;
                    let used = ms(now - start) / pictures.len() as u32;
                    for user in pictures {
                        bench.ledger.detector(users[user], bench.at(start), bench.at(now), used);
                    }
                }
                Event::Cut { user } => {
                    ended.push((open[user], now));
                    open[user] = bench.ledger.open(users[user], bench.at(now));
                }
            }
        }
        bench.now += 500;
        let end = bench.now;
        ended.extend(open.into_iter().map(|span| (span, end)));
        bench.now += 100;
        sample(&mut bench, 20.0, 0.6);
        for (span, end) in ended {
            shares.push(bench.close(span, end));
        }
        let total = bench.close(whole, end).node.total_joules().unwrap();
        let sum: f64 = shares.iter().filter_map(|spent| spent.joules).sum();
        prop_assert!((sum - total).abs() < 1e-6 * total.max(1.0), "{} of {}", sum, total);
        let is_share = |spent: &Spent| {
            let node = spent.node.total_joules().unwrap_or_default();
            spent.joules.is_none_or(|joules| joules > -1e-9 && joules < node + 1e-9)
        };
        prop_assert!(shares.iter().all(is_share), "no clip has more than its node: {:?}", shares);
    }
}
