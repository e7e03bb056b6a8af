//! What the tests of a hub send it as a node, over a real Zenoh session.

use albireo_wire::{ClipReport, ReportAnswer, ReportBatch, ReportRefusal, VERSION, read};
use serde_json::{Value, json};
use std::time::{Duration, SystemTime};
use uuid::{Builder, Uuid};

pub(crate) fn now_ns() -> u64 {
    u64::try_from(SystemTime::UNIX_EPOCH.elapsed().unwrap().as_nanos()).unwrap()
}

/// An id that is unique per node, time and number.
pub(crate) fn id(node: &str, number: u64, made_ns: u64) -> Uuid {
    let mut random = [0; 10];
    let name = node.bytes().fold(0_u16, |sum, byte| {
        sum.wrapping_mul(31).wrapping_add(byte.into())
    });
    random[..2].copy_from_slice(&name.to_be_bytes());
    random[2..].copy_from_slice(&number.to_be_bytes());
    Builder::from_unix_timestamp_millis(made_ns / 1_000_000, &random).into_uuid()
}

/// A report of 10 J, otherwise as in the example of `albireo_wire`.
pub(crate) fn clip_report(node: &str, camera: &str, number: u64, id: Uuid) -> ClipReport {
    let example = include_bytes!("../../../crates/wire/src/report/dictionary-1.json");
    let mut example: ReportBatch = read(example).expect("a batch");
    let mut report = example.reports.remove(0);
    report.energy.joules = Some(10.0);
    ClipReport {
        id,
        node: node.to_owned(),
        camera: camera.to_owned(),
        clip: format!("window-{number}"),
        count: Some(number),
        board: None,
        audit: None,
        ..report
    }
}

/// The batch of a node's reports, sent now.
pub(crate) fn in_batch(node: &str, reports: Vec<ClipReport>) -> ReportBatch {
    ReportBatch {
        v: VERSION,
        node: node.to_owned(),
        t_ms: now_ns() / 1_000_000,
        ages: Vec::new(),
        reports,
    }
}

/// The session of a node's uplink, once its router answers.
pub(crate) async fn uplink(endpoint: &str) -> zenoh::Session {
    let retry = json!({"period_init_ms": 50, "period_max_ms": 200});
    open(&[
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("connect/timeout_ms", json!(-1)),
        ("connect/retry", retry),
    ])
    .await
}

/// Opens a session with these settings over Zenoh's defaults.
pub(crate) async fn zenoh_session(settings: &[(&str, Value)]) -> zenoh::Result<zenoh::Session> {
    let mut config = zenoh::Config::default();
    let alone = ("scouting/multicast/enabled", json!(false));
    for (key, value) in settings.iter().chain([&alone]) {
        config.insert_json5(key, &value.to_string())?;
    }
    zenoh::open(config).await
}

pub(crate) async fn open(settings: &[(&str, Value)]) -> zenoh::Session {
    tokio::time::timeout(Duration::from_secs(60), zenoh_session(settings))
        .await
        .expect("the session opens in time")
        .unwrap()
}

#[derive(Debug)]
pub(crate) enum Reply {
    Answer(ReportAnswer),
    Refused(ReportRefusal),
    Nothing,
}

impl Reply {
    pub(crate) fn answer(self) -> ReportAnswer {
        match self {
            Self::Answer(answer) => answer,
            reply => panic!("{reply:?}"),
        }
    }

    pub(crate) fn assert_stored(self) {
        let answer = self.answer();
        assert!(answer.refused.is_empty(), "{answer:?}");
    }
}

/// Sends a payload as the reports of `node`, and waits for the reply.
pub(crate) async fn send(
    session: &zenoh::Session,
    node: &str,
    payload: Vec<u8>,
    limit: Duration,
) -> Reply {
    let query = session.get(format!("albireo/@report/{node}"));
    let replies = query.payload(payload).timeout(limit).await.unwrap();
    while let Ok(reply) = replies.recv_async().await {
        match reply.result() {
            Ok(sample) => return Reply::Answer(read(&sample.payload().to_bytes()).unwrap()),
            Err(error) => {
                // Zenoh's own error, for a timeout, is no refusal.
                if let Ok(refusal) = read(&error.payload().to_bytes()) {
                    return Reply::Refused(refusal);
                }
            }
        }
    }
    Reply::Nothing
}
