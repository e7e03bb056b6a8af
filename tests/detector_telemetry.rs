//! ONNX Runtime records no runs, and so can send nothing.

use std::path::Path;
use std::process::Command;

#[test]
#[ignore = "needs ONNX Runtime"]
fn onnx_runtime_leaves_nothing_under_the_users_home() {
    let home = tempfile::tempdir().unwrap();
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/models/boxes.onnx");
    let output = Command::new(env!("CARGO_BIN_EXE_albireo"))
        .arg("detect")
        .arg(model)
        .env("HOME", home.path())
        .env_remove("XDG_CACHE_HOME")
        .env_remove("ORT_DISABLE_TELEMETRY")
        // A folder named by a relative path would not be found elsewhere.
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let left: Vec<_> = std::fs::read_dir(home.path())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert!(left.is_empty(), "{left:?}");
}
