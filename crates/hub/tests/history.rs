//! The history of a hub: sums of energy, pages of clips, events, database files.

use crate::support::postgres::Postgres;
use crate::support::{
    Hub, assert_contains, assert_has, batch, config, now_ns, on_both, script, sqlite,
};
use crate::tuning::{SimulatedFleet, fleet, put};
use albireo_hub::store::{Store, StoreError, transfer};
use albireo_wire::{Target, Threshold};
use rstest::rstest;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Sums of clips.
#[derive(Debug, Default, PartialEq)]
struct Sums {
    /// Whole, so that the order of the sum does not matter.
    microjoules: i64,
    frames: i64,
}

async fn sums_match_the_clips_and_never_mix_energy_qualities(database: &str) {
    let hub = Hub::start(config(database)).await;
    for node in ["car-1", "car-2"] {
        for first in (0..200).step_by(50) {
            hub.store(node, first..=first + 49).await;
        }
    }
    let page = hub.get("/api/v1/clips?limit=1000").await;
    let clips = page["clips"].as_array().unwrap();
    assert_eq!(clips.len(), 400);
    let microjoules = |joules: &Value| (joules.as_f64().unwrap() * 1e6).round() as i64;
    let mut of_clips: BTreeMap<(String, String), Sums> = BTreeMap::new();
    for clip in clips {
        let key = (clip["node"].to_string(), clip["quality"].to_string());
        let sums = of_clips.entry(key).or_default();
        sums.microjoules += microjoules(&clip["joules"]);
        sums.frames += clip["frames"].as_i64().unwrap();
    }
    assert_eq!(of_clips.len(), 6);
    let day = 86_400_000;
    let now_ms = i64::try_from(now_ns() / 1_000_000).unwrap();
    let since = now_ms / day * day - 3 * day;
    for (since, resolution) in [
        (since, "hour"),
        (since + 300_000, "five_minutes"),
        // Older than the sums over five minutes.
        (since - 12 * day - 1, "hour"),
    ] {
        let path = format!("/api/v1/energy?by=node&since_ms={since}");
        let energy = hub.get(&path).await;
        assert_eq!(energy["resolution"], resolution);
        let mut served = BTreeMap::new();
        for group in energy["groups"].as_array().unwrap() {
            let key = (group["group"].to_string(), group["quality"].to_string());
            let sums = Sums {
                microjoules: microjoules(&group["joules"]),
                frames: group["frames"].as_i64().unwrap(),
            };
            assert_eq!(served.insert(key, sums), None, "each group comes once");
            let clips = &group["clips"];
            let saved = &group["saved_joules_estimated"];
            assert_eq!(saved.as_f64().unwrap(), 12.5 * clips.as_f64().unwrap());
            assert_eq!(group["unpriced_calls"], 0);
        }
        assert_eq!(served, of_clips, "{resolution}");
    }
    // The audit of the fleet counts all clips together, with energy of any quality.
    let path = format!("/api/v1/energy?by=all&since_ms={since}");
    let energy = hub.get(&path).await;
    let audit = &energy["audit"];
    let detected = 2 * 100 * 10;
    let shown = 2 * 50 * (9 + 8);
    let rate = f64::from(shown) / f64::from(detected);
    let expected = json!({
        "drawn": 2 * 100 * 5, "missed": 2 * 100, "calls": 2 * 100 * 4, "detected": detected, "recall": {"rate": rate},
    });
    assert_has(audit, &expected);
    let recall = &audit["recall"];
    assert!(recall["low"].as_f64() < recall["rate"].as_f64());
    assert!(recall["high"].as_f64() > recall["rate"].as_f64());
    // Three boxes were shown on each missed frame: at the lower end all of them count as lost.
    assert!(recall["low"].as_f64().unwrap() < 0.85 * 1000.0 / 1300.0);
    hub.assert_metrics(&[
        "albireo_hub_audit_frames_total{result=\"compared\"} 800",
        "albireo_hub_audit_frames_total{result=\"missed\"} 200",
        "albireo_hub_audit_boxes_total{side=\"detected\",result=\"paired\"} 1700",
        "albireo_hub_audit_boxes_total{side=\"detected\",result=\"unpaired\"} 300",
        "albireo_hub_audit_boxes_total{side=\"shown\",result=\"paired\"} 1700",
        "albireo_hub_audit_boxes_total{side=\"shown\",result=\"unpaired\"} 700",
    ])
    .await;
    let joules: f64 = energy["groups"]
        .as_array()
        .unwrap()
        .iter()
        .map(|group| group["audit_joules"].as_f64().unwrap())
        .sum();
    assert!((joules - 100.0).abs() < 1e-6, "{joules}");
    let one = clips.iter().find(|clip| clip["count"] == 2).unwrap();
    assert_eq!(one["audit"]["recall"]["rate"], 0.8);
    let other = clips.iter().find(|clip| clip["count"] == 3).unwrap();
    assert!(other["audit"].is_null());
    let thresholds = hub.get("/api/v1/energy?by=threshold").await;
    for group in thresholds["groups"].as_array().unwrap() {
        assert_eq!(group["group"], "albireo u=0.0003", "{thresholds}");
    }

    // Pages and the file hold each clip once.
    let mut seen = Vec::new();
    let mut cursor = String::new();
    loop {
        let page = hub.get(&format!("/api/v1/clips?limit=70{cursor}")).await;
        for clip in page["clips"].as_array().unwrap() {
            seen.push(clip["id"].as_i64().unwrap());
        }
        match page["next"].as_i64() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    seen.dedup();
    assert_eq!(seen.len(), 400);
    let csv = reqwest::get(format!("{}/api/v1/clips.csv", hub.http))
        .await
        .unwrap()
        .text()
        .await
        .unwrap();
    assert_eq!(csv.lines().count(), 401);
    assert!(csv.starts_with("id,node,camera,"), "{csv}");
    hub.stop().await;
}

on_both!(sums_match_the_clips_and_never_mix_energy_qualities);

async fn clips_under_a_target_are_summed_under_the_target(database: &str) {
    let hub = Hub::start(config(database)).await;
    let mut batch = batch("car-1", 1..=20);
    for (index, report) in batch.reports.iter_mut().enumerate() {
        report.target = Some(Target::SkipRate(0.5));
        report.threshold = Some(Threshold::new("u", 1e-4 + index as f64 * 1e-6));
    }
    hub.deliver(&batch).await.assert_stored();
    let sums = hub.get("/api/v1/energy?by=threshold").await;
    let groups = sums["groups"].as_array().unwrap();
    assert_eq!(groups.len(), 3, "{sums}");
    for group in groups {
        assert_eq!(group["group"], "albireo skip_rate=0.5", "{sums}");
    }
    let clip = &hub.get("/api/v1/clips?limit=1").await["clips"][0];
    assert_has(clip, &json!({"threshold": "skip_rate", "value": 0.5}));
    hub.stop().await;
}

on_both!(clips_under_a_target_are_summed_under_the_target);

/// What a reader that has read up to the event `last` gets until an event of the kind `wanted` ends.
async fn events_after(hub: &Hub, last: &str, wanted: &str) -> String {
    let mut response = reqwest::Client::new()
        .get(format!("{}/api/v1/events", hub.http))
        .header("Last-Event-ID", last)
        .send()
        .await
        .unwrap();
    let mut text = String::new();
    // An event ends with an empty line.
    while !(text.contains(&format!("event: {wanted}")) && text.ends_with("\n\n")) {
        let chunk = response.chunk().await.unwrap().unwrap();
        text.push_str(&String::from_utf8_lossy(&chunk));
    }
    text
}

/// A hub with an event: reports 2 and 3 of a node are missing.
async fn hub_with_an_event() -> Hub {
    let hub = Hub::fresh().await;
    for number in [1, 4] {
        hub.store("car-1", number..=number).await;
    }
    hub
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_reconnecting_reader_gets_the_events_it_missed() {
    let hub = hub_with_an_event().await;
    let text = events_after(&hub, "0", "gap").await;
    assert!(text.contains("\"first\":2"), "{text}");
    assert!(text.contains("id: "), "{text}");
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_reader_of_another_database_reads_the_present_state_again() {
    let hub = hub_with_an_event().await;
    let text = events_after(&hub, "999999", "resync").await;
    assert!(text.contains("another database"), "{text}");
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_reader_whose_next_event_is_deleted_reads_the_present_state_again() {
    let hub = hub_with_an_event().await;
    let as_if_fifty_were_deleted = "UPDATE events SET id = id + 50";
    script(&hub.config.database.url, as_if_fifty_were_deleted).await;
    let text = events_after(&hub, "0", "resync").await;
    assert!(text.contains("were missed and are deleted"), "{text}");
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn newer_tables_and_a_file_of_another_program_are_rejected_and_the_file_is_unchanged() {
    let letter = "Dear reader, this is no database, and it has enough words to be one.";
    let newer = "UPDATE hub_meta SET value = '999' WHERE key = 'version'";
    for (statement, wanted) in [
        (newer, "newer"),
        ("DROP TABLE hub_meta", "not a hub's"),
        (letter, "database.url"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("hub.db");
        let config = config(&sqlite(folder.path())).database;
        let is_letter = statement == letter;
        if is_letter {
            std::fs::write(&file, letter.repeat(40)).unwrap();
        } else {
            Store::open(&config).await.unwrap().close().await;
            let raw = rusqlite::Connection::open(&file).unwrap();
            raw.execute_batch(statement).unwrap();
        }
        let error = Store::open(&config).await.unwrap_err();
        assert!(matches!(error, StoreError::Refused(_)), "{error:?}");
        assert!(error.to_string().contains(wanted), "{error}");
        if is_letter {
            let kept = std::fs::read_to_string(&file).unwrap();
            assert_eq!(kept, letter.repeat(40));
        }
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_database_whose_encoding_lacks_characters_is_refused() {
    let server = Postgres::start();
    let url = server.url();
    let latin =
        "CREATE DATABASE l ENCODING 'LATIN1' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0";
    let bytes =
        "CREATE DATABASE b ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0";
    script(&url, latin).await;
    script(&url, bytes).await;
    let (address, _) = url.rsplit_once('/').unwrap();
    let refused = config(&format!("{address}/l")).database;
    let error = Store::open(&refused).await.unwrap_err();
    assert!(matches!(error, StoreError::Refused(_)), "{error:?}");
    let error = error.to_string();
    for part in ["LATIN1", "ENCODING 'UTF8' TEMPLATE template0"] {
        assert!(error.contains(part), "{error}");
    }
    let taken = config(&format!("{address}/b")).database;
    Store::open(&taken).await.unwrap().close().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn the_diagnostic_archive_describes_the_hub() {
    let hub = Hub::fresh().await;
    hub.store("car-1", 1..=1).await;
    let answer = reqwest::get(format!("{}/api/v1/diag", hub.http)).await;
    let archive = answer.unwrap().bytes().await.unwrap();
    let text = String::from_utf8_lossy(&archive);
    let files = "about.json configuration.json nodes-not-online.json events.json revisions.json metrics.txt log.txt";
    assert_contains(&text, &files.split(' ').collect::<Vec<_>>());
    let lines = [
        "\"commit_ms\": 20",
        "albireo_hub_clips_total 1",
        "albireo_hub_sessions 1",
        // The answer may come before the queue is empty again.
        "albireo_hub_queue_batches ",
        "no status was received yet",
    ];
    assert_contains(&text, &lines);
    hub.stop().await;
}

async fn tables_of_version_14_are_brought_to_this_version_with_what_is_in_them(database: &str) {
    let dump = if database.starts_with("sqlite:") {
        include_str!("../../../tests/fixtures/databases/hub-14-sqlite.sql")
    } else {
        include_str!("../../../tests/fixtures/databases/hub-14-postgres.sql")
    };
    script(database, dump).await;
    // The second start finds tables of its own version.
    let hub = Hub::start(config(database)).await.restart().await;
    let half = json!({"target": {"skip_rate": 0.5}});
    let u = json!({"threshold": {"name": "u", "value": 5e-4}});
    let all = hub.get("/api/v1/revisions").await;
    let given = json!({
        "revision": 6, "select": "car-8", "to": half, "why": "half", "counts": {"waiting": 1},
    });
    assert_has(&all["revisions"][0], &given);
    let revision = hub.get("/api/v1/revisions/5").await;
    let node = json!({
        "node": "car-7", "from": {"threshold": {"name": "u", "value": 3e-4}}, "to": u, "revision": 5,
        "given_ms": 1_795_321_700_000_u64, "outcome": "applied",
    });
    assert_has(&revision["nodes"][0], &node);
    assert_eq!(json!(hub.pull("car-7").await.setting), u);
    assert_eq!(json!(hub.pull("car-8").await.setting), half);
    let rollout = hub.get("/api/v1/rollouts/1").await;
    let member = json!({
        "node": "car-7", "value": {"name": "u", "value": 5e-4}, "given_ms": 1_795_321_700_000_u64,
    });
    assert_has(&rollout["nodes"][0], &member);
    assert_eq!(rollout["plan"]["why"], "they \"asked\": for it");
    // What is given next has a higher number, and ends what was open.
    hub.store("car-8", 1..=1).await;
    let put = put(
        &hub,
        json!({"u": 5e-4, "select": "car-8", "wait_s": 0}),
        json!({"waiting": 1}),
    )
    .await;
    assert!(put["revision"].as_u64() > Some(6), "{put}");
    let before = hub.get("/api/v1/revisions/6").await;
    assert_eq!(before["nodes"][0]["outcome"], "superseded", "{before}");
    hub.stop().await;
}

on_both!(tables_of_version_14_are_brought_to_this_version_with_what_is_in_them);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_imports_the_history_and_settings_of_a_database_of_0_1() {
    let folder = tempfile::tempdir().unwrap();
    let old = rusqlite::Connection::open(folder.path().join("hub.db")).unwrap();
    let dump = include_str!("../../../tests/fixtures/databases/hub-0.1.0.sql");
    old.execute_batch(dump).unwrap();
    let server = Postgres::start();
    let to = config(&server.url());
    let moved = transfer::to_postgres(&sqlite(folder.path()), &to.database, |_| ()).await;
    assert_eq!(moved.unwrap(), 15);
    let hub = Hub::start(to).await;
    let sums = json!({"group": "car-7", "clips": 1, "frames": 5, "joules": 49.90478});
    let energy = hub.get("/api/v1/energy?by=node&since_ms=0").await;
    assert_has(&energy["groups"][0], &sums);
    let setting = json!({"threshold": {"name": "u", "value": 5e-4}});
    let change = json!({"revision": 3, "to": setting, "counts": {"applied": 1}});
    assert_has(&hub.get("/api/v1/revisions").await["revisions"][0], &change);
    assert_eq!(json!(hub.pull("car-7").await.setting), setting);
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_imports_a_sqlite_file_with_history_report_ids_and_revisions() {
    let folder = tempfile::tempdir().unwrap();
    let file = sqlite(folder.path());
    let hub = Hub::start(config(&file)).await;
    for first in (0..1200).step_by(100) {
        hub.store("car-1", first..=first + 99).await;
    }
    let nodes = SimulatedFleet::start(&hub, fleet(2)).await;
    let body = |u: f64| json!({"u": u, "select": "sim-*"});
    let applied = json!({"applied": 2});
    let first = put(&hub, body(5e-4), applied.clone()).await;
    nodes.end().await;
    let paths = [
        "/api/v1/clips?limit=1000",
        "/api/v1/energy?by=camera&since_ms=0",
        "/api/v1/revisions",
    ];
    let mut before = Vec::new();
    for path in paths {
        before.push(hub.get(path).await);
    }
    let desired = hub.pull("sim-000001").await;
    hub.stop().await;

    let server = Postgres::start();
    let to = config(&server.url());
    let moved = transfer::to_postgres(&file, &to.database, |_| ()).await;
    assert!(moved.unwrap() > 2 * 1200);
    let again = transfer::to_postgres(&file, &to.database, |_| ()).await;
    let error = again.unwrap_err().to_string();
    assert!(error.contains("empty"), "{error}");
    let foreign = transfer::to_postgres("/dev/null", &to.database, |_| ()).await;
    let is_refused = matches!(foreign, Err(StoreError::Refused(_)));
    assert!(is_refused, "{foreign:?}");

    let hub = Hub::start(to).await;
    for (path, before) in paths.into_iter().zip(before) {
        assert_eq!(hub.get(path).await, before, "{path}");
    }
    let imported = hub.pull("sim-000001").await;
    assert_eq!(imported.revision, desired.revision);
    assert_eq!(imported.setting, desired.setting);
    // Reports stored before are known; new ones get new ids.
    hub.store("car-1", 1150..=1249).await;
    assert_eq!(hub.counts("car-1").await.len(), 1000);
    let energy = hub.get("/api/v1/energy?by=node&since_ms=0").await;
    let clips: i64 = energy["groups"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|group| group["group"] == "car-1")
        .map(|group| group["clips"].as_i64().unwrap())
        .sum();
    assert_eq!(clips, 1250);
    let nodes = SimulatedFleet::start(&hub, fleet(2)).await;
    let second = put(&hub, body(7e-4), applied).await;
    assert!(second["revision"].as_u64() > first["revision"].as_u64());
    nodes.end().await;
    hub.stop().await;
}
