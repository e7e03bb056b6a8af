//! Targets reach nodes as values do, and replace them; a target that a node cannot hold is refused with a reason.

use crate::support::{Hub, assert_contains, assert_has, config, full_status, now_ns, on_both};
use crate::tuning::{SimulatedFleet, begin, fleet, put, put_at, send, values};
use albireo_hub::config::LocalChange;
use albireo_wire::StatusMessage;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

/// The threshold with which a simulated node starts.
const FIRST_U: f64 = 3e-4;

/// Sets a target, or none, with these outcomes.
async fn hold(hub: &Hub, target: &Value, select: &str, counts: Value) -> Value {
    let body = json!({"target": target, "select": select, "why": "a test"});
    put_at(hub, "/api/v1/target", body, counts).await
}

/// The target that each node reports.
fn held(nodes: &Value) -> Vec<Value> {
    nodes["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["status"]["target"]["target"].clone())
        .collect()
}

/// True if the hub has heard each node since the time `since_ms`.
fn all_heard_since(nodes: &Value, since_ms: i64) -> bool {
    let heard_since = |node: &Value| node["heard_ms"].as_i64().is_some_and(|ms| ms > since_ms);
    nodes["nodes"].as_array().unwrap().iter().all(heard_since)
}

async fn a_value_or_target_reaches_the_selected_nodes_and_replaces_the_one_before(database: &str) {
    let hub = Hub::start(config(database)).await;
    let simulated = SimulatedFleet::start(&hub, fleet(6)).await;
    let wanted = json!({"skip_rate": 0.6});
    let dry = json!({"target": wanted, "select": "sim-*", "dry_run": true});
    let answer = put_at(&hub, "/api/v1/target", dry, json!({"would_change": 6})).await;
    assert_eq!(answer["nodes"][0]["outcome"], "would_change");
    assert_eq!(hub.get("/api/v1/revisions").await["revisions"], json!([]));

    // Nodes 0 and 4 are in the north.
    let counts = json!({"applied": 3, "refused": 1});
    let answer = hold(&hub, &wanted, "region=north,sim-000001,nobody", counts).await;
    let nodes = hub.get("/api/v1/nodes").await;
    let on = &wanted;
    let off = &Value::Null;
    let targets = held(&nodes);
    let all: Vec<_> = targets.iter().collect();
    assert_eq!(all, [on, on, off, off, on, off]);
    let status = &nodes["nodes"][0]["status"]["target"];
    assert_has(status, &json!({"status": "held", "source": "hub"}));
    let actual = status["actual"].as_f64().unwrap();
    assert!((actual - 0.6).abs() < 1e-9, "{nodes}");
    let us = values(&nodes);
    assert!(us[0] > FIRST_U, "{nodes}");
    assert_eq!(us[2], FIRST_U, "{nodes}");
    let change = answer["revision"].as_u64().unwrap();
    let revisions = hub.get("/api/v1/revisions?node=sim-000004").await;
    let expected = json!({"to": {"target": wanted}, "revision": change, "why": "a test"});
    assert_has(&revisions["revisions"][0], &expected);
    let detail = hub.get(&format!("/api/v1/revisions/{change}")).await;
    let from = json!({"threshold": {"name": "u", "value": FIRST_U}});
    let expected = json!({"from": from, "outcome": "applied"});
    assert_has(&detail["nodes"][0], &expected);
    hub.assert_metrics(&[
        "albireo_hub_targets{status=\"held\"} 3",
        "albireo_hub_targets{status=\"cannot_be_met\"} 0",
    ])
    .await;

    // The same target again changes no node. A node that holds nothing can be given another one.
    let answer = hold(&hub, &wanted, "sim-000001", json!({"unchanged": 1})).await;
    assert_eq!(answer["revision"], Value::Null);
    let high = json!({"skip_rate": 0.95});
    let applied = json!({"applied": 1});
    hold(&hub, &high, "sim-000002", applied.clone()).await;
    let node = hub.get("/api/v1/nodes/sim-000002").await;
    let expected = json!({
        "target": {"status": "cannot_be_met"}, "cameras": [{"threshold": {"value": 2e-3}}],
    });
    assert_has(&node["status"], &expected);

    // A value replaces the target, and a target the value, each by a single revision.
    let first = json!({"u": 5e-4, "select": "sim-000000"});
    let answer = put(&hub, first, applied.clone()).await;
    let from = json!({"target": wanted});
    assert_eq!(answer["nodes"][0]["from"], from, "{answer}");
    let nodes = hub.get("/api/v1/nodes").await;
    assert_eq!(held(&nodes)[0], *off);
    assert_eq!(values(&nodes)[0], 5e-4);
    let revision_of_value = answer["revision"].as_u64().unwrap();
    assert!(revision_of_value > change);
    let revisions = hub.get("/api/v1/revisions?node=sim-000000").await;
    let expected = json!({
        "revision": revision_of_value, "threshold": null, "who": "anonymous",
        "to": {"threshold": {"name": "u", "value": 5e-4}},
    });
    assert_has(&revisions["revisions"][0], &expected);
    let half = json!({"skip_rate": 0.5});
    let answer = hold(&hub, &half, "sim-000000", applied.clone()).await;
    let from = json!({"threshold": {"name": "u", "value": 5e-4}});
    assert_eq!(answer["nodes"][0]["from"], from, "{answer}");
    assert!(answer["revision"].as_u64().unwrap() > revision_of_value);

    // A node that holds a target releases it and keeps its threshold; the others are unchanged.
    let before = values(&hub.get("/api/v1/nodes").await);
    let counts = json!({"applied": 1, "unchanged": 1});
    hold(&hub, off, "sim-000000,sim-000003", counts).await;
    let nodes = hub.get("/api/v1/nodes").await;
    assert_eq!(held(&nodes)[0], *off);
    assert_eq!(values(&nodes), before);

    // A value out of range is refused by the node, with its reason.
    let for_the_last_node = |u: f64| json!({"u": u, "select": ["sim-000005"]});
    let answer = put(&hub, for_the_last_node(7.0), json!({"refused": 1})).await;
    assert_contains(&answer["nodes"][0]["detail"], &["from 1e-9 to 1"]);
    let answer = put(&hub, for_the_last_node(5e-4), applied.clone()).await;
    let revision = answer["revision"].as_u64().unwrap();
    simulated.end().await;

    // What is desired survives a restart of the hub: the nodes restart too, and hold nothing at first.
    let restarted_ms = i64::try_from(now_ns() / 1_000_000).unwrap();
    let hub = hub.restart().await;
    let simulated = SimulatedFleet::start(&hub, fleet(6)).await;
    let nodes = hub
        .until("/api/v1/nodes", |nodes| {
            let targets = held(nodes);
            all_heard_since(nodes, restarted_ms)
                && targets[1] == wanted
                && targets[2] == high
                && targets[4] == wanted
                && values(nodes)[5] == 5e-4
        })
        .await;
    assert_eq!(held(&nodes)[0], *off);
    assert_eq!(held(&nodes)[3], *off);
    let answer = put(&hub, for_the_last_node(1e-4), applied).await;
    assert!(answer["revision"].as_u64().unwrap() > revision, "{answer}");

    // A rollout leaves out a node that holds a target, and a node in a rollout is given no target.
    let both = ["sim-000001", "sim-000005"];
    let plan = json!({"u": 5e-4, "select": both, "stages": ["100%"], "soak_s": 3600});
    let begun = begin(&hub, "/api/v1/rollouts", plan).await;
    let left_out = &begun["left_out"][0];
    assert_eq!(left_out["node"], "sim-000001", "{begun}");
    assert_contains(&left_out["why"], &["holds the target skip_rate 0.6"]);
    hold(&hub, &wanted, "sim-000005", json!({"refused": 1})).await;
    simulated.end().await;
    hub.stop().await;
}

on_both!(a_value_or_target_reaches_the_selected_nodes_and_replaces_the_one_before);

#[rstest::rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_node_changed_repeatedly_is_set_back_three_times_and_then_left_alone() {
    let hub = Hub::fresh_with(|config| config.tuning.local_change = LocalChange::SetBack).await;
    let mut sequence = 0..;
    let mut report = async |node: &str, revision: u64, u: f64| {
        let seq = sequence.next().unwrap();
        let mut status = StatusMessage {
            revision,
            ..full_status(10, seq, &[])
        };
        let threshold = json!({"name": "u", "value": u});
        let camera = json!({"name": "front", "state": "live", "threshold": threshold, "threshold_source": "hub"});
        let cameras = serde_json::from_value(json!([camera])).unwrap();
        status.full.as_mut().unwrap().cameras = cameras;
        hub.put_status(node, &status).await;
    };
    // Without waiting for the nodes.
    let give = async |select: &str, u: f64| {
        let body = json!({"u": u, "select": select, "wait_s": 0});
        let answer = send(&hub, Method::PUT, "/api/v1/threshold", body, StatusCode::OK).await;
        answer["revision"].as_u64().unwrap()
    };
    for node in ["car-1", "car-2"] {
        report(node, 0, FIRST_U).await;
        hub.until_state(node, "online").await;
    }
    let first = give("car-1,car-2", 5e-4).await;
    report("car-1", first, 5e-4).await;
    report("car-2", first, 5e-4).await;
    let mut revision = first;
    for times in 1..=3 {
        report("car-1", revision, 9e-4).await;
        let drift = hub.until("/api/v1/drift", |drift| drift[0]["set_back"] == times).await;
        assert_eq!(drift[0]["node"], "car-1");
        let revisions = hub.get("/api/v1/revisions").await;
        assert_eq!(revisions["revisions"][0]["origin"], "drift", "{revisions}");
        revision = revisions["revisions"][0]["revision"].as_u64().unwrap();
        report("car-1", revision, 5e-4).await;
        // The node applies the value, and the drift is over.
        hub.until("/api/v1/drift", |all| *all == json!([])).await;
    }
    report("car-1", revision, 9e-4).await;
    hub.until("/api/v1/drift", |drift| drift[0]["node"] == "car-1").await;
    // The hub looks again, and sets back the other node alone.
    report("car-2", first, 9e-4).await;
    let drift = hub.until("/api/v1/drift", |drift| drift[1]["set_back"] == 1).await;
    assert_eq!(drift[0]["node"], "car-1", "{drift}");
    assert_eq!(drift[0]["set_back"], 3, "{drift}");
    let revisions = hub.get("/api/v1/revisions?node=car-1").await;
    assert_eq!(
        revisions["revisions"][0]["revision"], revision,
        "{revisions}"
    );
    // A change by a user restarts the count.
    let given = give("car-1", 6e-4).await;
    report("car-1", given, 6e-4).await;
    report("car-1", given, 9e-4).await;
    let is_set_back_once = |drift: &Value| drift[0]["node"] == "car-1" && drift[0]["set_back"] == 1;
    hub.until("/api/v1/drift", is_set_back_once).await;
    hub.stop().await;
}
