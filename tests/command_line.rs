//! The command line: `check` and environment variables.

use crate::support::fleet::HubProcess;
use crate::support::{Ended, assert_contains, free_port, run};
use rstest::rstest;
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;

/// Checks the shipped configuration without looking at this machine.
const CHECK: [&str; 3] = ["check", "--file-only", "config/node.toml"];
const NODE: [&str; 3] = ["node", "--config", "config/node.toml"];

#[test]
fn check_names_file_key_and_reason_and_examines_the_machine_unless_told_not_to() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.toml");
    let bad = "clip.window_s = \"soon\"\ndetector.model = \"/nowhere/model.onnx\"\nnode.state_dir = \"Cargo.toml\"\n\
               [[camera]]\nname = \"a\"\nmax_rate = 0\nsource = \"a.mp4\"\n";
    std::fs::write(&file, bad).unwrap();
    let file = file.to_str().unwrap();
    let said = run(&["check", file], &[]).fails();
    // This test does not need ONNX Runtime.
    let is_needed = |line: &&str| !line.starts_with("  detector.onnxruntime: ");
    let said: Vec<_> = said.lines().filter(is_needed).collect();
    insta::assert_snapshot!(said.join("\n").replace(file, "(the file)"));
    let said = run(&["check", "--file-only", file], &[]).fails();
    assert!(!said.contains("/nowhere"), "{said}");
}

const CAMERAS: &str =
    r#"[{name="a",key="x/y"},{name="b",key="x/y"},{name="c",key="albireo/node/a/detections"}]"#;

#[rstest]
#[case::cameras_with_the_same_key("ALBIREO_CAMERA", CAMERAS)]
#[case::a_word_for_a_number("ALBIREO_CLIP__WINDOW_S", "soon")]
#[case::an_unknown_key("ALBIREO_CLIP__WINDOW", "1")]
#[case::a_single_underscore("ALBIREO_CLIP_WINDOW_S", "1")]
#[case::an_open_address("ALBIREO_HTTP__LISTEN", "0.0.0.0:80")]
fn check_names_the_variable_and_the_reason(#[case] name: &str, #[case] value: &str) {
    let case = std::thread::current().name().unwrap().to_owned();
    let case = case.rsplit("::").next().unwrap();
    insta::assert_snapshot!(case, run(&CHECK, &[(name, value)]).fails());
}

#[rstest]
#[case(&NODE, ("RUST_LOG", "loud"), "environment variable RUST_LOG: `loud`")]
#[case(&NODE, ("ALBIREO_HTTP__TOKEN", "secret"), "http.token: has fewer than 16 characters")]
#[case(&["node", "--config", "/nowhere/node.toml"], ("A", "b"), "/nowhere/node.toml cannot be used")]
fn the_node_does_not_start_with_what_check_rejects(
    #[case] arguments: &[&str],
    #[case] variable: (&str, &str),
    #[case] expected: &str,
) {
    let said = run(arguments, &[variable]).fails();
    assert!(said.contains(expected), "{said}");
}

#[rstest]
#[case("ALBIREO_NODE__NAME", "car-7", "node `car-7`")]
#[case("ALBIREO_NODE__NAME", "4711", "node `4711`")]
#[case("ALBIREO_POLICY__U", "5e-4", "1 camera\n")]
#[case("ALBIREO_DETECTOR__PROVIDERS", "cuda,cpu", "1 camera\n")]
#[case("ALBIREO_HTTP__TOKEN", "1234567890123456", "1 camera\n")]
#[case("ALBIREO_CAMERA", r#"[{name="a"},{name="b"}]"#, "2 cameras")]
#[case::an_unrelated_variable_is_ignored("ALBIREO_SHARED", "/somewhere", "1 camera\n")]
fn environment_variables_override_the_shipped_configuration(
    #[case] name: &str,
    #[case] value: &str,
    #[case] expected: &str,
) {
    let said = run(&CHECK, &[(name, value)]).succeeds();
    assert!(said.contains(expected), "{said}");
}

