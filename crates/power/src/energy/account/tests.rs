use super::*;
use crate::reading::Value;
use crate::tests::{ms, reading, total};
use proptest::prelude::*;

/// The account of a meter, with a clock in milliseconds that starts at 0.
struct Bench {
    account: Account,
    camera: u64,
    start: Instant,
    now: u64,
}

impl Bench {
    fn read_every(interval: u64) -> Self {
        let mut account = Account::new("test", EnergyQuality::Measured, ms(interval));
        Self {
            camera: account.cameras.add(),
            account,
            start: Instant::now(),
            now: 0,
        }
    }

    fn at(&self, at: u64) -> Instant {
        self.start + ms(at)
    }

    fn sample(&mut self, at: u64, total: Value) {
        self.account.sampled(self.at(at), &reading(total));
    }

    fn sample_until(&mut self, until: u64, watts: impl Fn(f64) -> f64) {
        while self.now <= until {
            self.sample(self.now, Value::Power(watts(self.now as f64 / 1e3)));
            self.now += 100;
        }
    }

    fn open(&mut self, start: u64) -> u64 {
        self.account.open(self.camera, self.at(start))
    }

    fn until(&mut self, number: u64, at: u64) {
        self.account.until(number, self.at(at));
    }

    fn close(&mut self, number: u64, end: u64) -> Measured {
        self.account.close(number, self.at(end)).unwrap()
    }

    fn energy(&mut self, start: u64, end: u64) -> ClipEnergy {
        let number = self.open(start);
        self.close(number, end).energy
    }
}

#[test]
fn a_clip_of_three_hours_is_exact_in_bounded_memory() {
    let mut bench = Bench::read_every(100);
    let span = bench.open(250);
    let mut most = 0;
    // Three hours of a triangle wave with a period of 10 s.
    let watts = |t: f64| 10.0 + (t % 10.0 - 5.0).abs();
    for second in 1..=10_800 {
        bench.sample_until(second * 1000, watts);
        bench.until(span, second * 1000);
        bench.account.set_condition(BoardState::default());
        most = most.max(bench.account.footprint());
    }
    let spent = bench.close(span, 10_800_000);
    // The wave has a mean of 12.5 W. The clip begins 0.25 s after the first sample, from whose 15 W the power falls by 1 W a
    // second.
    let exact = 12.5 * 10_800.0 - 0.25 * (15.0 - 0.125);
    let joules = total(&spent.energy);
    assert!((joules - exact).abs() < 1e-3, "{joules}, not {exact}");
    assert!((spent.energy.joules.unwrap() - joules).abs() < 1e-3);
    assert_eq!(spent.energy.quality, EnergyQuality::Measured);
    assert!((spent.energy.coverage - 1.0).abs() < 1e-9);
    // Ten a second from 0 on, without the three before the clip.
    assert_eq!(spent.energy.samples, 107_998);
    let whole = &spent.energy.domains[0];
    assert_eq!(whole.peak_watts, Some(15.0));
    assert!((whole.mean_watts - whole.joules / 10_799.75).abs() < 1e-6);
    assert!(most < 1100, "{most} entries");
}

#[test]
fn a_clip_with_a_long_pause_that_is_closed_an_hour_after_its_end_is_exact() {
    let mut bench = Bench::read_every(100);
    let span = bench.open(0);
    bench.sample_until(10_000, |_| 10.0);
    bench.until(span, 10_000);
    bench.sample_until(600_000, |_| 20.0);
    bench.until(span, 600_030);
    bench.sample_until(4_200_000, |_| 50.0);
    let spent = bench.close(span, 600_030);
    // Within 100 ms the power ramps from 10 W to 20 W; during the last 30 ms, from 20 W towards 50 W.
    let exact = 100.0 + 1.5 + 589.9 * 20.0 + 0.03 * 20.0 + 0.5 * 0.03 * 0.03 * 300.0;
    let joules = total(&spent.energy);
    assert!((joules - exact).abs() < 1e-6, "{joules}, not {exact}");
    assert_eq!(spent.energy.samples, 6000);
    assert_eq!(spent.energy.domains[0].peak_watts, Some(20.0));
}

