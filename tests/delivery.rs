//! Delivery of clip reports to a fake hub: a queryable on its own session, whose queries a test answers.

use crate::support::camera::Camera;
use crate::support::{
    Client, Node, albireo, assert_contains, free_port, metric, next, project, run, until,
    until_ready, zenoh_client, zenoh_session,
};
use albireo_wire::{RefusalReason, ReportAnswer, ReportBatch, ReportRefusal, VERSION};
use rstest::rstest;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use uuid::Uuid;
use zenoh::Session;
use zenoh::query::Query;

const ACKNOWLEDGED: &str = "albireo_outbox_acknowledged_total";

pub(crate) fn settings(policy: &str) -> String {
    let model = project("tests/fixtures/models/boxes.onnx");
    format!(
        "detector.model = {model:?}\ndetector.timeout_ms = 60000\n\
         policy.name = \"{policy}\"\npower.source = \"none\"\n\
         # development: retry_min_ms=50 retry_max_ms=200 answer_timeout_ms=1500\n"
    )
}

/// A folder, and the settings of a node that keeps its state there.
pub(crate) fn folder(policy: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let settings = format!(
        "node.state_dir = \"{}\"\n{}",
        state.display(),
        settings(policy)
    );
    (folder, settings)
}

async fn wait_for(node: &Node, name: &str, wanted: f64) {
    until(name, async || metric(&node.http, name).await == wanted).await;
}

async fn node_and_camera() -> (Node, Camera) {
    let (folder, settings) = folder("vanilla");
    let node = Node::start_in(folder, &settings).await;
    let camera = Camera::at(&node.zenoh, "node").await;
    (node, camera)
}

struct Hub {
    session: Session,
    queries: UnboundedReceiver<Query>,
}

impl Hub {
    async fn start(endpoint: &str) -> Self {
        let session = zenoh_client(endpoint).await;
        let (sender, queries) = unbounded_channel();
        session
            .declare_queryable("albireo/@report/*")
            .callback(move |query| drop(sender.send(query)))
            .background()
            .await
            .unwrap();
        Self { session, queries }
    }

    /// The next query, which waits for its answer until it is dropped, and the ids and counts of its reports.
    async fn asked(&mut self) -> (Query, Vec<(Uuid, u64)>) {
        let query = next(&mut self.queries).await;
        let payload = query.payload().unwrap().to_bytes();
        assert!(payload.len() < 1 << 20, "a batch is below 1 MiB");
        let batch = ReportBatch::from_payload(&payload).unwrap();
        let counted =
            batch.reports.iter().map(|report| (report.id, report.count.unwrap())).collect();
        (query, counted)
    }

