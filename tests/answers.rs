//! Immediate and settled answers of a node whose detector is slower than its camera, fails and hangs.

use crate::node_frames::{Bench, CAMERA, configuration, pictures};
use crate::support::detectors::model;
use crate::support::{PATIENCE, grey_jpeg, next, until_read};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::FrameState;
use albireo_node::camera::AnswerTime;
use albireo_node::config::NodeConfig;
use albireo_scene::BoxScene;
use albireo_wire::{ClipReport, DetectionsMessage, SettledMessage};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::time::{interval, timeout};

/// The time between two frames, a fifth of a detector run.
const PERIOD: Duration = Duration::from_millis(20);

/// A node that answers at once; its detector takes about 100 ms and times out after 1 s.
fn at_once(policy: &str) -> NodeConfig {
    let mut config = configuration();
    config.node.answer = AnswerTime::AtOnce;
    config.policy.select(policy).unwrap();
    config.detector.model = model("slow.onnx");
    config.detector.timeout_ms = 1000;
    config.settle.enabled = true;
    config.audit.share = 0.0;
    config
}

/// Drains the channel.
fn taken<T>(messages: &mut UnboundedReceiver<T>) -> Vec<T> {
    std::iter::from_fn(|| messages.try_recv().ok()).collect()
}

/// A drive and the messages of the node about it.
struct Drive {
    bench: Bench,
    late: UnboundedReceiver<DetectionsMessage>,
    settled: UnboundedReceiver<SettledMessage>,
    reports: UnboundedReceiver<ClipReport>,
    sent: u64,
    live: Vec<DetectionsMessage>,
    finals: BTreeMap<u64, DetectionsMessage>,
    /// The most frames answered between a frame and its final answer.
    most_ahead: u64,
}

impl Drive {
    async fn start(config: &NodeConfig) -> Self {
        let bench = Bench::start(config).await;
        let late = bench.published("late").await;
        let settled = bench.published("settled").await;
        let reports = bench.reports().await;
        until_read(&bench.session, "node", CAMERA).await;
        Self {
            late,
            settled,
            reports,
            bench,
            sent: 0,
            live: Vec::new(),
            finals: BTreeMap::new(),
            most_ahead: 0,
        }
    }

    /// Sends these pictures in a loop, at the camera's pace, until a final answer `is_wanted`.
    async fn until(
        &mut self,
        pictures: &[Vec<u8>],
        is_wanted: impl Fn(&DetectionsMessage) -> bool,
    ) {
        let mut pace = interval(PERIOD);
        for picture in pictures.iter().cycle().take(2000) {
            pace.tick().await;
            self.frame(picture, "drive").await;
            let mut came = false;
            for message in taken(&mut self.late) {
                came |= is_wanted(&message);
                self.most_ahead = self.most_ahead.max(self.sent - 1 - message.seq);
                assert!(self.finals.insert(message.seq, message).is_none());
            }
            if came {
                return;
            }
        }
        panic!("no such answer in {} frames", self.sent);
    }

    /// Sends a frame and waits for its first answer.
    async fn frame(&mut self, picture: &[u8], clip: &str) {
        self.bench.send_of_clip(picture, self.sent, clip).await;
        let live = self.bench.answer().await;
        assert_eq!(live.seq, self.sent, "each frame is answered once, in order");
        self.live.push(live);
        self.sent += 1;
    }