#[test]
fn a_span_older_than_the_history_is_reported_as_not_covered() {
    let mut bench = Bench::read_every(100);
    bench.sample_until(200_000, |_| 10.0);
    let found = bench.energy(0, 200_000);
    assert_eq!(found.quality, EnergyQuality::Partial);
    // The history has 1024 samples, which cover the last 102 of the 200 seconds.
    assert!((found.coverage - 0.51).abs() < 0.01, "{}", found.coverage);
    assert_eq!(bench.energy(0, 50_000).quality, EnergyQuality::Unavailable);
}

#[test]
fn samples_missing_from_the_total_make_the_energy_partial_and_a_change_of_its_rule_is_reported() {
    let mut bench = Bench::read_every(100);
    for sample in 0..=100 {
        let mut both = reading(Value::Power(5.0));
        both.values.cpu = Some(Value::Counter(sample as f64));
        if sample >= 50 {
            both.values.total = None;
            both.total_from = "input_rail".into();
        }
        bench.account.sampled(bench.at(sample * 100), &both);
    }
    let found = bench.energy(0, 10_000);
    assert_eq!(found.quality, EnergyQuality::Partial);
    // The samples 0 to 49 have a total: 49 of the 100 intervals.
    assert!((found.coverage - 0.49).abs() < 1e-9, "{}", found.coverage);
    let cpu = found.domains.iter().find(|one| one.domain == "cpu").unwrap();
    assert!((cpu.joules - 100.0).abs() < 1e-9);
    assert_eq!(found.total_from, "sum_of_rails, then input_rail");
    let now = bench.account.history.present(bench.at(10_000)).unwrap();
    assert_eq!(now.watts.cpu, Some(10.0));
    assert_eq!(now.watts.total, None);
}

#[test]
fn a_clip_between_two_samples_is_interpolated_and_has_rule_and_board_state() {
    let mut bench = Bench::read_every(100);
    bench.account.set_condition(BoardState {
        cpu_mhz: Some(1500.0),
        ..BoardState::default()
    });
    bench.sample_until(1000, |t| 10.0 * t);
    let span = bench.open(1020);
    bench.until(span, 1060);
    bench.sample_until(1500, |t| 10.0 * t);
    let spent = bench.close(span, 1060);
    // The integral of 10·t W from 1.02 s to 1.06 s.
    let exact = 5.0 * (1.06 * 1.06 - 1.02 * 1.02);
    assert!((total(&spent.energy) - exact).abs() < 1e-9);
    assert_eq!(spent.energy.samples, 0);
    assert_eq!(spent.energy.total_from, "sum_of_rails");
    assert_eq!(spent.board.unwrap().cpu_mhz, Some(1500.0));
}

#[test]
fn savings_are_the_time_of_avoided_calls_times_detector_watts() {
    let mut bench = Bench::read_every(100);
    let mut clip = None;
    // The detector runs half of the time for 3 s, then as many calls are avoided for 3 s, and so on.
    for tick in 1..=6_000 {
        let now = tick * 100;
        let busy = tick / 30 % 2 == 0;
        if busy {
            let end = bench.at(now);
            bench.account.detector.called(end, ms(50));
            bench.account.cameras.called(bench.camera, ms(50));
        } else {
            bench.account.cameras.avoided(bench.camera);
        }
        bench.sample_until(now, |_| if busy { 20.0 } else { 10.0 });
        if now == 540_000 {
            clip = Some(bench.open(now));
        }
    }
    let spent = bench.close(clip.unwrap(), 600_000);
    let watts = spent.detector_watts.unwrap();
    assert!((watts - 20.0).abs() < 2.0, "{watts}");
    // In the last 60 s calls are avoided half of the time, ten a second: 300 of 50 ms.
    let saved_s = spent.energy.saved_joules_estimated.unwrap() / watts;
    assert!((saved_s - 15.0).abs() < 0.2, "{saved_s}");
}

