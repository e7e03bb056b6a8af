//! The hub as a process, killed in the middle of ingest: reports made = rows in its database, none twice.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::{PATIENCE, albireo, free_port};
use albireo_wire::{
    ClipEnd, ClipEnergy, ClipReport, DroppedFrames, EnergyQuality, FrameStates, Percentiles,
    ReportAnswer, ReportBatch, VERSION, read,
};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::process::Child;

/// Kills of one run. More by hand: `ALBIREO_KILLS=1000`.
fn kills() -> u64 {
    std::env::var("ALBIREO_KILLS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(12)
}

const NODES: usize = 4;

fn start(folder: &Path, zenoh: &str, http: &str) -> Child {
    albireo()
        .arg("hub")
        .env("ALBIREO_HTTP__LISTEN", http)
        .env("ALBIREO_ZENOH__LISTEN", format!("[\"{zenoh}\"]"))
        .env(
            "ALBIREO_DATABASE__URL",
            format!("sqlite:{}", folder.join("hub.db").display()),
        )
        .env("ALBIREO_INGEST__COMMIT_MS", "20")
        .stderr(Stdio::null())
        .spawn()
        .expect("the hub starts")
}

fn report(node: &str, number: u64, started_ns: u64) -> ClipReport {
    let percentiles = Percentiles {
        count: 10,
        mean: 5.0,
        p50: 5.0,
        p95: 6.0,
        p99: 7.0,
    };
    ClipReport {
        v: VERSION,
        node: node.to_owned(),
        camera: "front".to_owned(),
        clip: format!("window-{number}"),
        report: number,
        ended_by: ClipEnd::Window,
        started_ns: started_ns + number * 1_000_000,
        duration_s: 40.0,
        frames: 10,
        states: FrameStates {
            i: 10,
            ..FrameStates::default()
        },
        skip_rate: 0.0,
        degraded_frames: 0,
        dropped: DroppedFrames::default(),
        policy: "vanilla".to_owned(),
        knob: None,
        knob_changes: Vec::new(),
        model: "detector.onnx".to_owned(),
        provider: "cpu".to_owned(),
        total_latency_ms: percentiles,
        detector_latency_ms: percentiles,
        energy: ClipEnergy {
            joules: Some(10.0),
            node_joules: Some(10.0),
            edp: None,
            quality: EnergyQuality::Measured,
            source: "rapl".to_owned(),
            total_from: "input_rail".to_owned(),
            samples: 1,
            coverage: 1.0,
            domains: Vec::new(),
        },
        board: None,
    }
}

/// A node: it makes reports, keeps them until they are acknowledged, and sends them again until then.
async fn node(
    index: usize,
    zenoh: String,
    stop: Arc<AtomicBool>,
    acknowledged: Arc<AtomicU64>,
) -> u64 {
    let name = format!("car-{index}");
    let instance = format!("{index:032x}");
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{zenoh}\"]")),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        (
            "connect/retry",
            r#"{"period_init_ms":50,"period_max_ms":200}"#.to_owned(),
        ),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config
            .insert_json5(key, &value)
            .expect("a setting Zenoh knows");
    }
    let session = zenoh::open(config).await.expect("a session");
    let begun = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .expect("a clock after 1970");
    let begun = u64::try_from(begun.as_nanos()).expect("a clock before 2554");
    let (mut made, mut stored) = (0_u64, 0_u64);
    let deadline = Instant::now() + PATIENCE * 5;
    loop {
        if !stop.load(Ordering::Relaxed) {
            made += 3;
        } else if stored == made {
            session.close().await.expect("the session closes");
            return made;
        }
        assert!(
            Instant::now() < deadline,
            "{name}: {stored} of {made} acknowledged in time"
        );
        let last = made.min(stored + 50);
        let batch = ReportBatch {
            v: VERSION,
            node: name.clone(),
            instance: instance.clone(),
            machine: None,
            first: stored + 1,
            last,
            lost: 0,
            reports: (stored + 1..=last)
                .map(|number| report(&name, number, begun))
                .collect(),
        };
        let replies = session
            .get(format!("albireo/@report/{name}"))
            .payload(batch.to_payload().expect("a batch that can be written"))
            .timeout(Duration::from_secs(2))
            .await
            .expect("a query");
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result() {
                let answer: ReportAnswer = read(&sample.payload().to_bytes()).expect("an answer");
                assert!(answer.stored <= made, "{answer:?}");
                let more = answer.stored.saturating_sub(stored);
                stored += more;
                acknowledged.fetch_add(more, Ordering::Relaxed);
            }
        }
        // A pause, so that a hub that is not there is not asked without end.
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// Waits until some more was acknowledged: the hub is then in the middle of it.
async fn more_than(acknowledged: &AtomicU64, before: u64) {
    let deadline = Instant::now() + PATIENCE;
    while acknowledged.load(Ordering::Relaxed) <= before {
        assert!(Instant::now() < deadline, "nothing is acknowledged");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hub_killed_in_the_middle_of_ingest_loses_no_report_and_has_none_twice() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let zenoh = format!("tcp/127.0.0.1:{}", free_port());
    let http = format!("127.0.0.1:{}", free_port());
    let mut hub = start(folder.path(), &zenoh, &http);
    let stop = Arc::new(AtomicBool::new(false));
    let acknowledged = Arc::new(AtomicU64::new(0));
    let nodes: Vec<_> = (0..NODES)
        .map(|index| {
            tokio::spawn(node(
                index,
                zenoh.clone(),
                Arc::clone(&stop),
                Arc::clone(&acknowledged),
            ))
        })
        .collect();
    for kill in 0..kills() {
        let before = acknowledged.load(Ordering::Relaxed);
        more_than(&acknowledged, before + kill % 7 * 5).await;
        // At another moment of a commit each time.
        tokio::time::sleep(Duration::from_millis(kill * 13 % 40)).await;
        hub.kill().await.expect("the hub is killed with SIGKILL");
        hub = start(folder.path(), &zenoh, &http);
    }
    stop.store(true, Ordering::Relaxed);
    let mut made = Vec::new();
    for node in nodes {
        made.push(node.await.expect("the node ends"));
    }
    let total: u64 = made.iter().sum();
    assert!(total > 0);

    for (index, made) in made.into_iter().enumerate() {
        let (mut numbers, mut rows, mut cursor) = (BTreeSet::new(), 0_u64, String::new());
        loop {
            let url = format!("http://{http}/api/v1/clips?node=car-{index}&limit=1000{cursor}");
            let page: Value = reqwest::get(url)
                .await
                .expect("a page")
                .json()
                .await
                .expect("JSON");
            for clip in page["clips"].as_array().expect("clips") {
                rows += 1;
                numbers.insert(clip["report"].as_u64().expect("a number"));
            }
            match page["next"].as_i64() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => break,
            }
        }
        assert_eq!(rows, made, "rows of car-{index}");
        assert_eq!(
            numbers,
            (1..=made).collect::<BTreeSet<_>>(),
            "numbers of car-{index}"
        );
    }
    let energy: Value = reqwest::get(format!("http://{http}/api/v1/energy"))
        .await
        .expect("sums")
        .json()
        .await
        .expect("JSON");
    assert_eq!(energy["groups"][0]["clips"].as_u64(), Some(total));
    assert_eq!(
        energy["groups"][0]["joules"].as_f64(),
        Some(total as f64 * 10.0)
    );
    hub.kill().await.expect("the hub ends");
}
