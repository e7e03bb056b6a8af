use super::*;
use crate::reading::{Reading, Value};
use crate::tests::{Tree, reading, total};
use albireo_wire::ClipEnergy;

/// A meter that follows a power curve over the seconds since its creation.
struct Curve<F> {
    created: Instant,
    watts: F,
}

impl<F: FnMut(f64) -> Option<f64> + Send> Meter for Curve<F> {
    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let seconds = now.duration_since(self.created).as_secs_f64();
        match (self.watts)(seconds) {
            Some(watts) => Ok(vec![reading(Value::Power(watts))]),
            None => Err(MeterError::Failed("stalled".to_owned())),
        }
    }
}

fn sampled_every(
    interval_ms: u64,
    curve: impl FnMut(f64) -> Option<f64> + Send + 'static,
) -> (PowerHandle, Instant) {
    let start = Instant::now();
    let interval = Duration::from_millis(interval_ms);
    let never = CancellationToken::new();
    let meter = Curve {
        created: start,
        watts: curve,
    };
    let (handle, _task) = start_with("curve", Box::new(meter), interval, never);
    (handle, start)
}

async fn energy(handle: &PowerHandle, start: Instant, end: Instant) -> ClipEnergy {
    let measured = handle.camera().measure(start);
    measured.finish(end, Duration::MAX).await.unwrap().energy
}

#[tokio::test(start_paused = true)]
async fn a_span_is_measured_to_its_ends_and_the_sampler_stops_on_cancellation() {
    let start = Instant::now();
    let stop = CancellationToken::new();
    let meter = Curve {
        created: start,
        watts: |t| Some(10.0 + t),
    };
    let interval = Duration::from_millis(100);
    let (handle, task) = start_with("curve", Box::new(meter), interval, stop.clone());
    let end = start + Duration::from_millis(8_250);
    tokio::time::sleep_until(end).await;
    let found = energy(&handle, start + Duration::from_millis(250), end).await;
    let exact = 10.0 * 8.0 + 0.5 * (8.25_f64.powi(2) - 0.25_f64.powi(2));
    assert!((total(&found) / exact - 1.0).abs() < 1e-3);
    assert_eq!(found.quality, EnergyQuality::Measured);
    assert_eq!(handle.snapshot().quality, EnergyQuality::Measured);
    stop.cancel();
    task.await.unwrap();
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(handle.snapshot().quality, EnergyQuality::Unavailable);
}

#[tokio::test(start_paused = true)]
async fn without_a_meter_energy_is_unavailable_at_once() {
    let interval = Duration::from_millis(100);
    let never = CancellationToken::new();
    let (handle, _task) = start_with("none", Box::new(NoMeter), interval, never);
    let start = Instant::now();
    tokio::time::sleep(Duration::from_secs(2)).await;
    let asked = Instant::now();
    let found = energy(&handle, start, asked).await;
    assert_eq!(asked.elapsed(), Duration::ZERO);
    let source = "none".to_owned();
    let nothing = ClipEnergy {
        source,
        ..ClipEnergy::default()
    };
    assert_eq!(found, nothing);
}

#[tokio::test(start_paused = true)]
async fn energy_is_exact_from_the_shortest_to_the_longest_interval() {
    for interval in [10, 100, 999, 1000, 1500, 2000, 5000, 10_000] {
        let (handle, start) = sampled_every(interval, |_| Some(10.0));
        let span = handle.camera().measure(start);
        let mut counted = 0.0;
        for second in 1..=40 {
            tokio::time::sleep_until(start + Duration::from_secs(second)).await;
            span.until(Instant::now());
            let so_far = handle.snapshot();
            if let Some(&joules) = so_far.joules.get("total") {
                assert!(joules >= counted, "a counter never falls");
                counted = joules;
                assert!((joules - 10.0 * so_far.covered_s["total"]).abs() < 1e-6);
            }
            assert_eq!(so_far.watts.len(), 1, "after {second} s at {interval} ms");
        }
        let at_most_missing = 10.0 * (interval as f64 / 1e3 + 0.1);
        let is_enough = counted > 400.0 - at_most_missing;
        assert!(is_enough, "{counted} J counted at {interval} ms");
        let end = start + Duration::from_secs(40);
        let spent = span.finish(end, Duration::MAX).await.unwrap();
        let joules = total(&spent.energy);
        assert!((joules - 400.0).abs() < 1e-6, "{joules} J at {interval} ms");
        assert!((spent.energy.coverage - 1.0).abs() < 1e-9);
        assert_eq!(spent.energy.quality, EnergyQuality::Measured);
    }
}

#[tokio::test(start_paused = true)]
async fn a_stalled_meter_makes_energy_partial_at_short_and_long_intervals() {
    for interval in [100, 1000, 10_000] {
        let (handle, start) = sampled_every(interval, |t| {
            if (35.0..95.0).contains(&t) {
                return None;
            }
            Some(10.0)
        });
        let span = handle.camera().measure(start);
        let end = start + Duration::from_secs(200);
        tokio::time::sleep_until(end).await;
        let spent = span.finish(end, Duration::MAX).await.unwrap().energy;
        assert_eq!(spent.quality, EnergyQuality::Partial, "at {interval} ms");
        // The meter stalls for a minute.
        let failed = handle.snapshot().failed_reads;
        let is_enough = failed >= 58_000 / interval;
        assert!(is_enough, "{failed} failed at {interval} ms");
        assert!(
            (spent.coverage - 0.7).abs() < 0.06,
            "{spent:?} at {interval} ms"
        );
        assert!((total(&spent) - 2000.0 * spent.coverage).abs() < 1e-6);
    }
}