#[test]
fn a_forgotten_measurement_leaves_nothing_behind() {
    let mut bench = Bench::read_every(100);
    let before = bench.account.footprint();
    let given_up = bench.open(0);
    bench.account.forget(given_up);
    assert_eq!(bench.account.footprint(), before);
    assert!(bench.account.close(given_up, bench.at(0)).is_none());
}

#[test]
fn the_peak_of_a_counter_is_its_highest_mean_between_two_samples() {
    let mut bench = Bench::read_every(100);
    for (at, joules) in [(0, 0.0), (100, 1.0), (200, 4.0), (300, 5.0)] {
        bench.sample(at, Value::Counter(joules));
    }
    let peak = bench.energy(0, 300).domains[0].peak_watts.unwrap();
    assert!((peak - 30.0).abs() < 1e-6, "{peak}");
}

#[derive(Clone, Debug)]
enum Event {
    /// The meter is read.
    Sample { watts: f64 },
    /// A camera sends a frame.
    Frame { user: usize },
    /// A detector run of `took` ms ends; each entry of `pictures` is the camera of one picture.
    Run { took: u64, pictures: Vec<usize> },
    /// A camera's clip ends and its next one begins.
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
    fn clips_of_all_cameras_sum_to_the_node_total(
        events in events(),
        is_counter in any::<bool>(),
    ) {
        // Bridges every gap between two samples that the events can make.
        let mut bench = Bench::read_every(100_000);
        let mut users = vec![bench.camera];
        users.extend((1..USERS).map(|_| bench.account.cameras.add()));
        let mut joules = 0.0;
        let mut sample = |bench: &mut Bench, watts: f64, seconds: f64| {
            joules += watts * seconds;
            let value = if is_counter { Value::Counter(joules) } else { Value::Power(watts) };
            bench.sample(bench.now, value);
        };
        sample(&mut bench, 10.0, 0.0);
        let start = bench.at(0);
        let whole = bench.account.open(users[0], start);
        let mut open: Vec<u64> = users.iter().map(|user| bench.account.open(*user, start)).collect();
        // Ended clips that wait for a sample after their end.
        let mut ended: Vec<(u64, u64)> = Vec::new();
        let mut shares = Vec::new();
        let mut free_at = 0;
        for (wait, event) in events {
            bench.now += wait;
            let now = bench.now;
            let at = bench.at(now);
            match event {
                Event::Sample { watts } => {
                    sample(&mut bench, watts, wait as f64 / 1e3);
                    for (span, end) in ended.drain(..) {
                        shares.push(bench.close(span, end));
                    }
                }
                Event::Frame { user } => {
                    bench.account.cameras.frame(users[user]);
                    bench.account.cameras.avoided(users[user]);
                    bench.until(open[user], now);
                }
                Event::Run { took, pictures } => {
                    // Runs are sequential: a call during a run waits for its end.
                    let start = now.saturating_sub(took).max(free_at);
                    free_at = now;
                    let used = ms(now - start) / pictures.len() as u32;
                    for user in pictures {
                        bench.account.detector.called(at, used);
                        bench.account.cameras.called(users[user], used);
                    }
                }
                Event::Cut { user } => {
                    ended.push((open[user], now));
                    open[user] = bench.account.open(users[user], at);
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
        let total = bench.close(whole, end).energy.node_joules.unwrap();
        let sum: f64 = shares.iter().filter_map(|spent| spent.energy.joules).sum();
        prop_assert!((sum - total).abs() < 1e-6 * total.max(1.0), "{} of {}", sum, total);
        let is_share = |spent: &Measured| {
            let node = spent.energy.node_joules.unwrap_or_default();
            spent.energy.joules.is_none_or(|joules| joules > -1e-9 && joules < node + 1e-9)
        };
        prop_assert!(shares.iter().all(is_share), "no clip has more than its node: {:?}", shares);
    }
}
