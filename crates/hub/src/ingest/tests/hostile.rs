//! Thousands of hostile batches from the payload to the rows, without a network, with a real database.

use crate::config::{DatabaseConfig, HistoryConfig};
use crate::ingest::limits::{PRESENCE, SET_ASIDE};
use crate::ingest::tables::MOST_CAMERA_NAMES;
use crate::ingest::{Batch, Recorder, decode};
use crate::presence::{NodeView, PresenceState};
use crate::store::{Access, Store};
use albireo_service::clock::{DAY_MS, Now};
use albireo_wire::{REPORT_DICTIONARY, VERSION};
use bytes::Bytes;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use tempfile::TempDir;
use uuid::{Builder, Uuid};

const BATCHES_PER_TRANSACTION: usize = 250;
/// The number of report ids, small so that some repeat.
const REPORTS: u64 = 4000;
const NOW_MS: i64 = 1_790_000_000_000;

fn batch(random: &mut Pcg64Mcg) -> Value {
    let first = 1 + random.next_u64() % REPORTS;
    let count = 1 + random.next_u64() % 3;
    let reports: Vec<Value> = (first..first + count).map(report).collect();
    json!({ "v": VERSION, "node": "car-1", "t_ms": NOW_MS, "reports": reports })
}

fn report(number: u64) -> Value {
    let times = json!({"count": 9, "mean": 5.0, "p50": 5.0, "p95": 6.0, "p99": 7.0});
    let id = Builder::from_unix_timestamp_millis(NOW_MS.unsigned_abs() + number, &[3; 10]);
    json!({
        "v": VERSION, "id": id.into_uuid(), "count": number, "node": "car-1", "camera": "front",
        "clip": format!("w{number}"), "ended_by": "window", "started_ns": 1_780_000_000_000_000_000 + number,
        "duration_s": 40.0, "frames": 9, "states": {"E": 0, "P": 3, "E+I": 0, "I": 6, "AI": 0}, "skip_rate": 3.0 / 9.0,
        "degraded_frames": 0, "dropped": {}, "policy": "albireo", "threshold_changes": [], "model": "m",
        "provider": "cpu", "total_latency_ms": times, "detector_latency_ms": times,
        "energy": {
            "joules": 10.0, "node_joules": 10.0, "quality": "measured", "source": "rapl",
            "total_from": "input_rail", "samples": 4, "coverage": 1.0, "domains": [],
        },
    })
}

fn hostile(random: &mut Pcg64Mcg) -> Value {
    let values = json!([
        null, u64::MAX, i64::MAX, i64::MIN, -1, 1e300, f64::MIN_POSITIVE, "\u{0}\u{7f}'; DROP TABLE clips; --",
        "x".repeat(2000), [], { "threshold": { "name": "u", "value": "NaN" } }, true, "../../*/**",
        random.next_u64() % 50,
    ]);
    let count = values.as_array().unwrap().len();
    values[random.next_u64() as usize % count].clone()
}

fn corrupt(value: &mut Value, random: &mut Pcg64Mcg) {
    // Mostly a part of the value is corrupted: a batch that is no object is rejected at once.
    let goes_deeper = !random.next_u64().is_multiple_of(4);
    // Now and then a part is removed from an object, or added to an array.
    let changes_the_number_of_parts = random.next_u64().is_multiple_of(12);
    let place = random.next_u64() as usize;
    match value {
        Value::Object(members) if goes_deeper && !members.is_empty() => {
            let name = members.keys().nth(place % members.len()).unwrap().clone();
            if changes_the_number_of_parts {
                members.remove(&name);
            } else {
                corrupt(&mut members[&name], random);
            }
        }
        Value::Array(values) if goes_deeper && !values.is_empty() => {
            if changes_the_number_of_parts {
                values.push(hostile(random));
            } else {
                let index = place % values.len();
                corrupt(&mut values[index], random);
            }
        }
        value => *value = hostile(random),
    }
}

