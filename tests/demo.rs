//! `albireo demo` with its hub, end to end.

use crate::support::{
    Ended, albireo, assert_contains, collected, json_at, run, run_command, signal, until,
};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use tokio::io::{AsyncBufReadExt, BufReader};

#[rstest::rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn the_demo_has_a_hub_that_receives_its_clips_and_shows_its_node() {
    let temporary = tempfile::tempdir().unwrap();
    // At four times its own rate, so that clips are short.
    let mut demo = albireo()
        .args(["demo", "--port", "0", "--hub-port", "0", "--rate", "100"])
        .env("TMPDIR", temporary.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines();
    let hub = loop {
        let line = lines
            .next_line()
            .await
            .unwrap()
            .expect("the demonstration prints where its hub is");
        if let Some((_, url)) = line.split_once("hub      curl ") {
            break url.trim_end_matches("/api/v1/clips").to_owned();
        }
    };
    let fleet = lines.next_line().await.unwrap().unwrap();
    let fleet = fleet.trim().strip_prefix("fleet ").unwrap().trim().to_owned();
    let page = format!("{hub}/api/v1/clips");
    let count = |page: &Value| page["clips"].as_array().map_or(0, Vec::len);
    until("clips arrive", async || count(&json_at(&page).await) >= 2).await;
    let clips = json_at(&page).await;
    let mut all = clips["clips"].as_array().unwrap().iter();
    assert!(all.all(|clip| clip["node"] == "demo"), "{clips}");
    // The hub asks for the status if the node sent it too early.
    let node = format!("{hub}/api/v1/nodes/demo");
    until("the node is seen", async || {
        let node = json_at(&node).await;
        node["status"]["cameras"][0]["name"] == "dashcam" && node["state"] != "offline"
    })
    .await;

    // The program is not on the PATH.
    let mut printed = std::process::Command::new("sh");
    printed.args(["-c", &fleet]).env("PATH", "/usr/bin:/bin");
    assert_contains(&run_command(&mut printed).succeeds(), &["demo"]);

    signal(demo.id().unwrap(), "-TERM");
    let said = collected(lines).await.unwrap();
    let ended = Ended::from(demo.wait_with_output().await.unwrap());
    let code = (ended.code, &*ended.err);
    assert_eq!(code, (Some(0), ""), "nothing interrupts the table");
    assert_contains(&said, &["detector skipped on"]);
    // An uninterrupted table of the road's clips, in order, follows the first detection.
    let (_, after) = said.split_once("first detection after").expect(&said);
    let mut lines = after.lines().skip(1);
    assert_eq!(lines.next().unwrap(), "");
    assert!(lines.next().unwrap().starts_with("clip "), "{said}");
    let clips: Vec<_> = lines
        .take_while(|line| !line.is_empty())
        .map(|row| row.split_whitespace().next())
        .collect();
    assert!(clips.len() >= 2, "{said}");
    let road = ["busy", "sparse", "two-near", "empty-then-car"];
    for (number, clip) in clips.iter().enumerate() {
        let expected = format!("{}-{:04}", road[number % 4], number + 1);
        assert_eq!(*clip, Some(&*expected));
    }
    leaves_nothing(temporary.path());
}

fn leaves_nothing(temporary: &Path) {
    // ONNX Runtime leaves a file there.
    for left in std::fs::read_dir(temporary).unwrap() {
        let name = left.unwrap().file_name().into_string().unwrap();
        assert!(!name.starts_with("albireo"), "the demo leaves {name}");
    }
}

#[rstest::rstest]
#[ignore = "needs ONNX Runtime"]
fn the_demo_ends_without_a_word_when_nobody_reads_on() {
    let temporary = tempfile::tempdir().unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let ended = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(["demo", "--port", "0", "--hub-port", "0"])
        .env("TMPDIR", temporary.path())
        .stdout(writer)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!((ended.status.code(), &*said), (Some(141), ""));
    leaves_nothing(temporary.path());
}

#[test]
fn the_demo_says_of_a_wrong_clip_only_that_it_is_wrong() {
    let ended = run(&["demo", "--clip", "nowhere.mp4"], &[]);
    assert_eq!(ended.out, "");
    assert_contains(&ended.fails(), &["nowhere.mp4: no such file or folder"]);
}

#[test]
fn the_demo_says_what_it_loads_before_it_does() {
    let words = "demo --detector Cargo.toml --port 0 --hub-port 0";
    let words: Vec<&str> = words.split(' ').collect();
    let ended = run(&words, &[]);
    let said = "loading Cargo.toml: seconds on a PC";
    assert!(ended.out.starts_with(said), "{}", ended.out);
    assert_contains(&ended.fails(), &["albireo: "]);
}

#[rstest::rstest]
#[ignore = "needs ONNX Runtime"]
fn the_demo_says_which_port_is_in_use_and_which_it_takes() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let said = run(
        &["demo", "--port", &port, "--hub-port", "0", "--seconds", "1"],
        &[],
    )
    .succeeds();
    let moved =
        format!("port {port} is in use, by another demo or node perhaps: the page has port ");
    let (_, after) = said.split_once(&moved).expect(&said);
    let instead = after.lines().next().unwrap();
    assert_contains(&said, &[&format!("page     http://127.0.0.1:{instead}/")]);
}
