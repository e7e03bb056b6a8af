//! Compares three ways to send frames of 1920x1080 at 30 frames per second from a sender on the node's machine: raw
//! pixels in shared memory, raw pixels as bytes over TCP, and a JPEG file of about 36 kB. They take turns within one
//! run. Nearly every frame is a `P` frame, whose pixels are not needed.
//!
//! ```text
//! cargo bench --bench shared_memory [-- ROUNDS]
//! ```
//!
//! Prints per frame: the time in which the sender copies the picture's bytes into the send buffer; the time from there
//! to the arrival of the detections, without and with that copy (median and 99th percentile); the processor time of
//! node and sender. A camera that writes its pictures into shared memory needs no copy.

#![allow(clippy::expect_used, clippy::print_stdout)]

use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{EncodedPicture, FrameLimits, PictureFormat, to_jpeg};
use albireo_wire::{DetectionsMessage, FrameAttachment, VERSION, read};
use bytes::Bytes;
use std::collections::HashMap;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::shm::{GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};

const SIZE: PictureSize = PictureSize::new(1920, 1080);
const RATE: f64 = 30.0;
/// The frames of one turn. The frames of `WARM_UP` come first and do not count.
const FRAMES: u64 = 300;
const WARM_UP: u64 = 30;

/// Grey stripes with some noise, 3.1 MB of raw pixels.
fn raw() -> EncodedPicture {
    let pixels = SIZE.width as usize * SIZE.height as usize;
    let mut noise = 1_u32;
    let mut bytes = Vec::with_capacity(pixels * 3 / 2);
    for index in 0..pixels {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let stripe = if (index / 97) % 19 < 9 { 90 } else { 120 };
        bytes.push(stripe + u8::from(noise >> 24 > 253) * 20);
    }
    bytes.resize(pixels * 3 / 2, 128);
    EncodedPicture {
        format: PictureFormat::Nv12,
        bytes: Bytes::from(bytes),
        size: SIZE,
        mount: None,
    }
}

/// A smooth picture, whose file is as small as that of a typical camera.
fn jpeg() -> EncodedPicture {
    let width = SIZE.width as usize;
    let pixels = width * SIZE.height as usize;
    let mut bytes: Vec<u8> = (0..pixels).map(|index| (index % width * 255 / width) as u8).collect();
    bytes.resize(pixels * 3 / 2, 128);
    let soft = EncodedPicture {
        format: PictureFormat::Nv12,
        bytes: Bytes::from(bytes),
        size: SIZE,
        mount: None,
    };
    EncodedPicture {
        format: PictureFormat::Jpeg,
        bytes: to_jpeg(&soft, &FrameLimits::default()).expect("a picture is coded"),
        size: SIZE,
        mount: None,
    }
}

struct Node(Child);

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A node whose detector runs on 1 frame of 1,000, without an audit.
fn node(folder: &std::path::Path, port: u16) -> Node {
    let file = folder.join("node.toml");
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/models/yolox_nano.onnx");
    let text = format!(
        "http.listen = \"127.0.0.1:0\"\nzenoh.listen = [\"tcp/127.0.0.1:{port}\"]\nzenoh.shared_memory = true\nlog.level = \"warn\"\n\
         detector.model = \"{models}\"\npower.source = \"none\"\npolicy.name = \"fixed-skip\"\n\
         policy.fixed_skip.n = 1000\naudit.share = 0\n"
    );
    std::fs::write(&file, text).expect("the configuration is written");
    let child = Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(["node", "--config"])
        .arg(&file)
        .stdin(Stdio::null())
        .spawn()
        .expect("the node starts");
    Node(child)
}

/// The processor time of a process, user and system.
fn processor_time(pid: &str) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("/proc is there");
    let fields: Vec<u64> = stat
        .rsplit(") ")
        .next()
        .unwrap_or_default()
        .split(' ')
        .filter_map(|field| field.parse().ok())
        .collect();
    // The state is not a number and drops out, so user and system time are the 11th and 12th fields.
    let ticks: u64 = fields.iter().skip(10).take(2).sum();
    Duration::from_millis(ticks * 10)
}

