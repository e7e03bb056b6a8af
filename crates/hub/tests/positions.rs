//! Where clips were made: rows, GeoJSON, joules per kilometre, deletion, and tables from before.

use crate::support::{Hub, PATIENCE, YESTERDAY, assert_has, batch, config, on_both, script};
use albireo_hub::config::DatabaseConfig;
use albireo_hub::store::Store;
use albireo_wire::{ClipTravel, ReportBatch};
use serde_json::{Value, json};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Half a kilometre through Berlin.
fn travel() -> ClipTravel {
    ClipTravel {
        distance_m: 500.0,
        fastest_m_s: Some(13.9),
        bounds: [13.4, 52.5, 13.407, 52.502],
        track: vec![[13.4, 52.5], [13.404, 52.502], [13.407, 52.501]],
    }
}

/// Nine clips of a node, three of each energy quality, with 50 J of the node and half a kilometre in each.
fn driven(node: &str) -> ReportBatch {
    let mut batch = batch(node, 1..=9);
    for report in &mut batch.reports {
        report.travel = Some(travel());
        report.energy.node_joules = Some(50.0);
        report.energy.coverage = 1.0;
    }
    batch
}

fn quality<'a>(energy: &'a Value, quality: &str) -> &'a Value {
    energy["groups"]
        .as_array()
        .unwrap()
        .iter()
        .find(|group| group["quality"] == quality)
        .unwrap()
}

async fn joules_per_kilometre_count_whole_clips_and_never_mix_qualities(database: &str) {
    let hub = Hub::start(config(database)).await;
    let mut batch = driven("car-1");
    // Of the measured ones, one has a gap in its energy, and of the estimated ones one has no position.
    batch.reports[2].energy.coverage = 0.5;
    batch.reports[1].travel = None;
    batch.reports[4].energy.node_joules = Some(150.0);
    hub.deliver(&batch).await.assert_stored();
    for by in ["node", "camera", "clip", "all"] {
        let energy = hub.get(&format!("/api/v1/energy?by={by}")).await;
        let groups = energy["groups"].as_array().unwrap();
        if by == "clip" {
            let with = groups.iter().filter(|group| group["joules_per_km"].is_number()).count();
            assert_eq!(with, 7, "{energy}");
            continue;
        }
        let expected = json!({"distance_km": 1.0, "joules_per_km": 100.0});
        assert_has(quality(&energy, "measured"), &expected);
        let expected = json!({"distance_km": 1.5, "joules_per_km": 100.0});
        assert_has(quality(&energy, "partial"), &expected);
        let expected = json!({"distance_km": 1.0, "joules_per_km": 200.0});
        assert_has(quality(&energy, "estimated"), &expected);
    }
    hub.store("car-2", 1..=3).await;
    let energy = hub.get("/api/v1/energy?by=node&node=car-2").await;
    assert!(energy["groups"][0]["distance_km"].is_null(), "{energy}");
    hub.stop().await;
}

on_both!(joules_per_kilometre_count_whole_clips_and_never_mix_qualities);

