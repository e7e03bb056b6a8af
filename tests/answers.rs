//! Immediate and settled answers of a node whose detector is slower than its camera, fails and hangs.

use crate::node_frames::{Bench, CAMERA, configuration, pictures};
use crate::support::detectors::model;
use crate::support::{grey_jpeg, next, until_read};
use albireo_core::policy::FrameState;
use albireo_node::camera::AnswerTime;
use albireo_node::config::NodeConfig;
use albireo_wire::{ClipReport, DetectionsMessage, SettledMessage};
use rstest::rstest;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::time::interval;

/// The time between two frames, a thirteenth of a detector run.
const PERIOD: Duration = Duration::from_millis(20);

/// The most frames that are sent while a run lasts.
const MOST_AHEAD: usize = 25;

/// A node that answers at once. On an idle machine its detector takes 130 to 265 ms, and on a white picture twenty times that,
/// which misses the deadline also on a fast one; a busy machine may take eight times as long.
fn at_once(policy: &str) -> NodeConfig {
    let mut config = configuration();
    config.node.answer = AnswerTime::AtOnce;
    config.policy.select(policy).unwrap();
    config.detector.model = model("slow_265.onnx");
    config.detector.timeout_ms = 2000;
    config.settle.enabled = true;
    config.audit.share = 0.0;
    config
}

fn taken<T>(messages: &mut UnboundedReceiver<T>) -> Vec<T> {
    std::iter::from_fn(|| messages.try_recv().ok()).collect()
}

struct Drive {
    bench: Bench,
    late: UnboundedReceiver<DetectionsMessage>,
    settled: UnboundedReceiver<SettledMessage>,
    reports: UnboundedReceiver<ClipReport>,
    live: Vec<DetectionsMessage>,
    finals: BTreeMap<u64, DetectionsMessage>,
}

impl Drive {
    async fn start(config: &NodeConfig) -> Self {
        let bench = Bench::start(config).await;
        let late = bench.published("late").await;
        let settled = bench.published("settled").await;
        let reports = bench.published("clip").await;
        until_read(&bench.session, "node", CAMERA).await;
        Self {
            late,
            settled,
            reports,
            bench,
            live: Vec::new(),
            finals: BTreeMap::new(),
        }
    }

    /// Sends these pictures in a loop until a final answer `is_wanted`; returns the most frames between a frame and that.
    async fn until(
        &mut self,
        pictures: &[Vec<u8>],
        is_wanted: impl Fn(&DetectionsMessage) -> bool,
    ) -> u64 {
        let mut pace = interval(PERIOD);
        let mut most_ahead = 0;
        for picture in pictures.iter().cycle().take(2000) {
            pace.tick().await;
            self.frame(picture, "drive").await;
            let mut has_come = false;
            let mut messages = taken(&mut self.late);
            // However slow the machine is, a run lasts no longer than some frames: an object's box is not kept for ever.
            if messages.is_empty() && self.ahead() > MOST_AHEAD {
                messages.push(next(&mut self.late).await);
            }
            for message in messages {
                has_come |= is_wanted(&message);
                most_ahead = most_ahead.max(self.live.len() as u64 - 1 - message.seq);
                assert!(self.finals.insert(message.seq, message).is_none());
            }
            if has_come {
                return most_ahead;
            }
        }
        panic!("no such answer in {} frames", self.live.len());
    }

    /// How many frames were sent since the oldest one that waits for its final answer.
    fn ahead(&self) -> usize {
        let is_waiting =
            |live: &DetectionsMessage| live.pending && !self.finals.contains_key(&live.seq);
        let oldest = self.live.iter().position(is_waiting);
        oldest.map_or(0, |oldest| self.live.len() - oldest)
    }

    async fn frame(&mut self, picture: &[u8], clip: &str) {
        let seq = self.live.len() as u64;
        self.bench.send_of_clip(picture, seq, clip).await;
        let live = self.bench.answer().await;
        assert_eq!(live.seq, seq, "each frame is answered once, in order");
        self.live.push(live);
    }

    /// Stops the node, and checks the invariants that hold in any state of the detector.
    async fn stop(mut self) -> EndedDrive {
        let board = self.bench.board.clone();
        self.bench.shutdown.cancel();
        (&mut self.bench.stopped).await.unwrap().unwrap();
        let mut settled: Vec<SettledMessage> = Vec::new();
        while settled.len() < self.live.len() {
            settled.push(next(&mut self.settled).await);
        }
        let pending = self.live.iter().filter(|live| live.pending).count();
        while self.finals.len() < pending {
            let message = next(&mut self.late).await;
            assert!(self.finals.insert(message.seq, message).is_none());
        }
        let mut reports = vec![next(&mut self.reports).await];
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
        let mut took: Vec<_> = self.live.iter().map(|live| live.latency_ms.total).collect();
        took.sort_by(f64::total_cmp);
        // A busy machine delays single answers, and the detector's as well.
        let runs = self.finals.values().filter(|message| !message.degraded);
        let mut runs: Vec<_> = runs.map(|message| message.latency_ms.total).collect();
        runs.sort_by(f64::total_cmp);
        let answer = took[took.len() / 2];
        let run = runs[runs.len() / 2];
        assert!(
            answer < run / 2.0,
            "answers wait: median {answer} ms, of a run {run} ms"
        );
        assert!(self.finals.values().all(|message| !message.pending));
        assert_eq!(counted, (frames, degraded));
        let reported = |figure: fn(&ClipReport) -> u64| reports.iter().map(figure).sum::<u64>();
        assert_eq!(reported(|report| report.frames), frames);
        assert_eq!(reported(|report| report.states.frames()), frames);
        assert_eq!(reported(|report| report.degraded_frames), degraded);
        let order: Vec<u64> = settled.iter().map(|frame| frame.seq).collect();
        assert_eq!(order, (0..frames).collect::<Vec<_>>());
        EndedDrive {
            live: self.live,
            finals: self.finals,
            settled,
            reports,
        }
    }
}

/// What a drive whose node has stopped was told.
struct EndedDrive {
    live: Vec<DetectionsMessage>,
    finals: BTreeMap<u64, DetectionsMessage>,
    settled: Vec<SettledMessage>,
    reports: Vec<ClipReport>,
}

#[rstest]
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
        let ahead = drive.until(&white, |late| late.degraded).await;
        // The deadline is a hundred frames long, of which at most twenty-five are sent.
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
        assert!(predicted > 5, "{policy}: {predicted} predicted");
        let drawn = ended.settled.iter().filter(|frame| frame.settled).count();
        assert!(drawn > 5, "{policy}: {drawn} settled");
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_clip_is_reported_once_its_pending_frame_has_its_final_answer() {
    let mut config = at_once("expected-loss:0.3");
    config.cameras[0].reset_at_clip = false;
    // On a busy machine a run may take seconds, and a frame whose run is given up is answered by prediction.
    config.detector.timeout_ms = 30_000;
    config.settle.longest_ms = 40_000;
    let mut drive = Drive::start(&config).await;
    let picture = pictures(1).remove(0);
    drive.frame(&picture, "a").await;
    assert!(drive.live[0].pending);
    drive.frame(&picture, "b").await;
    let ended = drive.stop().await;
    let clips: Vec<_> = ended.reports.iter().map(|report| (&*report.clip, report.frames)).collect();
    assert_eq!(clips, [("a", 1), ("b", 1)]);
    assert!(ended.finals[&0].state != FrameState::P, "it was examined");
}
