//! The decision core per frame, detector time excluded: `P` frames and detector frames apart, for 1 to
//! 300 objects: Albireo with both profiles, and expected-loss. Run with `cargo bench --bench core`.

#![allow(clippy::expect_used)]

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{
    Albireo, AlbireoSettings, ExpectedLoss, ExpectedLossSettings, FrameEvidence, FrameHead,
    Outcome, Policy, Profile, Trigger, decide_at_once,
};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::time::{Duration, Instant};

const PICTURE: PictureSize = PictureSize::new(1280, 720);
const OBJECTS: [usize; 5] = [1, 10, 30, 100, 300];
/// So few that no uncertainty grows to the highest threshold.
const PREDICTED_IN_A_ROW: u64 = 15;

/// Boxes that wander about slowly, with noise and now and then a miss, as a detector would report them.
struct Scene {
    boxes: Vec<(BoundingBox, [f64; 2])>,
    random: Pcg64Mcg,
}

impl Scene {
    fn new(objects: usize) -> Self {
        let mut scene = Self {
            boxes: Vec::new(),
            random: Pcg64Mcg::seed_from_u64(7),
        };
        for _ in 0..objects {
            let x = scene.between(0.05, 0.95);
            let y = scene.between(0.05, 0.95);
            let side = scene.between(0.03, 0.12);
            let velocity = [scene.between(-2e-3, 2e-3), scene.between(-2e-3, 2e-3)];
            let b = BoundingBox::new(x, y, side, side);
            scene.boxes.push((b, velocity));
        }
        scene
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Moves on by one frame, and sees every object but `missed` of them.
    fn detections(&mut self, missed: usize) -> Vec<Detection> {
        for (b, velocity) in &mut self.boxes {
            for (value, step) in [&mut b.center_x, &mut b.center_y].into_iter().zip(velocity) {
                if !(0.05..0.95).contains(&(*value + *step)) {
                    *step = -*step;
                }
                *value += *step;
            }
        }
        let skip = (self.random.next_u64() % self.boxes.len() as u64) as usize;
        let count = self.boxes.len();
        let mut seen = Vec::new();
        for index in 0..count {
            if (index + skip) % count < missed {
                continue;
            }
            let b = self.boxes[index].0;
            let mut noise = || self.between(-1e-3, 1e-3);
            seen.push(Detection {
                bounding_box: BoundingBox::new(
                    b.center_x + noise(),
                    b.center_y + noise(),
                    b.width + noise(),
                    b.height + noise(),
                ),
                class: ClassId((index % 7) as u16),
                confidence: 0.9,
            });
        }
        // The detector's order says nothing of which object is which.
        for index in (1..seen.len()).rev() {
            seen.swap(
                index,
                (self.random.next_u64() % (index as u64 + 1)) as usize,
            );
        }
        seen
    }
}

/// A policy at work.
struct Camera<P> {
    policy: P,
    outcome: Outcome,
    index: u64,
}

impl<P: Policy> Camera<P> {
    fn new(policy: P) -> Self {
        Self {
            policy,
            outcome: Outcome::default(),
            index: 0,
        }
    }

    fn frame(&mut self, detections: &[Detection]) {
        self.index += 1;
        let head = FrameHead {
            // Never a multiple of the periodic cap.
            index: self.index % 29 + 1,
            step: 1,
            picture: PICTURE,
        };
        let mut known = FrameEvidence::in_view(detections);
        let Ok(()) = decide_at_once(&mut self.policy, head, &mut known, &mut self.outcome);
    }
}

fn frames(criterion: &mut Criterion) {
    for (name, profile) in [("paper", Profile::Paper), ("reference", Profile::Reference)] {
        let mut settings = AlbireoSettings::of(profile);
        let new = |settings| Albireo::new(settings, 1e-9).expect("the settings can be used");
        detector_frames(criterion, name, &new(settings));
        // So that nothing but the threshold calls the detector, and nobody leaves.
        settings.t_max = u32::MAX;
        settings.periodic_cap = u32::MAX;
        settings.life_cycle.boundary_margin = 10.0;
        predicted_frames(criterion, name, &new(settings), 1.0);
    }
    let trigger = Trigger::ExpectedLoss { lambda: 0.0 };
    let mut settings = ExpectedLossSettings::default();
    let new = |settings| ExpectedLoss::new(settings, trigger).expect("the settings can be used");
    detector_frames(criterion, ExpectedLoss::NAME, &new(settings));
    settings.life.longest_blindness = 300;
    settings.call.longest_pause = 300;
    predicted_frames(criterion, ExpectedLoss::NAME, &new(settings), 100.0);
}

/// Frames of `policy`, which calls the detector on each of them. One object in twenty is missed.
fn detector_frames<P: Policy + Clone>(criterion: &mut Criterion, name: &str, policy: &P) {
    let mut group = criterion.benchmark_group(format!("detector_frame/{name}"));
    for objects in OBJECTS {
        let mut scene = Scene::new(objects);
        let mut camera = Camera::new(policy.clone());
        let recorded: Vec<_> = (0..400).map(|_| scene.detections(objects / 20)).collect();
        for detections in &recorded {
            camera.frame(detections);
        }
        // Back and forth, so that the film has no cut.
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

/// Frames that `policy`, which has seen its objects ten times, predicts with its knob at `highest`.
fn predicted_frames<P: Policy + Clone>(
    criterion: &mut Criterion,
    name: &str,
    policy: &P,
    highest: f64,
) {
    let mut group = criterion.benchmark_group(format!("predicted_frame/{name}"));
    for objects in OBJECTS {
        let mut scene = Scene::new(objects);
        let mut camera = Camera::new(policy.clone());
        for _ in 0..10 {
            let detections = scene.detections(0);
            camera.frame(&detections);
        }
        let turned = camera.policy.set_knob(highest);
        turned.expect("the knob goes so far");
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