async fn positions_are_served_as_geojson_until_they_are_deleted(database: &str) {
    let hub = Hub::start(config(database)).await;
    let mut parked = driven("car-2");
    for report in &mut parked.reports {
        let travel = report.travel.as_mut().unwrap();
        travel.distance_m = 0.0;
        travel.track.truncate(1);
    }
    hub.deliver(&driven("car-1")).await.assert_stored();
    hub.deliver(&parked).await.assert_stored();
    hub.store("car-3", 1..=3).await;

    let since_ms = *YESTERDAY / 1_000_000;
    let path = |rest: &str| format!("/api/v1/positions.geojson?since_ms={since_ms}{rest}");
    let answer = reqwest::get(format!("{}{}", hub.http, path(""))).await.unwrap();
    assert_eq!(answer.headers()["content-type"], "application/geo+json");
    let all: Value = answer.json().await.unwrap();
    assert_has(
        &all,
        &json!({"type": "FeatureCollection", "truncated": false}),
    );
    assert_eq!(all["features"].as_array().unwrap().len(), 18);

    let one = hub.get(&path("&node=car-1&camera=front&limit=1")).await;
    assert_eq!(one["truncated"], true);
    let expected = json!({
        "type": "Feature", "bbox": [13.4, 52.5, 13.407, 52.502],
        "geometry": {"type": "LineString", "coordinates": [[13.4, 52.5], [13.404, 52.502], [13.407, 52.501]]},
        "properties": {
            "node": "car-1", "camera": "front", "clip": "window-9", "distance_m": 500.0, "fastest_m_s": 13.9,
            "joules_per_km": 100.0, "quality": "measured",
        },
    });
    assert_has(&one["features"][0], &expected);
    let began = one["features"][0]["properties"]["began"].as_str().unwrap();
    assert!(began.ends_with('Z'), "{began}");
    assert_eq!(began.len(), 24, "{began}");
    let until_ms = since_ms + 3 * 40_000;
    let early = hub.get(&path(&format!("&node=car-2&until_ms={until_ms}"))).await;
    let features = early["features"].as_array().unwrap();
    assert_eq!(features.len(), 2);
    let place = json!({"type": "Point", "coordinates": [13.4, 52.5]});
    assert_eq!(features[0]["geometry"], place);
    assert!(features[0]["properties"]["joules_per_km"].is_null());
    let clips = hub.get("/api/v1/clips?node=car-1").await;
    assert_eq!(clips["clips"][0]["distance_m"], 500.0);

    let delete = |rest: &str| {
        let url = format!("{}/api/v1/positions?node=car-1{rest}", hub.http);
        reqwest::Client::new().delete(url).send()
    };
    let until = format!("&until_ms={}", since_ms + 3 * 40_000);
    for (rest, gone) in [(until.as_str(), 2), ("", 7), ("", 0)] {
        let deleted: Value = delete(rest).await.unwrap().json().await.unwrap();
        assert_eq!(deleted, json!({"clips": gone}), "{rest}");
    }
    let left = hub.get(&path("&limit=5000")).await;
    let left = left["features"].as_array().unwrap();
    assert_eq!(left.len(), 9);
    for feature in left {
        assert_eq!(feature["properties"]["node"], "car-2");
    }
    let clips = hub.get("/api/v1/clips?node=car-1").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 9);
    hub.stop().await;
}

on_both!(positions_are_served_as_geojson_until_they_are_deleted);

async fn a_way_that_cannot_be_right_is_set_aside_with_the_reason(database: &str) {
    let hub = Hub::start(config(database)).await;
    let mut batch = driven("car-1");
    type Change = fn(&mut ClipTravel);
    let changes: [(Change, &str); 5] = [
        (
            |travel| travel.track = vec![[0.0, 0.0]; 61],
            "61 points, not 1 to 60",
        ),
        (|travel| travel.track.clear(), "0 points"),
        (
            |travel| travel.track[1][1] = 91.0,
            "latitude of travel.track is 91",
        ),
        (
            |travel| travel.bounds[0] = -181.0,
            "longitude of travel.box is -181",
        ),
        (|travel| travel.distance_m = -1.0, "travel.distance_m is -1"),
    ];
    for (report, (change, _)) in batch.reports.iter_mut().zip(changes) {
        change(report.travel.as_mut().unwrap());
    }
    let answer = hub.deliver(&batch).await.answer();
    assert_eq!(answer.refused.len(), changes.len());
    let aside = hub.get("/api/v1/set-aside").await;
    let causes = aside["reports"].as_array().unwrap();
    assert_eq!(causes.len(), changes.len(), "{aside}");
    for ((_, part), report) in changes.iter().rev().zip(causes) {
        let cause = report["cause"].as_str().unwrap();
        assert!(cause.contains(part), "{cause}");
    }
    // What is kept of them goes with the others.
    let url = format!("{}/api/v1/positions?node=car-1", hub.http);
    let deleted = reqwest::Client::new().delete(url).send().await.unwrap();
    assert_eq!(deleted.json::<Value>().await.unwrap(), json!({"clips": 4}));
    let aside = hub.get("/api/v1/set-aside").await;
    let reports = aside["reports"].as_array().unwrap();
    assert_eq!(reports.len(), changes.len(), "{aside}");
    for report in reports {
        assert_eq!(report["body"], "", "{aside}");
    }
    hub.stop().await;
}

on_both!(a_way_that_cannot_be_right_is_set_aside_with_the_reason);

