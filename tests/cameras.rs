//! Live cameras: opened by the node itself or by `albireo publish`, lost and reconnected, with hidden passwords.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::live_camera::{MotionJpegCamera, RtspCamera, Script};
use crate::support::{Node, PATIENCE, albireo, memory_mb};
use albireo::cli::replay::open_session;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_wire::{FrameAttachment, read};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::time::timeout;

const USER: &str = "viewer";
/// With what an address must not have as it is.
const PASSWORD: &str = "hid/den@7:x";

fn picture() -> Vec<u8> {
    let scene = BoxScene::new(3, PictureSize::new(320, 180));
    scene.frame(0).jpeg(80).unwrap()
}

/// A frame as a subscriber gets it.
struct Received {
    said: FrameAttachment,
    bytes: Vec<u8>,
}

/// `albireo publish` with somebody who takes its frames.
struct Publisher {
    child: Child,
    frames: UnboundedReceiver<Received>,
    log: tokio::task::JoinHandle<String>,
    session: zenoh::Session,
}

impl Publisher {
    async fn start(arguments: &[&str], environment: &[(&str, &str)]) -> Self {
        let listen = ["tcp/127.0.0.1:0".to_owned()];
        let session = open_session(&[], &listen, Duration::ZERO).await.unwrap();
        let locator = session.info().locators().await.into_iter().next().unwrap();
        let (sender, frames) = unbounded_channel();
        session
            .declare_subscriber("albireo/node/front/frame")
            .callback(move |sample| {
                let said = sample.attachment().unwrap().to_bytes();
                let _ = sender.send(Received {
                    said: read(&said).unwrap(),
                    bytes: sample.payload().to_bytes().into_owned(),
                });
            })
            .background()
            .await
            .unwrap();
        let mut child = albireo()
            .arg("publish")
            .args(arguments)
            .args(["--connect", &locator.to_string()])
            .envs(environment.iter().copied())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let log = tokio::spawn(async move {
            let mut log = String::new();
            while let Ok(Some(line)) = lines.next_line().await {
                log += &(line + "\n");
            }
            log
        });
        Self {
            child,
            frames,
            log,
            session,
        }
    }

    async fn next(&mut self) -> Received {
        let frame = timeout(PATIENCE, self.frames.recv()).await;
        frame.expect("a frame comes in time").unwrap()
    }

    async fn take(&mut self, count: usize) -> Vec<Received> {
        let mut frames = Vec::new();
        while frames.len() < count {
            frames.push(self.next().await);
        }
        frames
    }

    /// Ends it as a service manager does; its log.
    async fn stop(mut self) -> String {
        let id = self.child.id().unwrap().to_string();
        let told = std::process::Command::new("kill")
            .args(["-TERM", &id])
            .status();
        assert!(told.unwrap().success());
        let status = timeout(PATIENCE, self.child.wait()).await.unwrap().unwrap();
        let log = self.log.await.unwrap();
        assert!(status.success(), "{log}");
        self.session.close().await.unwrap();
        log
    }
}

/// The processes that a process has started.
fn children(parent: u32) -> Vec<u32> {
    let listed = std::fs::read_to_string(format!("/proc/{parent}/task/{parent}/children"));
    let mut found: Vec<u32> = listed
        .unwrap_or_default()
        .split_whitespace()
        .map(|id| id.parse().unwrap())
        .collect();
    // Other threads start them as well.
    for thread in std::fs::read_dir(format!("/proc/{parent}/task")).unwrap() {
        let file = thread.unwrap().path().join("children");
        let more = std::fs::read_to_string(file).unwrap_or_default();
        found.extend(more.split_whitespace().map(|id| id.parse::<u32>().unwrap()));
    }
    found.sort_unstable();
    found.dedup();
    found
}

fn command_line(process: u32) -> String {
    let line = std::fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
    String::from_utf8_lossy(&line).replace('\0', " ")
}

/// Every form in which the password could leak.
fn assert_hidden(text: &str) {
    for form in [PASSWORD, "hid%2Fden", "den@7", "den%407"] {
        assert!(!text.contains(form), "the password is told: {text}");
    }
}

async fn get(node: &Node, path: &str) -> String {
    let answer = reqwest::get(format!("{}{path}", node.http)).await.unwrap();
    answer.text().await.unwrap()
}

/// Frames that a node has processed of its camera.
async fn processed(node: &Node) -> u64 {
    let cameras: Value = serde_json::from_str(&get(node, "/api/v1/cameras").await).unwrap();
    cameras["cameras"][0]["frames"].as_u64().unwrap()
}

