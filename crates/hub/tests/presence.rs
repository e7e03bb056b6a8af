//! The hub knows which nodes exist and their state.

use crate::support::{
    Hub, Reply, assert_contains, assert_has, batch, free_port, full_status, names, open, script,
    status,
};
use albireo_service::config::ZenohMode;
use albireo_wire::{BatchCompression, CameraStatus, MOST_CAMERAS, RevisionMessage, VERSION};
use reqwest::StatusCode;
use rstest::rstest;
use serde_json::{Value, json};
use std::time::Duration;

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_node_is_online_then_degraded_with_its_reason_then_silent_then_offline() {
    let hub = Hub::fresh_with(|config| {
        config.presence.silent_after_s = 1.5;
        config.presence.offline_after_s = 4.0;
    })
    .await;
    hub.put_status("car-1", &full_status(10, 0, &[])).await;
    let node = hub.until_state("car-1", "online").await;
    assert_eq!(node["status"]["policy"], "albireo");
    let hanging = full_status(10, 1, &[("detector", "it hangs")]);
    hub.put_status("car-1", &hanging).await;
    let node = hub.until_state("car-1", "degraded").await;
    assert_eq!(node["why"], "detector: it hangs");
    let node = hub.until_state("car-1", "silent").await;
    assert_eq!(node["why"], "no status for 1.5 s");
    hub.until_state("car-1", "offline").await;
    let page = hub.get("/api/v1/nodes?state=offline").await;
    assert_eq!(page["counts"]["offline"], 1);
    assert_eq!(page["nodes"][0]["node"], "car-1");
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_gap_in_the_numbers_makes_the_hub_ask_for_the_full_status_which_survives_a_restart() {
    let hub = Hub::fresh().await;
    let notices = hub.uplink.declare_subscriber("albireo/@changed/car-2").await.unwrap();
    hub.put_status("car-2", &full_status(11, 0, &[])).await;
    hub.until_state("car-2", "online").await;
    assert!(!hub.pull("car-2").await.send_full_status);
    hub.put_status("car-2", &status(11, 5)).await;
    let notice = notices.recv_async().await.unwrap();
    albireo_wire::read::<RevisionMessage>(&notice.payload().to_bytes()).unwrap();
    assert!(hub.pull("car-2").await.send_full_status);
    let full = full_status(11, 6, &[("power", "no meter")]);
    hub.put_status("car-2", &full).await;
    let before = hub.until_state("car-2", "degraded").await;
    assert_eq!(before["why"], "power: no meter");
    assert!(!hub.pull("car-2").await.send_full_status);
    let hub = hub.restart().await;
    let after = hub.get("/api/v1/nodes/car-2").await;
    for key in ["state", "why", "since_ms", "status"] {
        assert_eq!(after[key], before[key], "{key}");
    }
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_no_node_may_have_is_refused_and_counted_and_the_sender_learns_why() {
    let hub = Hub::fresh().await;
    let too_long = "n".repeat(65);
    for name in ["all", "..", too_long.as_str()] {
        hub.put_status(name, &full_status(10, 0, &[])).await;
        let payload = batch(name, 1..=1).to_payload(BatchCompression::Best).unwrap();
        match hub.send(name, payload).await {
            Reply::Refused(refusal) => assert_contains(&refusal.detail, &["node name"]),
            reply => panic!("{name}: {reply:?}"),
        }
        let pull = json!({"v": VERSION, "revision": 0}).to_string();
        let replies = hub.uplink.get(format!("albireo/@pull/{name}")).payload(pull).await.unwrap();
        let refused = replies.recv_async().await.unwrap().into_result().unwrap_err();
        let refusal: Value = serde_json::from_slice(&refused.payload().to_bytes()).unwrap();
        assert_contains(&refusal["detail"], &["node name"]);
    }
    hub.put_status("car-1", &full_status(11, 0, &[])).await;
    hub.until_state("car-1", "online").await;
    let page = hub.get("/api/v1/nodes").await;
    assert_eq!(names(&page), ["car-1"]);
    hub.assert_metrics(&["albireo_hub_statuses_unreadable_total 3\n"]).await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_node_whose_name_no_node_may_have_now_can_be_forgotten() {
    let hub = Hub::fresh().await;
    let old = "INSERT INTO nodes (name, state, since_ms, why) VALUES ('all', 'offline', 1, '')";
    script(&hub.config.database.url, old).await;
    let hub = hub.restart().await;
    let page = hub.get("/api/v1/nodes").await;
    assert_eq!(names(&page), [""; 0]);
    let url = format!("{}/api/v1/nodes/all", hub.http);
    for expected in [StatusCode::NO_CONTENT, StatusCode::NOT_FOUND] {
        let answer = reqwest::Client::new().delete(&url).send().await.unwrap();
        assert_eq!(answer.status(), expected);
    }
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_status_of_as_many_cameras_as_a_node_may_have_is_read_and_a_larger_is_counted() {
    let hub = Hub::fresh().await;
    let with_cameras = |run: u32, cameras: usize| {
        let mut message = full_status(run, 0, &[]);
        let camera = json!({"name": "c".repeat(64), "state": "live", "threshold_source": "hub"});
        let camera: CameraStatus = serde_json::from_value(camera).unwrap();
        message.full.as_mut().unwrap().cameras = vec![camera; cameras];
        message
    };
    hub.put_status("car-1", &with_cameras(10, 20 * MOST_CAMERAS)).await;
    hub.put_status("car-2", &with_cameras(11, MOST_CAMERAS)).await;
    let node = hub.until_state("car-2", "online").await;
    let cameras = node["status"]["cameras"].as_array().unwrap();
    assert_eq!(cameras.len(), MOST_CAMERAS);
    let page = hub.get("/api/v1/nodes").await;
    assert_eq!(names(&page), ["car-2"]);
    hub.assert_metrics(&["albireo_hub_statuses_unreadable_total 1\n"]).await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn paging_returns_each_node_once_in_every_order() {
    let hub = Hub::fresh().await;
    for number in 0..7 {
        let reasons: &[(&str, &str)] = if number == 3 {
            &[("screen", "no model")]
        } else {
            &[]
        };
        let mut message = full_status(number, 0, reasons);
        message.waiting = u64::from(number % 3);
        hub.put_status(&format!("car-{number}"), &message).await;
    }
    hub.until("/api/v1/nodes", |page| page["counts"]["online"] == 6).await;
    let mut orders = Vec::new();
    for sort in ["name", "state", "since", "heard", "waiting"] {
        let mut all: Vec<String> = Vec::new();
        for offset in [0, 3, 6, 7] {
            let path = format!("/api/v1/nodes?sort={sort}&down=true&limit=3&offset={offset}");
            let page = hub.get(&path).await;
            assert_has(&page, &json!({"total": 7, "offset": offset}));
            all.extend(names(&page).into_iter().map(str::to_owned));
        }
        orders.push(all.clone());
        all.sort();
        let expected: Vec<_> = (0..7).map(|number| format!("car-{number}")).collect();
        assert_eq!(all, expected, "{sort}");
    }
    assert_eq!(orders[1][0], "car-3", "the one that is degraded");
    assert_eq!(orders[4][..2], ["car-2", "car-5"], "those with two waiting");
    for (query, allowed) in [("sort=weight", "waiting"), ("state=ill", "degraded")] {
        let wrong = hub.get(&format!("/api/v1/nodes?{query}")).await;
        assert_contains(&wrong["detail"], &[allowed]);
    }
    hub.stop().await;
}

async fn router(endpoint: &str) -> zenoh::Session {
    let listen = ("listen/endpoints", json!([endpoint]));
    open(&[("mode", json!("router")), listen]).await
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_hub_without_its_router_is_not_ready_and_declares_nobody_silent() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let first = router(&endpoint).await;
    let hub = Hub::fresh_with(|config| {
        config.zenoh.listen.clear();
        config.zenoh.mode = ZenohMode::Client;
        config.zenoh.connect = vec![endpoint.clone()];
        config.presence.silent_after_s = 2.0;
        config.presence.offline_after_s = 4.0;
    })
    .await;
    let token = hub.uplink.liveliness().declare_token("albireo/@alive/car-9").await.unwrap();
    hub.put_status("car-9", &full_status(10, 0, &[])).await;
    hub.until_state("car-9", "online").await;

    first.close().await.unwrap();
    let held = hub.until("/readyz", |page| page["ready"] == false).await;
    assert!(held["reasons"]["zenoh"].is_string(), "{held}");
    // Longer than the time after which a node is offline.
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(hub.get("/api/v1/nodes/car-9").await["state"], "online");

    drop(token);
    let second = router(&endpoint).await;
    hub.until("/readyz", |answer| answer["ready"] == true).await;
    // Now the hub could hear the node and does not.
    hub.until_state("car-9", "offline").await;
    second.close().await.unwrap();
    hub.stop().await;
}