/// Makes the tables those of version 14.
const BACK_TO_14: &str = "DROP INDEX clips_with_positions; \
    ALTER TABLE clips DROP COLUMN distance_mm; ALTER TABLE clips DROP COLUMN travel; \
    ALTER TABLE sums_5m DROP COLUMN travel_mm; ALTER TABLE sums_5m DROP COLUMN travel_uj; \
    ALTER TABLE sums_hour DROP COLUMN travel_mm; ALTER TABLE sums_hour DROP COLUMN travel_uj; \
    ALTER TABLE report_counts DROP COLUMN displaced; \
    ALTER TABLE revisions RENAME COLUMN selector TO \"select\"; ALTER TABLE revisions RENAME COLUMN setting TO \"to\"; \
    ALTER TABLE revisions RENAME TO orders; \
    ALTER TABLE revision_nodes RENAME COLUMN setting_before TO \"from\"; \
    ALTER TABLE revision_nodes RENAME COLUMN given_ms TO asked_ms; ALTER TABLE revision_nodes RENAME TO order_nodes; \
    DROP INDEX revision_nodes_by_node; DROP INDEX revision_nodes_open; \
    CREATE INDEX order_nodes_by_node ON order_nodes (node, revision); \
    CREATE INDEX order_nodes_open ON order_nodes (revision); \
    UPDATE hub_meta SET value = '14' WHERE key = 'version';";

async fn tables_from_before_positions_are_upgraded_with_their_clips(database: &str) {
    let hub = Hub::start(config(database)).await;
    hub.store("car-1", 1..=9).await;
    let before = hub.get("/api/v1/energy?by=node").await;
    hub.stop().await;
    script(database, BACK_TO_14).await;

    let hub = Hub::start(config(database)).await;
    assert_eq!(
        hub.get("/api/v1/energy?by=node").await["groups"],
        before["groups"]
    );
    hub.deliver(&driven("car-2")).await.assert_stored();
    let energy = hub.get("/api/v1/energy?by=node&node=car-2").await;
    assert_has(
        quality(&energy, "measured"),
        &json!({"joules_per_km": 100.0}),
    );
    let clips = hub.get("/api/v1/clips?limit=1000").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 18);
    hub.stop().await;

    script(
        database,
        "UPDATE hub_meta SET value = '13' WHERE key = 'version'",
    )
    .await;
    let of_13 = DatabaseConfig {
        url: database.to_owned(),
        ..DatabaseConfig::default()
    };
    let reason = Store::open(&of_13).await.unwrap_err().to_string();
    assert!(reason.contains("version 13"), "{reason}");
}

on_both!(tables_from_before_positions_are_upgraded_with_their_clips);

/// What GDAL reads of the hub's GeoJSON.
fn read_by_gdal(geojson: &str) -> Value {
    let file = tempfile::Builder::new().suffix(".geojson").tempfile().unwrap();
    std::fs::write(file.path(), geojson).unwrap();
    let project = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let own = format!("{project}/.cache/python/bin/python");
    let python = std::env::var("ALBIREO_PYTHON").unwrap_or(own);
    let read = std::process::Command::new(python)
        .arg(format!("{project}/tests/python/positions.py"))
        .arg(file.path())
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&read.stderr);
    assert!(read.status.success(), "{errors}");
    serde_json::from_slice(&read.stdout).unwrap()
}

#[rstest::rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs Python"]
async fn gdal_reads_the_positions_of_a_simulated_fleet() {
    let hub = Hub::fresh().await;
    let options = albireo_simulate::Options {
        connect: hub.zenoh.clone(),
        nodes: 4,
        sessions: 1,
        backlog: 6,
        positions: true,
        duration: Duration::from_millis(100),
        drain: PATIENCE / 2,
        seed: 1,
        ..albireo_simulate::Options::default()
    };
    let summary = albireo_simulate::run(options, CancellationToken::new(), |_| {}).await.unwrap();
    let made = summary.counts.made;
    assert!(made >= 24, "{made}");
    assert_eq!(summary.counts.acknowledged, made);

    let url = format!("{}/api/v1/positions.geojson", hub.http);
    let text = reqwest::get(url).await.unwrap().text().await.unwrap();
    let sent: Value = serde_json::from_str(&text).unwrap();
    let sent = sent["features"].as_array().unwrap();
    assert_eq!(sent.len() as u64, made);
    let read = read_by_gdal(&text);
    assert_eq!(read["crs"], "EPSG:4326");
    let types =
        json!({"began": "datetime64[ms]", "distance_m": "float64", "joules_per_km": "float64"});
    assert_has(&read["types"], &types);
    let read = read["clips"].as_array().unwrap();
    assert_eq!(read.len(), sent.len());
    for (read, sent) in read.iter().zip(sent) {
        let properties = &sent["properties"];
        assert_eq!(read["coordinates"], sent["geometry"]["coordinates"]);
        assert_eq!(read["node"], properties["node"]);
        assert_eq!(read["distance_m"], properties["distance_m"]);
        let began = properties["began"].as_str().unwrap();
        assert_eq!(read["began"].as_str().unwrap(), began.trim_end_matches('Z'));
    }
    hub.stop().await;
}