#[test]
fn check_names_a_file_with_a_secret_that_every_user_can_read() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hub.toml");
    let text = "[hub]\nprefix = \"albireo\"\n[http]\ntoken = \"0123456789abcdefgh\"\n";
    std::fs::write(&file, text).unwrap();
    for (mode, is_open) in [(0o640, false), (0o644, true)] {
        std::fs::set_permissions(&file, Permissions::from_mode(mode)).unwrap();
        let said = run(&["check", file.to_str().unwrap()], &[]).succeeds();
        let note = "every user of this machine can read it (mode 644): chmod o= ";
        assert_eq!(said.contains(note), is_open, "{said}");
    }
}

#[test]
fn check_finds_the_token_and_the_database_with_which_a_hub_would_not_start() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hub.toml");
    std::fs::write(folder.path().join("token"), "").unwrap();
    let place = folder.path().display();
    let text = format!(
        "[http]\ntoken_file = \"{place}/token\"\n[database]\nurl = \"sqlite:{place}/nowhere/hub.db\"\n"
    );
    std::fs::write(&file, text).unwrap();
    let file = file.to_str().unwrap();
    let said = run(&["check", file], &[]).fails();
    let expected = [
        "http.token_file: ",
        "the first line is empty",
        "database.url: the folder ",
        "does not exist: create it",
    ];
    assert_contains(&said, &expected);
    assert!(!said.contains("holds a secret"), "{said}");
    run(&["check", "--file-only", file], &[]).succeeds();
}

/// Tries everything that the shipped configuration with an uplink names, as a node uses it.
fn check_online(uplink: &str, more: (&str, &str)) -> Ended {
    let uplink = format!("[\"{uplink}\"]");
    let settings = [("ALBIREO_UPLINK__CONNECT", &*uplink), more];
    run(&["check", "--online", "config/node.toml"], &settings)
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn check_online_reports_the_running_provider_and_that_the_hub_accepts_reports() {
    let (zenoh, _hub) = HubProcess::fresh(vec![]).await;
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
    let both = "2 of these do not work";
    assert_contains(&said, &[works, fails[0], fails[1], both]);
}

#[rstest]
#[case::lines(&["check", "--file-only", "config/node.toml"])]
#[case::a_script(&["completions", "bash"])]
fn a_reader_that_has_seen_enough_ends_the_program_without_a_word(#[case] arguments: &[&str]) {
    let (reader, writer) = std::io::pipe().unwrap();
    // As `head` does, but before the first line: the first write finds nobody.
    drop(reader);
    let ended = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(arguments)
        .stdout(writer)
        .output()
        .unwrap();
    assert_eq!(String::from_utf8_lossy(&ended.stderr), "");
    assert_eq!(ended.status.code(), Some(141));
}

#[rstest]
#[case::lines(&["check", "--file-only", "config/node.toml"])]
#[case::a_script(&["completions", "bash"])]
fn a_full_disk_that_takes_no_output_is_told_in_one_line(#[case] arguments: &[&str]) {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let ended = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(arguments)
        .stdout(full)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    let expected = "albireo: stdout cannot be written: No space";
    assert!(said.starts_with(expected), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
    assert_eq!(ended.status.code(), Some(1));
}

#[rstest]
#[case::an_error(&["check", "nowhere.toml"])]
#[case::a_command_of_the_evaluation(&["eval", "recorded", "nowhere"])]
fn a_reader_of_what_is_noted_that_has_seen_enough_ends_the_program_too(#[case] arguments: &[&str]) {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let ended = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(writer)
        .status()
        .unwrap();
    assert_eq!(ended.code(), Some(141));
}

#[test]
fn an_address_in_use_says_by_whom_and_the_way_out() {
    let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
    let said = run(&["hub"], &[("ALBIREO_HTTP__LISTEN", &address)]).fails();
    let expected = format!("http.listen: {address} cannot be listened on");
    assert_contains(&said, &[&expected, "by a running node or hub?"]);
}
