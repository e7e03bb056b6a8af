//! Targets reach nodes as values do, and replace them; a target that a node cannot hold is refused with a reason.

use crate::support::{
    Fixture, Hub, assert_has, config, full_status, now_ns, on_both, put_status, sqlite,
};
use crate::tuning::{SimulatedFleet, fleet, post, put, put_at, values};
use albireo_hub::config::LocalChange;
use albireo_wire::{
    CameraState, CameraStatus, NodeTarget, SettingSource, StatusMessage, Target, TargetStatus,
    Threshold,
};
use reqwest::StatusCode;
use serde_json::{Value, json};

/// Sets a target, or none.
async fn hold(hub: &Hub, target: Value, select: &str) -> Value {
    let body = json!({"target": target, "select": select, "why": "a test"});
    let (status, answer) = put_at(hub, "/api/v1/target", body).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    answer
}

/// The target that each node reports.
fn held(nodes: &Value) -> Vec<Value> {
    let nodes = nodes["nodes"].as_array().unwrap().iter();
    nodes
        .map(|node| node["status"]["target"]["target"].clone())
        .collect()
}

async fn targets_reach_nodes(database: &str) {
    let hub = Hub::start(config(database)).await;
    let simulated = SimulatedFleet::start(&hub, fleet(6)).await;
    let wanted = json!({"skip_rate": 0.6});
    let dry = json!({"target": wanted, "select": "sim-*", "dry_run": true});
    let (_, answer) = put_at(&hub, "/api/v1/target", dry).await;
    assert_eq!(answer["counts"], json!({"would_change": 6}), "{answer}");
    assert_eq!(answer["nodes"][0]["to"], json!({"target": wanted}));
    assert_eq!(hub.get("/api/v1/changes").await["changes"], json!([]));

    // Nodes 0 and 4 are in the north.
    let answer = hold(&hub, wanted.clone(), "region=north,sim-000001,nobody").await;
    let counts = json!({"applied": 3, "refused": 1});
    assert_eq!(answer["counts"], counts, "{answer}");
    let nodes = hub.get("/api/v1/nodes").await;
    let (on, off) = (&wanted, &Value::Null);
    let all = held(&nodes);
    let all: Vec<_> = all.iter().collect();
    assert_eq!(all, [on, on, off, off, on, off]);
    let status = &nodes["nodes"][0]["status"]["target"];
    assert_has(status, &json!({"status": "held", "source": "hub"}));
    let us = values(&nodes);
    assert!(us[0] > 3e-4 && us[2] == 3e-4, "{nodes}");
    let change = answer["revision"].as_u64().unwrap();
    let changes = hub.get("/api/v1/changes?node=sim-000004").await;
    let expected = json!({"to": {"target": wanted}, "revision": change, "why": "a test"});
    assert_has(&changes["changes"][0], &expected);
    let detail = hub.get(&format!("/api/v1/changes/{change}")).await;
    let from = json!({"threshold": {"name": "u", "value": 3e-4}});
    assert_eq!(detail["nodes"][0]["from"], from, "{detail}");
    let metrics = hub.metrics().await;
    for line in [
        "albireo_hub_targets{status=\"held\"} 3",
        "albireo_hub_targets{status=\"cannot_be_met\"} 0",
    ] {
        assert!(metrics.contains(line), "{line}: {metrics}");
    }

    // The same target again changes no node. A node that holds nothing can be given another one.
    let answer = hold(&hub, wanted.clone(), "sim-000001").await;
    assert_eq!(answer["counts"], json!({"unchanged": 1}));
    assert_eq!(answer["revision"], Value::Null);
    let answer = hold(&hub, json!({"skip_rate": 0.95}), "sim-000002").await;
    assert_eq!(answer["counts"], json!({"applied": 1}), "{answer}");
    let node = hub.get("/api/v1/nodes/sim-000002").await;
    let status = &node["status"]["target"]["status"];
    assert_eq!(status, "cannot_be_met", "{node}");

    // A value replaces the target, and a target the value, each by a single revision.
    let (_, answer) = put(&hub, json!({"u": 5e-4, "select": "sim-000000"})).await;
    assert_eq!(answer["counts"], json!({"applied": 1}), "{answer}");
    let from = json!({"target": wanted});
    assert_eq!(answer["nodes"][0]["from"], from, "{answer}");
    let nodes = hub.get("/api/v1/nodes").await;
    assert_eq!((&held(&nodes)[0], values(&nodes)[0]), (off, 5e-4));
    let value = answer["revision"].as_u64().unwrap();
    assert!(value > change);
    let answer = hold(&hub, json!({"skip_rate": 0.5}), "sim-000000").await;
    assert_eq!(answer["counts"], json!({"applied": 1}), "{answer}");
    let from = json!({"threshold": {"name": "u", "value": 5e-4}});
    assert_eq!(answer["nodes"][0]["from"], from, "{answer}");
    assert!(answer["revision"].as_u64().unwrap() > value);

    // A node that holds a target releases it and keeps its threshold; the others are unchanged.
    let before = values(&hub.get("/api/v1/nodes").await);
    let answer = hold(&hub, Value::Null, "sim-000000,sim-000003").await;
    let counts = json!({"applied": 1, "unchanged": 1});
    assert_eq!(answer["counts"], counts, "{answer}");
    let nodes = hub.get("/api/v1/nodes").await;
    assert_eq!((&held(&nodes)[0], values(&nodes)), (off, before));
    simulated.end().await;
    hub.stop().await;

    // The desired targets survive a restart of the hub: the nodes restart too, and hold nothing at first.
    let restarted = i64::try_from(now_ns() / 1_000_000).unwrap();
    let hub = Hub::start(config(database)).await;
    let simulated = SimulatedFleet::start(&hub, fleet(6)).await;
    let nodes = hub
        .until("/api/v1/nodes", |nodes| {
            let all = nodes["nodes"].as_array().unwrap().iter();
            let held = held(nodes);
            all.map(|node| node["heard_ms"].as_i64())
                .all(|heard| heard > Some(restarted))
                && held[1] == wanted
                && held[2] == json!({"skip_rate": 0.95})
                && held[4] == wanted
        })
        .await;
    assert_eq!((&held(&nodes)[0], &held(&nodes)[3]), (off, off));
    simulated.end().await;
    hub.stop().await;
}

