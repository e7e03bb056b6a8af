//! Promises of the sampler.

use super::*;
use crate::{Domain, NoMeter, Value, Values};

/// A meter that follows a curve of power over the seconds since it was made.
struct Curve<F>(Instant, F);

impl<F: FnMut(f64) -> Option<f64> + Send> Meter for Curve<F> {
    fn source(&self) -> &str {
        "curve"
    }

    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Measured
    }

    fn poll(&mut self, now: Instant) -> Result<Vec<Reading>, MeterError> {
        let watts = self.1(now.duration_since(self.0).as_secs_f64());
        let watts = watts.ok_or_else(|| MeterError::Failed("stalled".to_owned()))?;
        let mut values = Values::default();
        values.set(Domain::Total, Value::power(watts));
        Ok(vec![Reading {
            at: None,
            values,
            total_from: "input_rail".into(),
            rails: Vec::new(),
        }])
    }
}

fn sampled(
    curve: impl FnMut(f64) -> Option<f64> + Send + 'static,
) -> (PowerHandle, Instant, CancellationToken, JoinHandle<()>) {
    sampled_every(100, curve)
}

fn sampled_every(
    interval_ms: u64,
    curve: impl FnMut(f64) -> Option<f64> + Send + 'static,
) -> (PowerHandle, Instant, CancellationToken, JoinHandle<()>) {
    let start = Instant::now();
    let stop = CancellationToken::new();
    let interval = Duration::from_millis(interval_ms);
    let (handle, task) = start_with(Box::new(Curve(start, curve)), interval, stop.clone());
    (handle, start, stop, task)
}

#[tokio::test(start_paused = true)]
async fn a_span_is_answered_to_its_edges_and_the_sampler_stops_when_told() {
    let (handle, start, stop, task) = sampled(|t| Some(10.0 + t));
    let end = start + Duration::from_millis(8_250);
    tokio::time::sleep_until(end).await;
    let found = handle
        .settled_energy(start + Duration::from_millis(250), end)
        .await;
    let exact = 10.0 * 8.0 + 0.5 * (8.25_f64.powi(2) - 0.25_f64.powi(2));
    assert!((found.total_joules().unwrap() / exact - 1.0).abs() < 1e-3);
    assert_eq!(found.quality, EnergyQuality::Measured);
    assert_eq!(handle.now().quality, EnergyQuality::Measured);
    stop.cancel();
    task.await.unwrap();
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(handle.now().quality, EnergyQuality::Unavailable);
}

