//! Measures a frame that needs no detector, end to end. A picture of about 36 kB is sent to a node and to a bare Zenoh
//! echo in a separate process, which answers with a message as long as the node's. Both take turns within one run with
//! a node that has the default audit: its detector checks one predicted frame of 50 afterwards. The last nodes answer
//! at once while their detectors of 10, 110 and 265 ms run all the time.
//!
//! ```text
//! cargo bench --bench predicted_frame [-- ROUNDS]
//! ```
//!
//! Prints the time from the put to the arrival of the answer (median and 99th percentile) at 30 frames per second, and
//! the processor time per frame of the answering process at 1,000 frames per second.

#![allow(clippy::expect_used, clippy::print_stdout)]

use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{EncodedPicture, FrameLimits, PictureFormat, to_jpeg};
use albireo_wire::{FrameAttachment, VERSION};
use bytes::Bytes;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

const SIZE: PictureSize = PictureSize::new(1280, 720);
const FRAME: &str = "albireo/node/front/frame";
const ANSWER: &str = "albireo/node/front/detections";
/// The length of the echo's answers, equal to that of the detections message of a frame without objects.
const ANSWER_BYTES: usize = 330;
/// The rates with the frames of a turn. The frames of `WARM_UP` come first and do not count.
const TURNS: [(f64, u64); 2] = [(30.0, 150), (1000.0, 3000)];
const WARM_UP: u64 = 20;
/// The argument that makes this program the echo.
const ECHO: &str = "--as-echo";

/// A smooth picture with some noise, whose file is as large as that of a typical camera.
fn picture() -> EncodedPicture {
    let width = SIZE.width as usize;
    let height = SIZE.height as usize;
    let mut noise = 1_u32;
    let mut pixels = Vec::new();
    for index in 0..width * height {
        // The generator of Numerical Recipes; its upper two bits are the noise.
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        pixels.push((index % width * 200 / width) as u8 + (noise >> 30) as u8);
    }
    pixels.resize(width * height * 3 / 2, 128);
    let raw = EncodedPicture {
        format: PictureFormat::Nv12,
        bytes: Bytes::from(pixels),
        size: SIZE,
        mount: None,
    };
    EncodedPicture {
        format: PictureFormat::Jpeg,
        bytes: to_jpeg(&raw, &FrameLimits::default()).expect("a picture is coded"),
        size: SIZE,
        mount: None,
    }
}

struct Answerer {
    process: Child,
    port: u16,
}

impl Drop for Answerer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Answerer {
    /// A node whose detector runs on 1 frame of 1,000.
    fn node(folder: &std::path::Path, audit: f64) -> Self {
        let model = concat!(env!("CARGO_MANIFEST_DIR"), "/models/yolox_nano.onnx");
        let policy = "policy.name = \"fixed-skip\"\npolicy.fixed_skip.n = 1000";
        Self::configured(
            folder,
            &format!("detector.model = \"{model}\"\n{policy}\naudit.share = {audit}\n"),
        )
    }

    /// A node that answers at once. Its detector finds nothing and keeps one core busy: it is called again as soon as
    /// it is free.
    fn at_once(folder: &std::path::Path, model: &str) -> Self {
        let models = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/models");
        let model = format!("{models}/{model}.onnx");
        Self::configured(
            folder,
            &format!(
                "detector.model = \"{model}\"\ndetector.threads = 1\npolicy.name = \"expected-loss\"\n\
                 node.answer = \"at_once\"\naudit.share = 0.0\n"
            ),
        )
    }

    fn configured(folder: &std::path::Path, settings: &str) -> Self {
        let port = free_port();
        let file = folder.join(format!("{port}.toml"));
        let text = format!(
            "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [\"tcp/127.0.0.1:{port}\"]\nlog.level = \"warn\"\n\
             power.source = \"none\"\n{settings}"
        );
        std::fs::write(&file, text).expect("the configuration is written");
        let built = env!("CARGO_BIN_EXE_albireo").into();
        let program = std::env::var_os("ALBIREO_BIN").unwrap_or(built);
        let mut program = Command::new(program);
        program.args(["node", "--config"]).arg(&file);
        Self::start(program, port)
    }

