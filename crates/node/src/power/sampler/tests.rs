//! Promises of the sampler.

use super::*;
use crate::power::{Domain, NoMeter, Value, Values};

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
    let start = Instant::now();
    let stop = CancellationToken::new();
    let interval = Duration::from_millis(100);
    let (handle, task) = start_with(
        Box::new(Curve(start, curve)),
        interval,
        Duration::ZERO,
        stop.clone(),
    );
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
async fn without_a_meter_energy_is_unavailable_and_nobody_waits_long() {
    let stop = CancellationToken::new();
    let (handle, _task) = start_with(
        Box::new(NoMeter),
        Duration::from_millis(100),
        Duration::ZERO,
        stop.clone(),
    );
    let start = Instant::now();
    tokio::time::sleep(Duration::from_secs(2)).await;
    let asked = Instant::now();
    let found = handle.settled_energy(start, asked).await;
    assert!(asked.elapsed() < Duration::from_millis(500));
    assert_eq!(found, SpanEnergy::unavailable("none"));
    stop.cancel();
}