#[tokio::test(start_paused = true)]
async fn a_stalled_meter_is_counted_and_its_time_is_not_covered() {
    let (handle, start, stop, task) = sampled(|t| (!(2.95..5.95).contains(&t)).then_some(20.0));
    tokio::time::sleep_until(start + Duration::from_secs(11)).await;
    let found = handle.energy(start, start + Duration::from_secs(10));
    assert!(handle.failed_reads() >= 29);
    assert_eq!(found.quality, EnergyQuality::Partial);
    assert!((found.coverage - 0.69).abs() < 0.02, "{}", found.coverage);
    let joules = found.total_joules().unwrap();
    assert!((joules - 200.0 * found.coverage).abs() < 1e-6);
    stop.cancel();
    task.await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn without_a_meter_energy_is_unavailable_and_nobody_waits() {
    let stop = CancellationToken::new();
    let (handle, _task) = start_with(Box::new(NoMeter), Duration::from_millis(100), stop.clone());
    let start = Instant::now();
    tokio::time::sleep(Duration::from_secs(2)).await;
    let asked = Instant::now();
    let found = handle.settled_energy(start, asked).await;
    assert_eq!(asked.elapsed(), Duration::ZERO);
    assert_eq!(found, SpanEnergy::unavailable("none"));
    stop.cancel();
}

#[tokio::test(start_paused = true)]
async fn energy_is_right_at_every_interval_the_configuration_accepts() {
    for interval in [10, 100, 999, 1000, 1500, 2000, 5000, 10_000] {
        let (handle, start, stop, _task) = sampled_every(interval, |_| Some(10.0));
        let span = handle.user("front").open(start);
        let mut counted = 0.0;
        for second in 1..=40 {
            tokio::time::sleep_until(start + Duration::from_secs(second)).await;
            span.until(Instant::now());
            let so_far = handle.so_far();
            if let Some(total) = so_far.first() {
                assert!(total.joules >= counted, "a counter never falls");
                counted = total.joules;
                assert!((total.joules - 10.0 * total.covered_s).abs() < 1e-6);
            }
            assert_eq!(
                handle.now().watts.len(),
                1,
                "after {second} s at {interval} ms"
            );
        }
        let at_most_missing = 10.0 * (interval as f64 / 1e3 + 0.1);
        assert!(
            counted > 400.0 - at_most_missing,
            "{counted} J counted at {interval} ms"
        );
        let end = start + Duration::from_secs(40);
        let spent = span.close(end, Duration::MAX).await.unwrap();
        let joules = spent.node.total_joules().unwrap();
        assert!((joules - 400.0).abs() < 1e-6, "{joules} J at {interval} ms");
        assert!((spent.node.coverage - 1.0).abs() < 1e-9);
        assert_eq!(spent.node.quality, EnergyQuality::Measured);
        stop.cancel();
    }
}

#[tokio::test(start_paused = true)]
async fn a_meter_that_stalls_makes_energy_partial_at_every_interval() {
    for interval in [100, 1000, 10_000] {
        let (handle, start, stop, _task) =
            sampled_every(interval, |t| (!(35.0..95.0).contains(&t)).then_some(10.0));
        let span = handle.user("front").open(start);
        let end = start + Duration::from_secs(200);
        tokio::time::sleep_until(end).await;
        let spent = span.close(end, Duration::MAX).await.unwrap().node;
        assert_eq!(spent.quality, EnergyQuality::Partial, "at {interval} ms");
        assert!(
            (spent.coverage - 0.7).abs() < 0.06,
            "{} at {interval} ms",
            spent.coverage
        );
        let joules = spent.total_joules().unwrap();
        assert!((joules - 2000.0 * spent.coverage).abs() < 1e-6);
        stop.cancel();
    }
}

#[tokio::test(start_paused = true)]
async fn a_clips_end_is_sampled_at_once_and_not_at_the_next_interval() {
    let (handle, start, stop, _task) = sampled_every(10_000, Some);
    let span = handle.user("front").open(start);
    let end = start + Duration::from_millis(13_000);
    tokio::time::sleep_until(end).await;
    let spent = span.close(end, Duration::MAX).await.unwrap().node;
    assert!(
        end.elapsed() < Duration::from_millis(20),
        "{:?}",
        end.elapsed()
    );
    let joules = spent.total_joules().unwrap();
    assert!((joules - 0.5 * 13.0 * 13.0).abs() < 0.1, "{joules}");
    // Only samples at their interval tell of power now and of peaks.
    assert_eq!(spent.samples, 2);
    assert!((spent.domains[0].peak_watts.unwrap() - 10.0).abs() < 0.01);
    stop.cancel();
}

#[tokio::test(start_paused = true)]
async fn a_meter_that_fails_lets_nobody_wait() {
    let (handle, start, stop, _task) = sampled_every(10_000, |t| (t < 5.0).then_some(10.0));
    let spans: Vec<_> = (0..100).map(|_| handle.user("front").open(start)).collect();
    let end = start + Duration::from_millis(9000);
    tokio::time::sleep_until(end).await;
    for span in spans {
        let spent = span.close(end, Duration::MAX).await.unwrap();
        let joules = spent.node.total_joules().unwrap();
        assert!(
            (joules - 90.0).abs() < 1e-6,
            "held for less than a gap: {joules}"
        );
    }
    assert!(
        end.elapsed() < Duration::from_millis(1100),
        "{:?}",
        end.elapsed()
    );
    stop.cancel();
}

#[tokio::test(start_paused = true)]
async fn a_meter_that_panics_is_counted_and_read_again() {
    let mut polls = 0;
    let (handle, start, stop, task) = sampled(move |_| {
        polls += 1;
        assert_ne!(polls, 20, "a bug in a meter");
        Some(10.0)
    });
    let end = start + Duration::from_secs(5);
    tokio::time::sleep_until(end).await;
    let found = handle.settled_energy(start, end).await;
    assert_eq!(handle.failed_reads(), 1);
    assert!((found.total_joules().unwrap() / 50.0 - 1.0).abs() < 1e-3);
    stop.cancel();
    task.await.unwrap();
}