fn payload(random: &mut Pcg64Mcg) -> Vec<u8> {
    let mut batch = batch(random);
    // A fault in the batch itself rejects it whole; most faults should get further.
    for _ in 0..random.next_u64() % 3 {
        let is_for_batch = random.next_u64().is_multiple_of(4);
        // An earlier fault may have left no first report.
        let has_report = !batch["reports"][0].is_null();
        if has_report && !is_for_batch {
            corrupt(&mut batch["reports"][0], random);
        } else {
            corrupt(&mut batch, random);
        }
    }
    let mut text = batch.to_string().into_bytes();
    if random.next_u64().is_multiple_of(8) {
        let place = random.next_u64() as usize % text.len();
        text[place] = random.next_u64() as u8;
    }
    let mut packed = zstd(&text);
    match random.next_u64() % 24 {
        0 => packed.truncate(random.next_u64() as usize % packed.len()),
        1 => {
            let place = random.next_u64() as usize % packed.len();
            packed[place] ^= 1 << (random.next_u64() % 8);
        }
        2 => packed = text,
        _ => {}
    }
    packed
}

/// Compresses any text as a node does.
fn zstd(text: &[u8]) -> Vec<u8> {
    let mut encoder = zstd::Encoder::new(vec![REPORT_DICTIONARY], 1).unwrap();
    encoder.write_all(text).unwrap();
    encoder.finish().unwrap()
}

/// A recorder of a new database.
async fn recorder(folder: &TempDir, now: Now) -> (Store, Recorder) {
    let config = DatabaseConfig {
        url: format!("sqlite:{}", folder.path().join("hub.db").display()),
        ..DatabaseConfig::default()
    };
    let store = Store::open(&config).await.unwrap();
    let recorder = Recorder::new(&store, &HistoryConfig::default(), now);
    (store, recorder)
}

fn now() -> Now {
    Now {
        unix_ms: NOW_MS,
        ..Now::system()
    }
}

#[tokio::test]
async fn what_a_node_can_repeat_fills_no_table_with_events() {
    let folder = tempfile::tempdir().unwrap();
    let now = now();
    let (store, mut recorder) = recorder(&folder, now).await;
    for state in [PresenceState::Online, PresenceState::Silent].repeat(50) {
        let node = NodeView {
            node: "car-1".to_owned(),
            state,
            ..NodeView::default()
        };
        recorder.unreadable("car-2", &"x".repeat(1 << 20), NOW_MS);
        recorder.record(&[], &[node], now).unwrap();
    }
    let events = store.events_after(0, 1000).await.unwrap();
    let count = |kind: &str| events.iter().filter(|event| event.kind == kind).count();
    assert_eq!(count("node"), PRESENCE.most as usize);
    // At most one a minute, and the time stands still.
    assert_eq!(count("refused"), 1);
    assert!(events.iter().all(|event| event.detail.to_string().len() < 3000));
    store.close().await;
}

