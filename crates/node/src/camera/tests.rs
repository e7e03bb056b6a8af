//! Tests of a camera's loop, with a detector of coloured boxes and with frames that wait or are missing.

use super::*;
use crate::PreparedNode;
use crate::camera::audit::Examiner;
use crate::camera::clip::Clip;
use crate::camera::clip::tests::report;
use crate::config::NodeConfig;
use crate::input::source::SourcePicture;
use crate::input::{Frame, Pushed};
use crate::publishing::Congestion;
use crate::recorder::Recorder;
use crate::state::board::{Board, Event, News};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::FrameState;
use albireo_power::PowerHandle;
use albireo_scene::BoxScene;
use albireo_vision::detector::{CameraSlot, DetectorConfig, DetectorHandle};
use albireo_vision::picture::{EncodedPicture, FrameLimits, PictureFormat};
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::EmptyRun;
use albireo_wire::{AuditReport, ClipEnd, ClipReport, DetectionsMessage, DetectorCalls, VERSION};
use futures_util::FutureExt;
use std::path::Path;
use std::time::Duration;
use tokio::sync::broadcast::Receiver;
use tokio::sync::mpsc::UnboundedReceiver;

fn detector_config(model: &str) -> DetectorConfig {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/models");
    DetectorConfig {
        model: models.join(model),
        timeout_ms: 60_000,
        ..DetectorConfig::default()
    }
}

pub(super) async fn detector() -> DetectorHandle {
    DetectorHandle::start(&detector_config("boxes.onnx")).await.unwrap()
}

/// A detector whose runs take two pictures, which finds an object in a bright one. Calls within `join` of the threshold join.
pub(super) async fn shared_detector(join: f64) -> DetectorHandle {
    let config = DetectorConfig {
        batch_size: 2,
        join,
        ..detector_config("yolo_open.onnx")
    };
    DetectorHandle::start(&config).await.unwrap()
}

pub(super) fn pixels(detector: &DetectorHandle) -> PixelWork {
    let preparation = detector.preparation().clone();
    PixelWork::new(preparation, None, FrameLimits::default(), 1)
}

/// The evidence of a camera without a screen.
pub(super) fn live_evidence(detector: &DetectorHandle, pixels: &PixelWork) -> LiveEvidence {
    let slot = CameraSlot(0);
    let pixels = pixels.clone();
    let run = EmptyRun::new(100);
    let never = CancellationToken::new();
    LiveEvidence::new(detector.clone(), None, run, slot, pixels, never)
}

