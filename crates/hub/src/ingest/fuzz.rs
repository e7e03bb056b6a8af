//! Hostile batches by the thousand, from the payload to the rows: no network, a real database.

use super::commit::{Numbers, write};
use super::decode::decode;
use super::plan::Outcome;
use crate::config::{DatabaseConfig, HistoryConfig};
use crate::store::Store;
use albireo_wire::{
    BatchCompression, ClipEnd, ClipEnergy, ClipReport, DroppedFrames, EnergyQuality, FrameStates,
    Percentiles, VERSION,
};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashSet};

/// Batches of one run. More by hand: `ALBIREO_BATCHES=100000`.
fn batches() -> u64 {
    let given = std::env::var("ALBIREO_BATCHES").ok();
    given.and_then(|text| text.parse().ok()).unwrap_or(10_000)
}

/// Batches of one transaction.
const GROUP: usize = 250;
/// Instances that the batches are of: few, so that they meet their own cursors.
const INSTANCES: u64 = 40;
const NOW_MS: i64 = 1_790_000_000_000;

fn batch(random: &mut Pcg64Mcg) -> Value {
    let first = 1 + random.next_u64() % 40;
    let count = 1 + random.next_u64() % 3;
    let reports: Vec<Value> = (first..first + count).map(report).collect();
    json!({
        "v": VERSION, "node": "car-1", "instance": format!("{:032x}", random.next_u64() % INSTANCES),
        "machine": if random.next_u64().is_multiple_of(4) { json!("m2") } else { json!("m1") },
        "first": first, "last": first + count - 1, "lost": 0, "reports": reports,
    })
}

/// A report as a node makes it.
fn report(number: u64) -> Value {
    let latency = Percentiles {
        count: 9,
        mean: 5.0,
        p50: 5.0,
        p95: 6.0,
        p99: 7.0,
    };
    let report = ClipReport {
        v: VERSION,
        node: "car-1".into(),
        camera: "front".into(),
        clip: format!("w{number}"),
        report: number,
        ended_by: ClipEnd::Window,
        started_ns: 1_780_000_000_000_000_000 + number,
        duration_s: 40.0,
        frames: 9,
        states: FrameStates {
            p: 3,
            i: 6,
            ..FrameStates::default()
        },
        skip_rate: 3.0 / 9.0,
        degraded_frames: 0,
        dropped: DroppedFrames::default(),
        policy: "albireo".into(),
        threshold: None,
        threshold_changes: Vec::new(),
        model: "m".into(),
        provider: "cpu".into(),
        total_latency_ms: latency,
        detector_latency_ms: latency,
        detector_used_ms: 0.0,
        energy: ClipEnergy {
            joules: Some(10.0),
            node_joules: Some(10.0),
            saved_joules_estimated: None,
            edp: None,
            quality: EnergyQuality::Measured,
            source: "rapl".into(),
            total_from: "input_rail".into(),
            samples: 4,
            coverage: 1.0,
            domains: Vec::new(),
        },
        board: None,
        audit: None,
    };
    serde_json::to_value(report).unwrap()
}

/// A value that nobody should send.
fn hostile(random: &mut Pcg64Mcg) -> Value {
    match random.next_u64() % 14 {
        0 => Value::Null,
        1 => json!(u64::MAX),
        2 => json!(i64::MAX),
        3 => json!(i64::MIN),
        4 => json!(-1),
        5 => json!(1e300),
        6 => json!(f64::MIN_POSITIVE),
        7 => json!("\u{0}\u{7f}'; DROP TABLE clips; --"),
        8 => json!("x".repeat(2000)),
        9 => json!([]),
        10 => json!({ "threshold": { "name": "u", "value": "NaN" } }),
        11 => json!(true),
        12 => json!("../../*/**"),
        _ => json!(random.next_u64() % 50),
    }
}

/// Changes one member, somewhere.
fn spoil(value: &mut Value, random: &mut Pcg64Mcg) {
    let mut here = value;
    loop {
        let count = match &*here {
            Value::Object(members) => members.len(),
            Value::Array(values) => values.len(),
            _ => 0,
        };
        // The outermost is seldom met: a batch that is no object at all is soon refused.
        if count == 0 || random.next_u64().is_multiple_of(4) {
            *here = hostile(random);
            return;
        }
        let place = random.next_u64() as usize % count;
        if random.next_u64().is_multiple_of(12) {
            match here {
                Value::Object(members) => {
                    let name = members.keys().nth(place).cloned().unwrap_or_default();
                    members.remove(&name);
                }
                Value::Array(values) => values.push(hostile(random)),
                _ => {}
            }
            return;
        }
        here = match here {
            Value::Object(members) => members.values_mut().nth(place).unwrap(),
            Value::Array(values) => &mut values[place],
            _ => unreachable!(),
        };
    }
}

