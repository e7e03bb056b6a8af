use super::*;
use crate::camera::clip::tests::{Camera, FakeMeter, ms, report};
use crate::camera::clip::{ClipConfig, ClipTracker};
use albireo_power::{Value, start_with};
use albireo_wire::EnergyQuality;
use tokio_util::sync::CancellationToken;

fn measured(joules: f64, coverage: f64) -> ClipEnergy {
    ClipEnergy {
        joules: Some(joules),
        coverage,
        quality: EnergyQuality::Measured,
        ..ClipEnergy::default()
    }
}

#[tokio::test(start_paused = true)]
async fn the_report_has_the_papers_energy_delay_product_and_counters_that_add_up() {
    let closed = Camera::new().frames(201, 200, None).remove(0);
    let product = energy_delay_product(&measured(811.5, 1.0), closed.duration(), 200);
    let report = report(closed).await;
    assert_eq!(report.frames, 200);
    assert_eq!(report.states.frames(), report.frames);
    // 80 frames ran without the detector; 6 of them needed it.
    assert_eq!(report.degraded_frames, 6);
    assert_eq!(report.states.p, 40);
    assert!((report.skip_rate - 74.0 / 200.0).abs() < 1e-12);
    assert_eq!(report.duration_s, 40.0);
    // 811.5 J over 40 s and 200 frames, which is 200 ms per frame.
    assert!((product.unwrap() - 811.5 * 200.0).abs() < 1e-6);
    assert_eq!(report.total_latency_ms.count, 200);
    assert_eq!(report.detector_latency_ms.count, 120);
    assert_eq!(report.total_latency_ms.p99, 12.0);
}

#[test]
fn without_frames_a_meter_or_whole_energy_there_is_no_product() {
    assert_eq!(energy_delay_product(&measured(5.0, 1.0), ms(100), 0), None);
    let none = ClipEnergy::default();
    assert_eq!(energy_delay_product(&none, ms(100), 5), None);
    for (coverage, has_product) in [(1.0, true), (0.9991, true), (0.998, false), (0.47, false)] {
        let energy = measured(10.0, coverage);
        let product = energy_delay_product(&energy, ms(1000), 10);
        assert_eq!(product.is_some(), has_product, "{coverage}");
        assert_eq!(energy.is_whole(), has_product);
    }
}

#[tokio::test(start_paused = true)]
async fn the_last_report_waits_no_longer_than_the_node_may_take_to_stop() {
    // It never has a new reading, as tegrastats has none between two lines.
    let meter = FakeMeter(|_: Instant| None::<Value>);
    let never = CancellationToken::new();
    let (power, _task) = start_with("fake", Box::new(meter), ms(10_000), never);
    let mut tracker = ClipTracker::new(ClipConfig::default(), power.camera(), None, "albireo");
    tracker.arrive(0, Some("last"), Instant::now());
    tokio::time::sleep(ms(500)).await;
    let asked = Instant::now();
    report(tracker.shutdown(asked).unwrap()).await;
    assert!(asked.elapsed() <= ms(301), "{:?}", asked.elapsed());
}