pub(super) fn picture(index: u64) -> EncodedPicture {
    let size = PictureSize::new(640, 360);
    let frame = BoxScene::new(5, size).frame(index);
    EncodedPicture {
        format: PictureFormat::Jpeg,
        bytes: frame.jpeg(85).unwrap().into(),
        size,
        mount: None,
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Audit {
    Off,
    OfEachSkippedFrame,
}

/// A camera whose frames the test puts into its ring.
struct Bench {
    board: Arc<Board>,
    receiver: Arc<FrameReceiver>,
    camera: Camera,
    clips: UnboundedReceiver<Clip>,
}

impl Bench {
    /// A camera under a policy.
    async fn new(policy: &str, audit: Audit) -> Self {
        let mut config = NodeConfig::default();
        config.audit.share = match audit {
            Audit::Off => 0.0,
            Audit::OfEachSkippedFrame => 1.0,
        };
        config.policy.select(policy).unwrap();
        Self::of(config).await
    }

    async fn of(config: NodeConfig) -> Self {
        Self::with(config, detector().await).await
    }

    async fn with(mut config: NodeConfig, detector: DetectorHandle) -> Self {
        config.cameras[0].ring = 64;
        let node = PreparedNode::new(&config).unwrap();
        let board = Arc::clone(&node.board);
        let camera = Arc::clone(&board.cameras[0]);
        let settings = config.cameras[0].receiver_settings(config.frame);
        let receiver = Arc::new(FrameReceiver::new(settings, Arc::clone(&camera.input)));
        let pixels = pixels(&detector);
        let energy = PowerHandle::none().camera();
        let (closed, clips) = tokio::sync::mpsc::unbounded_channel();
        let recorder = Recorder::new(&config.record, Vec::new()).of_camera(0);
        let examiner = Examiner {
            detector: detector.clone(),
            pixels: pixels.clone(),
            energy: energy.clone(),
            recorder: recorder.clone(),
        };
        let examine =
            move |picture, shown, answer| examiner.clone().examine(picture, shown, answer).boxed();
        let audit = CameraAudit::new(config.audit, Arc::clone(&camera), examine);
        let session = crate::api::name::tests::session_alone().await;
        let key = camera.keys.detections();
        let sent = Congestion::LIVE_ANSWERS;
        let detections = Outlet::declare(&session, key, sent, &camera.unpublished).await.unwrap();
        let evidence = live_evidence(&detector, &pixels);
        let parts = CameraParts {
            detections,
            positions: Arc::clone(&board.positions),
            board: camera,
            receiver: Arc::clone(&receiver),
            policies: Arc::new(|_, config| config.build()),
            late: None,
            settled: None,
            ros2: None,
            min_confidence: MinConfidence::new(None, 0.5),
            class_names: detector.class_names().to_vec(),
            closed,
            energy,
            recorder,
            reset_at_clip: false,
        };
        Self {
            board,
            receiver,
            camera: Camera::new(Arc::new(parts), config.loop_settings(), evidence, audit).unwrap(),
            clips,
        }
    }

    async fn play(mut self) -> (Arc<Board>, Vec<Clip>) {
        let stop = CancellationToken::new();
        let camera = tokio::spawn(self.camera.run(stop.clone()));
        while self.receiver.ring.waiting() > 0 {
            tokio::task::yield_now().await;
        }
        // A stop lets the current frame finish.
        stop.cancel();
        camera.await.unwrap();
        let mut clips = Vec::new();
        while let Some(clip) = self.clips.recv().await {
            clips.push(clip);
        }
        (self.board, clips)
    }
}

/// The next answer on the board.
async fn next_answer(events: &mut Receiver<Arc<Event>>) -> Arc<DetectionsMessage> {
    loop {
        if let News::Frame(event) = &events.recv().await.unwrap().news {
            return Arc::clone(&event.detections);
        }
    }
}

fn put(receiver: &FrameReceiver, index: u64, epoch: u64, received: Instant) {
    let pushed = receiver.ring.push(sequenced(index, epoch, received), 0);
    assert!(matches!(pushed, Pushed::Queued));
}

/// Puts a frame with this picture.
fn put_picture(receiver: &FrameReceiver, index: u64, picture: EncodedPicture) {
    let mut sequenced = sequenced(index, 0, Instant::now());
    sequenced.frame.picture = picture;
    let pushed = receiver.ring.push(sequenced, 0);
    assert!(matches!(pushed, Pushed::Queued));
}

/// A frame of a camera with 25 frames per second, whenever it is received.
fn sequenced(index: u64, epoch: u64, received: Instant) -> SequencedFrame {
    let frame = Frame {
        sequence: index,
        time_ns: 1_000_000_000 + index * 40_000_000,
        clip: Some("drive".into()),
        position: None,
        picture: picture(index),
        received,
    };
    SequencedFrame {
        frame,
        index,
        epoch,
        is_broken: false,
        query: None,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_new_stream_starts_with_an_empty_policy_whichever_frame_arrives_first() {
    let bench = Bench::new("fixed-skip", Audit::Off).await;
    // The first frame of a stream always calls the detector. The second stream's first frame is missing.
    for (index, epoch) in [(0, 0), (1, 0), (3, 1)] {
        put(&bench.receiver, index, epoch, Instant::now());
    }
    let (board, _) = bench.play().await;
    let states = board.camera("front").unwrap().snapshot().states;
    assert_eq!((states.p, states.i), (1, 2), "{states:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn frames_that_wait_are_no_silence_and_dropped_ones_count_for_their_clip() {
    let bench = Bench::new("vanilla", Audit::Off).await;
    let receiver = &bench.receiver;
    receiver.count_dropped(DropKind::Undecodable, 3, &"broken");
    // The detector was slow, so ten seconds of frames wait: the first is older than the silence that ends a clip.
    let now = Instant::now();
    for index in 0..10 {
        put(receiver, index, 0, now - Duration::from_secs(10 - index));
    }
    let (board, clips) = bench.play().await;
    let snapshot = board.camera("front").unwrap().snapshot();
    assert_eq!(snapshot.states.frames(), 10);
    assert_eq!(clips.len(), 1);
    let report = &clips[0].report;
    assert_eq!(report.frames, 10);
    assert_eq!(report.ended_by, ClipEnd::Shutdown);
    let dropped = &report.dropped;
    assert_eq!(dropped.undecodable, 3);
    assert_eq!(dropped.total(), 3);
    assert_eq!(snapshot.dropped, *dropped);
}

/// A picture of one shade.
fn plain_picture(shade: u8) -> EncodedPicture {
    let size = PictureSize::new(640, 360);
    EncodedPicture {
        format: PictureFormat::Gray8,
        bytes: vec![shade; 640 * 360].into(),
        size,
        mount: None,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn an_empty_road_is_passed_over_and_the_audit_tells_what_was_missed() {
    let mut config = NodeConfig::default();
    config.audit.share = 1.0;
    // At 25 frames per second, the time of three frames, and of four.
    config.screen.pause_s = 0.12;
    config.screen.after_s = 0.16;
    let mut bench = Bench::of(config).await;
    let board = Arc::clone(&bench.board.cameras[0]);
    let mut events = bench.board.subscribe();
    let stop = CancellationToken::new();
    let camera = tokio::spawn(bench.camera.run(stop.clone()));
    let mut states = Vec::new();
    for index in 0..12 {
        // Something comes in while nobody looks.
        let picture = if index < 8 {
            plain_picture(0)
        } else {
            picture(index)
        };
        put_picture(&bench.receiver, index, picture);
        states.push(next_answer(&mut events).await.state.as_str());
        let skipped = states.iter().filter(|state| matches!(**state, "E" | "P")).count() as u64;
        while board.snapshot().audit.unwrap().sums.drawn() < skipped {
            tokio::task::yield_now().await;
        }
    }
    stop.cancel();
    camera.await.unwrap();
    assert_eq!(states[..10].join(" "), "I I I I E E I E E I");
    let snapshot = board.snapshot();
    assert_eq!(snapshot.states.e, 4);
    assert_eq!(snapshot.calls.get(CallCause::EmptyRoad), 2);
    assert!((board.rate().unwrap() - 25.0).abs() < 0.1);
    let report = report(bench.clips.recv().await.unwrap()).await;
    assert_eq!(report.states.e, 4);
    // On frame 8, passed over, the detector finds what was not shown.
    let sums = report.audit.unwrap().sums;
    assert!(sums.frames >= 4, "{sums:?}");
    assert!(sums.detected > sums.paired, "{sums:?}");
}

/// Plays a drive; returns its messages without latencies, and the audit of its report, which must agree with the board.
async fn drive(policy: &str, audit: Audit) -> (Vec<DetectionsMessage>, Option<AuditReport>) {
    let mut bench = Bench::new(policy, audit).await;
    let board = Arc::clone(&bench.board.cameras[0]);
    let mut events = bench.board.subscribe();
    let stop = CancellationToken::new();
    let camera = tokio::spawn(bench.camera.run(stop.clone()));
    let mut published = Vec::new();
    let mut skipped = 0;
    for index in 0..60 {
        put(&bench.receiver, index, 0, Instant::now());
        let message = next_answer(&mut events).await;
        skipped += u64::from(message.state.is_skipped());
        published.push(DetectionsMessage {
            latency_ms: Latency::default(),
            ..(*message).clone()
        });
        // Each drawn frame is audited before the next arrives, as if the detector had time.
        while audit == Audit::OfEachSkippedFrame
            && board.snapshot().audit.unwrap().sums.drawn() < skipped
        {
            tokio::task::yield_now().await;
        }
    }
    stop.cancel();
    camera.await.unwrap();
    let reported = report(bench.clips.recv().await.unwrap()).await.audit;
    let counts = |audit: &AuditReport| (audit.sums, audit.calls);
    let counted = board.snapshot().audit;
    assert_eq!(reported.as_ref().map(counts), counted.as_ref().map(counts));
    (published, reported)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_switch_of_the_policy_loses_no_frame_and_each_report_names_the_policy_of_its_frames() {
    let bench = Bench::new("albireo:1e-3", Audit::OfEachSkippedFrame).await;
    let board = Arc::clone(&bench.board);
    let receiver = Arc::clone(&bench.receiver);
    let mut clips = bench.clips;
    let mut events = bench.board.subscribe();
    let stop = CancellationToken::new();
    let camera = tokio::spawn(bench.camera.run(stop.clone()));
    let mut thresholds = Vec::new();
    for index in 0..60 {
        if index == 25 {
            let policy = board.policy().named("expected-loss").unwrap();
            board.switch_policy(policy);
        }
        put(&receiver, index, 0, Instant::now());
        let message = next_answer(&mut events).await;
        assert_eq!(message.seq, index);
        thresholds.push(message.threshold.unwrap().name);
    }
    stop.cancel();
    camera.await.unwrap();
    assert!(thresholds[..25].iter().all(|name| name.as_str() == "u"));
    assert!(thresholds[25..].iter().all(|name| name.as_str() == "lambda"));
    let snapshot = board.cameras[0].snapshot();
    assert_eq!(snapshot.states.frames(), 60);
    let reports = [clips.recv().await.unwrap(), clips.recv().await.unwrap()];
    assert!(clips.recv().await.is_none());
    let [before, after] = reports.map(|clip| clip.report);
    assert_eq!(before.policy, "albireo");
    assert_eq!(before.part, 0);
    assert_eq!(before.frames, 25);
    assert_eq!(after.policy, "expected-loss");
    assert_eq!(after.part, 1);
    assert_eq!(after.frames, 35);
    assert_eq!(before.ended_by, ClipEnd::Policy);
    // What was drawn under a policy is in its report, and shown as its own.
    let drawn = |report: &ClipReport| report.audit.as_ref().unwrap().sums.drawn();
    let skipped = |report: &ClipReport| report.states.skipped(report.degraded_frames);
    assert_eq!(drawn(&before), skipped(&before));
    assert_eq!(drawn(&after), skipped(&after));
    assert_eq!(snapshot.policy_audit.unwrap().sums.drawn(), drawn(&after));
    let drawn_in_all = drawn(&before) + drawn(&after);
    assert_eq!(snapshot.audit.unwrap().sums.drawn(), drawn_in_all);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn the_detector_does_not_see_broken_pictures_and_they_are_answered_by_prediction() {
    // Asks the detector for every frame.
    let bench = Bench::new("vanilla", Audit::Off).await;
    for index in 0..9 {
        bench.receiver.take_picture(SourcePicture {
            picture: Ok(picture(index)),
            is_reopened: index == 0,
            is_broken: (3..6).contains(&index),
            recorded: None,
        });
    }
    let (board, _) = bench.play().await;
    let shown = board.camera("front").unwrap().snapshot();
    assert_eq!((shown.states.p, shown.states.i), (3, 6), "{shown:?}");
    assert_eq!(shown.degraded_frames, 3);
    assert_eq!(shown.skip_rate(), 0.0, "a broken frame saves nothing");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn objects_are_forgotten_once_pictures_have_been_broken_for_seconds() {
    for (blind_s, is_reported) in [(1, true), (3, false)] {
        let bench = Bench::new("albireo:1e-3", Audit::Off).await;
        let begun = Instant::now();
        for (index, seconds) in [(0, 0), (1, 0), (2, 0), (3, blind_s)] {
            let mut frame = sequenced(index, 0, begun + Duration::from_secs(seconds));
            frame.is_broken = index > 1;
            bench.receiver.ring.push(frame, 0);
        }
        let (board, _) = bench.play().await;
        let latest = board.camera("front").unwrap().snapshot().latest.unwrap();
        assert_eq!(latest.seq, 3);
        assert_eq!(!latest.boxes.is_empty(), is_reported, "after {blind_s} s");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn the_audit_changes_no_bit_of_published_messages() {
    for policy in ["albireo:1e-3", "expected-loss:0.6"] {
        let (without, none) = drive(policy, Audit::Off).await;
        let (with, audit) = drive(policy, Audit::OfEachSkippedFrame).await;
        assert!(none.is_none());
        assert_eq!(without, with, "{policy}");
        let skipped = with.iter().filter(|frame| frame.state.is_skipped());
        // The audit counts as shown exactly what was published.
        let shown: usize = skipped.clone().map(|frame| frame.boxes.len()).sum();
        let skipped = skipped.count() as u64;
        assert!(skipped > 10, "{policy}: {skipped}");
        let audit = audit.unwrap();
        let sums = &audit.sums;
        assert_eq!(sums.frames, skipped, "{policy}");
        assert_eq!(audit.calls, skipped, "{policy}");
        assert_eq!(sums.missed, 0, "{policy}");
        assert_eq!(sums.shown, shown as u64, "{policy}");
        assert!(audit.detector_us > 0);
        // Low in this scene: at 0.6 `expected-loss` shows 5 of its 29 boxes, as a comparison on every frame confirms.
        let recall = audit.sums.recall().unwrap();
        assert!(recall.low < recall.rate, "{policy}: {recall:?}");
        assert!(recall.rate > 0.05, "{policy}: {recall:?}");
    }
}

/// The final answer of a frame without boxes and threshold.
pub(crate) fn answer(seq: u64, state: FrameState) -> DetectionsMessage {
    DetectionsMessage {
        v: VERSION,
        seq,
        t_ns: 0,
        clip: "c".to_owned(),
        state,
        pending: false,
        degraded: false,
        cause: (state != FrameState::E).then_some(CallCause::Uncertain),
        passed: None,
        tau_max: Some(1e-4),
        threshold: None,
        width: 4,
        height: 3,
        boxes: Vec::new(),
        latency_ms: Latency::default(),
    }
}

/// The calls of a camera with an object in view that stands still, by their causes.
async fn calls_of(detector: DetectorHandle) -> DetectorCalls {
    let mut config = NodeConfig::default();
    config.policy.select("albireo:1e-3").unwrap();
    let bench = Bench::with(config, detector).await;
    for index in 0..30 {
        put_picture(&bench.receiver, index, plain_picture(255));
    }
    let (board, _) = bench.play().await;
    board.camera("front").unwrap().snapshot().calls
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_call_that_is_near_joins_the_run_that_another_camera_is_about_to_begin() {
    let size = PictureSize::new(640, 360);
    let other = CameraSlot(1);
    let detector = shared_detector(0.5).await;
    let alone = calls_of(detector.clone()).await;
    assert_eq!(
        alone.get(CallCause::Joined),
        0,
        "nobody else is about to call"
    );

    let _announced = detector.announce(other, size);
    assert!(calls_of(detector).await.get(CallCause::Joined) > 0);

    let never_joins = shared_detector(0.0).await;
    let _announced = never_joins.announce(other, size);
    assert_eq!(calls_of(never_joins).await, alone);
}
