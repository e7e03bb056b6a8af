//! Cameras that must not lose a frame (`delivery = "every"`): only their own senders are slowed down.

use crate::node_frames::{
    Bench, CAMERA, ask_frame, attachment, configuration, pictures, put, refused,
};
use crate::support::policies::Before;
use crate::support::{PATIENCE, until};
use albireo_core::policy::{Policy, PolicyConfig};
use albireo_node::PreparedNode;
use albireo_node::config::CameraConfig;
use albireo_node::input::Delivery;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use tokio::time::timeout;

const LIVE: u64 = 100;

const TAPES: [&str; 2] = ["tape-a", "tape-b"];

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
            let attached = attachment(seq, None, None);
            put(&bench.session, tape, &picture, attached).await;
        }
        // As `albireo replay --every` does: each frame after the previous one was accepted.
        let (session, picture) = (bench.session.clone(), picture.clone());
        senders.push(tokio::spawn(async move {
            for seq in 4..12 {
                let attached = attachment(seq, None, None);
                let reply = ask_frame(&session, tape, &*picture, "image/jpeg", attached).await;
                assert_eq!(refused(reply), None);
            }
        }));
    }
    // Frames of the tapes have lower numbers, so that answers can be distinguished.
    for seq in LIVE..LIVE + 3 {
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
