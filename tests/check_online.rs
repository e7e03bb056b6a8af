//! `albireo check --online` tries everything that a configuration names, as a node uses it.

use crate::support::fleet::{HubProcess, settings, sqlite};
use crate::support::{Ended, assert_contains, free_port, run};

/// Checks the shipped configuration with an uplink.
fn check_online(uplink: &str, more: (&str, &str)) -> Ended {
    let uplink = format!("[\"{uplink}\"]");
    let settings = [("ALBIREO_UPLINK__CONNECT", &*uplink), more];
    run(&["check", "--online", "config/node.toml"], &settings)
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn check_online_reports_the_running_provider_and_that_the_hub_accepts_reports() {
    let folder = tempfile::tempdir().unwrap();
    let (zenoh, settings) = settings(&sqlite(folder.path()));
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    let said = check_online(&zenoh, ("ALBIREO_NODE__PREFIX", "albireo")).succeeds();
    let uplink = "works  uplink.connect: the router answers, and a hub accepts reports";
    assert_contains(&said, &["works  detector: runs on cpu, ", uplink]);
    // A hub of another fleet is none of this node's.
    let other = check_online(&zenoh, ("ALBIREO_NODE__PREFIX", "another"));
    let said = other.out.clone() + &other.fails();
    assert_contains(&said, &["but no hub accepts reports"]);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn check_online_names_what_does_not_answer_and_exits_1() {
    let nobody = format!("tcp/127.0.0.1:{}", free_port());
    let cameras = "[{name=\"road\",source=\"rtsp://127.0.0.1:9/road\"}]";
    let checked = check_online(&nobody, ("ALBIREO_CAMERA", cameras));
    let said = checked.out.clone() + &checked.fails();
    let works = "works  detector: runs on cpu, ";
    let fails = ["fails  camera.road.source: ", "fails  uplink.connect: "];
    assert_contains(
        &said,
        &[works, fails[0], fails[1], "2 of these do not work"],
    );
}