    fn echo() -> Self {
        let port = free_port();
        let mut program = Command::new(std::env::current_exe().expect("this program has a path"));
        program.arg(ECHO).arg(port.to_string());
        Self::start(program, port)
    }

    fn start(mut program: Command, port: u16) -> Self {
        let process = program.stdin(Stdio::null()).spawn().expect("the program starts");
        Self { process, port }
    }
}

fn free_port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port")
        .port()
}

async fn session(listen: Option<u16>, connect: Option<u16>) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let endpoints = |port: Option<u16>| {
        let endpoints: Vec<String> =
            port.iter().map(|port| format!("tcp/127.0.0.1:{port}")).collect();
        serde_json::to_string(&endpoints).expect("text")
    };
    for (key, value) in [
        ("scouting/multicast/enabled", "false".to_owned()),
        ("listen/endpoints", endpoints(listen)),
        ("connect/endpoints", endpoints(connect)),
        ("connect/timeout_ms", "20000".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("Zenoh knows it");
    }
    zenoh::open(config).await.expect("the session opens")
}

/// Answers every sample in the callback that receives it.
async fn run_echo(port: u16) {
    let session = session(Some(port), None).await;
    let answers = session
        .declare_publisher(ANSWER)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .await
        .expect("a publisher");
    let _frames = session
        .declare_subscriber(FRAME)
        .callback(move |sample| {
            let put = answers
                .put(vec![b' '; ANSWER_BYTES])
                .encoding(Encoding::APPLICATION_JSON)
                .attachment(sample.attachment().cloned());
            zenoh::Wait::wait(put).expect("Zenoh takes an answer");
        })
        .await
        .expect("a subscriber");
    std::future::pending::<()>().await;
}

/// The processor time of a process, user and system, in seconds.
fn processor_time(pid: u32) -> f64 {
    // Adds up the nanoseconds of each thread, because `stat` has a resolution of 10 ms.
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).expect("/proc is there");
    let nanoseconds = threads.flatten().filter_map(|thread| {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    });
    nanoseconds.sum::<u64>() as f64 * 1e-9
}

/// What one turn took, in milliseconds.
#[derive(Clone)]
struct Turn {
    /// From put to answer, ascending.
    times: Vec<f64>,
    /// The processor's time per frame.
    processor: f64,
}

impl Turn {
    /// The time that this share of the answers did not exceed.
    fn percentile(&self, share: f64) -> f64 {
        let place = (self.times.len() as f64 * share) as usize;
        self.times.get(place).copied().unwrap_or(f64::NAN)
    }
}

/// The medians of the turns at one rate, in milliseconds.
struct Summary {
    median: f64,
    /// The 99th percentile.
    late: f64,
    /// The processor's time per frame.
    processor: f64,
}

impl Summary {
    fn new(turns: &[Turn]) -> Self {
        Self {
            median: median(turns.iter().map(|turn| turn.percentile(0.5))),
            late: median(turns.iter().map(|turn| turn.percentile(0.99))),
            processor: median(turns.iter().map(|turn| turn.processor)),
        }
    }
}

/// A connection to an answerer and back.
struct Line {
    _session: zenoh::Session,
    frames: Publisher<'static>,
    arrived: UnboundedReceiver<Instant>,
    _answers: zenoh::pubsub::Subscriber<()>,
    pid: u32,
    seq: u64,
}

impl Line {
    async fn to(answerer: &Answerer) -> Self {
        let session = session(None, Some(answerer.port)).await;
        let (tell, arrived) = unbounded_channel();
        let answers = session
            .declare_subscriber(ANSWER)
            .callback(move |_| {
                let _ = tell.send(Instant::now());
            })
            .await
            .expect("a subscriber");
        let frames = session
            .declare_publisher(FRAME)
            .congestion_control(CongestionControl::Block)
            .await
            .expect("a publisher");
        let listener = frames.matching_listener().await.expect("somebody may listen");
        let heard = async {
            while !frames.matching_status().await?.matching() {
                listener.recv_async().await?;
            }
            Ok::<(), zenoh::Error>(())
        };
        tokio::time::timeout(Duration::from_secs(60), heard)
            .await
            .expect("it is there within a minute")
            .expect("it listens");
        Self {
            _session: session,
            frames,
            arrived,
            _answers: answers,
            pid: answerer.process.id(),
            seq: 0,
        }
    }

