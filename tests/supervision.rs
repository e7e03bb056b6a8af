//! A node whose parts fail or hang restarts them, delays no others, and stops within the configured time.

use crate::node_frames::{
    Bench, CAMERA, ask_frame, attachment, configuration, pictures, put, refused,
};
use crate::support::detectors::model;
use crate::support::{
    Node, albireo, assert_contains, grey_jpeg, metric, next, run_command, until, until_read,
    zenoh_client,
};
use albireo_core::policy::{Evidence, FrameHead, Need, Outcome, Policy, PolicyConfig};
use albireo_node::PreparedNode;
use albireo_node::config::CameraConfig;
use albireo_node::input::Delivery;
use albireo_wire::{ClipEnd, ClipReport, HealthState, HealthStatus};
use rstest::rstest;
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// A wrapper that runs `before` ahead of each frame of `inner`, a policy without a threshold.
struct Before<F> {
    inner: Box<dyn Policy>,
    before: F,
}

impl<F: FnMut() + Send + Sync> Policy for Before<F> {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        (self.before)();
        self.inner.begin(frame)
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        self.inner.answer(evidence)
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.inner.finish(outcome);
    }

    fn reset(&mut self) {
        self.inner.reset();
    }
}

async fn status(
    changes: &mut watch::Receiver<HealthStatus>,
    wanted: impl FnMut(&HealthStatus) -> bool,
) -> HealthStatus {
    changes.wait_for(wanted).await.unwrap().clone()
}

