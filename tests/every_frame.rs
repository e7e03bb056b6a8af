//! Cameras that must not lose a frame (`delivery = "every"`): only their own senders are slowed down.

use crate::node_frames::{Bench, CAMERA, attachment, configuration, pictures};
use crate::support::policies::Before;
use crate::support::{PATIENCE, until};
use albireo_core::policy::{Policy, PolicyConfig};
use albireo_node::PreparedNode;
use albireo_node::config::CameraConfig;
use albireo_node::input::Delivery;
use albireo_wire::FrameAnswer;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// The number of the live camera's first frame.
const LIVE: u64 = 100;

const TAPES: [&str; 2] = ["tape-a", "tape-b"];

async fn put(session: &zenoh::Session, camera: &str, seq: u64, picture: &[u8]) {
    session
        .put(format!("albireo/node/{camera}/frame"), picture)
        .encoding("image/jpeg")
        .attachment(attachment(seq, None, None))
        .congestion_control(zenoh::qos::CongestionControl::Block)
        .await
        .unwrap();
}

/// Sends a frame as a query, and returns the node's answer.
async fn ask(session: &zenoh::Session, camera: &str, seq: u64, picture: &[u8]) -> FrameAnswer {
    let replies = session
        .get(format!("albireo/node/{camera}/frame"))
        .payload(picture)
        .encoding("image/jpeg")
        .attachment(attachment(seq, None, None))
        .timeout(PATIENCE)
        .await
        .unwrap();
    let reply = replies.recv_async().await.expect("it is answered");
    let sample = reply.into_result().unwrap();
    albireo_wire::read(&sample.payload().to_bytes()).unwrap()
}

/// Sends frames as `albireo replay --every` does: each after the previous one was accepted.
fn send_each(session: &zenoh::Session, camera: &'static str, picture: &[u8]) -> JoinHandle<()> {
    let (session, picture) = (session.clone(), picture.to_vec());
    tokio::spawn(async move {
        for seq in 4..12 {
            assert_eq!(ask(&session, camera, seq, &picture).await.refused, None);
        }
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
#[ignore = "needs ONNX Runtime"]
async fn cameras_that_slow_down_their_senders_slow_down_nobody_else() {
    let mut config = configuration();
    let policy: PolicyConfig = config.policy.clone();
    config.cameras = vec![CameraConfig::named(CAMERA)];
    config.cameras.extend(TAPES.map(|tape| CameraConfig {
        delivery: Delivery::Every,
        ring: 1,
        ..CameraConfig::named(tape)
    }));
    // The policies of the tapes wait until `shut` is dropped, however the test ends.
    let (shut, gate) = channel::<()>();
    let gate = Arc::new(Mutex::new(gate));
    let prepared = PreparedNode::new(&config)
        .unwrap()
        .with_policies(Arc::new(move |camera| {
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
            put(&bench.session, tape, seq, &picture).await;
        }
        senders.push(send_each(&bench.session, tape, &picture));
    }
    // Frames of the tapes have lower numbers, so that answers can be distinguished.
    for seq in LIVE..LIVE + 3 {
        put(&bench.session, CAMERA, seq, &picture).await;
        assert_eq!(bench.answer().await.seq, seq);
        let replies = bench.session.get("albireo/node/tape-a/threshold").await;
        let answered = replies.unwrap().recv_async().await;
        // An error, because this policy has no threshold, is an answer too.
        answered.expect("a threshold query is answered");
    }
    assert!(senders.iter().all(|sender| !sender.is_finished()));
    drop(shut);
    for sender in senders {
        timeout(PATIENCE, sender).await.unwrap().unwrap();
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
        until("every frame is counted", async || {
            tape.snapshot().states.frames() == 12
        })
        .await;
        assert_eq!(tape.snapshot().dropped.total(), 0);
    }
    bench.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn an_unusable_frame_is_rejected_with_a_reason_and_counted() {
    let mut bench = Bench::start(&configuration()).await;
    let answer = ask(&bench.session, CAMERA, 0, b"not a picture").await;
    assert!(answer.refused.is_some());
    let dropped = bench.snapshot().dropped;
    assert_eq!((dropped.undecodable, dropped.total()), (1, 1));
    bench.send(pictures(1).remove(0), 1).await;
    assert_eq!(bench.answer().await.seq, 1);
    bench.stop().await;
}
