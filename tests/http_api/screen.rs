use super::served::{Served, prepared, problem};
use crate::support::{assert_contains, assert_has};
use albireo_service::config::HttpConfig;
use serde_json::{Value, json};

const PATH: &str = "/api/v1/screen";

#[tokio::test]
async fn a_pause_set_by_one_put_is_in_force_and_told_per_camera() {
    let directory = tempfile::tempdir().unwrap();
    let node = Served::kept_in(directory.path()).await;
    let before: Value = node.get(PATH).await.json().await.unwrap();
    assert_has(
        &before,
        &json!({"pause_s": 0.0, "after_s": 1.0, "applies": true}),
    );
    let now: Value = node.put(PATH, r#"{"pause_s": 0.16}"#).await.json().await.unwrap();
    assert_has(
        &now,
        &json!({"pause_s": 0.16, "after_s": 1.0, "survives_restart": true}),
    );
    assert_has(
        &now["cameras"][0],
        &json!({"camera": "front", "looks_at_one_in": 1}),
    );
    let now: Value = node.put(PATH, r#"{"after_s": 2}"#).await.json().await.unwrap();
    assert_has(&now, &json!({"pause_s": 0.16, "after_s": 2.0}));
    let now: Value = node.put(PATH, r#"{"still_s": 10}"#).await.json().await.unwrap();
    assert_has(&now, &json!({"pause_s": 0.16, "still_s": 10.0}));
}

#[tokio::test]
async fn an_impossible_pause_is_refused_in_words_and_changes_nothing() {
    let node = Served::start().await;
    for (body, status, words) in [
        (
            r#"{"pause_s": -1}"#,
            422,
            "`pause_s` must be a number of seconds from 0 to 60",
        ),
        (
            r#"{"after_s": 3601}"#,
            422,
            "`after_s` must be a number of seconds from 0 to 3600",
        ),
        (
            r#"{"still_s": 61}"#,
            422,
            "`still_s` must be a number of seconds from 0 to 60",
        ),
        (r#"{"pause": 0.2}"#, 422, "unknown field `pause`"),
        ("{}", 422, "it names no pause"),
        ("0.2", 422, "not a JSON object"),
        ("pause", 400, "with seconds"),
    ] {
        let refused = problem(node.put(PATH, body).await, status).await;
        assert_contains(&refused["detail"], &[words]);
    }
    let vanilla = Served::over(HttpConfig::default(), prepared("vanilla", None)).await;
    let refused = problem(vanilla.put(PATH, r#"{"pause_s": 0.2}"#).await, 409).await;
    assert_contains(&refused["detail"], &["`vanilla` takes no pause"]);
    for (node, applies) in [(node, true), (vanilla, false)] {
        let unchanged: Value = node.get(PATH).await.json().await.unwrap();
        assert_has(&unchanged, &json!({"pause_s": 0.0, "applies": applies}));
    }
}
