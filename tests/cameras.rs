//! Live cameras, opened by the node or by `albireo publish`: they reconnect, and their passwords stay hidden.

use crate::node_frames::{attachment, put};
use crate::support::live_camera::{MotionJpegCamera, RtspCamera};
use crate::support::{
    Node, albireo, assert_contains, collected, detectors, json_at, listening_peer, memory_mb, next,
    replay, run, signal, subscribe, test_video, until, until_connected, zenoh_client,
};
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_wire::{FrameAttachment, read};
use rstest::rstest;
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::Child;
use tokio::sync::mpsc::UnboundedReceiver;
use zenoh::sample::Sample;

const USER: &str = "viewer";
/// A password with characters that an address must encode.
const PASSWORD: &str = "hid/den@7:x";
const LOGIN: [&str; 2] = [USER, PASSWORD];
/// The variables in the addresses of [`with_login`].
const ENVIRONMENT: [(&str, &str); 2] = [("GATE_USER", USER), ("GATE_PASSWORD", PASSWORD)];

fn with_login(camera: &RtspCamera) -> String {
    camera.address().replace("rtsp://", "rtsp://${GATE_USER}:${GATE_PASSWORD}@")
}

fn picture() -> Vec<u8> {
    BoxScene::new(3, PictureSize::new(320, 180)).frame(0).jpeg(80).unwrap()
}

struct Received {
    said: FrameAttachment,
    bytes: Vec<u8>,
}

struct Publisher {
    child: Child,
    frames: UnboundedReceiver<Received>,
    log: tokio::task::JoinHandle<String>,
    session: zenoh::Session,
}

impl Publisher {
    async fn start(arguments: &[&str], environment: &[(&str, &str)]) -> Self {
        let (session, locator) = listening_peer().await;
        let received = |sample: Sample| Received {
            said: read(&sample.attachment().unwrap().to_bytes()).unwrap(),
            bytes: sample.payload().to_bytes().into_owned(),
        };
        let frames = subscribe(&session, "albireo/node/front/frame", received).await;
        let mut child = albireo()
            .arg("publish")
            .args(arguments)
            .args(["--connect", &locator])
            .envs(environment.iter().copied())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let log = collected(BufReader::new(child.stderr.take().unwrap()).lines());
        Self {
            child,
            frames,
            log,
            session,
        }
    }

    async fn take(&mut self, count: usize) -> Vec<Received> {
        let mut frames = Vec::new();
        while frames.len() < count {
            frames.push(next(&mut self.frames).await);
        }
        frames
    }

    async fn stop(mut self) -> String {
        signal(self.child.id().unwrap(), "-TERM");
        let status = self.child.wait().await.unwrap();
        let log = self.log.await.unwrap();
        assert!(status.success(), "{log}");
        self.session.close().await.unwrap();
        log
    }
}

fn children(parent: u32) -> Vec<u32> {
    let mut children = Vec::new();
    for thread in std::fs::read_dir(format!("/proc/{parent}/task")).unwrap() {
        let file = thread.unwrap().path().join("children");
        let listed = std::fs::read_to_string(file).unwrap_or_default();
        children.extend(listed.split_whitespace().map(|id| id.parse::<u32>().unwrap()));
    }
    children
}

fn command_line(process: u32) -> String {
    let line = std::fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
    String::from_utf8_lossy(&line).replace('\0', " ")
}

/// Asserts that `text` has the password in no form.
fn assert_hidden(text: &str) {
    for form in [PASSWORD, "hid%2Fden", "den@7", "den%407"] {
        assert!(!text.contains(form), "the password is shown: {text}");
    }
}

async fn front(node: &Node) -> Value {
    json_at(&format!("{}/api/v1/cameras", node.http)).await["cameras"][0].take()
}

async fn processed(node: &Node) -> u64 {
    front(node).await["frames"].as_u64().unwrap()
}

async fn until_processed(node: &Node, frames: u64) {
    until("frames come", async || processed(node).await >= frames).await;
}