fn settings(detector: &str, more: &str) -> String {
    let model = model(detector);
    format!(
        "detector.model = {model:?}\npolicy.name = \"vanilla\"\npower.source = \"none\"\n{more}"
    )
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_panicking_camera_loop_is_counted_reported_and_restarted_and_no_frame_vanishes() {
    let config = configuration();
    // Each policy panics after two frames.
    let policies = move |_: &str, policy: &PolicyConfig| {
        let inner = policy.build()?;
        let mut good = 2_u32;
        let before = move || good = good.checked_sub(1).expect("a bug in a policy");
        Ok(Box::new(Before { inner, before }) as Box<dyn Policy>)
    };
    let prepared = PreparedNode::new(&config).unwrap();
    let prepared = prepared.with_policies(Arc::new(policies));
    let mut bench = Bench::start_prepared(&config, prepared).await;
    let mut reports = bench.published::<ClipReport>("clip").await;
    let mut changes = bench.board.readiness.subscribe();
    let picture = pictures(1).remove(0);
    for seq in 0..2 {
        bench.send_of_clip(picture.clone(), seq, "a").await;
        assert_eq!(bench.answer().await.seq, seq);
    }
    bench.send_of_clip(picture.clone(), 2, "a").await;
    let failed = status(&mut changes, |status| status.state == HealthState::NotReady).await;
    let said = ["camera front", "a bug in a policy"];
    assert_contains(&failed.reasons["tasks"], &said);
    // The open clip is not lost with the loop.
    let report = next(&mut reports).await;
    assert_eq!((report.clip.as_str(), report.frames), ("a", 2));

    let board = Arc::clone(&bench.board);
    let failures = || board.tasks.lock()["camera front"];
    let restarted = async || board.readiness.health().state() == HealthState::Degraded;
    until("a restart", restarted).await;
    assert_eq!(failures(), 1);
    bench.send_of_clip(picture.clone(), 3, "a").await;
    assert_eq!(bench.answer().await.seq, 3);
    let health = bench.board.readiness.health();
    assert_eq!(health.state(), HealthState::Degraded);

    // Every third frame ends its loop, and the backoff between loops grows: most frames find no loop.
    for seq in 4..44 {
        bench.send_of_clip(picture.clone(), seq, "a").await;
    }
    let stopped = || bench.snapshot().dropped.stopped;
    // A frame that ends a loop is counted with the task.
    let answered = || bench.snapshot().states.frames();
    let counted = async || answered() + stopped() + failures() >= 44;
    until("all frames are accounted for", counted).await;
    assert!(stopped() >= 30, "{:?}", bench.snapshot().dropped);
    assert_eq!(bench.snapshot().dropped.total(), stopped());
    bench.stop().await;
}

const TAPES: [&str; 2] = ["tape-a", "tape-b"];

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
#[ignore = "needs ONNX Runtime"]
async fn cameras_that_slow_down_their_senders_slow_down_nobody_else() {
    let mut config = configuration();
    config.cameras = vec![CameraConfig::named(CAMERA)];
    config.cameras.extend(TAPES.map(|tape| CameraConfig {
        delivery: Delivery::Every,
        ring: 1,
        ..CameraConfig::named(tape)
    }));
    // The policies of the tapes wait until `shut` is dropped, however the test ends.
    let (shut, gate) = channel::<()>();
    let gate = Arc::new(Mutex::new(gate));
    let prepared =
        PreparedNode::new(&config)
            .unwrap()
            .with_policies(Arc::new(move |camera, policy| {
                let inner = policy.build()?;
                if !TAPES.contains(&camera) {
                    return Ok(inner);
                }
                let gate = Arc::clone(&gate);
                // `block_in_place` lets the other tasks of this worker thread continue.
                let pass = move || assert!(gate.lock().unwrap().recv().is_err());
                let before = move || tokio::task::block_in_place(&pass);
                Ok(Box::new(Before { inner, before }) as Box<dyn Policy>)
            }));
    let mut bench = Bench::start_prepared(&config, prepared).await;
    let picture = pictures(1).remove(0);
    // More frames than the loop and the ring hold: puts wait, and queries stay unanswered.
    let mut senders = Vec::new();
    for tape in TAPES {
        for seq in 0..4 {
            put(&bench.session, tape, &picture, attachment(seq, None, None)).await;
        }
        // As `albireo replay --every` does: each frame after the previous one was accepted.
        let session = bench.session.clone();
        let picture = picture.clone();
        senders.push(tokio::spawn(async move {
            for seq in 4..12 {
                let attached = attachment(seq, None, None);
                let reply = ask_frame(&session, tape, &*picture, "image/jpeg", attached).await;
                assert_eq!(refused(reply), None);
            }
        }));
    }
    // Frames of the tapes have lower numbers, so that answers can be distinguished.
    for seq in 100..103 {
        let attached = attachment(seq, None, None);
        put(&bench.session, CAMERA, &picture, attached).await;
        assert_eq!(bench.answer().await.seq, seq);
        let replies = bench.session.get("albireo/node/tape-a/threshold").await;
        let answered = replies.unwrap().recv_async().await;
        // An error, because this policy has no threshold, is an answer too.
        answered.expect("a threshold query is answered");
    }
    assert!(senders.iter().all(|sender| !sender.is_finished()));
    drop(shut);
    for sender in senders {
        sender.await.unwrap();
    }
    let mut seen = Vec::new();
    for _ in 0..24 {
        seen.push(bench.answer().await.seq);
    }
    seen.sort_unstable();
    assert_eq!(seen, (0..24).map(|n| n / 2).collect::<Vec<_>>());
    for tape in TAPES {
        let tape = bench.board.camera(tape).unwrap();
        // A frame is counted after its answer is sent.
        let is_counted = async || tape.snapshot().states.frames() == 12;
        until("every frame is counted", is_counted).await;
        assert_eq!(tape.snapshot().dropped.total(), 0);
    }
    bench.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn stopping_takes_at_most_the_configured_time_when_the_detector_hangs_and_keeps_the_clip() {
    let mut config = configuration();
    config.detector.model = model("hanging.onnx");
    config.node.stop_timeout = Duration::from_secs(4);
    config.cameras[0].ring = 4;
    let mut bench = Bench::start(&config).await;
    let mut reports = bench.published::<ClipReport>("clip").await;
    // Dark pictures are answered at once, a bright one never.
    bench.send_of_clip(solid(0), 0, "last").await;
    assert_eq!(bench.answer().await.seq, 0);
    bench.send_of_clip(solid(255), 1, "last").await;
    for seq in 2..4 {
        let sent = bench.send_of_clip(solid(0), seq, "last");
        let answered = timeout(Duration::from_secs(1), sent).await;
        assert!(answered.is_err(), "it must wait for its turn");
    }
    // The link keeps the order: once the query is answered, the frames are in the ring.
    until_read(&bench.session, "node", CAMERA).await;
    let board = Arc::clone(&bench.board);
    let start = Instant::now();
    bench.shutdown.cancel();
    (&mut bench.stopped).await.unwrap().unwrap();
    let took = start.elapsed();
    assert!(took < Duration::from_secs(4), "it took {took:?}");
    let report = next(&mut reports).await;
    assert_eq!((report.clip.as_str(), report.frames), ("last", 2));
    assert_eq!((report.degraded_frames, &*report.provider), (1, "cpu"));
    assert_eq!(report.ended_by, ClipEnd::Shutdown);
    // Frames in the ring are counted, on the board and in the clip report.
    assert_eq!(report.dropped.stopped, 2);
    assert_eq!(board.camera(CAMERA).unwrap().snapshot().dropped.stopped, 2);
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_second_node_with_the_same_name_is_degraded_until_the_first_stops() {
    let first = Bench::start(&configuration()).await;
    let mut config = configuration();
    config.zenoh.connect = first.endpoints.clone();
    let second = Bench::start(&config).await;
    let mut changes = second.board.readiness.subscribe();
    let of_this_name = |status: &HealthStatus| {
        let reason = status.reasons.get("zenoh");
        reason.is_some_and(|reason| reason.contains("of this name"))
    };
    let twin = status(&mut changes, of_this_name).await;
    assert_eq!(twin.state, HealthState::Degraded);
    first.stop().await;
    status(&mut changes, |now| !now.reasons.contains_key("zenoh")).await;
    second.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_second_signal_ends_a_node_at_once_whatever_hangs() {
    let limits = "# development: stop_timeout_s=60\ndetector.timeout_ms = 600000\n";
    let node = Node::start(&settings("hanging.onnx", limits)).await;
    let session = zenoh_client(&node.zenoh).await;
    // The first frame makes the detector hang, two more wait, and the next displaces one: the camera loop waits.
    let overrun = r#"albireo_frames_dropped_total{camera="front",kind="overrun"}"#;
    let mut seq = 0;
    until("the detector hangs", async || {
        put(&session, CAMERA, &solid(255), attachment(seq, None, None)).await;
        seq += 1;
        metric(&node.http, overrun).await > 0.0
    })
    .await;
    // Pending signals of one kind merge into one, so the signal is repeated until the node has exited.
    let id = node.id().to_string();
    let again = tokio::spawn(async move {
        let mut period = tokio::time::interval(Duration::from_millis(50));
        loop {
            period.tick().await;
            let _ = Command::new("kill").args(["-TERM", &id]).stderr(Stdio::null()).status();
        }
    });
    let ended = node.ended().await;
    again.abort();
    assert_eq!(ended.status.code(), Some(130));
    assert!(ended.took < Duration::from_secs(5), "{:?}", ended.took);
}

#[rstest]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn two_signals_at_once_are_one_request_for_an_orderly_stop() {
    let node = Node::start(&settings("colours.onnx", "")).await;
    // Like `timeout`, which signals its child and then the whole group. Two kinds, since two of one kind may merge; from one
    // shell, since a signal 1 s after the first is a second request.
    let kill = "kill -INT $0 && kill -TERM $0";
    run_command(Command::new("sh").args(["-c", kill, &node.id().to_string()])).succeeds();
    let ended = node.ended().await;
    assert_eq!(ended.status.code(), Some(0), "{}", ended.log);
}

/// A picture of one grey level, of the size of the detectors' input.
fn solid(value: u8) -> Vec<u8> {
    grey_jpeg(value, [64, 32])
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_detector_run_that_never_returns_ends_the_node_with_an_error() {
    let node = Node::start(&settings("hanging.onnx", "detector.timeout_ms = 500\n")).await;
    let session = zenoh_client(&node.zenoh).await;
    put(&session, CAMERA, &solid(255), attachment(0, None, None)).await;
    let ended = node.ended().await;
    assert_eq!(ended.status.code(), Some(1), "{}", ended.log);
    let said = "the thread of the detector has not come back for 30 s";
    assert_contains(&ended.log, &[said]);
}

#[rstest]
#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_model_never_finishes_loading_stops_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let node = Node::spawn(albireo(), folder, &settings("endless.onnx", "")).await;
    let ready = reqwest::get(format!("{}/readyz", node.http)).await.unwrap();
    assert_eq!(ready.status(), 503);
    until("the model is being loaded", async || {
        let lines = node.text("/api/v1/log").await;
        lines.contains("ONNX Runtime loaded") && lines.contains("endless.onnx")
    })
    .await;
    let ended = node.stop_well().await;
    let (took, log) = (ended.took, ended.log);
    assert!(took < Duration::from_secs(10), "it took {took:?}:\n{log}");
    let said = ["loading the detector", "stopped before the node was ready"];
    assert_contains(&log, &said);
    // The unloading of ONNX Runtime must not break a run in progress.
    assert!(!log.contains("GetElementType"), "{log}");
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_disk_that_stalls_at_start_delays_no_health_check() {
    let folder = tempfile::tempdir().unwrap();
    // Opening a pipe to write blocks until somebody reads.
    let pipe = folder.path().join("lock");
    crate::support::pipe(&pipe);
    let mut config = configuration();
    config.node.state_dir = Some(folder.path().to_owned());
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let shutdown = CancellationToken::new();
    let stop = shutdown.clone();
    let running =
        tokio::spawn(async move { albireo_node::run(&config, None, listener, stop).await });
    let status = async |path: &str| {
        let answer = reqwest::get(format!("http://{address}{path}")).await;
        answer.map_or(0, |answer| answer.status().as_u16())
    };
    let mut found = Vec::new();
    for path in ["/healthz", "/readyz", "/api/v1/cameras"] {
        found.push(status(path).await);
    }
    // Read before any assertion: a failing test would wait for the writer.
    let reader = tokio::task::spawn_blocking(move || std::fs::File::open(pipe));
    let _reader = reader.await.unwrap().unwrap();
    assert_eq!(found, [200, 503, 503]);
    let continues = async || status("/api/v1/cameras").await == 200;
    until("the node continues", continues).await;
    assert_eq!(status("/healthz").await, 200);
    shutdown.cancel();
    running.await.unwrap().unwrap();
}
