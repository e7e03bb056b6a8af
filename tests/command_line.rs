//! The command line as a user meets it: help, `check`, and the environment.

#![allow(clippy::unwrap_used)]

use std::process::{Command, Output};

/// The shipped configuration, whatever this machine has.
const CHECK: [&str; 3] = ["check", "--file-only", "config/node.toml"];

fn albireo(arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(arguments)
        .envs(environment.iter().copied())
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn check_accepts_the_shipped_configuration() {
    let output = albireo(&CHECK, &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("1 camera\n"));
}

#[test]
fn check_examines_the_machine_unless_file_only_is_given() {
    let missing = [
        ("ALBIREO_DETECTOR__MODEL", "/nowhere/model.onnx"),
        ("ALBIREO_NODE__STATE_DIR", "Cargo.toml"),
        ("ALBIREO_CLIP__WINDOW_S", "soon"),
    ];
    let output = albireo(&["check", "config/node.toml"], &missing);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    for part in [
        "clip.window_s: must be a number, not string \"soon\" (from environment variable ALBIREO_CLIP__WINDOW_S)",
        "detector.model: /nowhere/model.onnx cannot be read: No such file",
        "node.state_dir: Cargo.toml is a file; name a folder",
    ] {
        assert!(said.contains(part), "{part} in {said}");
    }
    let output = albireo(&CHECK, &missing[..2]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[test]
fn cameras_that_would_receive_each_others_messages_are_refused() {
    let cameras = "[{name=\"a\",key=\"x/y\"},{name=\"b\",key=\"x/y\"},{name=\"c\",key=\"albireo/node/a/detections\"}]";
    let output = albireo(&CHECK, &[("ALBIREO_CAMERA", cameras)]);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    for part in [
        "camera.b.key: `x/y` is the key of camera `a` too",
        "camera.c.key: `albireo/node/a/detections` is what this node writes",
    ] {
        assert!(said.contains(part), "{part} in {said}");
    }
}

#[test]
fn rust_log_is_obeyed_and_named_when_it_is_wrong() {
    let start = ["node", "--config", "config/node.toml"];
    let output = albireo(&start, &[("RUST_LOG", "loud")]);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    assert!(
        said.contains("environment variable RUST_LOG: `loud`"),
        "{said}"
    );
}

#[test]
fn a_token_that_can_be_guessed_is_refused_in_words_by_check_and_at_the_start() {
    for arguments in [CHECK.as_slice(), &["node", "--config", "config/node.toml"]] {
        let output = albireo(arguments, &[("ALBIREO_HTTP__TOKEN", "secret")]);
        assert_eq!(output.status.code(), Some(1));
        let said = text(&output.stderr);
        assert!(
            said.contains("http.token: has fewer than 16 characters"),
            "{said}"
        );
    }
}

#[test]
fn check_names_file_key_and_reason_and_exits_1() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("bad.toml");
    std::fs::write(
        &file,
        "[clip]\nwindow_s = -1\n[[camera]]\nname = \"a\"\nmax_rate = 0\nsource = \"a.mp4\"\n",
    )
    .unwrap();
    let output = albireo(&["check", file.to_str().unwrap()], &[]);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    for part in [
        file.to_str().unwrap(),
        "clip.window_s: must be above 0",
        "camera.a.max_rate: must be above 0",
    ] {
        assert!(said.contains(part), "{said}");
    }
}

#[test]
fn the_node_does_not_start_on_a_configuration_that_check_refuses() {
    let output = albireo(&["node", "--config", "/nowhere/node.toml"], &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("/nowhere/node.toml cannot be used"));
}

#[test]
fn environment_variables_override_the_file_and_are_named_when_wrong() {
    let check = CHECK;
    let output = albireo(&check, &[("ALBIREO_NODE__NAME", "car-7")]);
    assert!(
        text(&output.stdout).contains("node `car-7`"),
        "{}",
        text(&output.stderr)
    );
    let output = albireo(&check, &[("ALBIREO_CAMERA", "[{name=\"a\"},{name=\"b\"}]")]);
    assert!(
        text(&output.stdout).contains("2 cameras"),
        "{}",
        text(&output.stderr)
    );
    for (name, value, expected) in [
        (
            "ALBIREO_CLIP__WINDOW_S",
            "soon",
            "clip.window_s: must be a number",
        ),
        (
            "ALBIREO_CLIP__WINDOW_S",
            "-1",
            "(from environment variable ALBIREO_CLIP__WINDOW_S)",
        ),
        ("ALBIREO_CLIP__WINDOW", "1", "clip.window: unknown key"),
        ("ALBIREO_CLIP_WINDOW_S", "1", "ALBIREO_CLIP__WINDOW_S"),
        (
            "ALBIREO_HTTP__LISTEN",
            "0.0.0.0:80",
            "http.listen: 0.0.0.0:80 can be reached",
        ),
    ] {
        let output = albireo(&check, &[(name, value)]);
        assert_eq!(output.status.code(), Some(1), "{name}");
        assert!(
            text(&output.stderr).contains(expected),
            "{}",
            text(&output.stderr)
        );
    }
    let output = albireo(&check, &[("ALBIREO_SHARED", "/somewhere")]);
    assert!(output.status.success());
}

#[test]
fn every_subcommand_has_help_with_examples() {
    let help = text(&albireo(&["--help"], &[]).stdout);
    let commands: Vec<_> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .take_while(|line| *line != "Options:")
        // The text of a command that takes a second line is indented further.
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .collect();
    assert!(
        commands.contains(&"node") && commands.contains(&"check"),
        "{help}"
    );
    for command in commands {
        let help = text(&albireo(&[command, "--help"], &[]).stdout);
        assert!(help.contains("Examples:"), "{command}: {help}");
    }
}