#[tokio::test]
async fn hostile_batches_break_nothing_and_every_acknowledged_report_is_accounted_for() {
    // More by hand: ALBIREO_BATCHES=100000.
    let batches: u64 =
        std::env::var("ALBIREO_BATCHES").map_or(10_000, |text| text.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let now = now();
    let (store, mut recorder) = recorder(&folder, now).await;
    let mut random = Pcg64Mcg::seed_from_u64(20_261_122);
    let mut unreadable = 0_u64;
    let mut group = Vec::new();
    let mut clips = 0;
    let mut again = 0;
    let mut aside = 0;
    let mut refused = 0;
    let mut stored = BTreeSet::<Uuid>::new();
    for number in 1..=batches {
        match decode("car-1", &payload(&mut random).into(), NOW_MS) {
            Ok(batch) => group.push(batch),
            Err(error) => {
                assert!(!error.is_empty());
                unreadable += 1;
            }
        }
        if group.len() < BATCHES_PER_TRANSACTION && number < batches {
            continue;
        }
        let group = std::mem::take(&mut group);
        let done = recorder
            .record(&group, &[], now)
            .expect("the database accepts the rows of any batch");
        clips += done.counts.clips;
        again += done.counts.again;
        aside += done.counts.set_aside;
        assert_eq!(done.answers.len(), group.len());
        for (batch, answer) in group.iter().zip(&done.answers) {
            refused += answer.refused.len() as u64;
            let refused_ids: BTreeSet<Uuid> =
                answer.refused.iter().map(|report| report.id).collect();
            stored.extend(
                batch
                    .reports
                    .iter()
                    .filter(|report| report.content.is_ok())
                    .filter_map(|report| report.id)
                    .filter(|id| !refused_ids.contains(id)),
            );
        }
    }
    println!(
        "{batches} batches: {unreadable} not read, {clips} clips, {again} again, {aside} reports set aside, \
         {refused} refused by name"
    );
    // Each way that a report can take was taken.
    assert!(unreadable > batches / 20);
    assert!(clips > 0);
    assert!(again > 0);
    assert!(refused > 0);
    assert_eq!(stored.len() as u64, clips);
    let counts = store.report_counts("car-1").await.unwrap().unwrap();
    assert_eq!(counts.stored.unsigned_abs(), clips);
    assert_eq!(counts.set_aside.unsigned_abs(), aside);
    // All set aside are counted, but of a node only so many a day are kept.
    let kept = store.set_aside(None, None, 1000).await.unwrap();
    assert!(aside > u64::from(SET_ASIDE.most));
    assert_eq!(kept.len(), SET_ASIDE.most as usize);
    store.close().await;
}

/// The batch of these reports in the name of car-1, decoded as a payload of `sender`.
fn decoded(sender: &str, reports: &Value) -> Result<Batch, String> {
    let batch = json!({ "v": VERSION, "node": "car-1", "t_ms": NOW_MS, "reports": reports });
    let payload = Bytes::from(zstd(batch.to_string().as_bytes()));
    decode(sender, &payload, NOW_MS)
}

#[test]
fn an_empty_batch_and_an_oversized_one_are_rejected_whole() {
    let none = decoded("car-1", &json!([])).unwrap_err();
    assert_eq!(none, "the batch has no reports");
    let many = decoded("car-1", &json!(vec![0; 200_000])).unwrap_err();
    assert_eq!(many, "200000 reports, more than 1000");
}

#[test]
fn a_node_can_send_neither_the_report_nor_the_batch_of_another() {
    let mut report_of_another = report(1);
    report_of_another["node"] = "car-2".into();
    let batch = decoded("car-1", &json!([report_of_another])).unwrap();
    assert!(batch.reports[0].content.is_err());
    assert!(decoded("car-2", &json!([report(1)])).is_err());
}

/// Reports of these numbers, each of a camera of its own.
fn of_cameras(numbers: std::ops::RangeInclusive<u64>) -> Vec<Value> {
    let of_camera = |number| {
        let mut report = report(number);
        report["camera"] = format!("c{number}").into();
        report
    };
    numbers.map(of_camera).collect()
}

#[tokio::test]
async fn a_camera_under_a_new_name_is_stored_however_many_names_its_node_has_had() {
    let folder = tempfile::tempdir().unwrap();
    let now = now();
    let (store, mut recorder) = recorder(&folder, now).await;
    for day in 0_u64..3 {
        let first = 300 * day + 1;
        let batch = decoded("car-1", &json!(of_cameras(first..=first + 299))).unwrap();
        let then = Now {
            unix_ms: NOW_MS + day.cast_signed() * DAY_MS,
            ..now
        };
        let done = recorder.record(&[batch], &[], then).unwrap();
        assert_eq!(done.counts.clips, 300, "{day}");
    }
    store.close().await;
}

#[tokio::test]
async fn a_report_of_one_camera_too_many_is_set_aside_whole_and_the_others_are_stored() {
    let folder = tempfile::tempdir().unwrap();
    let now = now();
    let (store, mut recorder) = recorder(&folder, now).await;
    let most = MOST_CAMERA_NAMES.unsigned_abs();
    for first in (1..=most).step_by(512) {
        let batch = decoded("car-1", &json!(of_cameras(first..=first + 511))).unwrap();
        let done = recorder.record(&[batch], &[], now).unwrap();
        assert_eq!(done.counts.clips, 512, "{first}");
    }
    let mut reports = vec![report(most + 2)];
    reports[0]["camera"] = "c1".into();
    reports.extend(of_cameras(most + 1..=most + 1));
    let batch = decoded("car-1", &json!(reports)).unwrap();
    let done = recorder.record(&[batch], &[], now).unwrap();
    assert_eq!(done.counts.clips, 1, "that of a known camera");
    assert_eq!(done.counts.set_aside, 1);
    // What counts for its share does not grow with the names.
    assert_eq!(done.cameras, [albireo_wire::MOST_CAMERAS]);
    let kept = store.set_aside(None, None, 10).await.unwrap();
    let body: Value = serde_json::from_str(&kept[0].body).unwrap();
    assert_eq!(Some(&body), reports.last());
    store.close().await;
}

#[tokio::test]
async fn only_the_cameras_that_a_batch_names_are_read_of_its_node() {
    let folder = tempfile::tempdir().unwrap();
    let now = now();
    let (store, mut recorder) = recorder(&folder, now).await;
    for (node, numbers) in [("car-1", 1..=3), ("car-2", 4..=6)] {
        let mut of_node = of_cameras(numbers);
        for report in &mut of_node {
            report["node"] = node.into();
        }
        let sent = json!({ "v": VERSION, "node": node, "t_ms": NOW_MS, "reports": of_node });
        let payload = Bytes::from(zstd(sent.to_string().as_bytes()));
        recorder.record(&[decode(node, &payload, NOW_MS).unwrap()], &[], now).unwrap();
    }
    let mut database = store.connect(Access::Read, None).unwrap();
    let nodes = database.reporting_nodes(&["car-1", "car-2"], NOW_MS).unwrap();
    let id = nodes["car-2"].node_id;
    assert_eq!(nodes["car-2"].cameras, 3);
    let names = BTreeMap::from([(id, BTreeSet::from(["c1", "c5", "new"]))]);
    let found = database.cameras(&names).unwrap();
    assert_eq!(found.len(), 1, "only that node");
    let names: Vec<&String> = found[&id].keys().collect();
    assert_eq!(names, ["c5"]);
    drop(database);
    store.close().await;
}

#[tokio::test]
async fn reports_that_are_set_aside_together_keep_each_its_own_text() {
    let folder = tempfile::tempdir().unwrap();
    let now = now();
    let (store, mut recorder) = recorder(&folder, now).await;
    let mut reports: Vec<Value> = (1..=6).map(report).collect();
    for place in [1, 2, 5] {
        reports[place]["frames"] = (-1).into();
    }
    let batch = decoded("car-1", &json!(reports)).unwrap();
    assert_eq!(batch.texts(&[]), Vec::<String>::new());
    assert_eq!(
        batch.texts(&[5, 1]),
        [reports[5].to_string(), reports[1].to_string()]
    );
    // One more than there are has no text.
    assert_eq!(batch.texts(&[6]), [""]);
    recorder.record(&[batch], &[], now).unwrap();
    let mut kept = store.set_aside(None, None, 10).await.unwrap();
    kept.reverse();
    let bodies: Vec<&String> = kept.iter().map(|one| &one.body).collect();
    let expected = [1, 2, 5].map(|place: usize| reports[place].to_string());
    assert_eq!(bodies, expected.iter().collect::<Vec<_>>());
    store.close().await;
}

#[test]
fn a_camera_under_a_name_that_no_camera_may_have_is_invalid() {
    let too_long = "c".repeat(201);
    for name in ["..", "a/b", too_long.as_str()] {
        let mut named = report(1);
        named["camera"] = name.into();
        let batch = decoded("car-1", &json!([named, report(2)])).unwrap();
        let are_valid: Vec<bool> =
            batch.reports.iter().map(|report| report.content.is_ok()).collect();
        assert_eq!(are_valid, [false, true], "{name}");
    }
}