/// A way to send pictures.
struct Way {
    name: &'static str,
    uses_shared_memory: bool,
    picture: EncodedPicture,
}

/// The moments of a sent frame.
struct Sent {
    /// When the copy of its bytes began.
    began: Instant,
    /// When they were in the send buffer.
    placed: Instant,
}

/// The results of one turn, in milliseconds per frame.
struct Turn {
    copies: Vec<f64>,
    /// The times from the put to the answer, without the copy.
    latencies: Vec<f64>,
    /// The same times with the copy.
    whole_latencies: Vec<f64>,
    node_ms: f64,
    sender_ms: f64,
    missing: u64,
}

/// The arrival of a frame's detections.
struct Answer {
    seq: u64,
    arrived: Instant,
}

/// A session with the node, as a camera that listens to its answers.
struct Line {
    session: zenoh::Session,
    frames: Publisher<'static>,
    answers: UnboundedReceiver<Answer>,
}

/// Opens a session with the node, and waits until it subscribes to the frames.
async fn connect(port: u16) -> Line {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("connect/timeout_ms", "20000".to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        // The sender places only frames in shared memory, and does that itself.
        (
            "transport/shared_memory/transport_optimization/enabled",
            "false".to_owned(),
        ),
    ] {
        config.insert_json5(key, &value).expect("Zenoh takes it");
    }
    let session = zenoh::open(config).await.expect("the node is there");
    let (tell, answers) = unbounded_channel();
    session
        .declare_subscriber("albireo/node/front/detections")
        .callback(move |sample| {
            let arrived = Instant::now();
            if let Ok(message) = read::<DetectionsMessage>(&sample.payload().to_bytes()) {
                let seq = message.seq;
                let _ = tell.send(Answer { seq, arrived });
            }
        })
        .background()
        .await
        .expect("a subscriber");
    let frames = session
        .declare_publisher("albireo/node/front/frame")
        .await
        .expect("a publisher");
    let matching = frames.matching_listener().await.expect("a listener");
    while !frames.matching_status().await.expect("a status").matching() {
        matching.recv_async().await.expect("the node listens");
    }
    Line {
        session,
        frames,
        answers,
    }
}

/// Sends the frames of a turn, of which the first has the sequence number `first`, and waits for their answers.
async fn turn(port: u16, pid: u32, way: &Way, first: u64) -> Turn {
    let picture = &way.picture;
    let mut line = connect(port).await;
    let memory = way.uses_shared_memory.then(|| shared_memory(picture.bytes.len()));
    let mut copies = Vec::new();
    let mut sent = HashMap::new();
    let mut clock = tokio::time::interval(Duration::from_secs_f64(1.0 / RATE));
    let pid = pid.to_string();
    let mut node_began = Duration::ZERO;
    let mut sender_began = Duration::ZERO;
    for number in 0..WARM_UP + FRAMES {
        clock.tick().await;
        if number == WARM_UP {
            node_began = processor_time(&pid);
            sender_began = processor_time("self");
        }
        let seq = first + number;
        let attachment = FrameAttachment {
            v: VERSION,
            seq: Some(seq),
            width: Some(SIZE.width),
            height: Some(SIZE.height),
            ..FrameAttachment::default()
        };
        let encoding = match picture.format {
            PictureFormat::Jpeg => "image/jpeg".to_owned(),
            raw => format!("image/raw;{}", raw.as_str()),
        };
        let began = Instant::now();
        let payload = match &memory {
            Some(memory) => place(memory, &picture.bytes),
            None => ZBytes::from(picture.bytes.as_ref()),
        };
        let placed = Instant::now();
        if number >= WARM_UP {
            copies.push((placed - began).as_secs_f64() * 1e3);
            sent.insert(seq, Sent { began, placed });
        }
        line.frames
            .put(payload)
            .encoding(encoding)
            .attachment(serde_json::to_vec(&attachment).expect("JSON"))
            .wait()
            .expect("Zenoh takes a frame");
    }
    let mut latencies = Vec::new();
    let mut whole_latencies = Vec::new();
    while let Ok(Some(Answer { seq, arrived })) =
        tokio::time::timeout(Duration::from_secs(1), line.answers.recv()).await
    {
        if let Some(frame) = sent.remove(&seq) {
            latencies.push((arrived - frame.placed).as_secs_f64() * 1e3);
            whole_latencies.push((arrived - frame.began).as_secs_f64() * 1e3);
        }
    }
    let node_time = processor_time(&pid) - node_began;
    let sender_time = processor_time("self") - sender_began;
    line.session.close().await.expect("the session is closed");
    for times in [&mut copies, &mut latencies, &mut whole_latencies] {
        times.sort_by(f64::total_cmp);
    }
    let a_frame = |time: Duration| time.as_secs_f64() * 1e3 / FRAMES as f64;
    Turn {
        copies,
        latencies,
        whole_latencies,
        node_ms: a_frame(node_time),
        sender_ms: a_frame(sender_time),
        missing: sent.len() as u64,
    }
}