    /// Acknowledges everything until it has exactly the first `reports` reports, each once and in order.
    async fn stores(&mut self, reports: u64) {
        let mut known = BTreeSet::new();
        let mut stored = Vec::new();
        while (stored.len() as u64) < reports {
            let (query, mut new) = self.asked().await;
            new.retain(|(id, _)| known.insert(*id));
            stored.extend(new.into_iter().map(|(_, count)| count));
            let answer = serde_json::to_vec(&ReportAnswer::default()).unwrap();
            query.reply(query.key_expr().clone(), answer).await.unwrap();
        }
        assert_eq!(stored, (1..=reports).collect::<Vec<_>>());
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn closed_clips_survive_kills_the_open_one_a_stop_and_all_wait_for_the_answer_of_a_hub() {
    let (mut folder, settings) = folder("vanilla");
    for round in 0..6 {
        let node = Node::start_in(folder, &settings).await;
        let mut camera = Camera::at(&node.zenoh, "node").await;
        camera.clips(4).await;
        // Milliseconds after the clips end: the file is synced, although their energy may not be known yet.
        wait_for(&node, "albireo_outbox_kept_total", 3.0).await;
        if round < 5 {
            folder = node.kill().await;
        } else {
            // A session that hears the reports is no hub.
            let heard = async || camera.reported().len() == 3;
            until("the camera's session hears the reports", heard).await;
            camera.close().await;
            folder = node.stop().await.folder;
        }
    }
    let node = Node::start_in(folder, &settings).await;
    wait_for(&node, "albireo_outbox_waiting", 19.0).await;
    for _ in 0..3 {
        let mut dying = Hub::start(&node.zenoh).await;
        let unanswered = dying.asked().await;
        dying.session.close().await.unwrap();
        drop(unanswered);
    }
    let mut hub = Hub::start(&node.zenoh).await;
    let unanswered = [hub.asked().await, hub.asked().await];
    let [first, again] = unanswered.each_ref().map(|(_, reports)| reports);
    assert_eq!(first, again);
    assert_eq!(metric(&node.http, "albireo_outbox_waiting").await, 19.0);
    assert_eq!(metric(&node.http, ACKNOWLEDGED).await, 0.0);
    hub.stores(19).await;
    wait_for(&node, "albireo_outbox_waiting", 0.0).await;
    assert_eq!(metric(&node.http, ACKNOWLEDGED).await, 19.0);
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_busy_hub_is_asked_again_after_the_time_it_names_or_when_the_node_stops() {
    let (node, mut camera) = node_and_camera().await;
    let mut hub = Hub::start(&node.zenoh).await;
    camera.clips(4).await;
    let mut asked = Vec::new();
    for retry_after_ms in [700, 700, 3_600_000] {
        let (query, _) = hub.asked().await;
        asked.push(Instant::now());
        let refusal = ReportRefusal {
            v: VERSION,
            reason: RefusalReason::Busy,
            detail: "too much to do".to_owned(),
            retry_after_ms: Some(retry_after_ms),
        };
        query.reply_err(serde_json::to_vec(&refusal).unwrap()).await.unwrap();
    }
    for pause in asked.windows(2).map(|two| two[1] - two[0]) {
        assert!(pause >= Duration::from_millis(650), "{pause:?}");
    }
    assert_eq!(metric(&node.http, "albireo_outbox_waiting").await, 3.0);
    camera.close().await;
    let stopping = tokio::spawn(node.stop_well());
    hub.stores(4).await;
    stopping.await.unwrap();
}

/// The times that detections take, and those of HTTP.
async fn times(node: &Node, camera: &mut Camera, frames: u64) -> [Vec<Duration>; 2] {
    let mut detections = Vec::new();
    let mut http = Vec::new();
    for _ in 0..frames {
        let start = Instant::now();
        camera.clips(1).await;
        detections.push(start.elapsed());
        let start = Instant::now();
        assert_contains(&node.text("/healthz").await, &["ok"]);
        http.push(start.elapsed());
    }
    [detections, http]
}

fn median(times: &[Duration]) -> Duration {
    let mut times = times.to_vec();
    times.sort_unstable();
    times[times.len() / 2]
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn a_stalled_subscriber_slows_neither_detections_nor_http() {
    let (node, mut camera) = node_and_camera().await;
    let without = times(&node, &mut camera, 200).await;
    let endpoint = format!("{}#so_rcvbuf=4096", node.zenoh);
    let deaf = Client::listen(&endpoint, "albireo/node/**").await;
    deaf.freeze();
    // Two messages per frame, among them a clip report: far more than the buffers in between hold.
    let with = times(&node, &mut camera, 1700).await;
    for (without, with) in without.iter().zip(&with) {
        let without = median(without);
        let longest = *with.iter().max().unwrap();
        let with = median(&with[1500..]);
        println!("median {without:?} without it, {with:?} with it; maximum {longest:?}");
        assert!(with < without * 10 + Duration::from_millis(50));
        // A put that waited for the subscriber would take seconds.
        assert!(longest < Duration::from_millis(2500));
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_second_node_with_the_same_state_directory_is_rejected_with_a_reason() {
    let (node, _camera) = node_and_camera().await;
    let file = node.folder.path().join("node.toml");
    let elsewhere = [("ALBIREO_ZENOH__LISTEN", "[\"tcp/127.0.0.1:0\"]")];
    let said = run(&["node", "--config", file.to_str().unwrap()], &elsewhere).fails();
    assert_contains(&said, &["in use by another node"]);
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_node_starts_without_its_router_answers_health_and_survives_a_router_restart() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let connect = format!("zenoh.mode = \"client\"\nzenoh.connect = [\"{endpoint}\"]\n");
    let settings = connect + &settings("vanilla");
    let mut client = albireo();
    client.env("ALBIREO_ZENOH__LISTEN", "[]");
    let node = Node::spawn(client, tempfile::tempdir().unwrap(), &settings).await;
    assert_contains(&node.text("/healthz").await, &["ok"]);
    until("its router is missed", async || {
        let ready = node.text("/readyz").await;
        let is_plain = ready.contains("\"ready\":false") && !ready.contains(".rs:");
        assert!(is_plain, "{ready}");
        ready.contains("router cannot be reached")
    })
    .await;

    let settings = [
        ("mode", "router".into()),
        ("listen/endpoints", vec![&*endpoint].into()),
    ];
    let router = zenoh_session(&settings).await.unwrap();
    until_ready(&node.http).await;
    let mut camera = Camera::at(&endpoint, "node").await;
    camera.clips(2).await;
    camera.close().await;
    router.close().await.unwrap();
    drop(router);
    let _router = zenoh_session(&settings).await.unwrap();
    let mut camera = Camera::at(&endpoint, "node").await;
    camera.seq = 2;
    camera.clips(2).await;
}
