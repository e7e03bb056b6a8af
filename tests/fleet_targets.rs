//! A target set by `albireo fleet` at a hub, held by a real node, switched off by hand, and refused with a reason.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::fleet::Car;
use crate::support::fleet::{HubProcess, settings, sqlite};
use crate::support::{PATIENCE, albireo};
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// What `albireo fleet` prints, and its exit code.
async fn fleet(hub: &HubProcess, arguments: &[&str]) -> (String, Option<i32>) {
    let ended = albireo()
        .args(["fleet", "--hub", &hub.http])
        .args(arguments)
        .output()
        .await
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stdout) + String::from_utf8_lossy(&ended.stderr);
    (said.into_owned(), ended.status.code())
}

async fn at_node(car: &Car) -> Value {
    let url = format!("{}/api/v1/target", car.node.as_ref().unwrap().http);
    reqwest::get(url).await.unwrap().json().await.unwrap()
}

/// Sends frames until the node's own account of its target is as wanted.
async fn until(car: &mut Car, wanted: impl Fn(&Value) -> bool) -> Value {
    let until = Instant::now() + PATIENCE;
    loop {
        car.drive(5).await;
        let report = at_node(car).await;
        if wanted(&report) {
            return report;
        }
        assert!(Instant::now() < until, "{report}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_target_ordered_at_the_hub_is_held_by_the_node_until_somebody_turns_its_knob() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, configured) = settings(&sqlite(folder.path()));
    let hub = HubProcess::start(&configured);
    hub.until_ready().await;
    let mut car = Car::under("expected-loss", "car-1", &endpoint);
    let mut plain = Car::under("vanilla", "car-2", &endpoint);
    for car in [&mut car, &mut plain] {
        car.start().await;
        let path = format!("/api/v1/nodes/{}", car.name);
        hub.until(&path, |node| node["status"].is_object()).await;
    }
    let select = ["--select", "car-*", "--why", "half of it", "--wait", "60s"];
    let order = [&["set-target", "skip_rate=0.5"][..], &select].concat();
    let (said, code) = fleet(&hub, &order).await;
    assert!(said.contains(": 1 applied, 1 refused"), "{said}");
    let revision = said.split("revision ").nth(1).unwrap();
    let revision = revision.split(':').next().unwrap();
    assert!(said.contains("hold skip_rate 0.5"), "{said}");
    assert_eq!(code, Some(3), "{said}");
    let refused = hub.get(&format!("/api/v1/changes/{revision}")).await;
    let words = refused["nodes"][1]["detail"].as_str().unwrap();
    assert!(
        words.contains("policy `vanilla` has nothing to turn"),
        "{refused}"
    );
    let report = at_node(&car).await;
    assert_eq!(report["target"], json!({"skip_rate": 0.5}), "{report}");
    assert_eq!(report["source"], "hub");

    // It is measured, and its state is reported to the hub.
    until(&mut car, |report| report["state"]["actual"].is_f64()).await;
    hub.until("/api/v1/nodes/car-1", |node| {
        node["status"]["target"]["actual"].is_f64()
    })
    .await;
    let (said, _) = fleet(&hub, &["show", "car-1"]).await;
    assert!(said.contains("target       skip_rate 0.5, now "), "{said}");

    // A restart goes on with it.
    car.end().await;
    car.start().await;
    let report = at_node(&car).await;
    assert_eq!(
        (&report["target"], &report["source"]),
        (&json!({"skip_rate": 0.5}), &json!("hub"))
    );

    let turned = reqwest::Client::new()
        .put(format!(
            "{}/api/v1/threshold",
            car.node.as_ref().unwrap().http
        ))
        .body(r#"{"lambda": 0.3}"#)
        .send()
        .await
        .unwrap();
    assert_eq!(turned.status(), 200);
    let drift = hub.until("/api/v1/drift", |drift| drift[0]["node"] == "car-1");
    let drift = drift.await;
    assert_eq!(drift[0]["why"], "the threshold was set by hand", "{drift}");
    let (said, _) = fleet(&hub, &["drift"]).await;
    assert!(
        said.contains("hold skip_rate 0.5") && said.contains("lambda 0.3"),
        "{said}"
    );

    // The target again, then a value in its place, then nothing to switch off any more.
    let again = [
        "set-target",
        r#"{"skip_rate": 0.5}"#,
        "--select",
        "car-1",
        "--wait",
        "60s",
    ];
    assert_eq!(fleet(&hub, &again).await.1, Some(0));
    assert_eq!(at_node(&car).await["target"], json!({"skip_rate": 0.5}));
    let value = [
        "set-u", "0.4", "--knob", "lambda", "--select", "car-1", "--wait", "60s",
    ];
    let (said, code) = fleet(&hub, &value).await;
    assert!(
        code == Some(0) && said.contains("hold skip_rate 0.5 -> lambda 0.4"),
        "{said}"
    );
    let report = at_node(&car).await;
    assert_eq!(
        (&report["target"], &report["off"]),
        (&Value::Null, &json!("the threshold was set by the hub"))
    );
    let off = ["set-target", "off", "--select", "car-1"];
    let (said, code) = fleet(&hub, &off).await;
    assert!(code == Some(0) && said.contains("1 unchanged"), "{said}");
    car.end().await;
    plain.end().await;
    tokio::time::timeout(Duration::from_secs(30), hub.kill())
        .await
        .unwrap();
}
