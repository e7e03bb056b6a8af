use super::served::{Served, problem};
use serde_json::{Value, json};

const PATH: &str = "/api/v1/target";

async fn read(node: &Served) -> Value {
    node.get(PATH).await.json().await.unwrap()
}

#[tokio::test]
async fn a_bad_target_is_refused_says_what_is_allowed_and_changes_nothing() {
    let node = Served::start().await;
    for (body, status) in [
        (r#"{"target": {"skip_rate": 1.0}}"#, 422),
        (r#"{"target": {"skip_rate": -0.5}}"#, 422),
        (r#"{"target": {"recall": 1.5}}"#, 422),
        (r#"{"target": {"watts": 0}}"#, 422),
        (r#"{"target": {"watts": "6"}}"#, 422),
        (r#"{"target": {"speed": 3}}"#, 422),
        (r#"{"target": {"skip_rate": 0.5, "watts": 6}}"#, 422),
        (r#"{"target": 0.5}"#, 422),
        (r#"{"target": {"skip_rate": 0.5}, "v": 2}"#, 422),
        (r#"{"target": {"skip_rate": 0.5}, "u": 1e-3}"#, 422),
        ("{}", 422),
        ("[]", 422),
        ("", 400),
        (r#"{"target": {"skip_rate": 0.5}"#, 400),
    ] {
        let refused = problem(node.put(PATH, body).await, status).await;
        assert!(refused["detail"].is_string(), "{body}");
        assert_eq!(read(&node).await["target"], Value::Null, "{body}");
    }
}

#[tokio::test]
async fn a_target_is_set_read_switched_off_by_hand_and_by_null_and_says_so() {
    let node = Served::start().await;
    let set = node.put(PATH, r#"{"target": {"skip_rate": 0.5}}"#).await;
    assert_eq!(set.status(), 200);
    let set: Value = set.json().await.unwrap();
    assert_eq!(set["target"], json!({"skip_rate": 0.5}));
    assert_eq!(set["source"], "local");
    assert_eq!(set["range"], json!({"least": 1.5e-4, "most": 2e-3}));
    assert_eq!(set["threshold"], json!({"name": "u", "value": 3e-4}));
    assert_eq!(read(&node).await, set);
    let metrics = || async { node.get("/metrics").await.text().await.unwrap() };
    let wanted = "albireo_target{target=\"skip_rate\"} 0.5";
    assert!(metrics().await.contains(wanted));

    let turned = node
        .put("/api/v1/cameras/front/threshold", r#"{"u": 7e-4}"#)
        .await;
    assert_eq!(turned.status(), 200);
    let off = read(&node).await;
    assert_eq!(off["target"], Value::Null);
    assert_eq!(off["off"], "the threshold was set by hand");
    assert!(!metrics().await.contains("albireo_target{"));

    node.put(PATH, r#"{"target": {"watts": 6.0}}"#).await;
    assert_eq!(read(&node).await["target"], json!({"watts": 6.0}));
    let off = node.put(PATH, r#"{"target": null}"#).await;
    let off: Value = off.json().await.unwrap();
    assert_eq!(
        (&off["target"], &off["off"]),
        (&Value::Null, &json!("it was switched off"))
    );
}
