//! `albireo demo` with its hub, as a user runs it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::{PATIENCE, albireo};
use serde_json::Value;
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::time::timeout;

async fn ask(url: &str) -> Value {
    match reqwest::get(url).await {
        Ok(response) => response.json().await.unwrap_or(Value::Null),
        Err(_) => Value::Null,
    }
}

/// After the first detection comes a table of clips without another line in it: the road's clips in order.
fn assert_is_a_table(lines: &[String]) {
    let first = lines
        .iter()
        .position(|line| line.starts_with("first detection after"));
    let mut after = lines[first.expect("cars are found")..].iter().skip(1);
    assert_eq!(after.next().unwrap(), "");
    assert!(after.next().unwrap().starts_with("clip "), "{lines:?}");
    let clips: Vec<_> = after
        .take_while(|line| !line.is_empty())
        .map(|line| line.split_whitespace().next().unwrap())
        .collect();
    assert!(clips.len() >= 2, "{lines:?}");
    let road = ["busy", "sparse", "empty-then-car", "night"];
    for (number, clip) in clips.iter().enumerate() {
        assert_eq!(*clip, format!("{}-{:04}", road[number % 4], number + 1));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn the_demonstration_has_a_hub_where_its_clips_arrive_and_its_node_is_seen() {
    let temporary = tempfile::tempdir().unwrap();
    // Four times as fast, so that a clip does not take long.
    let mut demo = albireo()
        .args(["demo", "--port", "0", "--hub-port", "0", "--rate", "40"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("TMPDIR", temporary.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines();
    let hub = loop {
        let line = timeout(PATIENCE, lines.next_line()).await.unwrap().unwrap();
        let line = line.expect("the demonstration prints where its hub is");
        if let Some(rest) = line.split("hub      curl ").nth(1) {
            break rest.trim_end_matches("/api/v1/clips").to_owned();
        }
    };
    let deadline = Instant::now() + PATIENCE;
    let clips = loop {
        let page = ask(&format!("{hub}/api/v1/clips")).await;
        let clips = page["clips"].as_array().cloned().unwrap_or_default();
        if clips.len() >= 2 {
            break clips;
        }
        assert!(Instant::now() < deadline, "no clips arrive: {page}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert!(clips.iter().all(|clip| clip["node"] == "demo"), "{clips:?}");
    // Its status was sent before the hub could hear, perhaps; then the hub asks for it.
    loop {
        let node = ask(&format!("{hub}/api/v1/nodes/demo")).await;
        if node["status"]["cameras"][0]["name"] == "dashcam" && node["state"] != "offline" {
            break;
        }
        assert!(Instant::now() < deadline, "the node is not seen: {node}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }

    let id = demo.id().unwrap().to_string();
    let signalled = std::process::Command::new("kill")
        .args(["-TERM", &id])
        .status();
    assert!(signalled.unwrap().success());
    let mut rest = Vec::new();
    while let Some(line) = timeout(PATIENCE, lines.next_line()).await.unwrap().unwrap() {
        rest.push(line);
    }
    let ended = timeout(PATIENCE, demo.wait_with_output())
        .await
        .unwrap()
        .unwrap();
    let complaint = String::from_utf8(ended.stderr).unwrap();
    assert!(ended.status.success(), "{complaint}");
    assert_eq!(complaint, "", "nothing tears the table");
    assert!(
        rest.iter().any(|line| line.contains("detector skipped on")),
        "{rest:?}"
    );
    assert_is_a_table(&rest);
    // ONNX Runtime leaves its own file there.
    let left: Vec<_> = std::fs::read_dir(temporary.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with("albireo"))
        .collect();
    assert!(left.is_empty(), "the hub's folder goes with it: {left:?}");
}
