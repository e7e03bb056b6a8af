//! Delivery of clip reports to a fake hub: a queryable on its own session.

mod hub;

use crate::support::camera::Camera;
use crate::support::{Client, Node, assert_contains, free_port, project, run, until, until_ready};
use hub::{Hub, Manner};
use std::time::{Duration, Instant};

const ACKNOWLEDGED: &str = "albireo_outbox_acknowledged_total";

/// Settings of a node with short timeouts and backoffs.
fn settings() -> String {
    let model = project("tests/fixtures/models/boxes.onnx");
    format!(
        "detector.model = {model:?}\ndetector.timeout_ms = 60000\n\
         policy.name = \"vanilla\"\npower.source = \"none\"\n\
         # development: retry_min_ms=50 retry_max_ms=200 answer_timeout_ms=1500\n"
    )
}

/// A folder for a node's state, and settings that name it.
fn folder() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let settings = format!("node.state_dir = \"{}\"\n{}", state.display(), settings());
    (folder, settings)
}

async fn metric(node: &Node, name: &str) -> f64 {
    crate::support::metric(&node.http, name).await
}

async fn wait_for(node: &Node, name: &str, wanted: f64) {
    until(name, async || metric(node, name).await == wanted).await;
}

async fn node_and_camera() -> (Node, Camera) {
    let (folder, settings) = folder();
    let node = Node::start_in(folder, &settings).await;
    let camera = Camera::at(&node.zenoh, "node").await;
    (node, camera)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn neither_a_listener_nor_a_hub_that_crashes_or_hangs_counts_as_delivery() {
    let (node, mut camera) = node_and_camera().await;
    camera.clips(21).await;
    let heard = async || camera.reported().len() == 20;
    until("the camera's session hears the reports", heard).await;
    wait_for(&node, "albireo_outbox_waiting", 20.0).await;
    for _ in 0..3 {
        let dying = Hub::start(&node.zenoh, Manner::CommitsAndSaysNothing).await;
        dying.wait_for_asked(1).await;
        dying.die().await;
    }
    let hub = Hub::start(&node.zenoh, Manner::CommitsAndSaysNothing).await;
    hub.wait_for(20).await;
    hub.wait_for_asked(2).await;
    assert_eq!(metric(&node, "albireo_outbox_waiting").await, 20.0);
    assert_eq!(metric(&node, ACKNOWLEDGED).await, 0.0);
    hub.behave(Manner::Honest);
    wait_for(&node, "albireo_outbox_waiting", 0.0).await;
    assert_eq!(metric(&node, ACKNOWLEDGED).await, 20.0);
    hub.assert_gapless(20);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_busy_hub_is_asked_again_after_the_time_it_names_or_when_the_node_stops() {
    let (node, mut camera) = node_and_camera().await;
    let retry_after_ms = 700;
    let hub = Hub::start(&node.zenoh, Manner::Busy { retry_after_ms }).await;
    camera.clips(4).await;
    hub.wait_for_asked(3).await;
    let shortest = hub.pauses().into_iter().min().unwrap();
    assert!(shortest >= Duration::from_millis(650), "{shortest:?}");
    let retry_after_ms = 3_600_000;
    hub.behave(Manner::Busy { retry_after_ms });
    hub.wait_for_asked(4).await;
    assert_eq!(metric(&node, "albireo_outbox_waiting").await, 3.0);
    hub.behave(Manner::Honest);
    camera.close().await;
    node.stop_well().await;
    hub.wait_for(4).await;
    hub.assert_gapless(4);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn closed_clips_survive_a_kill_and_the_open_one_survives_a_stop() {
    let (mut folder, settings) = folder();
    for round in 0..6 {
        let node = Node::start_in(folder, &settings).await;
        let mut camera = Camera::at(&node.zenoh, "node").await;
        camera.clips(4).await;
        // Milliseconds after the clips end: the file is synced, although their energy may not be known yet.
        wait_for(&node, "albireo_outbox_kept_total", 3.0).await;
        if round < 5 {
            folder = node.kill().await;
        } else {
            camera.close().await;
            (_, _, _, folder) = node.stop().await;
        }
    }
    let node = Node::start_in(folder, &settings).await;
    let hub = Hub::start(&node.zenoh, Manner::Honest).await;
    hub.wait_for(5 * 3 + 4).await;
    hub.assert_gapless(5 * 3 + 4);
}

async fn times(node: &Node, camera: &mut Camera, frames: u64) -> [Vec<Duration>; 2] {
    let mut took = [Vec::new(), Vec::new()];
    for _ in 0..frames {
        let start = Instant::now();
        camera.clips(1).await;
        took[0].push(start.elapsed());
        let start = Instant::now();
        assert_contains(&node.text("/healthz").await, &["ok"]);
        took[1].push(start.elapsed());
    }
    took
}

fn median(times: &[Duration]) -> Duration {
    let mut times = times.to_vec();
    times.sort_unstable();
    times[times.len() / 2]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn a_stalled_subscriber_slows_neither_detections_nor_http() {
    let (node, mut camera) = node_and_camera().await;
    let without = times(&node, &mut camera, 200).await;
    let endpoint = format!("{}#so_rcvbuf=4096", node.zenoh);
    let deaf = Client::listen(&endpoint, "albireo/node/**", false).await;
    deaf.freeze();
    // Two messages per frame, among them a clip report: far more than the buffers in between hold.
    let with = times(&node, &mut camera, 1700).await;
    for (without, with) in without.iter().zip(&with) {
        let (without, longest) = (median(without), *with.iter().max().unwrap());
        let with = median(&with[1500..]);
        println!("median {without:?} without it, {with:?} with it; maximum {longest:?}");
        assert!(with < without * 10 + Duration::from_millis(50));
        // A put that waited for the subscriber would take seconds.
        assert!(longest < Duration::from_millis(2500));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_second_node_with_the_same_state_directory_is_rejected_with_a_reason() {
    let (node, _camera) = node_and_camera().await;
    let file = node.folder.path().join("node.toml");
    let elsewhere = [("ALBIREO_ZENOH__LISTEN", "[\"tcp/127.0.0.1:0\"]")];
    let said = run(&["node", "--config", file.to_str().unwrap()], &elsewhere).fails();
    assert_contains(&said, &["in use by another node"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_node_starts_without_its_router_answers_health_and_survives_a_router_restart() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let settings = format!(
        "zenoh.mode = \"client\"\nzenoh.connect = [\"{endpoint}\"]\n{}",
        settings()
    );
    let client = [("ALBIREO_ZENOH__LISTEN", "[]")];
    let node = Node::start_with(tempfile::tempdir().unwrap(), &settings, &client).await;
    assert_contains(&node.text("/healthz").await, &["ok"]);
    until("its router is missed", async || {
        let ready = node.text("/readyz").await;
        assert!(
            ready.contains("\"ready\":false") && !ready.contains(".rs:"),
            "{ready}"
        );
        ready.contains("router cannot be reached")
    })
    .await;

    let router = hub::router(&endpoint).await;
    until_ready(&node.http).await;
    let mut camera = Camera::at(&endpoint, "node").await;
    camera.clips(2).await;
    camera.close().await;
    router.close().await.unwrap();
    drop(router);
    let _router = hub::router(&endpoint).await;
    let mut camera = Camera::at(&endpoint, "node").await;
    camera.seq = 2;
    camera.clips(2).await;
}