on_both!(
    targets_reach_nodes,
    a_target_reaches_the_selected_nodes_and_replaces_a_value,
    postgres_a_target_reaches_the_selected_nodes_and_replaces_a_value
);

/// The full status of a node with one camera at that `u`.
fn status_at(one: u32, seq: u64, revision: u64, u: f64) -> StatusMessage {
    let mut status = StatusMessage {
        revision,
        ..full_status(one, seq, &[])
    };
    status.full.as_mut().unwrap().cameras = vec![CameraStatus {
        name: "front".into(),
        state: CameraState::Live,
        threshold: Some(Threshold::new("u", u)),
        threshold_source: SettingSource::Hub,
    }];
    status
}

#[tokio::test(flavor = "multi_thread")]
async fn a_target_switched_off_at_the_node_is_drift_with_its_reason() {
    let fixture = Fixture::start().await;
    let (hub, session) = (&fixture.hub, &fixture.session);
    let one = 10;
    put_status(session, "car-1", &status_at(one, 0, 0, 3e-4)).await;
    hub.until("/api/v1/nodes/car-1", |node| node["state"] == "online")
        .await;
    let body = json!({"target": {"recall": 0.9}, "select": "car-1", "wait_s": 0});
    let (_, answer) = put_at(hub, "/api/v1/target", body).await;
    let change = answer["revision"].as_u64().unwrap();
    let mut holds = status_at(one, 1, change, 3e-4);
    holds.full.as_mut().unwrap().target = Some(NodeTarget {
        target: Target::Recall(0.9),
        source: SettingSource::Hub,
        status: Some(TargetStatus::Measuring),
        actual: None,
    });
    put_status(session, "car-1", &holds).await;
    hub.until(&format!("/api/v1/changes/{change}"), |change| {
        change["nodes"][0]["outcome"] == "applied"
    })
    .await;
    assert_eq!(hub.get("/api/v1/drift").await, json!([]));
    let mut turned = status_at(one, 2, change, 7e-4);
    let off = "the threshold was set by hand";
    turned.full.as_mut().unwrap().target_off = Some(off.to_owned());
    put_status(session, "car-1", &turned).await;
    let drift = hub
        .until("/api/v1/drift", |drift| drift[0]["node"] == "car-1")
        .await;
    let in_force = json!({"threshold": {"name": "u", "value": 7e-4}});
    let expected =
        json!({"desired": {"target": {"recall": 0.9}}, "in_force": in_force, "why": off});
    assert_has(&drift[0], &expected);
    fixture.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_changed_repeatedly_is_set_back_three_times_and_then_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(&sqlite(folder.path()));
    config.tuning.local_change = LocalChange::SetBack;
    let fixture = Fixture::on(config).await;
    let (hub, session) = (&fixture.hub, &fixture.session);
    let mut statuses = 0..;
    let mut report = async |revision, u| {
        let seq = statuses.next().unwrap();
        put_status(session, "car-1", &status_at(10, seq, revision, u)).await;
    };
    report(0, 3e-4).await;
    hub.until("/api/v1/nodes/car-1", |node| node["state"] == "online")
        .await;
    let body = json!({"u": 5e-4, "select": "car-1", "wait_s": 0});
    let (_, answer) = put(hub, body).await;
    let mut revision = answer["revision"].as_u64().unwrap();
    report(revision, 5e-4).await;
    for times in 1..=3 {
        report(revision, 9e-4).await;
        let drift = hub
            .until("/api/v1/drift", |drift| drift[0]["set_back"] == times)
            .await;
        assert_eq!(drift[0]["node"], "car-1");
        let changes = hub.get("/api/v1/changes").await;
        assert_eq!(changes["changes"][0]["origin"], "drift", "{changes}");
        revision = changes["changes"][0]["revision"].as_u64().unwrap();
        report(revision, 5e-4).await;
        if times == 1 {
            // The node applies the value, and the drift is over.
            hub.until("/api/v1/drift", |drift| *drift == json!([]))
                .await;
        }
    }
    report(revision, 9e-4).await;
    let drift = hub
        .until("/api/v1/drift", |drift| drift[0]["node"] == "car-1")
        .await;
    assert_eq!(drift[0]["set_back"], 3, "{drift}");
    // A change by a user restarts the count.
    let body = json!({"u": 6e-4, "select": "car-1", "wait_s": 0});
    let (_, answer) = put(hub, body).await;
    let ordered = answer["revision"].as_u64().unwrap();
    let changes = hub.get("/api/v1/changes").await;
    assert_eq!(changes["changes"][0]["revision"], ordered, "{changes}");
    fixture.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_leaves_out_a_node_that_holds_a_target() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let simulated = SimulatedFleet::start(&hub, fleet(3)).await;
    hold(&hub, json!({"skip_rate": 0.6}), "sim-000001").await;
    let plan = json!({"u": 5e-4, "select": ["all"], "stages": ["100%"], "soak_s": 3600});
    let (status, begun) = post(&hub, "/api/v1/rollouts", plan).await;
    assert_eq!(status, StatusCode::CREATED, "{begun}");
    let left_out = &begun["left_out"][0];
    assert_eq!(left_out["node"], "sim-000001", "{begun}");
    let why = left_out["why"].as_str().unwrap();
    assert!(why.contains("holds the target skip_rate 0.6"), "{why}");
    // A node in a rollout is given no target.
    let answer = hold(&hub, json!({"skip_rate": 0.6}), "sim-000000").await;
    assert_eq!(answer["counts"], json!({"refused": 1}), "{answer}");
    simulated.end().await;
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_target_is_rejected_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    for (body, expected) in [
        (json!({"select": ["all"]}), "must have a target"),
        (json!({"target": 0.5, "select": ["all"]}), "target: "),
        (
            json!({"target": {"speed": 3}, "select": ["all"]}),
            "unknown variant `speed`",
        ),
        (
            json!({"target": {"skip_rate": 1.5}, "select": ["all"]}),
            "from 0.01 to 0.99",
        ),
        (json!({"target": {"skip_rate": 0.5}}), "select"),
        (
            json!({"target": null, "select": ["all"], "u": 3e-4}),
            "unknown field `u`",
        ),
    ] {
        let (status, answer) = put_at(&hub, "/api/v1/target", body).await;
        assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY, "{answer}");
        let detail = answer["detail"].as_str().unwrap();
        assert!(detail.contains(expected), "{expected}: {answer}");
        if expected.contains("target") {
            assert_eq!(answer["allowed"][1], "skip_rate", "{answer}");
        }
    }
    hub.stop().await;
}
