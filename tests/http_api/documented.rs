use super::metrics::filled;
use super::served::problem;
use crate::support::Ended;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use tokio::process::Command;

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
async fn every_documented_route_is_listed_in_the_index_and_answers() {
    let node = filled().await;
    let document = node.json("/openapi.json").await;
    let described = albireo_node::api::http::openapi();
    assert_eq!(document, serde_json::to_value(described).unwrap());
    let index = node.json("/api/v1").await;
    assert_eq!(index["cameras"], json!(["front", "rear"]));
    let listed = index["routes"].as_array().unwrap();
    let mut summaries = listed.iter().map(|route| &route["summary"]);
    assert!(summaries.all(|summary| summary != ""), "{listed:?}");
    for (route, _) in operations(&document) {
        let (method, path) = route.split_once(' ').unwrap();
        assert!(listed.iter().any(|one| one["path"] == *path), "{path}");
        let ask = async |camera: &str| {
            let path = path.replace("{camera}", camera);
            match method {
                "get" => node.get(&path).await,
                _ => node.put(&path, r#"{"u": 5e-4}"#).await,
            }
        };
        if method == "get" {
            assert_eq!(ask("front").await.status(), 200, "{route}");
        }
        if path.contains("{camera}") {
            let missing = problem(ask("roof").await, 404).await;
            assert_eq!(missing["allowed"], json!(["front", "rear"]), "{route}");
        }
    }
}

#[test]
fn every_operation_has_a_unique_id() {
    let mut documents = vec![serde_json::to_value(albireo_node::api::http::openapi()).unwrap()];
    #[cfg(feature = "hub")]
    documents.push(serde_json::to_value(albireo_hub::http::openapi()).unwrap());
    for document in documents {
        let all = operations(&document);
        let ids = all
            .iter()
            .map(|(name, one)| one["operationId"].as_str().expect(name));
        let names: BTreeSet<_> = ids.collect();
        assert!(all.len() > 15);
        assert_eq!(names.len(), all.len(), "{names:?}");
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
        // The stream never ends by itself.
        let (limit, code, begin) = match name.ends_with("/events") {
            true => (3, 28, "event: "),
            false => (60, 0, ""),
        };
        let curl = format!("exec curl -sSf --max-time {limit} ");
        let mut shell = Command::new("sh");
        shell.args(["-c", &here.replace("curl ", &curl)]);
        let output = shell.current_dir(directory.path()).output().await;
        let ended = Ended::from(output.unwrap());
        assert_eq!(ended.code, Some(code), "{command}: {}", ended.err);
        assert!(ended.out.starts_with(begin), "{command}: {}", ended.out);
    }
    assert!(directory.path().join("frame.jpg").is_file());
    assert_eq!(node.front().threshold(), Some(5e-4));
}

#[cfg(feature = "swagger")]
#[tokio::test]
async fn the_document_is_shown_as_a_page() {
    let node = filled().await;
    for (path, part) in [
        ("/docs/", "swagger-ui"),
        ("/docs/swagger-initializer.js", "/openapi.json"),
    ] {
        let page = node.get(path).await.text().await.unwrap();
        crate::support::assert_contains(&page, &[part]);
    }
}
