//! Promises of the clip report and its energy.

use super::*;
use crate::clip::tests::{Camera, ms};
use crate::clip::{ClipConfig, ClipTracker, EnergyShares, FrameArrival};
use crate::power::sampler::start_with;
use crate::power::{Domain, Meter, MeterError, Reading, Value, Values};
use albireo_wire::DomainEnergy;
use tokio_util::sync::CancellationToken;

fn measured(joules: f64) -> SpanEnergy {
    SpanEnergy {
        source: "rapl".to_owned(),
        quality: EnergyQuality::Measured,
        total_from: "sum_of_rails".to_owned(),
        samples: 400,
        coverage: 1.0,
        domains: vec![DomainEnergy {
            domain: "total".to_owned(),
            joules,
            mean_watts: joules / 40.0,
            peak_watts: None,
        }],
    }
}

#[test]
fn the_report_has_the_papers_energy_delay_product_and_counters_that_add_up() {
    let mut camera = Camera::new();
    let mut closed = None;
    for i in 0..=200 {
        closed = camera.frame(i * 200, None);
    }
    let closed = closed.unwrap();
    let energy = energy_of(&measured(811.5), Some(811.5), closed.duration(), 200);
    let meta = ClipMeta {
        node: "car-7".to_owned(),
        camera: "front".to_owned(),
        report: 5,
        policy: "albireo".to_owned(),
        model: "yolo.onnx".to_owned(),
        provider: "cpu".to_owned(),
    };
    let report = closed.into_report(meta, energy, None);
    assert_eq!(report.frames, 200);
    assert_eq!(report.states.frames(), report.frames);
    assert!((report.skip_rate - 0.4).abs() < 1e-12);
    assert_eq!(report.duration_s, 40.0);
    // 811.5 J over 40 s and 200 frames: 200 ms a frame.
    assert!((report.energy.edp.unwrap() - 811.5 * 200.0).abs() < 1e-6);
    assert_eq!(report.total_latency_ms.count, 200);
    assert_eq!(report.detector_latency_ms.count, 120);
    assert_eq!(report.total_latency_ms.p99, 12.0);
}

#[test]
fn without_frames_or_without_a_meter_there_is_no_product_and_no_nan() {
    assert_eq!(energy_delay_product(5.0, ms(100), 0), None);
    let none = energy_of(&SpanEnergy::unavailable("none"), None, ms(100), 5);
    assert_eq!(
        (none.joules, none.node_joules, none.edp),
        (None, None, None)
    );
    assert_eq!(none.quality, EnergyQuality::Unavailable);
}

/// A board that draws ten watts.
struct TenWatts;

impl Meter for TenWatts {
    fn source(&self) -> &str {
        "ten"
    }

    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Measured
    }

    fn poll(&mut self, _now: Instant) -> Result<Vec<Reading>, MeterError> {
        let mut values = Values::default();
        values.set(Domain::Total, Value::power(10.0));
        Ok(vec![Reading {
            at: None,
            values,
            total_from: "input_rail".into(),
            rails: Vec::new(),
        }])
    }
}

#[tokio::test(start_paused = true)]
async fn the_clips_of_two_cameras_add_up_to_the_nodes_energy() {
    let stop = CancellationToken::new();
    let (power, _task) = start_with(Box::new(TenWatts), ms(100), ms(0), stop.clone());
    let ledger = EnergyShares::new(ms(0));
    let start = Instant::now();
    let mut cameras: Vec<_> = ["front", "rear"]
        .iter()
        .map(|name| (ClipTracker::new(ClipConfig::default()), ledger.camera(name)))
        .collect();
    for second in 0..60_u32 {
        for (i, (books, share)) in cameras.iter_mut().enumerate() {
            let arrival = Instant::now();
            books.arrive(&FrameArrival {
                t_ns: 0,
                clip: Some("drive"),
                arrival,
            });
            share.frame(arrival);
            // The rear camera needs the detector in every third second only.
            if i == 0 || second.is_multiple_of(3) {
                share.detector(arrival, arrival + ms(50));
            }
        }
        tokio::time::sleep(ms(1000)).await;
    }
    let mut joules = Vec::new();
    for (books, share) in &mut cameras {
        let clip = books.shutdown(Instant::now()).unwrap();
        let energy = clip_energy(&clip, &power, share).await;
        assert!((energy.node_joules.unwrap() - 600.0).abs() < 1e-6);
        assert_eq!(energy.quality, EnergyQuality::Measured);
        joules.push(energy.joules.unwrap());
    }
    assert_eq!(start.elapsed().as_secs(), 60);
    assert!((joules[0] + joules[1] - 600.0).abs() < 1e-6, "{joules:?}");
    assert!((joules[1] - 100.0).abs() < 1e-6, "{joules:?}");
    stop.cancel();
}
