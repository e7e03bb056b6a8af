//! ONNX Runtime records no runs, and so can send nothing.

use crate::support::detectors::model;
use crate::support::run_command;
use std::process::Command;

#[test]
#[ignore = "needs ONNX Runtime"]
fn onnx_runtime_leaves_nothing_under_the_users_home() {
    let home = tempfile::tempdir().unwrap();
    let mut detect = Command::new(env!("CARGO_BIN_EXE_albireo"));
    detect
        .arg("detect")
        .arg(model("boxes.onnx"))
        .env("HOME", home.path())
        .env_remove("XDG_CACHE_HOME")
        .env_remove("ORT_DISABLE_TELEMETRY");
    run_command(&mut detect).succeeds();
    assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 0);
}