    async fn put(&mut self, picture: &EncodedPicture) -> Instant {
        let attachment = FrameAttachment {
            v: VERSION,
            seq: Some(self.seq),
            width: Some(SIZE.width),
            height: Some(SIZE.height),
            ..FrameAttachment::default()
        };
        self.seq += 1;
        let attachment = serde_json::to_vec(&attachment).expect("an attachment is JSON");
        let put = Instant::now();
        self.frames
            .put(picture.bytes.clone())
            .encoding(Encoding::IMAGE_JPEG)
            .attachment(attachment)
            .await
            .expect("Zenoh takes a frame");
        put
    }

    async fn turn(&mut self, picture: &EncodedPicture, rate: f64, frames: u64) -> Turn {
        let mut clock = tokio::time::interval(Duration::from_secs_f64(1.0 / rate));
        clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut times = Vec::new();
        let mut began = 0.0;
        for number in 0..WARM_UP + frames {
            clock.tick().await;
            if number == WARM_UP {
                began = processor_time(self.pid);
            }
            let put = self.put(picture).await;
            let answer = tokio::time::timeout(Duration::from_secs(20), self.arrived.recv()).await;
            let arrived = answer.ok().flatten().expect("every frame is answered");
            if number >= WARM_UP {
                times.push((arrived - put).as_secs_f64() * 1e3);
            }
        }
        let processor = (processor_time(self.pid) - began) * 1e3 / frames as f64;
        times.sort_by(f64::total_cmp);
        Turn { times, processor }
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[tokio::main]
async fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let Some(port) = arguments.iter().skip_while(|argument| *argument != ECHO).nth(1) {
        return run_echo(port.parse().expect("a port")).await;
    }
    let rounds: usize = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(5);
    let folder = tempfile::tempdir().expect("a folder");
    let picture = picture();
    println!(
        "a JPEG of {} kB, {rounds} rounds; milliseconds, medians of the rounds",
        picture.bytes.len() / 1000
    );
    println!(
        "{:<22} {:>9} {:>9} {:>14} {:>9} {:>9} {:>14}",
        "frames/s", "30", "99 %", "processor", "1000", "99 %", "processor"
    );
    let answerers = [
        ("bare echo", Answerer::echo()),
        ("node", Answerer::node(folder.path(), 0.0)),
        ("node, audited", Answerer::node(folder.path(), 0.02)),
        (
            "at once, 10 ms",
            Answerer::at_once(folder.path(), "slow_10"),
        ),
        ("at once, 110 ms", Answerer::at_once(folder.path(), "slow")),
        (
            "at once, 265 ms",
            Answerer::at_once(folder.path(), "slow_265"),
        ),
    ];
    let mut lines = Vec::new();
    for (_, answerer) in &answerers {
        lines.push(Line::to(answerer).await);
    }
    let mut turns: Vec<[Vec<Turn>; 2]> = vec![Default::default(); answerers.len()];
    for _ in 0..rounds {
        for (place, (rate, frames)) in TURNS.into_iter().enumerate() {
            for (line, turns) in lines.iter_mut().zip(&mut turns) {
                turns[place].push(line.turn(&picture, rate, frames).await);
            }
        }
    }
    let mut summaries = Vec::new();
    for ((name, _), rates) in answerers.iter().zip(&turns) {
        let [slow, fast] = rates.each_ref().map(|turns| Summary::new(turns));
        print!("{name:<22}");
        for summary in [&slow, &fast] {
            print!(" {:>9.3}", summary.median);
            print!(" {:>9.3}", summary.late);
            print!(" {:>14.3}", summary.processor);
        }
        println!();
        summaries.push([slow, fast]);
    }
    let [echo_slow, echo_fast] = &summaries[0];
    let [node_slow, node_fast] = &summaries[1];
    println!(
        "the node adds {:.3} ms at 30 frames/s and {:.3} ms at 1000; its processor time is {:.2} times the echo's",
        node_slow.median - echo_slow.median,
        node_fast.median - echo_fast.median,
        node_fast.processor / echo_fast.processor
    );
}