async fn wait_until(what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    let waiting = async {
        while !is_so().await {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, waiting).await.expect(what);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn a_node_s_own_camera_reconnects_and_its_password_never_leaks() {
    let login = [USER, PASSWORD];
    let camera = RtspCamera::start("h264", &login).await;
    let port = camera.port;
    let settings = format!(
        "[[camera]]\nname = \"front\"\n# development: ring=64 source_timeout_s=20\n\
         source = \"rtsp://${{GATE_USER}}:${{GATE_PASSWORD}}@127.0.0.1:{port}/stream\"\n"
    );
    let environment = [("GATE_USER", USER), ("GATE_PASSWORD", PASSWORD)];
    let folder = tempfile::tempdir().unwrap();
    let node = Node::start_with(folder, &settings, &environment).await;
    wait_until("frames come", async || processed(&node).await >= 20).await;
    let programs = children(node.id());
    let lines: Vec<_> = programs.iter().map(|id| command_line(*id)).collect();
    assert!(
        lines.iter().any(|line| line.starts_with("ffmpeg ")),
        "{lines:?}"
    );
    lines.iter().for_each(|line| assert_hidden(line));

    camera.kill().await;
    wait_until("the node says so", async || {
        get(&node, "/readyz")
            .await
            .contains("\"reason\":\"failed: ")
    })
    .await;
    let mut told = get(&node, "/readyz").await;
    let _camera = RtspCamera::start_at(port, "h264", &login).await;
    wait_until("the node is ready again", async || {
        !get(&node, "/readyz")
            .await
            .contains("\"subject\":\"front\"")
    })
    .await;
    // More than may have waited in the ring since before.
    let before = processed(&node).await;
    wait_until("frames come again", async || {
        processed(&node).await >= before + 70
    })
    .await;
    for path in ["/metrics", "/api/v1/cameras", "/api/v1/frame-states"] {
        told += &get(&node, path).await;
    }
    assert!(told.contains("; next attempt in "), "{told}");
    assert!(told.contains(&format!("127.0.0.1:{port}/stream")), "{told}");
    assert_hidden(&told);
    let programs = children(node.id());
    let (status, _, log, _) = node.stop().await;
    assert!(status.success(), "{log}");
    assert!(log.contains("next attempt in"), "{log}");
    assert_hidden(&log);
    for process in programs {
        assert!(
            !Path::new(&format!("/proc/{process}")).exists(),
            "left behind"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg and RTSP server"]
async fn a_published_camera_reconnects_with_a_new_numbering() {
    let login = [USER, PASSWORD];
    let camera = RtspCamera::start("h264", &login).await;
    let port = camera.port;
    let source = format!("rtsp://${{GATE_USER}}:${{GATE_PASSWORD}}@127.0.0.1:{port}/stream");
    let environment = [("GATE_USER", USER), ("GATE_PASSWORD", PASSWORD)];
    let mut publisher = Publisher::start(&[&source], &environment).await;
    let frames = publisher.take(30).await;
    let first = &frames[0].said;
    assert!(first.stream.is_some());
    for (number, frame) in frames.iter().enumerate() {
        assert_eq!(frame.said.seq, Some(number as u64));
        assert_eq!(frame.said.stream, first.stream);
        assert!(frame.bytes.starts_with(&[0xFF, 0xD8]));
    }
    camera.kill().await;
    let _camera = RtspCamera::start_at(port, "h264", &login).await;
    let again = loop {
        let frame = publisher.next().await;
        if frame.said.stream != first.stream {
            break frame;
        }
    };
    assert_eq!(again.said.seq, Some(0));
    publisher.take(20).await;
    let log = publisher.stop().await;
    assert!(log.contains("next attempt in"), "{log}");
    assert_hidden(&log);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg and RTSP server"]
async fn a_wrong_password_is_reported_without_the_password() {
    let camera = RtspCamera::start("h264", &[USER, "another"]).await;
    let source = format!(
        "rtsp://{USER}:${{GATE_PASSWORD}}@127.0.0.1:{}/stream",
        camera.port
    );
    let mut command = albireo();
    let peer = open_session(&[], &["tcp/127.0.0.1:0".to_owned()], Duration::ZERO).await;
    let peer = peer.unwrap();
    let locator = peer.info().locators().await.into_iter().next().unwrap();
    command
        .args(["publish", &source, "--connect", &locator.to_string()])
        .env("GATE_PASSWORD", PASSWORD)
        .stderr(Stdio::piped());
    let log = until_said(&mut command, "401 Unauthorized").await;
    assert_hidden(&log);
    assert!(log.contains("no node subscribes"), "{log}");
}

/// Runs a command until its output contains `part`; returns the output.
async fn until_said(command: &mut Command, part: &str) -> String {
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut log = String::new();
    let said = async {
        while let Some(line) = lines.next_line().await.unwrap() {
            log += &(line + "\n");
            if log.contains(part) {
                return;
            }
        }
        panic!("ended without {part:?}:\n{log}");
    };
    timeout(PATIENCE, said).await.expect(part);
    child.kill().await.unwrap();
    log
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn motion_jpeg_is_passed_on_byte_for_byte_from_one_connection_and_within_the_limit() {
    let picture = picture();
    let camera = MotionJpegCamera::start(picture.clone(), Duration::from_millis(10)).await;
    let mut publisher = Publisher::start(&[&camera.address, "--rate", "5"], &[]).await;
    let first = publisher.next().await;
    let begun = Instant::now();
    let frames = publisher.take(15).await;
    // Fifteen slots of a fifth of a second follow the first frame's; that may come late in its own.
    assert!(
        begun.elapsed() >= Duration::from_millis(2700),
        "{:?}",
        begun.elapsed()
    );
    assert!(
        frames
            .iter()
            .chain([&first])
            .all(|frame| frame.bytes == picture)
    );
    assert_eq!(camera.clients(), 1);
    publisher.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg and RTSP server"]
async fn motion_jpeg_by_rtsp_is_found_out_and_not_coded_again() {
    let camera = RtspCamera::start("jpeg", &[]).await;
    let source = format!("rtsp://127.0.0.1:{}/stream", camera.port);
    let mut publisher = Publisher::start(&[&source, "--hardware", "cuda"], &[]).await;
    // Nothing is decoded, so a decoder that is not here is not missed, once it is known what comes.
    publisher.take(20).await;
    publisher.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs RTSP server"]
async fn a_gstreamer_pipeline_is_a_camera_and_stands_in_where_there_is_no_ffmpeg() {
    let pipeline =
        "videotestsrc is-live=true ! video/x-raw,width=160,height=120,framerate=20/1 ! jpegenc";
    let mut publisher = Publisher::start(&[pipeline], &[]).await;
    publisher.take(20).await;
    publisher.stop().await;

    let camera = RtspCamera::start("jpeg", &[]).await;
    let source = format!("rtsp://127.0.0.1:{}/stream", camera.port);
    let programs = tempfile::tempdir().unwrap();
    let path = programs.path().join("gst-launch-1.0");
    std::os::unix::fs::symlink("/usr/bin/gst-launch-1.0", path).unwrap();
    let only = [("PATH", programs.path().to_str().unwrap())];
    let mut publisher = Publisher::start(&[&source], &only).await;
    publisher.take(20).await;
    publisher.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg"]
async fn a_file_is_a_camera_that_never_ends() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive 1.mp4");
    let made = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i"])
        .args(["testsrc=size=320x180:rate=20:duration=1", "-c:v", "mpeg4"])
        .arg(&file)
        .status();
    assert!(made.unwrap().success());
    let settings = format!(
        "[[camera]]\nname = \"front\"\n# development: ring=64\nsource = \"{}\"\n",
        file.display()
    );
    let begun = Instant::now();
    let node = Node::start(&settings).await;
    wait_until("it begins again", async || processed(&node).await >= 50).await;
    assert!(
        begun.elapsed() >= Duration::from_millis(2000),
        "played at its own speed"
    );
    let cameras: Value = serde_json::from_str(&get(&node, "/api/v1/cameras").await).unwrap();
    assert_eq!(cameras["cameras"][0]["width"], 320);
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime"]
async fn a_sender_that_starts_anew_loses_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    for number in 0..50 {
        std::fs::write(folder.path().join(format!("{number}.jpg")), picture()).unwrap();
    }
    let node = Node::start("[[camera]]\nname = \"front\"\ndelivery = \"every\"\n").await;
    for _ in 0..3 {
        let played = albireo()
            .arg("replay")
            .arg(folder.path())
            .args([
                "--rate",
                "max",
                "--every",
                "--clip",
                "drive",
                "--wait-for-subscriber",
            ])
            .args(["--connect", &node.zenoh])
            .stdout(Stdio::null())
            .status();
        assert!(timeout(PATIENCE, played).await.unwrap().unwrap().success());
    }
    wait_until("all are processed", async || processed(&node).await >= 150).await;
    let told = get(&node, "/metrics").await;
    let dropped: Vec<_> = told
        .lines()
        .filter(|line| line.starts_with("albireo_frames_dropped") && !line.ends_with(" 0.0"))
        .collect();
    assert!(dropped.is_empty(), "{dropped:?}");
    assert!(told.contains("albireo_frames_dropped"), "{told}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_source_that_cannot_be_opened_is_named_with_what_to_do() {
    let run = async |arguments: &[&str], environment: &[(&str, &str)]| {
        let mut command = albireo();
        command.args(arguments).envs(environment.iter().copied());
        let output = timeout(PATIENCE, command.output()).await.unwrap().unwrap();
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let said = run(&["publish", "no/such/drive.mp4"], &[]).await;
    assert!(said.contains("no/such/drive.mp4: no such file"), "{said}");
    let said = run(
        &["publish", "rtsp://${NOBODY_SETS_THIS}@camera/stream"],
        &[],
    )
    .await;
    assert!(said.contains("NOBODY_SETS_THIS"), "{said}");
    let said = run(
        &["publish", "rtsp://camera/stream"],
        &[("PATH", "/nowhere")],
    )
    .await;
    for part in ["ffmpeg", "gst-launch-1.0", "apt-get install ffmpeg"] {
        assert!(said.contains(part), "{said}");
    }
    let said = run(&["publish", "a ! jpegenc"], &[("PATH", "/nowhere")]).await;
    assert!(said.contains("gstreamer1.0-tools"), "{said}");
}

/// Settings of a node's camera `front` with this source.
fn source(address: &str, more: &str) -> String {
    format!(
        "[[camera]]\nname = \"front\"\n# development: ring=64\nsource = \"{address}\"\n{more}\n"
    )
}

async fn front(node: &Node) -> Value {
    let cameras: Value = serde_json::from_str(&get(node, "/api/v1/cameras").await).unwrap();
    cameras["cameras"][0].clone()
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn a_failed_source_says_why_and_when_it_is_tried_again() {
    let camera = RtspCamera::start("h264", &[USER, "another"]).await;
    let password = "hid%2Fden%407%3Ax";
    let address = format!("rtsp://{USER}:{password}@127.0.0.1:{}/stream", camera.port);
    let node = Node::start(&source(&address, "")).await;
    wait_until("the third attempt has failed", async || {
        front(&node).await["fault"] == "failed: 401 Unauthorized; next attempt in 2 s"
    })
    .await;
    let entry = front(&node).await;
    assert_eq!(
        entry["source"],
        format!("rtsp://127.0.0.1:{}/stream", camera.port)
    );
    assert!(entry.get("key").is_none(), "{entry}");
    let told = get(&node, "/readyz").await;
    assert!(
        told.contains("\"reason\":\"failed: 401 Unauthorized; next attempt in "),
        "{told}"
    );
    let (_, _, log, _) = node.stop().await;
    let lines = log
        .lines()
        .filter(|line| line.contains("next attempt in 2 s"));
    assert_eq!(lines.count(), 1, "once for each attempt: {log}");
    assert_hidden(&log);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg"]
async fn a_camera_that_cannot_be_reached_is_named_in_clear_words() {
    let address = format!("rtsp://127.0.0.1:{}/stream", crate::support::free_port());
    let node = Node::start(&source(&address, "")).await;
    wait_until("the node says so", async || {
        let entry = front(&node).await;
        let fault = entry["fault"].as_str().unwrap_or_default();
        fault.contains("cannot be reached: Connection refused")
    })
    .await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg"]
async fn a_source_that_falls_silent_fails_when_it_is_to() {
    let script = Script::FallSilent(vec![picture(); 20]);
    let camera = MotionJpegCamera::playing(script, Duration::from_millis(10)).await;
    let node = Node::start(&source(
        &camera.address,
        "# development: source_timeout_s=3",
    ))
    .await;
    wait_until("frames come", async || processed(&node).await >= 1).await;
    let mut last = (processed(&node).await, Instant::now());
    let fault = loop {
        let entry = front(&node).await;
        if let Some(fault) = entry["fault"].as_str() {
            break fault.to_owned();
        }
        let now = entry["frames"].as_u64().unwrap();
        if now > last.0 {
            last = (now, Instant::now());
        }
        assert!(last.1.elapsed() < PATIENCE, "nothing is said");
        tokio::time::sleep(Duration::from_millis(10)).await;
    };
    assert!(
        fault.starts_with("failed: no picture for more than 3 s"),
        "{fault}"
    );
    // The last pictures may have waited for the detector.
    let silent = last.1.elapsed();
    assert!(silent < Duration::from_millis(4500), "{silent:?}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_picture_that_never_ends_does_not_fill_the_memory() {
    let camera = MotionJpegCamera::playing(Script::EndlessPart, Duration::ZERO).await;
    let publisher = Publisher::start(&[&camera.address], &[]).await;
    let mut peak = 0.0_f64;
    wait_until("it has failed twice", async || {
        for program in children(publisher.child.id().unwrap()) {
            peak = peak.max(memory_mb(program, "VmHWM:"));
        }
        camera.clients() >= 3
    })
    .await;
    println!("ffmpeg had at most {peak:.0} MB");
    assert!((1.0..300.0).contains(&peak), "{peak:.0} MB");
    let log = publisher.stop().await;
    assert!(log.contains("next attempt in"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_stream_of_broken_pictures_is_not_opened_again_and_again() {
    let broken = Script::Repeat(vec![b"no picture".to_vec()]);
    let camera = MotionJpegCamera::playing(broken, Duration::from_millis(10)).await;
    let publisher = Publisher::start(&[&camera.address], &[]).await;
    wait_until("it is tried in both ways", async || camera.clients() >= 2).await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert!(camera.clients() <= 6, "{} times", camera.clients());
    publisher.stop().await;

    // One broken picture in a good stream is left out.
    let picture = picture();
    let mut parts = vec![picture.clone(); 20];
    parts[0] = b"broken".to_vec();
    parts[10] = b"broken".to_vec();
    let camera = MotionJpegCamera::playing(Script::Repeat(parts), Duration::from_millis(10)).await;
    let mut publisher = Publisher::start(&[&camera.address], &[]).await;
    let frames = publisher.take(60).await;
    assert!(frames.iter().all(|frame| frame.bytes == picture));
    assert_eq!(camera.clients(), 1);
    publisher.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn options_reach_a_camera_whose_address_has_a_password_and_nobody_else() {
    let camera = MotionJpegCamera::start(picture(), Duration::from_millis(10)).await;
    let address = camera.address.replace("http://", "http://viewer:hidden@");
    let arguments = [
        &address,
        "--source-option=-headers",
        "--source-option=X-Gate: opened by hidden",
        "--source-option=-auth_type",
        "--source-option=basic",
    ];
    let environment = [("ALBIREO_HTTP__TOKEN", "hidden"), ("GST_DEBUG", "1")];
    let mut publisher = Publisher::start(&arguments, &environment).await;
    publisher.take(3).await;
    let request = camera.first_request();
    for part in ["X-Gate: opened by hidden", "Authorization: Basic"] {
        assert!(request.contains(part), "{request}");
    }
    let programs = children(publisher.child.id().unwrap());
    assert_eq!(programs.len(), 1);
    let environment = std::fs::read(format!("/proc/{}/environ", programs[0])).unwrap();
    let environment = String::from_utf8_lossy(&environment).into_owned();
    assert!(environment.contains("GST_DEBUG=1"), "{environment}");
    for told in [command_line(programs[0]), environment] {
        assert!(!told.contains("hidden"), "{told}");
    }
    let log = publisher.stop().await;
    assert!(!log.contains("opened by"), "{log}");
}

/// A camera with Zenoh's own settings, shared memory among them, that sends some frames and goes.
async fn come_and_go(endpoint: &str, number: u64, picture: &[u8]) {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{endpoint}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    let session = zenoh::open(config).await.unwrap();
    for seq in 0..10 {
        let attachment = FrameAttachment {
            v: albireo_wire::VERSION,
            seq: Some(seq),
            stream: Some(number),
            ..FrameAttachment::default()
        };
        session
            .put("albireo/node/front/frame", picture)
            .encoding("image/jpeg")
            .attachment(serde_json::to_vec(&attachment).unwrap())
            .await
            .unwrap();
    }
    session.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn cameras_that_come_and_go_leave_no_memory_in_the_node() {
    // For figures by hand: how many, and with which setting.
    let count = std::env::var("ALBIREO_SESSIONS").map_or(200, |count| count.parse().unwrap());
    let more = std::env::var("ALBIREO_SESSIONS_NODE").unwrap_or_default();
    let node = Node::start(&format!(
        "policy.name = \"fixed-skip\"\npolicy.fixed_skip.n = 1000\naudit.share = 0\n{more}\n"
    ))
    .await;
    let picture = picture();
    for number in 0..20 {
        come_and_go(&node.zenoh, number, &picture).await;
    }
    let before = memory_mb(node.id(), "VmRSS:");
    for number in 20..20 + count {
        come_and_go(&node.zenoh, number, &picture).await;
    }
    let after = memory_mb(node.id(), "VmRSS:");
    println!("{count} sessions: {before:.1} MB, then {after:.1} MB");
    assert!(after - before < 10.0, "{before:.1} MB, then {after:.1} MB");
    node.stop().await;
}