#[tokio::test(start_paused = true)]
async fn a_clip_waits_for_the_first_sample_after_its_end_but_no_longer_than_its_limit() {
    let (handle, start) = sampled_every(10_000, Some);
    let camera = handle.camera();
    let hasty = camera.measure(start);
    let patient = camera.measure(start);
    let end = start + Duration::from_millis(13_000);
    tokio::time::sleep_until(end).await;
    let limit = Duration::from_millis(300);
    let spent = hasty.finish(end, limit).await.unwrap().energy;
    assert_eq!(end.elapsed(), limit);
    assert!((total(&spent) - 50.0).abs() < 1e-6, "{spent:?}");
    assert!((spent.coverage - 10.0 / 13.0).abs() < 1e-6, "{spent:?}");
    let spent = patient.finish(end, Duration::MAX).await.unwrap().energy;
    let waited = end.elapsed();
    let expected = Duration::from_secs(7)..Duration::from_millis(7_100);
    assert!(expected.contains(&waited), "{waited:?}");
    assert!((total(&spent) - 0.5 * 13.0 * 13.0).abs() < 0.1, "{spent:?}");
    assert_eq!(spent.samples, 1);
    assert_eq!(spent.quality, EnergyQuality::Measured);
}

#[tokio::test(start_paused = true)]
async fn a_failing_meter_delays_clips_briefly_and_leaves_the_gap_uncovered() {
    let (handle, start) = sampled_every(1_000, |t| if t < 5.5 { Some(10.0) } else { None });
    let camera = handle.camera();
    let spans: Vec<_> = (0..100).map(|_| camera.measure(start)).collect();
    let end = start + Duration::from_secs(10);
    tokio::time::sleep_until(end).await;
    for span in spans {
        let spent = span.finish(end, Duration::MAX).await.unwrap();
        assert!((total(&spent.energy) - 50.0).abs() < 1e-6, "{spent:?}");
        assert!((spent.energy.coverage - 0.5).abs() < 1e-9);
        assert_eq!(spent.energy.quality, EnergyQuality::Partial);
    }
    let waited = end.elapsed();
    assert!(waited < Duration::from_millis(2_100), "{waited:?}");
}

#[tokio::test(start_paused = true)]
async fn a_panicking_meter_is_counted_and_read_again() {
    let mut polls = 0;
    let (handle, start) = sampled_every(100, move |_| {
        polls += 1;
        if polls == 20 {
            panic!("a bug in a meter");
        }
        Some(10.0)
    });
    let end = start + Duration::from_secs(5);
    tokio::time::sleep_until(end).await;
    let found = energy(&handle, start, end).await;
    assert_eq!(handle.snapshot().failed_reads, 1);
    assert!((total(&found) / 50.0 - 1.0).abs() < 1e-3);
}

/// The files of a board, a PC and a laptop in one tree, more than most machines have.
fn tree() -> Tree {
    let tree = Tree::default();
    for chip in ["hwmon1", "hwmon2"] {
        let rail = (chip, 5000, 1200);
        tree.ina3221(chip, &[rail, rail, rail]);
    }
    for (package, name) in [("intel-rapl:0", "package-0"), ("intel-rapl:1", "package-1")] {
        tree.rapl(package, name, 123_456_789_012);
        for (sub, name) in ["core", "uncore", "dram"].into_iter().enumerate() {
            tree.rapl(&format!("{package}/{package}:{sub}"), name, 123_456_789_012);
        }
    }
    for zone in 0..10 {
        let zone = format!("sys/class/thermal/thermal_zone{zone}");
        tree.write(format!("{zone}/type"), "cpu-thermal");
        tree.write(format!("{zone}/temp"), "45000");
    }
    for cpu in 0..8 {
        let file = format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq");
        tree.write(file, "1500000");
    }
    tree.write("proc/stat", "cpu 100 0 100 800 0 0 0 0 0 0");
    tree
}

#[rstest::rstest]
fn each_file_source_uses_under_half_a_percent_of_a_core_at_ten_samples_per_second(
    #[values(PowerSource::Ina, PowerSource::Rapl, PowerSource::Estimate)] source: PowerSource,
) {
    let tree = tree();
    let config = PowerConfig {
        source,
        ..tree.config()
    };
    let (_, mut meter) = choose::open(&config).unwrap();
    let mut machine = Machine::new(&config);
    let seconds = 30;
    let before = thread_cpu();
    for _ in 0..seconds {
        // Per second, the sampler reads the condition once and the meter ten times.
        machine.read();
        for _ in 0..10 {
            meter.poll(Instant::now()).unwrap();
        }
    }
    let cpu = thread_cpu().saturating_sub(before) + meter.other_cpu();
    let share = cpu.as_secs_f64() / f64::from(seconds);
    assert!(share < 0.005, "{}: {share}", source.as_str());
}
