//! A program of this version beside one of the version before: messages and a database as that one wrote them, recorded
//! from its processes (tests/fixtures/messages, tests/fixtures/databases).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::fleet::{HubProcess, settings, sqlite, uplink};
use albireo_wire::{
    ClipReport, CountersMessage, Desired, DetectionsMessage, PullRequest, ReceivedBatch,
    ReportAnswer, StatusMessage, read,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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

#[tokio::test]
async fn a_hub_goes_on_with_the_database_of_the_version_before() {
    let folder = tempfile::tempdir().unwrap();
    let packed = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/databases")
        .join(format!("hub-{BEFORE}.db.gz"));
    let mut database = Vec::new();
    flate2::read::GzDecoder::new(std::fs::File::open(packed).unwrap())
        .read_to_end(&mut database)
        .unwrap();
    std::fs::write(folder.path().join("hub.db"), database).unwrap();
    let (_, settings) = settings(&sqlite(folder.path()));
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    let node = hub.get("/api/v1/nodes/car-7").await;
    assert_eq!(node["node"], "car-7", "{node}");
    // Its clip is older than what is kept one by one after two weeks; the sums of its day stay for ever.
    let energy = hub
        .get("/api/v1/energy?by=node&since_ms=1795219200000")
        .await;
    assert!(energy.to_string().contains("car-7"), "{energy}");
}
