//! A stop ends a node in order, whatever it is doing and whoever does not listen.

use crate::support::detectors::model;
use crate::support::{
    Node, PATIENCE, albireo, assert_contains, development, free_port, grey_jpeg, listening_peer,
    signal, text_at, until, until_ready, value_of,
};
use rstest::rstest;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

/// Starts a node at a known address, whose standard error goes to `log`.
fn start(mut command: Command, folder: &Path, settings: &str, log: Stdio) -> (Child, String) {
    let http = format!("127.0.0.1:{}", free_port());
    let file = folder.join("node.toml");
    let own = format!(
        "http.listen = \"{http}\"\nzenoh.listen = [\"tcp/127.0.0.1:{}\"]\n",
        free_port()
    );
    std::fs::write(&file, own + settings).unwrap();
    let child = command
        .args(["node", "--config"])
        .arg(&file)
        .env("ALBIREO_DEVELOPMENT", development(settings))
        .stderr(log)
        .spawn()
        .unwrap();
    (child, format!("http://{http}"))
}

/// Sends a signal to the process, and waits until it ends, at most `limit`.
async fn stop(child: &mut Child, name: &str, limit: Duration) -> ExitStatus {
    signal(child.id().unwrap(), name);
    let ended = tokio::time::timeout(limit, child.wait()).await;
    ended.expect("the process ends").unwrap()
}

fn detector(name: &str) -> String {
    format!("detector.model = {:?}\n", model(name))
}

