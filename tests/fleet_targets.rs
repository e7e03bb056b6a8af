//! A target set with `albireo fleet`: held by a real node, switched off by hand, refused with a reason.

use crate::fleet::Car;
use crate::support::fleet::HubProcess;
use crate::support::{assert_contains, assert_has, json_at, run, until};
use serde_json::{Value, json};

/// What a command to the fleet said, to both outputs, and its exit code.
struct Answer {
    said: String,
    code: Option<i32>,
}

fn fleet(hub: &HubProcess, words: &str) -> Answer {
    let words: Vec<_> = words.split(' ').collect();
    let ended = run(&[&["fleet", "--hub", &hub.http], &words[..]].concat(), &[]);
    Answer {
        said: ended.out + &ended.err,
        code: ended.code,
    }
}

async fn at_node(car: &Car) -> Value {
    let http = &car.node.as_ref().unwrap().http;
    json_at(&format!("{http}/api/v1/target")).await
}

#[rstest::rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_target_set_at_the_hub_is_held_by_the_node_until_its_threshold_is_set_by_hand() {
    let (endpoint, hub) = HubProcess::fresh(vec![]).await;
    let mut car = Car::new("expected-loss", "car-1", &endpoint);
    let mut plain = Car::new("vanilla", "car-2", &endpoint);
    for car in [&mut car, &mut plain] {
        car.start().await;
        let path = format!("/api/v1/nodes/{}", car.name);
        hub.until(&path, |node| node["status"].is_object()).await;
    }
    let order = "set-target skip_rate=0.5 --select car-* --why half --wait 60s";
    let Answer { said, code } = fleet(&hub, order);
    assert_contains(&said, &[": 1 applied, 1 refused", "hold skip_rate 0.5"]);
    assert_eq!(code, Some(3), "{said}");
    let (_, after) = said.split_once("revision ").unwrap();
    let (revision, _) = after.split_once(':').unwrap();
    let refused = hub.get(&format!("/api/v1/revisions/{revision}")).await;
    let words = &refused["nodes"][1]["detail"];
    assert_contains(words, &["policy `vanilla` has no threshold"]);
    let held = json!({"target": {"skip_rate": 0.5}, "source": "hub"});
    assert_has(&at_node(&car).await, &held);
    assert_eq!(hub.get("/api/v1/drift").await, json!([]));

    // The node measures it and reports its state to the hub.
    until("the target is measured", async || {
        car.drive(5).await;
        at_node(&car).await["state"]["actual"].is_f64()
    })
    .await;
    let is_reported = |node: &Value| node["status"]["target"]["actual"].is_f64();
    hub.until("/api/v1/nodes/car-1", is_reported).await;
    let shown = fleet(&hub, "show car-1").said;
    assert_contains(&shown, &["target       skip_rate 0.5, now "]);

    car.end().await;
    car.start().await;
    assert_has(&at_node(&car).await, &held);

    let threshold = format!("{}/api/v1/threshold", car.node.as_ref().unwrap().http);
    let put = reqwest::Client::new().put(threshold).body(r#"{"lambda": 0.3}"#);
    assert_eq!(put.send().await.unwrap().status(), 200);
    let drift = hub.until("/api/v1/drift", |drift| drift[0]["node"] == "car-1").await;
    let by_hand = json!({
        "desired": {"target": {"skip_rate": 0.5}},
        "in_force": {"threshold": {"name": "lambda", "value": 0.3}},
        "why": "the threshold was set by hand",
    });
    assert_has(&drift[0], &by_hand);
    let drifted = fleet(&hub, "drift").said;
    assert_contains(&drifted, &["hold skip_rate 0.5", "lambda 0.3"]);

    // The target again, then a value instead, then no target is left to switch off.
    let again = r#"set-target {"skip_rate":0.5} --select car-1 --wait 60s"#;
    assert_eq!(fleet(&hub, again).code, Some(0));
    assert_eq!(at_node(&car).await["target"], json!({"skip_rate": 0.5}));
    let value = "set-u 0.4 --threshold lambda --select car-1 --wait 60s";
    let Answer { said, code } = fleet(&hub, value);
    assert_contains(&said, &["hold skip_rate 0.5 -> lambda 0.4"]);
    assert_eq!(code, Some(0), "{said}");
    let off = json!({"target": null, "off": "the threshold was set by the hub"});
    assert_has(&at_node(&car).await, &off);
    let Answer { said, code } = fleet(&hub, "set-target off --select car-1");
    assert!(code == Some(0) && said.contains("1 unchanged"), "{said}");
}
