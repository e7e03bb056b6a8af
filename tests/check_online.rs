//! `albireo check --online` tries everything that a configuration names, as a node would use it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::fleet::{HubProcess, settings, sqlite};
use crate::support::{albireo, free_port};
use std::process::Output;

/// Checks the shipped configuration with an uplink; returns the output.
async fn check_online(uplink: &str, more: &[(&str, &str)]) -> (Output, String) {
    let output = albireo()
        .args(["check", "--online", "config/node.toml"])
        .env("ALBIREO_UPLINK__CONNECT", format!("[\"{uplink}\"]"))
        .envs(more.iter().copied())
        .output()
        .await
        .unwrap();
    let said =
        [&output.stdout, &output.stderr].map(|said| String::from_utf8_lossy(said).into_owned());
    let said = said.join("\n");
    (output, said)
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn check_online_reports_the_running_provider_and_that_the_hub_accepts_reports() {
    let folder = tempfile::tempdir().unwrap();
    let (zenoh, settings) = settings(&sqlite(folder.path()));
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    let (output, said) = check_online(&zenoh, &[]).await;
    assert!(output.status.success(), "{said}");
    assert!(said.contains("works  detector: runs on cpu, "), "{said}");
    assert!(
        said.contains("works  uplink.connect: the router answers, and a hub takes reports"),
        "{said}"
    );
    // A hub of another fleet is none of this node's.
    let (output, said) = check_online(&zenoh, &[("ALBIREO_NODE__PREFIX", "another")]).await;
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("but no hub takes reports"), "{said}");
    hub.kill().await;
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn check_online_names_what_does_not_answer_and_exits_1() {
    let nobody = format!("tcp/127.0.0.1:{}", free_port());
    let cameras = "[{name=\"road\",source=\"rtsp://127.0.0.1:9/road\"}]";
    let (output, said) = check_online(&nobody, &[("ALBIREO_CAMERA", cameras)]).await;
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("works  detector: runs on cpu, "), "{said}");
    assert!(said.contains("fails  camera.road.source: "), "{said}");
    assert!(said.contains("fails  uplink.connect: "), "{said}");
    assert!(said.contains("2 of these do not work"), "{said}");
}