fn source(address: &str, more: &str) -> String {
    let head = "[[camera]]\nname = \"front\"\n# development: ring=64\n";
    format!("{head}source = \"{address}\"\n{more}\n")
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn a_camera_opened_by_the_node_reconnects_and_its_password_never_leaks() {
    let camera = RtspCamera::start("h264", &LOGIN).await;
    let port = camera.port;
    let address = with_login(&camera);
    let settings = source(&address, "");
    let mut command = albireo();
    command.envs(ENVIRONMENT);
    let node = Node::spawn(command, tempfile::tempdir().unwrap(), &settings).await;
    until_processed(&node, 20).await;
    let programs = children(node.id());
    let lines: Vec<_> = programs.iter().map(|id| command_line(*id)).collect();
    let is_ffmpeg = |line: &String| line.starts_with("ffmpeg ");
    assert!(lines.iter().any(is_ffmpeg), "{lines:?}");
    for line in &lines {
        assert_hidden(line);
    }

    camera.kill().await;
    let ready = async || node.text("/readyz").await;
    let failed = "\"reason\":\"failed: ";
    until("it is reported", async || ready().await.contains(failed)).await;
    let mut shown = ready().await;
    let _camera = RtspCamera::start_at(port, "h264", &LOGIN).await;
    let is_ready = async || !ready().await.contains("\"subject\":\"front\"");
    until("the node is ready again", is_ready).await;
    // More frames than the ring may still hold from before.
    until_processed(&node, processed(&node).await + 70).await;
    for path in ["/metrics", "/api/v1/cameras", "/api/v1/frame-states"] {
        shown += &node.text(path).await;
    }
    let address = format!("127.0.0.1:{port}/stream");
    assert_contains(&shown, &["; next attempt in ", &address]);
    assert_hidden(&shown);
    let programs = children(node.id());
    let log = node.stop_well().await.log;
    assert_contains(&log, &["next attempt in"]);
    assert_hidden(&log);
    for process in programs {
        let place = format!("/proc/{process}");
        assert!(!Path::new(&place).exists(), "left behind");
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg and RTSP server"]
async fn a_published_camera_reconnects_and_restarts_its_numbering() {
    let camera = RtspCamera::start("h264", &LOGIN).await;
    let port = camera.port;
    let source = with_login(&camera);
    let mut publisher = Publisher::start(&[&source], &ENVIRONMENT).await;
    let frames = publisher.take(30).await;
    let first = &frames[0].said;
    assert!(first.stream.is_some());
    for (number, frame) in frames.iter().enumerate() {
        assert_eq!(frame.said.seq, Some(number as u64));
        assert_eq!(frame.said.stream, first.stream);
        assert!(frame.bytes.starts_with(&[0xFF, 0xD8]));
    }
    camera.kill().await;
    let _camera = RtspCamera::start_at(port, "h264", &LOGIN).await;
    let again = loop {
        let frame = next(&mut publisher.frames).await;
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

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg and RTSP server"]
async fn a_gstreamer_pipeline_is_a_camera_and_motion_jpeg_over_rtsp_is_not_encoded_again() {
    let pipeline =
        "videotestsrc is-live=true ! video/x-raw,width=160,height=120,framerate=20/1 ! jpegenc";
    let camera = RtspCamera::start("jpeg", &[]).await;
    let address = camera.address();
    let programs = tempfile::tempdir().unwrap();
    let path = programs.path().join("gst-launch-1.0");
    std::os::unix::fs::symlink("/usr/bin/gst-launch-1.0", path).unwrap();
    // Without ffmpeg, GStreamer opens the address.
    let without_ffmpeg = [("PATH", programs.path().to_str().unwrap())];
    for (arguments, environment) in [
        (&[&*address][..], &without_ffmpeg[..]),
        (&[pipeline], &[]),
        // Nothing is decoded, so the missing CUDA decoder does not matter.
        (&[&*address, "--hardware", "cuda"], &[]),
    ] {
        let mut publisher = Publisher::start(arguments, environment).await;
        publisher.take(20).await;
        publisher.stop().await;
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg"]
async fn a_video_file_is_a_camera_that_never_ends() {
    let folder = tempfile::tempdir().unwrap();
    let file = test_video(folder.path(), "drive 1.mp4", "rate=20:duration=1");
    let begun = Instant::now();
    let node = Node::start(&source(file.to_str().unwrap(), "")).await;
    until_processed(&node, 50).await;
    let took = begun.elapsed();
    let own = Duration::from_secs(2);
    assert!(took >= own, "played at its own speed, not in {took:?}");
    assert_eq!(front(&node).await["width"], 320);
    node.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime"]
async fn a_sender_that_restarts_loses_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    for number in 0..50 {
        std::fs::write(folder.path().join(format!("{number}.jpg")), picture()).unwrap();
    }
    let node = Node::start("[[camera]]\nname = \"front\"\ndelivery = \"every\"\n").await;
    let pictures = folder.path().to_str().unwrap();
    for _ in 0..3 {
        replay(&node, pictures, &["--rate", "max", "--clip", "drive"]).await;
    }
    until_processed(&node, 150).await;
    let states = json_at(&format!("{}/api/v1/frame-states", node.http)).await;
    let dropped = states["cameras"][0]["dropped"].as_object().unwrap();
    assert!(dropped.values().all(|count| *count == 0), "{dropped:?}");
}

#[rstest]
#[case("no/such/drive.mp4", &["no/such/drive.mp4: no such file"])]
#[case("rtsp://${NOBODY_SETS_THIS}@camera/stream", &["NOBODY_SETS_THIS"])]
#[case("rtsp://camera/stream", &["ffmpeg", "gst-launch-1.0", "apt-get install ffmpeg"])]
#[case("a ! jpegenc", &["gstreamer1.0-tools"])]
fn a_source_that_cannot_be_opened_is_named_with_a_remedy(
    #[case] source: &str,
    #[case] parts: &[&str],
) {
    let said = run(&["publish", source], &[("PATH", "/nowhere")]).fails();
    assert_contains(&said, parts);
}

#[test]
fn a_source_that_is_a_bag_or_an_archive_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    for (name, begins, remedy) in [
        ("a.bag", "#ROSBAG V2.0\n", "rosbags-convert"),
        ("a.zip", "PK\x03\x04", "unpack it"),
    ] {
        let file = folder.path().join(name);
        std::fs::write(&file, begins).unwrap();
        let file = file.to_str().unwrap();
        let said = run(&["publish", file], &[("PATH", "/nowhere")]).fails();
        assert_contains(&said, &[name, remedy]);
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn a_failed_source_reports_why_and_when_it_retries() {
    let camera = RtspCamera::start("h264", &[USER, "another"]).await;
    let password = "hid%2Fden%407%3Ax";
    let login = format!("rtsp://{USER}:{password}@");
    let address = camera.address().replace("rtsp://", &login);
    let node = Node::start(&source(&address, "")).await;
    let fault = async || front(&node).await["fault"].as_str().unwrap_or_default().to_owned();
    let second = "it is refused twice";
    until(second, async || {
        fault().await.contains("left alone for 10 minutes")
    })
    .await;
    let entry = front(&node).await;
    assert_eq!(entry["source"], camera.address());
    assert!(entry.get("key").is_none(), "{entry}");
    let reason = "\"reason\":\"failed: 401 Unauthorized: refused 2 times";
    assert_contains(&node.text("/readyz").await, &[reason]);
    let log = node.stop().await.log;
    let attempts = log.matches("next attempt in ").count();
    assert_eq!(attempts, 2, "once for each attempt: {log}");
    assert_hidden(&log);
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn broken_pictures_are_dropped_and_a_stream_of_them_is_not_reopened_endlessly() {
    let camera = MotionJpegCamera::start(vec![b"no picture".to_vec()]).await;
    let publisher = Publisher::start(&[&camera.address], &[]).await;
    let clients = || camera.requests().len();
    until("it is tried in both ways", async || clients() >= 2).await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert!(clients() <= 6, "{} times", clients());
    publisher.stop().await;

    // A broken picture in a good stream is dropped.
    let picture = picture();
    let mut parts = vec![picture.clone(); 20];
    parts[0] = b"broken".to_vec();
    parts[10] = b"broken".to_vec();
    let camera = MotionJpegCamera::start(parts).await;
    let mut publisher = Publisher::start(&[&camera.address], &[]).await;
    let frames = publisher.take(60).await;
    assert!(frames.iter().all(|frame| frame.bytes == picture));
    assert_eq!(camera.requests().len(), 1);
    publisher.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn motion_jpeg_is_forwarded_unchanged_at_the_rate_with_options_that_leak_nowhere() {
    let picture = picture();
    let camera = MotionJpegCamera::start(vec![picture.clone()]).await;
    let address = camera.address.replace("http://", "http://viewer:hidden@");
    let arguments = [
        &address,
        "--rate=5",
        "--source-option=-headers",
        "--source-option=X-Gate: opened by hidden",
        "--source-option=-auth_type",
        "--source-option=basic",
    ];
    let environment = [("ALBIREO_HTTP__TOKEN", "hidden"), ("GST_DEBUG", "1")];
    let mut publisher = Publisher::start(&arguments, &environment).await;
    let frames = publisher.take(16).await;
    // By the publisher's clock, fifteen slots of 0.2 s follow the first frame's slot; that frame may come late in its slot.
    let first = frames[0].said.t_ns.unwrap();
    let last = frames[15].said.t_ns.unwrap();
    let took = Duration::from_nanos(last - first);
    assert!(took >= Duration::from_millis(2700), "{took:?}");
    assert!(frames.iter().all(|frame| frame.bytes == picture));
    let given = ["X-Gate: opened by hidden", "Authorization: Basic"];
    assert_contains(&camera.requests()[0], &given);
    let programs = children(publisher.child.id().unwrap());
    assert_eq!(programs.len(), 1);
    let environment = std::fs::read(format!("/proc/{}/environ", programs[0])).unwrap();
    let environment = String::from_utf8_lossy(&environment).into_owned();
    assert!(environment.contains("GST_DEBUG=1"), "{environment}");
    for shown in [command_line(programs[0]), environment] {
        assert!(!shown.contains("hidden"), "{shown}");
    }
    let log = publisher.stop().await;
    assert!(!log.contains("opened by"), "{log}");
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn cameras_that_come_and_go_leak_no_memory() {
    let settings = "policy.name = \"fixed-skip\"\npolicy.fixed_skip.n = 1000\naudit.share = 0\n";
    let node = Node::start(settings).await;
    let picture = picture();
    let mut memory = Vec::new();
    for streams in [0..20, 20..220] {
        for stream in streams {
            let session = zenoh_client(&node.zenoh).await;
            for seq in 0..10 {
                let attachment = attachment(seq, Some(stream), None);
                put(&session, "front", &picture, attachment).await;
            }
            session.close().await.unwrap();
        }
        memory.push(memory_mb(node.id(), "VmRSS:"));
    }
    assert!(memory[1] - memory[0] < 10.0, "{memory:?} MB");
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime"]
async fn a_camera_that_slows_down_is_a_reason_in_readyz_with_both_rates() {
    let model = detectors::model("boxes.onnx");
    let node = Node::start(&format!("detector.model = {model:?}\n")).await;
    let session = zenoh_client(&node.zenoh).await;
    until_connected(&session, "node", "front").await;
    let picture = picture();
    let mut seq = 0;
    let mut send = async |pause: Duration| {
        put(&session, "front", &picture, attachment(seq, None, None)).await;
        seq += 1;
        tokio::time::sleep(pause).await;
    };
    // The stream shows its rate for more than the ten seconds over which it is taken.
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(20) {
        send(Duration::from_millis(40)).await;
    }
    assert!(!node.text("/readyz").await.contains("frames per second come"));
    let said = loop {
        send(Duration::from_secs(1)).await;
        let said = node.text("/readyz").await;
        if said.contains(" frames per second come; ") {
            break said;
        }
    };
    let (before, after) = said.split_once(" frames per second come; ").unwrap();
    let now: f64 = before.rsplit('"').next().unwrap().parse().unwrap();
    let usual: f64 = after.split_once(" came before").unwrap().0.parse().unwrap();
    assert!(now < usual / 2.0, "{said}");
    let fault = front(&node).await["fault"].to_string();
    assert_contains(&fault, &["frames per second come; "]);
    session.close().await.unwrap();
    node.stop_well().await;
}
