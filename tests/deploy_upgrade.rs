//! A program of this version beside one of the version before: messages and a database as that one wrote them, recorded
//! from its processes (tests/fixtures/messages, tests/fixtures/databases).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::PATIENCE;
use crate::support::fleet::{HubProcess, settings, sqlite, uplink};
use crate::support::postgres::Postgres;
use albireo_wire::{
    ClipReport, CountersMessage, Desired, DetectionsMessage, KnobValue, PullRequest, ReceivedBatch,
    ReportAnswer, StatusMessage, read,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio::time::timeout;

/// The version that wrote them.
const BEFORE: &str = "0.1.0";

fn recorded(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/messages")
        .join(BEFORE)
        .join(file)
}

fn bytes(file: &str) -> Vec<u8> {
    std::fs::read(recorded(file)).unwrap()
}

/// The message as it goes out: in text, where a short number stays one.
fn written(message: &impl Serialize) -> Value {
    serde_json::from_slice(&serde_json::to_vec(message).unwrap()).unwrap()
}

/// Reads what was recorded, and what a later version may make of it: with a field that nobody here knows. `T` must give
/// back every field that was there.
fn is_understood<T: DeserializeOwned + Serialize>(file: &str) {
    let was: Value = serde_json::from_slice(&bytes(file)).unwrap();
    let message: T = read(&bytes(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    assert_eq!(written(&message), was, "{file}");

    let mut later = was.clone();
    later["a_field_of_a_later_version"] = true.into();
    let taken = read::<T>(&serde_json::to_vec(&later).unwrap());
    let taken = taken.unwrap_or_else(|error| panic!("{file}, later: {error}"));
    assert_eq!(written(&taken), was, "{file}, later");

    let mut unknown = was;
    unknown["v"] = 999.into();
    let refused = read::<T>(&serde_json::to_vec(&unknown).unwrap());
    assert!(refused.is_err(), "{file}: a version that nobody knows");
}

#[test]
fn messages_of_the_version_before_are_understood_with_every_field_and_so_is_a_field_more() {
    is_understood::<StatusMessage>("status-full.json");
    is_understood::<StatusMessage>("status-short.json");
    is_understood::<DetectionsMessage>("detections.json");
    is_understood::<CountersMessage>("counters.json");
    is_understood::<ClipReport>("clip.json");
    is_understood::<PullRequest>("pull-request.json");
    is_understood::<ReportAnswer>("report-answer.json");
    is_understood::<Desired>("desired.json");
    let batch: ReceivedBatch = read(&bytes("report-batch.json")).unwrap();
    for report in &batch.reports {
        let _: ClipReport = read(report.get().as_bytes()).unwrap();
    }
    assert!(!batch.reports.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hub_takes_the_report_and_the_status_of_a_node_of_the_version_before() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, settings) = settings(&sqlite(folder.path()));
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    let node = uplink(&endpoint).await;
    let until = Instant::now() + crate::support::PATIENCE;
    let answer: ReportAnswer = loop {
        let replies = node
            .get("albireo/@report/car-7")
            .payload(bytes("report-batch.json.gz"))
            .timeout(Duration::from_secs(5))
            .await
            .unwrap();
        let reply = replies.recv_async().await.ok();
        let sample = reply.and_then(|reply| reply.into_result().ok());
        if let Some(sample) = sample {
            break read(&sample.payload().to_bytes()).unwrap();
        }
        assert!(Instant::now() < until, "the report was never taken");
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(answer.stored, 1);
    node.put("albireo/@status/car-7", bytes("status-full.json"))
        .await
        .unwrap();
    let shown = hub
        .until("/api/v1/nodes/car-7", |node| node["status"].is_object())
        .await;
    assert_eq!(shown["status"]["labels"]["region"], "north", "{shown}");
    let clips = hub.clips("car-7").await;
    assert_eq!(clips[0]["clip"], "window-0");
}

fn database(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/databases")
        .join(file)
}

/// An order as the version before kept it, given just now: what is older than the history is kept goes at the start.
fn an_order() -> String {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let now = now.unwrap().as_millis();
    format!(
        "INSERT INTO orders VALUES (4, {now}, 'night shift', 'less traffic', 'hand', 'car-7', 'u', '0.0005');
         INSERT INTO order_nodes VALUES (4, 'car-7', '0.0003', 'waiting', {now}, '');
         INSERT INTO desired VALUES ('car-7', 4, 'u', '0.0005');
         UPDATE counters SET value = 4 WHERE name = 'generation';"
    )
}

async fn desired(endpoint: &str) -> Desired {
    let node = uplink(endpoint).await;
    let replies = node
        .get("albireo/@pull/car-7")
        .payload(bytes("pull-request.json"))
        .await
        .unwrap();
    let reply = timeout(PATIENCE, replies.recv_async()).await.unwrap();
    let sample = reply.unwrap().into_result().unwrap();
    let desired = read(&sample.payload().to_bytes()).unwrap();
    node.close().await.unwrap();
    desired
}

async fn order(hub: &HubProcess, path: &str, body: Value) -> Value {
    let request = reqwest::Client::new()
        .put(format!("{}{path}", hub.http))
        .json(&body);
    request.send().await.unwrap().json().await.unwrap()
}

/// A hub on a database of the version before, with [`an_order`] in it.
async fn a_hub_goes_on_with(database: &str) {
    let (endpoint, settings) = settings(database);
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    let changes = hub.get("/api/v1/changes/4").await;
    assert_eq!(changes["to"], json!({"u": 5e-4}), "{changes}");
    let node = &changes["nodes"][0];
    assert_eq!(
        (&node["from"], &node["outcome"]),
        (&json!({"u": 3e-4}), &json!("waiting"))
    );
    let knob = Some(KnobValue {
        name: "u",
        value: 5e-4,
    });
    let was = desired(&endpoint).await;
    assert_eq!((was.generation, was.knob, was.target), (4, knob, None));
    // Its node is of that version too, and passes over targets: it is not asked for one, and what was desired stands.
    let target = json!({"target": {"skip_rate": 0.5}, "select": "car-7", "wait_s": 0});
    let refused = order(&hub, "/api/v1/target", target).await;
    let detail = refused["nodes"][0]["detail"].as_str().unwrap_or_default();
    assert!(
        detail.contains("version 0.1.0, takes no target"),
        "{refused}"
    );
    assert_eq!(desired(&endpoint).await, was);
    // The columns that this version adds take what it orders.
    let next = order(
        &hub,
        "/api/v1/threshold",
        json!({"u": 7e-4, "select": "car-7", "wait_s": 0}),
    );
    assert_eq!(next.await["change"], 5);
    let before = hub.get("/api/v1/changes/4").await;
    assert_eq!(before["nodes"][0]["outcome"], "superseded", "{before}");
    let detail = hub.get("/api/v1/changes/5").await;
    assert_eq!(detail["nodes"][0]["from"], json!({"u": 3e-4}), "{detail}");
    let node = hub.get("/api/v1/nodes/car-7").await;
    assert_eq!(node["node"], "car-7", "{node}");
    // Its clip is older than what is kept one by one after two weeks; the sums of its day stay for ever.
    let energy = hub
        .get("/api/v1/energy?by=node&since_ms=1795219200000")
        .await;
    assert!(energy.to_string().contains("car-7"), "{energy}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hub_goes_on_with_the_database_of_the_version_before() {
    let folder = tempfile::tempdir().unwrap();
    let packed = std::fs::File::open(database(&format!("hub-{BEFORE}.db.gz"))).unwrap();
    let mut unpacked = Vec::new();
    flate2::read::GzDecoder::new(packed)
        .read_to_end(&mut unpacked)
        .unwrap();
    let file = folder.path().join("hub.db");
    std::fs::write(&file, unpacked).unwrap();
    let opened = rusqlite::Connection::open(file).unwrap();
    opened.execute_batch(&an_order()).unwrap();
    drop(opened);
    a_hub_goes_on_with(&sqlite(folder.path())).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn a_hub_goes_on_with_the_postgresql_database_of_the_version_before() {
    let server = Postgres::start();
    server.play(&database(&format!("hub-{BEFORE}.postgres.sql")));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("order.sql");
    std::fs::write(&file, an_order()).unwrap();
    server.play(&file);
    a_hub_goes_on_with(&server.url()).await;
}
