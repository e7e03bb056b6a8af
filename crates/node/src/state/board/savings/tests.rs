//! Compares the estimated saving on a machine of known watts with the true one; the detector is a lock held for 40 ms.

use crate::camera::answer;
use crate::camera::clip::tests::{FakeMeter, report};
use crate::camera::clip::{ClipConfig, ClipTracker};
use crate::frame::{DetectorRun, FrameRecord, Times};
use crate::settings::tests::{config, prepared};
use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{Evidence, FrameHead, Need, Outcome, Policy, PolicyConfig};
use albireo_power::{PowerHandle, Value, start_with};
use albireo_service::clock::milliseconds;
use albireo_wire::{ClipReport, DetectionsMessage, EnergyQuality};
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

const IDLE_WATTS: f64 = 60.0;
const BUSY_WATTS: f64 = 70.0;
const CALL: Duration = Duration::from_millis(40);
const CLIP: Duration = Duration::from_secs(150);

/// One detector for all cameras, first come first served.
#[derive(Default)]
struct Detector {
    turn: tokio::sync::Mutex<()>,
    runs: Mutex<Vec<Instant>>,
}

impl Detector {
    async fn run(&self) -> Instant {
        let _turn = self.turn.lock().await;
        self.runs.lock().push(Instant::now());
        tokio::time::sleep(CALL).await;
        Instant::now()
    }

    fn busy_s(&self, now: Instant) -> f64 {
        let runs = self.runs.lock();
        let Some((last, before)) = runs.split_last() else {
            return 0.0;
        };
        (CALL * before.len() as u32 + CALL.min(now - *last)).as_secs_f64()
    }
}

/// Detections at a time: objects that pass one by one, sometimes two at once, with pauses in between.
fn scene(camera: usize, seconds: f64) -> Vec<Detection> {
    let mut passing = Vec::new();
    for object in 0..40 {
        let since = seconds - f64::from(object) * 4.5 - camera as f64 * 1.7;
        let lasts = 2.0 + f64::from(object * 7 % 5) * 1.4;
        if (0.0..lasts).contains(&since) {
            let wobble = 0.01 * (since * 5.0 + f64::from(object)).sin();
            passing.push(Detection {
                bounding_box: BoundingBox::new(0.1 + 0.09 * since + wobble, 0.5, 0.1, 0.15),
                class: ClassId(2),
                confidence: 0.8,
            });
        }
    }
    passing
}

/// A camera's loop over the clip: it answers the newest frame, then takes the next.
async fn play(
    camera: usize,
    rate: f64,
    mut policy: Box<dyn Policy>,
    detector: Arc<Detector>,
    power: PowerHandle,
) -> ClipReport {
    let mut tracker = ClipTracker::new(ClipConfig::default(), power.camera(), None, policy.name());
    let mut outcome = Outcome::default();
    let start = Instant::now();
    let mut last: Option<u64> = None;
    loop {
        let newest = (start.elapsed().as_secs_f64() * rate + 1e-6).floor() as u64;
        let index = last.map_or(0, |last| newest.max(last + 1));
        let arrival = start + Duration::from_secs_f64(index as f64 / rate);
        if arrival >= start + CLIP {
            break;
        }
        tokio::time::sleep_until(arrival).await;
        let head = FrameHead {
            index,
            step: u32::try_from(last.map_or(1, |last| index - last)).unwrap(),
            picture: PictureSize::new(1280, 720),
        };
        last = Some(index);
        tracker.arrive(0, Some("drive"), arrival);
        let mut times = Times::default();
        let mut need = policy.begin(head);
        while need != Need::Nothing {
            need = match need {
                Need::Detections => {
                    let end = detector.run().await;
                    times.latency.detector = Some(milliseconds(arrival.elapsed()));
                    times.detector_run = Some(DetectorRun { end, used: CALL });
                    let found = scene(camera, index as f64 / rate);
                    policy.answer(Evidence::Detections(&found))
                }
                _ => policy.answer(Evidence::Unavailable),
            };
        }
        policy.finish(&mut outcome);
        let message = DetectionsMessage {
            degraded: outcome.degraded,
            ..answer(index, outcome.state)
        };
        tracker.count(&FrameRecord {
            times,
            ..FrameRecord::new(Arc::new(message), arrival.elapsed())
        });
    }
    tokio::time::sleep_until(start + CLIP).await;
    report(tracker.shutdown(Instant::now()).unwrap()).await
}

