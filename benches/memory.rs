//! Measures a node's memory without the model: its resident set with several cameras minus that of a process with only
//! ONNX Runtime and the same model. Also shows whether it grows.
//!
//! ```text
//! cargo bench --bench memory                                   # 1, 2, 4 and 8 cameras, 30 s each
//! cargo bench --bench memory -- --cameras 4 --minutes 60       # an hour, printed every minute
//! cargo bench --bench memory -- --program OTHER --program target/release/albireo
//! cargo bench --bench memory -- --model MODEL.onnx --head yolox
//! ```
//!
//! Every camera sends JPEG pictures of 1280x720 at 30 frames per second, in clips of 40 s. The detector runs on every
//! frame (`vanilla`), the case that needs most memory. With `--skip 30` it runs on one frame of 30, a lighter load.
//! Several programs take turns within one run.

#![allow(clippy::expect_used, clippy::panic, clippy::print_stdout)]

use albireo::cli::frames::{FrameSender, OutgoingFrame, Pacing, open_session};
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_vision::detector::{DetectorConfig, DetectorNetwork};
use albireo_vision::picture::{EncodedPicture, Picture, PictureFormat};
use albireo_wire::{FrameAttachment, VERSION};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const SIZE: PictureSize = PictureSize::new(1280, 720);
const RATE: f64 = 30.0;
const CLIP: Duration = Duration::from_secs(40);
/// The argument that makes this program the process with only ONNX Runtime and the model.
const BARE: &str = "--as-bare-runtime";

/// The settings of a measurement.
struct Arguments {
    programs: Vec<PathBuf>,
    cameras: Vec<usize>,
    time: Duration,
    model: PathBuf,
    head: String,
    /// The detector runs on one of this many frames.
    skip: u64,
}

impl Arguments {
    fn read() -> Self {
        let model = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/tests/fixtures/models/boxes.onnx"
        );
        let mut read = Self {
            programs: Vec::new(),
            cameras: vec![1, 2, 4, 8],
            time: Duration::from_secs(30),
            model: model.into(),
            head: "auto".to_owned(),
            skip: 1,
        };
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().expect("a value follows");
            match argument.as_str() {
                "--program" => read.programs.push(value().into()),
                "--cameras" => {
                    read.cameras.clear();
                    for number in value().split(',') {
                        read.cameras.push(number.parse().expect("a number"));
                    }
                }
                "--minutes" => {
                    let minutes: f64 = value().parse().expect("minutes");
                    read.time = Duration::from_secs_f64(minutes * 60.0);
                }
                "--model" => read.model = value().into(),
                "--head" => read.head = value(),
                "--skip" => read.skip = value().parse().expect("a number of frames"),
                // The first argument comes from Cargo.
                "--bench" | BARE => {}
                other => panic!("{other}: not known; see the top of benches/memory.rs"),
            }
        }
        if read.programs.is_empty() {
            read.programs.push(env!("CARGO_BIN_EXE_albireo").into());
        }
        read
    }

    fn detector(&self) -> DetectorConfig {
        DetectorConfig {
            model: self.model.clone(),
            head: serde_json::from_value(self.head.clone().into()).expect("a head's name"),
            ..DetectorConfig::default()
        }
    }
}

/// A child process that is killed on drop.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The resident memory of a process in MB: all pages, and the anonymous ones.
#[derive(Clone, Copy)]
struct Resident {
    all: f64,
    own: f64,
}

impl Resident {
    fn read(process: &Process) -> Self {
        let file = format!("/proc/{}/status", process.0.id());
        let status = std::fs::read_to_string(file).expect("the process runs");
        let megabytes = |name: &str| {
            let value = status
                .lines()
                .find_map(|line| line.strip_prefix(name))
                .expect("the system reports its memory");
            let kilobytes = value.trim().strip_suffix(" kB").expect("kB");
            let kilobytes: f64 = kilobytes.parse().expect("a number");
            kilobytes * 1024.0 / 1e6
        };
        Self {
            all: megabytes("VmRSS:"),
            own: megabytes("RssAnon:"),
        }
    }
}

/// Loads the model, runs it on a black picture, reports that it is ready, and keeps running.
fn be_bare(arguments: &Arguments) {
    let mut network = DetectorNetwork::open(&arguments.detector()).expect("the model opens");
    let size = network.preparation().format().size;
    let prepared = network.preparation().prepare(&Picture::black(size)).expect("a picture");
    for _ in 0..50 {
        network.detect(&prepared).expect("the model runs");
    }
    println!("ready");
    std::thread::park();
}

fn bare(arguments: &Arguments) -> Resident {
    let mut child = Command::new(std::env::current_exe().expect("this program"))
        .args([BARE, "--head", &arguments.head, "--model"])
        .arg(&arguments.model)
        .stdout(Stdio::piped())
        .spawn()
        .expect("this program starts again");
    let output = child.stdout.take().expect("piped");
    let process = Process(child);
    let mut line = String::new();
    BufReader::new(output).read_line(&mut line).expect("it says when it is ready");
    assert_eq!(line.trim(), "ready");
    Resident::read(&process)
}

