//! Promises of the division of energy.

use super::*;

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Ten watts, sampled every 100 ms, and two users.
struct Bench {
    shares: Shares,
    start: Instant,
    now: u64,
}

const FRONT: usize = 0;
const REAR: usize = 1;

impl Bench {
    fn new() -> Self {
        let start = Instant::now();
        let mut shares = Shares::new(start);
        assert_eq!((shares.user("front"), shares.user("rear")), (FRONT, REAR));
        assert_eq!(shares.user("front"), FRONT);
        Self {
            shares,
            start,
            now: 0,
        }
    }

    fn at(&self, at: u64) -> Instant {
        self.start + ms(at)
    }

    fn pass_until(&mut self, until: u64) {
        while self.now < until {
            self.now += 100;
            self.shares
                .sampled(self.at(self.now), self.now as f64 / 100.0);
        }
    }

    fn ran(&mut self, user: usize, from: u64, to: u64) {
        let (start, end) = (self.at(from), self.at(to));
        self.shares.detector(user, start, end, end - start);
    }

    /// Joules of both in a span that ends now or before.
    fn joules(&mut self, from: u64, to: u64) -> [f64; 2] {
        let newest = (self.at(self.now), self.now as f64 / 100.0);
        self.shares.settle(self.at(to), newest);
        [FRONT, REAR].map(|user| {
            let at = |at: u64| self.shares.at(user, self.at(at), at as f64 / 100.0);
            at(to) - at(from)
        })
    }
}

fn assert_near(found: [f64; 2], expected: [f64; 2]) {
    let near = found
        .iter()
        .zip(expected)
        .all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(near, "{found:?}, not {expected:?}");
}

#[test]
fn detector_time_divides_a_second_and_frames_divide_one_without() {
    let mut bench = Bench::new();
    bench.ran(FRONT, 100, 400);
    bench.ran(REAR, 500, 600);
    bench.pass_until(1000);
    for i in 0..9 {
        bench.shares.frame(FRONT, bench.at(1000 + i * 100));
    }
    bench.shares.frame(REAR, bench.at(1500));
    bench.pass_until(3000);
    assert_near(bench.joules(0, 1000), [7.5, 2.5]);
    assert_near(bench.joules(1000, 2000), [9.0, 1.0]);
    assert_near(bench.joules(2000, 3000), [9.0, 1.0]);
    assert_near(bench.joules(500, 1500), [3.75 + 4.5, 1.25 + 0.5]);
}

#[test]
fn users_that_did_nothing_share_equally() {
    let mut bench = Bench::new();
    bench.pass_until(1000);
    assert_near(bench.joules(0, 1000), [5.0, 5.0]);
}

#[test]
fn a_run_is_divided_between_the_seconds_it_took_though_it_is_known_at_its_end() {
    let mut bench = Bench::new();
    bench.pass_until(3000);
    bench.ran(FRONT, 500, 3000);
    bench.ran(REAR, 0, 500);
    assert_near(bench.joules(0, 1000), [5.0, 5.0]);
    assert_near(bench.joules(1000, 3000), [20.0, 0.0]);
}

#[test]
fn a_run_of_a_batch_is_divided_between_its_pictures() {
    let mut bench = Bench::new();
    for user in [FRONT, FRONT, FRONT, REAR] {
        let (start, end) = (bench.at(200), bench.at(600));
        bench.shares.detector(user, start, end, ms(100));
    }
    bench.pass_until(1000);
    assert_near(bench.joules(0, 1000), [7.5, 2.5]);
}

#[test]
fn waiting_for_the_detector_costs_nothing() {
    let mut bench = Bench::new();
    // Both ask at once, ten times; the rear camera always waits 80 ms and is then done in 20.
    for round in 0..10 {
        bench.ran(FRONT, round * 100, round * 100 + 80);
        bench.ran(REAR, round * 100 + 80, round * 100 + 100);
    }
    bench.pass_until(1000);
    assert_near(bench.joules(0, 1000), [8.0, 2.0]);
}

#[test]
fn what_somebody_was_told_is_never_divided_again() {
    let mut bench = Bench::new();
    bench.ran(FRONT, 0, 100);
    bench.pass_until(500);
    assert_near(bench.joules(0, 500), [5.0, 0.0]);
    // Of the time before, but only known now: it counts in what is left of the second.
    bench.ran(REAR, 100, 500);
    bench.pass_until(1000);
    assert_near(bench.joules(0, 1000), [5.0, 5.0]);
    assert_near(bench.joules(0, 500), [5.0, 0.0]);
}

#[test]
fn who_stands_aside_takes_the_time_it_worked_and_no_more() {
    let mut bench = Bench::new();
    let audit = bench.shares.user_aside("front audit");
    // The only detector time of the first second: a tenth of it. The frames divide the rest.
    bench.ran(audit, 300, 400);
    for i in 0..3 {
        bench.shares.frame(FRONT, bench.at(i * 100));
    }
    bench.shares.frame(REAR, bench.at(500));
    bench.pass_until(1000);
    bench.ran(audit, 1200, 1400);
    bench.ran(FRONT, 1500, 1600);
    bench.ran(REAR, 1600, 1700);
    bench.pass_until(3000);
    assert_near(bench.joules(0, 1000), [6.75, 2.25]);
    assert_near(bench.joules(1000, 2000), [4.0, 4.0]);
    // Nothing was done in the third: it goes as before, and nobody stands aside.
    assert_near(bench.joules(2000, 3000), [5.0, 5.0]);
    let at = |at: u64| bench.shares.at(audit, bench.at(at), at as f64 / 100.0);
    assert!((at(1000) - 1.0).abs() < 1e-9 && (at(2000) - 3.0).abs() < 1e-9);
    assert!((at(3000) - 3.0).abs() < 1e-9);
}