/// A clip that a separate machine has run.
struct Run {
    /// What the machine used.
    joules: f64,
    power: PowerHandle,
    /// One for each camera.
    reports: Vec<ClipReport>,
}

/// Runs the clip under a policy.
async fn run(policy: &str, cameras: usize, rate: f64) -> Run {
    let mut config = PolicyConfig::default();
    config.select(policy).unwrap();
    let start = Instant::now();
    let detector = Arc::new(Detector::default());
    let metered = Arc::clone(&detector);
    let used_until = move |now: Instant| {
        IDLE_WATTS * now.duration_since(start).as_secs_f64()
            + (BUSY_WATTS - IDLE_WATTS) * metered.busy_s(now)
    };
    let counter = used_until.clone();
    let plug = FakeMeter(move |now: Instant| Some(Value::Counter(counter(now))));
    let stop = CancellationToken::new();
    let interval = Duration::from_millis(100);
    let (power, sampler) = start_with("fake", Box::new(plug), interval, stop.clone());
    let mut loops = Vec::new();
    for camera in 0..cameras {
        let policy = config.build().unwrap();
        let playing = play(camera, rate, policy, Arc::clone(&detector), power.clone());
        loops.push(tokio::spawn(playing));
    }
    tokio::time::sleep_until(start + CLIP).await;
    let joules = used_until(start + CLIP);
    let mut reports = Vec::new();
    for camera in loops {
        reports.push(camera.await.unwrap());
    }
    stop.cancel();
    sampler.await.unwrap();
    Run {
        joules,
        power,
        reports,
    }
}

/// The node's own estimate, as its page shows it.
fn estimated_saving(power: &PowerHandle) -> Option<f64> {
    let board = prepared(&config(None, "albireo")).board;
    board.set_power(power.snapshot());
    let energy = board.savings().since_start.energy.unwrap();
    assert_eq!(energy.quality, EnergyQuality::Measured);
    energy.saved_joules_estimated
}

#[tokio::test(start_paused = true)]
async fn the_estimate_is_within_a_tenth_of_the_extra_cost_of_vanilla() {
    // Loads of 0.4, 1.2, 0.8 and 1.6: calls that fit, calls that wait for each other, and more than one detector can run.
    for (cameras, rate) in [(1, 10.0), (1, 30.0), (4, 5.0), (4, 10.0)] {
        let vanilla = run("vanilla", cameras, rate).await;
        let albireo = run("albireo", cameras, rate).await;
        let truth = vanilla.joules - albireo.joules;
        let saved = |report: &ClipReport| report.energy.saved_joules_estimated;
        let of_clips: f64 = albireo.reports.iter().map(|report| saved(report).unwrap()).sum();
        let case = format!("{cameras} cameras at {rate}/s: {truth:.1} J saved");
        assert!(truth > 50.0, "{case}");
        for estimate in [of_clips, estimated_saving(&albireo.power).unwrap()] {
            let off = (estimate / truth - 1.0).abs();
            assert!(off < 0.1, "{case}, not {estimate:.1}");
        }
        for report in &albireo.reports {
            let calls = report.detector_latency_ms.count as f64;
            assert_eq!(report.detector_used_ms, 40.0 * calls, "without any waiting");
        }
        // A node that calls the detector on every frame saves nothing.
        for report in &vanilla.reports {
            assert_eq!(saved(report).unwrap_or(0.0), 0.0);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn without_known_detector_watts_no_saving_is_reported() {
    // The detector's watts follow from how power changes with the share of calls, and here that share is constant.
    let run = run("fixed-skip", 1, 10.0).await;
    assert_eq!(estimated_saving(&run.power), None);
    assert!(run.reports[0].skip_rate > 0.4);
    assert_eq!(run.reports[0].energy.saved_joules_estimated, None);
}
