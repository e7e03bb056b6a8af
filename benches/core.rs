//! Measures the decision core per frame, without the detector: `P` frames and detector frames separately, with 1 to
//! 300 objects, for Albireo with both profiles and for expected-loss. Run with `cargo bench --bench core`.

#![allow(clippy::expect_used)]

use albireo_core::policy::{
    Albireo, AlbireoSettings, ExpectedLoss, ExpectedLossSettings, Policy, Profile, Trigger,
};
use albireo_scene::{Camera, Scene};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use std::time::{Duration, Instant};

const OBJECTS: [usize; 5] = [1, 10, 30, 100, 300];
/// Few enough that no uncertainty reaches the highest threshold.
const PREDICTED_IN_A_ROW: u64 = 15;

fn frames(criterion: &mut Criterion) {
    for (name, profile) in [("paper", Profile::Paper), ("reference", Profile::Reference)] {
        let mut settings = AlbireoSettings::of(profile);
        let new = |settings| Albireo::new(settings, 1e-9).expect("the settings can be used");
        detector_frames(criterion, name, &new(settings));
        // Only the threshold calls the detector, and no object leaves the picture.
        settings.t_max = u32::MAX;
        settings.periodic_cap = u32::MAX;
        settings.objects.life_cycle.boundary_margin = 10.0;
        predicted_frames(criterion, name, &new(settings), 1.0);
    }
    let trigger = Trigger::ExpectedLoss { lambda: 0.0 };
    let mut settings = ExpectedLossSettings::default();
    let new = |settings| ExpectedLoss::new(settings, trigger).expect("the settings can be used");
    detector_frames(criterion, ExpectedLoss::NAME, &new(settings));
    settings.longest_blindness = 300;
    settings.longest_pause = 300;
    predicted_frames(criterion, ExpectedLoss::NAME, &new(settings), 100.0);
}

/// Measures frames on which `policy` calls the detector, which is all of them. The detector misses 1 object in 20.
fn detector_frames<P: Policy + Clone>(criterion: &mut Criterion, name: &str, policy: &P) {
    let mut group = criterion.benchmark_group(format!("detector_frame/{name}"));
    for objects in OBJECTS {
        let mut camera = Camera::new(policy.clone());
        let recorded = Scene::new(objects).film(400, objects / 20);
        for detections in &recorded {
            camera.frame(detections);
        }
        // Played backwards and forwards, so that the film has no cut.
        let film = recorded.iter().rev().chain(&recorded);
        let mut film = film.cycle();
        group.bench_function(BenchmarkId::from_parameter(objects), |bencher| {
            bencher.iter(|| camera.frame(film.next().expect("it goes on for ever")));
        });
        assert!(!camera.outcome.state.is_skipped());
        assert!(camera.outcome.boxes.len() >= objects * 9 / 10);
    }
    group.finish();
}

/// Measures frames that `policy` predicts with its threshold at `highest`, after ten observations of its objects.
fn predicted_frames<P: Policy + Clone>(
    criterion: &mut Criterion,
    name: &str,
    policy: &P,
    highest: f64,
) {
    let mut group = criterion.benchmark_group(format!("predicted_frame/{name}"));
    for objects in OBJECTS {
        let mut camera = Camera::new(policy.clone());
        for detections in Scene::new(objects).film(10, 0) {
            camera.frame(&detections);
        }
        camera.policy.set_threshold(highest).expect("the threshold goes so far");
        let start = camera.policy.clone();
        group.bench_function(BenchmarkId::from_parameter(objects), |bencher| {
            bencher.iter_custom(|frames| {
                let mut elapsed = Duration::ZERO;
                let mut left = frames;
                while left > 0 {
                    camera.policy.clone_from(&start);
                    let run = left.min(PREDICTED_IN_A_ROW);
                    let begin = Instant::now();
                    for _ in 0..run {
                        camera.frame(&[]);
                    }
                    elapsed += begin.elapsed();
                    left -= run;
                }
                assert!(camera.outcome.state.is_skipped());
                assert_eq!(camera.outcome.boxes.len(), objects);
                elapsed
            });
        });
    }
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