/// Shared memory for 12 pictures: those that wait, those that the node reads, and those in transit.
fn shared_memory(bytes: usize) -> ShmProvider<PosixShmProviderBackend> {
    ShmProviderBuilder::default_backend(12 * bytes).wait().expect("shared memory")
}

fn place(memory: &ShmProvider<PosixShmProviderBackend>, picture: &[u8]) -> ZBytes {
    let room = memory.alloc(picture.len());
    let mut room = room.with_policy::<GarbageCollect>().wait().expect("room for a picture");
    room.copy_from_slice(picture);
    room.into()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[tokio::main]
async fn main() {
    let rounds: usize =
        std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(3);
    let folder = tempfile::tempdir().expect("a folder");
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port")
        .port();
    let node = node(folder.path(), port);
    let raw = raw();
    let jpeg = jpeg();
    println!(
        "1920x1080 at {RATE} frames/s, {rounds} rounds of {FRAMES} frames; milliseconds per frame; JPEG of {} kB",
        jpeg.bytes.len() / 1000
    );
    println!(
        "{:<20} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9} {:>10} {:>8}",
        "", "placing", "placed", "99 %", "in all", "99 %", "node cpu", "sender cpu", "missing"
    );
    let ways = [
        Way {
            name: "raw, shared memory",
            uses_shared_memory: true,
            picture: raw.clone(),
        },
        Way {
            name: "raw, as bytes",
            uses_shared_memory: false,
            picture: raw,
        },
        Way {
            name: "JPEG, as bytes",
            uses_shared_memory: false,
            picture: jpeg,
        },
    ];
    let mut turns: [Vec<Turn>; 3] = Default::default();
    let mut first = 0;
    for _ in 0..rounds {
        for (way, turns) in ways.iter().zip(&mut turns) {
            turns.push(turn(port, node.0.id(), way, first).await);
            first += WARM_UP + FRAMES;
        }
    }
    for (way, turns) in ways.iter().zip(&turns) {
        let percentile = |times_of_turn: fn(&Turn) -> &Vec<f64>, share: f64| {
            let mut percentiles = Vec::new();
            for turn in turns {
                let times = times_of_turn(turn);
                let place = (times.len() as f64 * share) as usize;
                percentiles.push(times.get(place).copied().unwrap_or(f64::NAN));
            }
            median(percentiles)
        };
        println!(
            "{:<20} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {:>9.3} {:>10.3} {:>8}",
            way.name,
            percentile(|turn| &turn.copies, 0.5),
            percentile(|turn| &turn.latencies, 0.5),
            percentile(|turn| &turn.latencies, 0.99),
            percentile(|turn| &turn.whole_latencies, 0.5),
            percentile(|turn| &turn.whole_latencies, 0.99),
            median(turns.iter().map(|turn| turn.node_ms).collect()),
            median(turns.iter().map(|turn| turn.sender_ms).collect()),
            turns.iter().map(|turn| turn.missing).sum::<u64>()
        );
    }
}
