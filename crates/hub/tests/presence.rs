//! The hub knows which nodes exist and their state.

use crate::support::{
    Fixture, Hub, assert_has, config, full_status, pull, put_status, sqlite, status, uplink,
};
use albireo_service::config::ZenohMode;
use albireo_wire::ConfigChanged;
use serde_json::json;
use std::time::Duration;

#[tokio::test(flavor = "multi_thread")]
async fn a_node_is_online_then_degraded_with_its_reason_then_silent_then_offline() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(&sqlite(folder.path()));
    config.presence.silent_after_s = 1.5;
    config.presence.offline_after_s = 4.0;
    let hub = Hub::start(config).await;
    let session = uplink(&hub.zenoh).await;
    let one = 10;
    put_status(&session, "car-1", &full_status(one, 0, &[])).await;
    let node = hub
        .until("/api/v1/nodes/car-1", |node| node["state"] == "online")
        .await;
    assert_eq!(node["status"]["policy"], "albireo");
    let hanging = full_status(one, 1, &[("detector", "it hangs")]);
    put_status(&session, "car-1", &hanging).await;
    let node = hub
        .until("/api/v1/nodes/car-1", |node| node["state"] == "degraded")
        .await;
    assert_eq!(node["why"], "detector: it hangs");
    let node = hub
        .until("/api/v1/nodes/car-1", |node| node["state"] == "silent")
        .await;
    assert_eq!(node["why"], "no status for 1.5 s");
    hub.until("/api/v1/nodes/car-1", |node| node["state"] == "offline")
        .await;
    let page = hub.get("/api/v1/nodes?state=offline").await;
    assert_eq!(page["counts"]["offline"], 1);
    assert_eq!(page["nodes"][0]["node"], "car-1");
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gap_in_the_numbers_makes_the_hub_ask_for_the_full_status() {
    let fixture = Fixture::start().await;
    let (hub, session) = (&fixture.hub, &fixture.session);
    let notices = session
        .declare_subscriber("albireo/@changed/car-2")
        .await
        .unwrap();
    let one = 11;
    put_status(session, "car-2", &full_status(one, 0, &[])).await;
    hub.until("/api/v1/nodes/car-2", |node| node["state"] == "online")
        .await;
    assert!(!pull(session, "car-2").await.send_full_status);
    put_status(session, "car-2", &status(one, 5)).await;
    let notice = tokio::time::timeout(Duration::from_secs(30), notices.recv_async()).await;
    let notice = notice.unwrap().unwrap();
    albireo_wire::read::<ConfigChanged>(&notice.payload().to_bytes()).unwrap();
    assert!(pull(session, "car-2").await.send_full_status);
    let full = full_status(one, 6, &[("power", "no meter")]);
    put_status(session, "car-2", &full).await;
    hub.until("/api/v1/nodes/car-2", |node| {
        node["why"] == "power: no meter"
    })
    .await;
    assert!(!pull(session, "car-2").await.send_full_status);
    fixture.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_nodes_with_the_same_name_are_reported() {
    let fixture = Fixture::start().await;
    let (hub, session) = (&fixture.hub, &fixture.session);
    let (one, other) = (10, 11);
    put_status(session, "car-3", &full_status(one, 0, &[])).await;
    hub.until("/api/v1/nodes/car-3", |node| node["state"] == "online")
        .await;
    // Another run is a restart: nothing to report.
    let mut restarted = full_status(other, 0, &[]);
    restarted.waiting = 9;
    put_status(session, "car-3", &restarted).await;
    hub.until("/api/v1/nodes/car-3", |node| node["waiting"] == 9)
        .await;
    assert_eq!(hub.get("/api/v1/nodes/car-3").await["state"], "online");
    // Two runs that both send are a conflict.
    put_status(session, "car-3", &full_status(one, 1, &[])).await;
    let node = hub
        .until("/api/v1/nodes/car-3", |node| node["state"] == "degraded")
        .await;
    let why = node["why"].as_str().unwrap();
    assert!(why.starts_with("two nodes have this name"), "{why}");
    fixture.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restarted_hub_remembers_the_state_of_its_nodes() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let session = uplink(&hub.zenoh).await;
    let one = 12;
    let degraded = full_status(one, 0, &[("screen", "no model")]);
    put_status(&session, "car-4", &degraded).await;
    let before = hub
        .until("/api/v1/nodes/car-4", |node| node["state"] == "degraded")
        .await;
    let again = hub.config.clone();
    session.close().await.unwrap();
    hub.stop().await;

    let hub = Hub::start(again).await;
    let after = hub.get("/api/v1/nodes/car-4").await;
    for key in ["state", "why", "since_ms", "status"] {
        assert_eq!(after[key], before[key], "{key}");
    }
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn paging_returns_each_node_once_in_every_order() {
    let fixture = Fixture::start().await;
    let (hub, session) = (&fixture.hub, &fixture.session);
    for number in 0..7 {
        let reasons = [("screen", "no model")];
        let mut message = full_status(number, 0, &reasons[..usize::from(number == 3)]);
        message.waiting = u64::from(number % 3);
        put_status(session, &format!("car-{number}"), &message).await;
    }
    hub.until("/api/v1/nodes", |page| page["counts"]["online"] == 6)
        .await;
    let mut orders = Vec::new();
    for sort in ["name", "state", "since", "heard", "waiting"] {
        let mut names: Vec<String> = Vec::new();
        loop {
            let offset = names.len();
            let path = format!("/api/v1/nodes?sort={sort}&down=true&limit=3&offset={offset}");
            let page = hub.get(&path).await;
            assert_has(&page, &json!({"total": 7, "offset": offset}));
            let nodes = page["nodes"].as_array().unwrap();
            if nodes.is_empty() {
                break;
            }
            let found = nodes.iter().map(|node| node["node"].as_str().unwrap());
            names.extend(found.map(str::to_owned));
        }
        let mut sorted = names.clone();
        sorted.sort();
        let all: Vec<String> = (0..7).map(|number| format!("car-{number}")).collect();
        assert_eq!(sorted, all, "{sort}");
        orders.push(names);
    }
    assert_eq!(orders[1][0], "car-3", "the one that is degraded");
    assert_eq!(orders[4][..2], ["car-2", "car-5"], "those with two waiting");
    for (query, allowed) in [("sort=weight", "waiting"), ("state=ill", "degraded")] {
        let wrong = hub.get(&format!("/api/v1/nodes?{query}")).await;
        let detail = wrong["detail"].as_str().unwrap();
        assert!(detail.contains(allowed), "{wrong}");
    }
    fixture.end().await;
}

/// A router of a fleet.
async fn router(endpoint: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"{endpoint}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hub_without_its_router_is_not_ready_and_declares_nobody_silent() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(&sqlite(folder.path()));
    let endpoint = std::mem::take(&mut config.zenoh.listen).remove(0);
    config.zenoh.mode = ZenohMode::Client;
    config.zenoh.connect = vec![endpoint.clone()];
    config.presence.silent_after_s = 2.0;
    config.presence.offline_after_s = 4.0;
    let first = router(&endpoint).await;
    let hub = Hub::start(config).await;
    let session = uplink(&endpoint).await;
    let token = session.liveliness().declare_token("albireo/@alive/car-9");
    let token = token.await.unwrap();
    put_status(&session, "car-9", &full_status(10, 0, &[])).await;
    let path = "/api/v1/nodes/car-9";
    hub.until(path, |node| node["state"] == "online").await;

    first.close().await.unwrap();
    let held = hub
        .until("/readyz", |answer| answer["ready"] == false)
        .await;
    assert!(held["reasons"]["zenoh"].is_string(), "{held}");
    // Longer than the time after which a node is offline.
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(hub.get(path).await["state"], "online");

    drop(token);
    session.close().await.unwrap();
    let second = router(&endpoint).await;
    hub.until("/readyz", |answer| answer["ready"] == true).await;
    // Now the hub could hear the node and does not.
    hub.until(path, |node| node["state"] == "offline").await;
    second.close().await.unwrap();
    hub.stop().await;
}