fn node(
    program: &Path,
    arguments: &Arguments,
    cameras: usize,
    folder: &Path,
    port: u16,
) -> Process {
    let file = folder.join("node.toml");
    let mut text = format!(
        "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [\"tcp/127.0.0.1:{port}\"]\nlog.level = \"error\"\n\
         detector.model = \"{}\"\ndetector.head = \"{}\"\npower.source = \"none\"\n",
        arguments.model.display(),
        arguments.head,
    );
    text += &match arguments.skip {
        1 => "policy.name = \"vanilla\"\n".to_owned(),
        frames => format!("policy.name = \"fixed-skip\"\npolicy.fixed_skip.n = {frames}\n"),
    };
    for camera in 0..cameras {
        text += &format!("[[camera]]\nname = \"camera-{camera}\"\n");
    }
    std::fs::write(&file, text).expect("the configuration is written");
    let child = Command::new(program)
        .args(["node", "--config"])
        .arg(&file)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect("the node starts");
    Process(child)
}

fn pictures() -> Vec<EncodedPicture> {
    let scene = BoxScene::new(7, SIZE);
    let picture = |index| EncodedPicture {
        format: PictureFormat::Jpeg,
        bytes: scene.frame(index).jpeg(85).expect("a JPEG file").into(),
        size: SIZE,
        mount: None,
    };
    (0..32).map(picture).collect()
}

/// Sends to all cameras for `time`. Calls `tell` every minute, or once at the end of a shorter run.
async fn send(
    port: u16,
    cameras: usize,
    time: Duration,
    pictures: &[EncodedPicture],
    mut tell: impl FnMut(Duration),
) {
    let endpoint = [format!("tcp/127.0.0.1:{port}")];
    let session = open_session(&endpoint, &[], Duration::from_secs(20))
        .await
        .expect("the node is there");
    let mut senders = Vec::new();
    for camera in 0..cameras {
        let key = format!("albireo/node/camera-{camera}/frame");
        let sender = FrameSender::declare(&session, &key, Pacing::Drop).await.expect("a sender");
        sender
            .wait_for_receiver(Duration::from_secs(20))
            .await
            .expect("the node listens");
        senders.push(sender);
    }
    let mut clock = tokio::time::interval(Duration::from_secs_f64(1.0 / RATE));
    let start = Instant::now();
    let mut reported = Duration::ZERO;
    for seq in 0_u64.. {
        clock.tick().await;
        let since = start.elapsed();
        if since - reported >= Duration::from_secs(60).min(time) {
            reported = since;
            tell(since);
        }
        if since >= time {
            break;
        }
        let clip = since.as_secs() / CLIP.as_secs();
        for (camera, sender) in senders.iter().enumerate() {
            let picture = &pictures[(seq as usize + 5 * camera) % pictures.len()];
            let frame = OutgoingFrame {
                picture: picture.clone(),
                attachment: FrameAttachment {
                    v: VERSION,
                    seq: Some(seq),
                    clip: Some(format!("clip-{clip}")),
                    ..FrameAttachment::default()
                },
            };
            sender.put(&frame).expect("Zenoh takes a frame");
        }
    }
    session.close().await.expect("the session is closed");
}

#[tokio::main(worker_threads = 2)]
async fn main() {
    if std::env::args().nth(1).as_deref() == Some(BARE) {
        return be_bare(&Arguments::read());
    }
    let arguments = Arguments::read();
    let folder = tempfile::tempdir().expect("a folder");
    let pictures = pictures();
    let bare = bare(&arguments);
    println!(
        "{}: ONNX Runtime and the model alone take {:.1} MB, {:.1} of them no file's",
        arguments.model.file_name().unwrap_or_default().display(),
        bare.all,
        bare.own
    );
    println!(
        "{:<32} {:>7} {:>8} {:>9} {:>9} {:>8}",
        "program", "cameras", "minutes", "all, MB", "over bare", "own, MB"
    );
    for &cameras in &arguments.cameras {
        for program in &arguments.programs {
            let port = std::net::TcpListener::bind("127.0.0.1:0")
                .and_then(|listener| listener.local_addr())
                .expect("a port")
                .port();
            let node = node(program, &arguments, cameras, folder.path(), port);
            let name = program.to_string_lossy();
            // Its last characters, as many as the column has.
            let left_out = name.chars().count().saturating_sub(32);
            let name: String = name.chars().skip(left_out).collect();
            send(port, cameras, arguments.time, &pictures, |since| {
                let now = Resident::read(&node);
                println!(
                    "{name:<32} {cameras:>7} {:>8.1} {:>9.1} {:>9.1} {:>8.1}",
                    since.as_secs_f64() / 60.0,
                    now.all,
                    now.all - bare.all,
                    now.own
                );
            })
            .await;
        }
    }
}
