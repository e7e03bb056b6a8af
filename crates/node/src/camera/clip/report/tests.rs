//! Tests of the clip report and its energy.

use super::*;
use crate::camera::clip::tests::{Camera, FakeMeter, ms, report};
use crate::camera::clip::{ClipConfig, ClipTracker};
use crate::camera::evidence::{DetectorRun, Times};
use crate::camera::{FrameRecord, answer};
use albireo_core::policy::FrameState;
use albireo_power::{PowerHandle, Value, start_with};
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
    let mut camera = Camera::new();
    let mut closed = None;
    for i in 0..=200 {
        closed = camera.frame(i * 200, None);
    }
    let closed = closed.unwrap();
    let product = energy_delay_product(&measured(811.5, 1.0), closed.duration(), 200);
    let report = report(closed).await;
    assert_eq!(report.frames, 200);
    assert_eq!(report.states.frames(), report.frames);
    // 80 frames ran without the detector; 6 of them needed it.
    assert_eq!((report.degraded_frames, report.states.p), (6, 40));
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

/// A meter that reads constant watts; `None`: no new readings.
fn steady(watts: Option<f64>, interval: u64) -> (PowerHandle, CancellationToken) {
    let stop = CancellationToken::new();
    let meter = FakeMeter(move |_: Instant| watts.map(Value::Power));
    let (power, _task) = start_with(Box::new(meter), ms(interval), stop.clone());
    (power, stop)
}

fn tracker(power: &PowerHandle) -> ClipTracker {
    ClipTracker::new(ClipConfig::default(), power.camera(), None)
}

impl ClipTracker {
    /// Counts a frame of `clip` that arrives now.
    fn frame(&mut self, clip: &str) -> Option<Clip> {
        self.arrive(0, Some(clip), Instant::now())
    }
}

#[tokio::test(start_paused = true)]
async fn the_clips_of_two_cameras_add_up_to_the_nodes_energy() {
    let (power, stop) = steady(Some(10.0), 100);
    let start = Instant::now();
    let mut cameras = [(); 2].map(|()| tracker(&power));
    for second in 0..60_u32 {
        for (i, tracker) in cameras.iter_mut().enumerate() {
            tracker.frame("drive");
            // The rear camera needs the detector only every third second. Waiting for the front camera's run costs it
            // nothing.
            if i == 0 || second.is_multiple_of(3) {
                let end = Instant::now() + ms(50);
                tracker.count(&FrameRecord {
                    times: Times {
                        detector_run: Some(DetectorRun { end, used: ms(50) }),
                        ..Times::default()
                    },
                    ..FrameRecord::new(answer(0, FrameState::I, false, None), ms(50))
                });
            }
        }
        tokio::time::sleep(ms(1000)).await;
    }
    let mut joules = Vec::new();
    let end = Instant::now();
    for tracker in &mut cameras {
        let report = report(tracker.shutdown(end).unwrap()).await;
        let energy = report.energy;
        assert!((energy.node_joules.unwrap() - 600.0).abs() < 1e-6);
        assert_eq!(energy.quality, EnergyQuality::Measured);
        joules.push(energy.joules.unwrap());
    }
    assert_eq!(start.elapsed().as_secs(), 60);
    assert!((joules[0] + joules[1] - 600.0).abs() < 1e-6, "{joules:?}");
    // A quarter of the detector time, weighted by when it was used.
    assert!((joules[1] - 136.0).abs() < 5.0, "{joules:?}");
    stop.cancel();
}

#[tokio::test(start_paused = true)]
async fn without_a_meter_no_report_waits() {
    let mut tracker = tracker(&PowerHandle::none());
    let start = Instant::now();
    for clip in 0..1000 {
        if let Some(closed) = tracker.frame(&clip.to_string()) {
            let report = report(closed).await;
            assert_eq!(report.energy.quality, EnergyQuality::Unavailable);
        }
    }
    assert_eq!(start.elapsed(), Duration::ZERO);
}

#[tokio::test(start_paused = true)]
async fn the_last_report_waits_no_longer_than_the_node_may_take_to_stop() {
    // Like tegrastats between two lines.
    let (power, stop) = steady(None, 10_000);
    let mut tracker = tracker(&power);
    tracker.frame("last");
    tokio::time::sleep(ms(500)).await;
    let asked = Instant::now();
    let closed = tracker.shutdown(asked).unwrap();
    report(closed).await;
    assert!(asked.elapsed() <= ms(301), "{:?}", asked.elapsed());
    stop.cancel();
}
