use super::served::{Frames, Served, clip};
use albireo_core::policy::FrameState;
use albireo_vision::picture::PictureFormat;
use serde_json::Value;
use std::collections::BTreeSet;
use tokio::io::AsyncBufReadExt;
use tokio::process::Command;

/// Every route of the interface.
const ROUTES: &str = "get /healthz
get /readyz
get /metrics
get /api/v1
get /api/v1/caller
get /api/v1/node
get /api/v1/threshold
put /api/v1/threshold
get /api/v1/target
put /api/v1/target
get /api/v1/cameras/{camera}/threshold
put /api/v1/cameras/{camera}/threshold
get /api/v1/frame-states
get /api/v1/cameras/{camera}/frame-states
get /api/v1/cameras
get /api/v1/cameras/{camera}
get /api/v1/cameras/{camera}/detections
get /api/v1/cameras/{camera}/history
get /api/v1/cameras/{camera}/skip-estimate
get /api/v1/power
get /api/v1/log
get /api/v1/diag
get /api/v1/cameras/{camera}/frame.jpg
get /api/v1/clips
get /api/v1/events";

async fn filled() -> Served {
    let node = Served::start().await;
    node.ready();
    let front = node.front();
    front.answered_all(&[FrameState::I, FrameState::P]);
    front.sent(0, PictureFormat::Gray8, vec![7; 16], [4, 4]);
    node.board.record_clip(clip("front", 0));
    node
}

fn operations(document: &Value) -> Vec<(String, &Value)> {
    let mut found = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            found.push((format!("{method} {path}"), operation));
        }
    }
    found
}

#[tokio::test]
async fn the_openapi_document_lists_every_route_and_each_answers() {
    let node = filled().await;
    let document = node.json("/openapi.json").await;
    let documented = operations(&document).into_iter().map(|(name, _)| name);
    let documented: BTreeSet<_> = documented.collect();
    assert_eq!(documented, ROUTES.lines().map(str::to_owned).collect());
    for route in ROUTES
        .lines()
        .filter_map(|route| route.strip_prefix("get "))
    {
        let path = route.replace("{camera}", "front");
        assert_eq!(node.get(&path).await.status(), 200, "{path}");
    }
    let described = albireo_node::api::http::openapi();
    assert_eq!(document, serde_json::to_value(described).unwrap());
}

#[test]
fn every_operation_has_a_unique_id() {
    let mut documents = vec![serde_json::to_value(albireo_node::api::http::openapi()).unwrap()];
    #[cfg(feature = "hub")]
    documents.push(serde_json::to_value(albireo_hub::http::openapi()).unwrap());
    for document in documents {
        let all = operations(&document);
        let names: BTreeSet<_> = (all.iter())
            .map(|(name, operation)| {
                let id = operation["operationId"].as_str();
                id.unwrap_or_else(|| panic!("{name} has no operationId"))
            })
            .collect();
        assert!(all.len() > 15);
        assert_eq!(names.len(), all.len(), "{names:?}");
    }
}

#[tokio::test]
async fn every_reference_in_the_document_resolves() {
    fn references<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
        match value {
            Value::Object(map) => {
                found.extend(map.get("$ref").and_then(Value::as_str));
                map.values().for_each(|value| references(value, found));
            }
            Value::Array(list) => list.iter().for_each(|value| references(value, found)),
            _ => {}
        }
    }
    let document = serde_json::to_value(albireo_node::api::http::openapi()).unwrap();
    let mut found = Vec::new();
    references(&document, &mut found);
    assert!(found.len() > 20, "{found:?}");
    for reference in found {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{reference}");
    }
}

#[tokio::test]
#[ignore = "needs curl"]
async fn every_documented_command_works() {
    let node = filled().await;
    let document = node.json("/openapi.json").await;
    let directory = tempfile::tempdir().unwrap();
    for (name, operation) in operations(&document) {
        let text = operation["description"].as_str().unwrap();
        let command = text.split('`').find(|part| part.starts_with("curl "));
        let command = command.unwrap_or_else(|| panic!("{name} shows no command"));
        let here = command.replace("127.0.0.1:8080", &node.address.to_string());
        assert_ne!(here, command, "{name}");
        let mut curl = Command::new("sh")
            .args(["-c", &here.replace("curl ", "exec curl -sSf ")])
            .current_dir(directory.path())
            .kill_on_drop(true)
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        if name.ends_with("/events") {
            // The stream never ends: its first line suffices.
            let mut lines = tokio::io::BufReader::new(curl.stdout.take().unwrap());
            let mut line = String::new();
            lines.read_line(&mut line).await.unwrap();
            assert!(line.starts_with("event: "), "{command}: {line}");
            curl.kill().await.unwrap();
            continue;
        }
        let output = curl.wait_with_output().await.unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{command}: {said}");
    }
    assert!(directory.path().join("frame.jpg").is_file());
    assert_eq!(node.front().threshold(), Some(5e-4));
}

#[cfg(feature = "swagger")]
#[tokio::test]
async fn the_document_is_shown_as_a_page() {
    let node = Served::start().await;
    for (path, part) in [
        ("/docs/", "swagger-ui"),
        ("/docs/swagger-initializer.js", "/openapi.json"),
    ] {
        let page = node.get(path).await.text().await.unwrap();
        crate::support::assert_contains(&page, &[part]);
    }
}