fn payload(random: &mut Pcg64Mcg) -> Vec<u8> {
    let mut batch = batch(random);
    // A fault in the batch itself refuses it whole; most are to come further.
    for _ in 0..random.next_u64() % 3 {
        let whole = random.next_u64().is_multiple_of(4) || batch["reports"][0].is_null();
        spoil(
            if whole {
                &mut batch
            } else {
                &mut batch["reports"][0]
            },
            random,
        );
    }
    let mut text = batch.to_string().into_bytes();
    if random.next_u64().is_multiple_of(8) {
        let place = random.next_u64() as usize % text.len();
        text[place] = random.next_u64() as u8;
    }
    let mut packed = BatchCompression::Quick.compress(&text).unwrap();
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

#[tokio::test]
async fn hostile_batches_break_nothing_and_what_is_acknowledged_is_accounted_for() {
    let batches = batches();
    let folder = tempfile::tempdir().unwrap();
    let config = DatabaseConfig {
        url: format!("sqlite:{}", folder.path().join("hub.db").display()),
        ..DatabaseConfig::default()
    };
    let store = Store::open(&config).await.unwrap();
    let mut writer = store.writer();
    let mut numbers = Numbers::default();
    let mut random = Pcg64Mcg::seed_from_u64(20_261_122);
    let (mut refused, mut conflicts, mut group) = (0_u64, 0_u64, Vec::new());
    let (mut clips, mut aside, mut stored) = (0, 0, BTreeMap::<String, i64>::new());
    for number in 1..=batches {
        match decode("car-1", &payload(&mut random)) {
            Ok(batch) => group.push(batch),
            Err(error) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
        }
        if group.len() < GROUP && number < batches {
            continue;
        }
        // One batch of an instance in a transaction, as the writer does it.
        let mut rest = std::mem::take(&mut group);
        while !rest.is_empty() {
            let mut met = HashSet::new();
            let (now, later): (Vec<_>, Vec<_>) = rest
                .into_iter()
                .partition(|batch| met.insert(batch.instance.clone()));
            rest = later;
            let mut writing = writer.begin().await.unwrap();
            let done = write(
                &mut writing,
                &mut numbers,
                &now,
                &HistoryConfig::default(),
                NOW_MS,
            )
            .await;
            let done = done.expect("whatever a batch holds, the database takes what is made of it");
            writing.commit().await.unwrap();
            (clips, aside) = (clips + done.clips, aside + done.set_aside);
            for (batch, outcome) in now.iter().zip(&done.outcomes) {
                match outcome {
                    Outcome::Stored(upto) => {
                        assert!(*upto <= batch.last);
                        let highest = stored.entry(batch.instance.clone()).or_default();
                        *highest = (*highest).max(*upto);
                    }
                    Outcome::Conflict(reason) => {
                        assert!(!reason.is_empty());
                        conflicts += 1;
                    }
                }
            }
        }
    }
    writer.close().await;
    println!(
        "{batches} batches: {refused} refused whole, {conflicts} in conflict, {clips} clips, {aside} reports set aside, \
         {} instances",
        stored.len()
    );
    assert!(refused > batches / 20 && clips > 0 && aside > 0 && conflicts > 0);
    // Nothing is acknowledged that the cursor has not passed, and the counts are those of the rows.
    let instances = store.instances("car-1").await.unwrap();
    assert_eq!(instances.len(), stored.len());
    for instance in &instances {
        let upto = stored.get(&instance.instance).copied().unwrap_or(0);
        assert!(upto < instance.next_report, "{instance:?}: {upto}");
    }
    let rows: u64 = instances.iter().map(|one| one.reports.unsigned_abs()).sum();
    assert_eq!(rows, clips);
    let rows: u64 = instances
        .iter()
        .map(|one| one.set_aside.unsigned_abs())
        .sum();
    assert_eq!(rows, aside);
    store.close().await;
}
