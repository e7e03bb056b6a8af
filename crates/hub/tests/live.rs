//! Watching one node through the hub: the node sends only while it is watched.

use crate::support::{Hub, assert_has, batch_of, full_status, names, now_ns};
use rstest::rstest;
use serde_json::{Value, json};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::time::timeout;
use zenoh::Wait;

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_watched_node_learns_it_and_its_counters_and_pictures_reach_the_watcher() {
    let hub = Hub::fresh().await;
    let live = format!("{}/api/v1/nodes/car-7/live", hub.http);
    assert_eq!(reqwest::get(&live).await.unwrap().status(), 404);
    let node = &hub.uplink;
    let notices = node.declare_subscriber("albireo/@changed/car-7").await.unwrap();
    hub.put_status("car-7", &full_status(10, 0, &[])).await;
    hub.until_state("car-7", "online").await;
    assert_eq!(hub.pull("car-7").await.watched_for_s, None);
    while let Ok(Some(_)) = notices.try_recv() {}

    let mut live = reqwest::get(live).await.unwrap();
    assert_eq!(live.status(), 200);
    notices.recv_async().await.unwrap();
    let lease = hub.pull("car-7").await.watched_for_s.unwrap();
    assert!((1..=31).contains(&lease), "{lease}");

    let publisher = node.declare_publisher("albireo/car-7/front/counters").await.unwrap();
    let counters = json!({
        "v": 1, "t_ns": 1, "camera": "front", "frames": 7,
        "states": {"E": 1, "P": 2, "E+I": 0, "I": 4, "AI": 0}, "skip_rate": 0.43, "degraded_frames": 0,
        "calls": {"uncertain": 4}, "dropped": {}, "threshold": {"name": "u", "value": 3e-4}, "watts": [],
        "power_quality": "unavailable",
    });
    let mut text = String::new();
    while !text.contains("event: counters") {
        publisher.put(counters.to_string()).await.unwrap();
        if let Ok(chunk) = timeout(Duration::from_millis(100), live.chunk()).await {
            text.push_str(&String::from_utf8_lossy(&chunk.unwrap().unwrap()));
        }
    }
    let data = text.lines().find_map(|line| line.strip_prefix("data: "));
    let heard: Value = serde_json::from_str(data.unwrap()).unwrap();
    assert_has(&heard, &json!({"frames": 7, "calls": {"uncertain": 4}}));

    // The first query for a picture is never answered, as if it was lost on the way: Zenoh ends it with an error.
    let dropped = Arc::new(OnceLock::new());
    let first = Arc::clone(&dropped);
    let _pictures = node
        .declare_queryable("albireo/car-7/front/picture")
        .callback(move |query| {
            let Err(query) = first.set(query) else { return };
            let key = query.key_expr().clone();
            let _ = query.reply(key, b"\xff\xd8\xffjpeg".to_vec()).attachment("42").wait();
        })
        .await
        .unwrap();
    let path = format!("{}/api/v1/nodes/car-7/cameras/front/frame.jpg", hub.http);
    let answer = reqwest::get(&path).await.unwrap();
    assert_eq!(answer.status(), 200);
    assert_eq!(answer.headers()["albireo-frame"], "42");
    assert_eq!(answer.headers()["content-type"], "image/jpeg");
    assert!(answer.bytes().await.unwrap().starts_with(b"\xff\xd8\xff"));
    let odd = reqwest::get(path.replace("front", "*")).await;
    assert_eq!(odd.unwrap().status(), 404);
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nodes_are_sorted_by_todays_energy_even_after_a_restart() {
    let mut hub = Hub::fresh().await;
    // A clip each, of now: 100.4, 101.1 and 100.8 J measured in part, measured and estimated.
    let now = now_ns();
    for (name, number) in [("car-1", 1), ("car-2", 3), ("car-3", 2)] {
        let mut one = batch_of(name, number..=number, now);
        one.reports[0].started_ns = now;
        hub.deliver(&one).await;
    }
    let mut shown = Vec::new();
    for restarted in [false, true] {
        if restarted {
            hub = hub.restart().await;
        }
        let read = |page: &Value| names(page) == ["car-2", "car-3", "car-1"];
        let page = hub.until("/api/v1/nodes?sort=joules&down=true", read).await;
        let rows = hub.get("/api/v1/nodes?sort=joules").await;
        assert_eq!(names(&rows), ["car-1", "car-3", "car-2"]);
        let today = &page["nodes"][0]["today"];
        assert_eq!(today["estimated_joules"], 0.0);
        let skipped = today["skip_rate"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&skipped), "{today}");
        shown.push(json!({"skip_rate": today["skip_rate"], "recall": today["recall"]}));
        let measured = today["measured_joules"].as_f64().unwrap();
        assert!((measured - 101.1).abs() < 1e-3, "{today}");
        let estimated = &page["nodes"][1]["today"]["estimated_joules"];
        assert!(estimated.as_f64().unwrap() > 100.0);
    }
    // The restarted hub reads the same from its database.
    assert_eq!(shown[0], shown[1]);
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_index_lists_every_documented_route() {
    let hub = Hub::fresh().await;
    let index = hub.get("/api/v1").await;
    let routes = index["routes"].as_array().unwrap();
    let described = hub.get("/openapi.json").await;
    for path in "threshold target rollouts/{id} trials revisions/{revision}".split(' ') {
        let path = format!("/api/v1/{path}");
        assert!(described["paths"][&path].is_object(), "{path}");
    }
    for (path, methods) in described["paths"].as_object().unwrap() {
        for method in methods.as_object().unwrap().keys() {
            let is_this_one =
                |route: &Value| route["path"] == *path && route["method"] == *method.to_uppercase();
            assert!(routes.iter().any(is_this_one), "{method} {path}");
        }
    }
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_of_events_of_an_unknown_type_is_refused_with_the_known_ones() {
    let hub = Hub::fresh().await;
    let (status, said) = answer(&hub, "/api/v1/events?types=node,nope").await;
    assert_eq!(status, 400, "{said}");
    for part in ["`nope`", "node, gap, reset, set_aside"] {
        assert!(said.contains(part), "{said}");
    }
    let known = "node,gap,reset,set_aside,clock_off,refused,drift,forgotten,resync";
    let stream = reqwest::get(format!("{}/api/v1/events?types={known}", hub.http)).await;
    assert_eq!(stream.unwrap().status(), 200);
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_list_of_no_or_a_negative_number_of_rows_is_refused_in_words_by_every_route() {
    let hub = Hub::fresh().await;
    let described = hub.get("/openapi.json").await;
    let takes_limit = |route: &Value| {
        let parameters = route["get"]["parameters"].as_array();
        parameters.is_some_and(|all| all.iter().any(|one| one["name"] == "limit"))
    };
    let paths = described["paths"].as_object().unwrap();
    let lists: Vec<&String> = paths
        .iter()
        .filter(|(_, route)| takes_limit(route))
        .map(|(path, _)| path)
        .collect();
    assert!(lists.len() >= 7, "{lists:?}");
    for path in lists {
        for limit in ["-1", "-9223372036854775808", "9223372036854775808", "many"] {
            let asked = format!("{}?limit={limit}", path.replace("{node}", "car-7"));
            let (status, said) = answer(&hub, &asked).await;
            assert_eq!(status, 400, "{asked}: {said}");
            assert!(said.contains("limit"), "{asked}: {said}");
        }
        // Only the list of nodes can be asked for its number alone.
        let asked = format!("{}?limit=0", path.replace("{node}", "car-7"));
        let (status, said) = answer(&hub, &asked).await;
        let expected = if path == "/api/v1/nodes" { 200 } else { 400 };
        assert_eq!(status, expected, "{asked}: {said}");
    }
    hub.stop().await;
}

/// The status and the body of a GET.
async fn answer(hub: &Hub, path: &str) -> (u16, String) {
    let answer = reqwest::get(format!("{}{path}", hub.http)).await.unwrap();
    (answer.status().as_u16(), answer.text().await.unwrap())
}
