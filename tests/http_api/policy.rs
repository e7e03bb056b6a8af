use super::served::{Served, problem};
use crate::support::{assert_contains, assert_has};
use albireo_node::state::board::News;
use serde_json::{Value, json};

const PATH: &str = "/api/v1/policy";

#[tokio::test]
async fn one_put_switches_the_policy_and_every_route_tells_it() {
    let directory = tempfile::tempdir().unwrap();
    let node = Served::kept_in(directory.path()).await;
    let before = node.json(PATH).await;
    assert_has(&before, &json!({"name": "albireo", "threshold": "u"}));
    let mut events = node.board.subscribe();
    let response = node.put(PATH, r#"{"name": "expected-loss"}"#).await;
    assert_eq!(response.status(), 200);
    let now: Value = response.json().await.unwrap();
    assert_has(
        &now,
        &json!({"name": "expected-loss", "threshold": "lambda", "configured": "albireo", "survives_restart": true, "notes": []}),
    );
    // The subscribers of events learn the threshold that is in force now.
    let event = events.try_recv().unwrap();
    let News::Threshold(told) = &event.news else {
        panic!("{event:?}");
    };
    assert_eq!(&*told.camera, "front");
    assert_eq!(told.threshold.name.as_str(), "lambda");
    assert_has(
        &node.json("/api/v1/threshold").await,
        &json!({"lambda": 0.3, "cameras": [{"lambda": 0.3, "threshold_spec": {"name": "lambda"}}, {"camera": "rear"}]}),
    );
    assert_has(
        &node.json("/api/v1/cameras/front").await,
        &json!({"policy": "expected-loss", "policy_set_by": "local", "set_by": "configuration"}),
    );
    let overview = node.json("/api/v1/node").await;
    assert_has(
        &overview,
        &json!({"policy": "expected-loss", "since_switch": {"frames": 0}}),
    );
    let metrics = node.get("/metrics").await.text().await.unwrap();
    assert_contains(&metrics, &["policy=\"expected-loss\"", "name=\"lambda\""]);
    // A value of the policy before is not taken for one of this.
    let refused = problem(node.put("/api/v1/threshold", r#"{"u": 5e-4}"#).await, 422).await;
    assert_contains(&refused["detail"], &["is `lambda`, not `u`"]);
}

#[tokio::test]
async fn a_typo_names_the_policies_and_changes_nothing() {
    let node = Served::start().await;
    for (body, words) in [
        (
            r#"{"name": "expected-los"}"#,
            "did you mean `expected-loss`?",
        ),
        (r#"{"name": "fast"}"#, "the policies are `albireo`"),
        (
            r#"{"policy": "vanilla"}"#,
            "unknown field `policy`, expected `name`",
        ),
    ] {
        let refused = problem(node.put(PATH, body).await, 422).await;
        assert_contains(&refused["detail"], &[words]);
        let allowed = refused["allowed"].as_array().unwrap();
        assert!(allowed.contains(&json!("expected-loss")) && allowed.len() > 10);
    }
    assert_eq!(node.json(PATH).await["name"], "albireo");
}

#[tokio::test]
async fn what_does_nothing_under_the_new_policy_is_said() {
    let node = Served::start().await;
    node.put("/api/v1/screen", r#"{"pause_s": 0.2}"#).await;
    node.put("/api/v1/target", r#"{"target": {"skip_rate": 0.5}}"#).await;
    let response = node.put(PATH, r#"{"name": "vanilla"}"#).await;
    let now: Value = response.json().await.unwrap();
    assert_contains(
        &now["notes"],
        &["screen.pause_s is set, but", "no target is held"],
    );
    let back: Value = node.put(PATH, r#"{"name": "albireo"}"#).await.json().await.unwrap();
    assert_eq!(back["notes"], json!([]));
}