    /// Stops the node, and checks the invariants that hold in any state of the detector.
    async fn stop(mut self) -> Ended {
        let board = self.bench.board.clone();
        self.bench.shutdown.cancel();
        let stopped = timeout(PATIENCE, &mut self.bench.stopped).await.unwrap();
        stopped.unwrap().unwrap();
        let mut settled: Vec<SettledMessage> = Vec::new();
        while settled.len() < self.live.len() {
            settled.push(next(&mut self.settled).await);
        }
        let pending = self.live.iter().filter(|live| live.pending).count();
        while self.finals.len() < pending {
            let message = next(&mut self.late).await;
            assert!(self.finals.insert(message.seq, message).is_none());
        }
        let report = next(&mut self.reports).await;
        let mut reports: Vec<ClipReport> = vec![report];
        reports.extend(taken(&mut self.reports));
        assert!(taken(&mut self.settled).is_empty() && taken(&mut self.late).is_empty());
        let camera = board.camera(CAMERA).unwrap().snapshot();
        let counted = (camera.states.frames(), camera.degraded_frames);
        let frames = self.live.len() as u64;
        let is_degraded = |message: &&DetectionsMessage| message.degraded;
        let degraded = self.finals.values().filter(is_degraded).count() as u64;
        for live in &self.live {
            assert_eq!(live.state, FrameState::P, "{live:?}");
            assert!(!live.degraded && live.cause.is_none(), "{live:?}");
            assert_eq!(live.pending, self.finals.contains_key(&live.seq));
        }
        let mut took: Vec<_> = (self.live.iter())
            .map(|live| live.latency_ms.total)
            .collect();
        took.sort_by(f64::total_cmp);
        // Half a detector run; a busy machine may delay single answers.
        let half = took[took.len() / 2];
        assert!(
            half < 50.0,
            "median {half} ms: answers wait for the detector"
        );
        assert!(self.finals.values().all(|message| !message.pending));
        assert_eq!(counted, (frames, degraded));
        let reported: u64 = reports.iter().map(|report| report.frames).sum();
        let states: u64 = reports.iter().map(|report| report.states.frames()).sum();
        let reported_degraded: u64 = reports.iter().map(|r| r.degraded_frames).sum();
        assert_eq!(
            (reported, states, reported_degraded),
            (frames, frames, degraded)
        );
        let order: Vec<u64> = settled.iter().map(|frame| frame.seq).collect();
        assert_eq!(order, (0..frames).collect::<Vec<_>>());
        Ended {
            live: self.live,
            finals: self.finals,
            settled,
            reports,
        }
    }
}

struct Ended {
    live: Vec<DetectionsMessage>,
    finals: BTreeMap<u64, DetectionsMessage>,
    settled: Vec<SettledMessage>,
    reports: Vec<ClipReport>,
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn every_frame_is_answered_at_once_while_the_detector_is_slow_late_or_failing() {
    let scene = pictures(100);
    let [white, dark] = [255, 36].map(|value| [grey_jpeg(value, [640, 360])]);
    let is_seen = |late: &DetectionsMessage| !late.degraded && !late.boxes.is_empty();
    for policy in ["albireo:1e-3", "expected-loss:0.3"] {
        let mut drive = Drive::start(&at_once(policy)).await;
        for _ in 0..3 {
            drive.until(&scene, is_seen).await;
        }
        // A run that misses its deadline, then a good one.
        drive.most_ahead = 0;
        drive.until(&white, |late| late.degraded).await;
        // The deadline is fifty frames long.
        let ahead = drive.most_ahead;
        assert!(ahead >= 10, "only {ahead} frames were answered in between");
        drive.until(&scene, is_seen).await;
        // A run that fails, then a good one in a rebuilt session.
        drive.until(&dark, |late| late.degraded).await;
        drive.until(&scene, is_seen).await;
        // A truncated picture.
        let half = scene[0][..scene[0].len() / 2].to_vec();
        drive.until(&[half], |late| late.degraded).await;
        drive.until(&scene, is_seen).await;
        let ended = drive.stop().await;
        let is_predicted = |live: &&DetectionsMessage| !live.pending && !live.boxes.is_empty();
        let predicted = ended.live.iter().filter(is_predicted).count();
        assert!(
            predicted > 20,
            "{policy}: {predicted} with boxes beside the pending ones"
        );
        let drawn = ended.settled.iter().filter(|frame| frame.settled).count();
        assert!(drawn > 20, "{policy}: {drawn} settled");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_clip_is_reported_once_its_pending_frame_has_its_final_answer() {
    let mut config = at_once("expected-loss:0.3");
    config.cameras[0].reset_at_clip = false;
    let mut drive = Drive::start(&config).await;
    let picture = BoxScene::new(5, PictureSize::new(640, 360)).frame(0);
    let picture = picture.jpeg(85).unwrap();
    drive.frame(&picture, "a").await;
    assert!(drive.live[0].pending);
    drive.frame(&picture, "b").await;
    let ended = drive.stop().await;
    let reports = ended.reports.iter();
    let clips: Vec<_> = reports
        .map(|report| (&*report.clip, report.frames))
        .collect();
    assert_eq!(clips, [("a", 1), ("b", 1)]);
    assert!(ended.finals[&0].state != FrameState::P, "it was examined");
}