/// A model loads on a thread of ONNX Runtime. A process that left through the C library's exit tore the library down
/// beside that thread, and one stop of eight ended with SIGSEGV. `ALBIREO_STOPS` sets the number of tries.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
#[ignore = "needs ONNX Runtime"]
async fn a_stop_while_the_model_is_loaded_ends_in_order() {
    let tries = std::env::var("ALBIREO_STOPS").map_or(100, |tries| tries.parse().unwrap());
    let settings = detector("hungry.onnx");
    for number in 0..tries {
        let folder = tempfile::tempdir().unwrap();
        let (mut child, _) = start(albireo(), folder.path(), &settings, Stdio::null());
        // Spread over the start: from the exec to some time after the model is loaded.
        tokio::time::sleep(Duration::from_millis(10 + number * 37 % 400)).await;
        let status = stop(&mut child, "-TERM", PATIENCE).await;
        // Before the handler is installed, the signal itself ends the process.
        let ended_well = status.success() || status.to_string().contains("SIGTERM");
        assert!(ended_well, "try {number}: {status}");
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_log_that_nobody_reads_holds_up_neither_health_nor_a_stop_and_its_drops_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    // The pipe's reader stays open and never reads; `2>&1` sends standard output there, too.
    let (reader, writer) = std::io::pipe().unwrap();
    let mut command = albireo();
    command.stdout(writer.try_clone().unwrap());
    let settings = detector("hungry.onnx") + "log.level = \"trace\"\n";
    let (mut child, http) = start(command, folder.path(), &settings, writer.into());
    until_ready(&http).await;
    let dropped = async || {
        let metrics = text_at(&format!("{http}/metrics")).await;
        value_of(&metrics, "albireo_log_lines_dropped_total") > 0.0
    };
    until("lines are dropped", dropped).await;
    let begun = Instant::now();
    for _ in 0..20 {
        text_at(&format!("{http}/healthz")).await;
    }
    assert!(begun.elapsed() < Duration::from_secs(20));
    let status = stop(&mut child, "-TERM", Duration::from_secs(30)).await;
    assert!(status.success(), "{status}");
    drop(reader);
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_service_manager_that_reads_nothing_holds_up_neither_health_nor_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let _manager = UnixDatagram::bind(&path).unwrap();
    let stuffing = UnixDatagram::unbound().unwrap();
    stuffing.set_nonblocking(true).unwrap();
    while stuffing.send_to(b"STATUS=full", &path).is_ok() {}
    let mut command = albireo();
    command.env("NOTIFY_SOCKET", &path);
    let settings = detector("hungry.onnx");
    let (mut child, http) = start(command, folder.path(), &settings, Stdio::null());
    until_ready(&http).await;
    for _ in 0..20 {
        text_at(&format!("{http}/healthz")).await;
    }
    let status = stop(&mut child, "-TERM", Duration::from_secs(30)).await;
    assert!(status.success(), "{status}");
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_closed_terminal_stops_a_node_as_sigterm_does_unless_it_was_started_with_nohup() {
    let settings = detector("hungry.onnx");
    let node = Node::start(&settings).await;
    signal(node.id(), "-HUP");
    let ended = node.ended().await;
    assert!(ended.status.success(), "{}:\n{}", ended.status, ended.log);

    let mut command = Command::new("nohup");
    command.arg(albireo().as_std().get_program()).stdout(Stdio::null());
    let folder = tempfile::tempdir().unwrap();
    let (mut child, http) = start(command, folder.path(), &settings, Stdio::null());
    until_ready(&http).await;
    signal(child.id().unwrap(), "-HUP");
    text_at(&format!("{http}/healthz")).await;
    let status = stop(&mut child, "-TERM", Duration::from_secs(30)).await;
    assert!(status.success(), "{status}");
}

/// A folder with a picture.
fn picture() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.jpg"), grey_jpeg(32, [32, 32])).unwrap();
    folder
}

#[rstest]
#[case::for_a_session(false, &["replay", "PICTURES", "--wait-for-subscriber=3600", "--connect"])]
#[case::for_a_subscriber(true, &["replay", "PICTURES", "--wait-for-subscriber=3600", "--connect"])]
#[case::for_a_hub(false, &["simulate", "--nodes", "1", "--sessions", "1", "--connect"])]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_that_waits_says_for_what_and_ends_at_the_first_signal(
    #[case] is_somebody_there: bool,
    #[case] arguments: &[&str],
) {
    let folder = picture();
    let pictures = folder.path().to_str().unwrap();
    let peer = if is_somebody_there {
        Some(listening_peer().await)
    } else {
        None
    };
    let endpoint = match &peer {
        Some((_session, endpoint)) => endpoint.clone(),
        None => format!("tcp/127.0.0.1:{}", free_port()),
    };
    let mut command = albireo();
    command.args(arguments.iter().map(|argument| argument.replace("PICTURES", pictures)));
    let mut child = command.arg(&endpoint).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let first = tokio::time::timeout(PATIENCE, lines.next_line()).await;
    let first = first.expect("it says so at once").unwrap().unwrap();
    assert_contains(&first, &[&endpoint, "Ctrl-C ends the wait"]);
    stop(&mut child, "-INT", PATIENCE).await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_valid_thresholds_does_not_fill_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let file = std::fs::File::create(&log).unwrap();
    let settings = "zenoh.mode = \"client\"\nzenoh.connect = [\"tcp/127.0.0.1:1\"]\n";
    let (mut child, http) = start(albireo(), folder.path(), settings, file.into());
    let url = format!("{http}/api/v1/threshold");
    let answers = async || reqwest::get(&url).await.is_ok_and(|answer| answer.status() == 200);
    until("the board is open", answers).await;
    let client = reqwest::Client::new();
    let begun = Instant::now();
    for number in 1..=300 {
        let put = client.put(&url).body(format!("{{\"u\": {number}e-6}}"));
        assert_eq!(put.send().await.unwrap().status(), 200);
    }
    let seconds = begun.elapsed().as_secs() as usize;
    stop(&mut child, "-TERM", Duration::from_secs(30)).await;
    let written = std::fs::read_to_string(&log).unwrap();
    let lines = written.lines().filter(|line| line.contains("threshold changed")).count();
    assert!(
        (1..=seconds + 1).contains(&lines),
        "{lines} lines in {seconds} s"
    );
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_probe_that_is_told_not_ready_writes_no_line() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    // A router that never answers: not ready for ever.
    let settings = "zenoh.mode = \"client\"\nzenoh.connect = [\"tcp/127.0.0.1:1\"]\n";
    let file = std::fs::File::create(&log).unwrap();
    let (mut child, http) = start(albireo(), folder.path(), settings, file.into());
    let listens = async || reqwest::get(format!("{http}/healthz")).await.is_ok();
    until("the node listens", listens).await;
    for _ in 0..50 {
        let answer = reqwest::get(format!("{http}/readyz")).await.unwrap();
        assert_eq!(answer.status(), 503);
    }
    stop(&mut child, "-TERM", Duration::from_secs(30)).await;
    let written = std::fs::read_to_string(&log).unwrap();
    let about_requests = written.lines().filter(|line| line.contains("HTTP request failed"));
    assert_eq!(about_requests.count(), 0, "{written}");
}
