//! Feeds untrusted input to every parser. Each function must return for any bytes. A panic, an overflow, unbounded
//! memory or a value that changes when it is written and read again is a fault. The result is `true` for valid bytes,
//! which exposes a corpus whose inputs are all rejected.

use albireo_core::geometry::PictureSize;
use albireo_hub::config::HubConfig;
use albireo_hub::tuning::plan::RolloutPlan;
use albireo_hub::tuning::selector::Selector;
use albireo_node::PreparedNode;
use albireo_node::config::NodeConfig;
use albireo_node::input::{PayloadFormat, RawSample, read_frame};
use albireo_node::position::positions_in;
use albireo_power::tegrastats_rails;
use albireo_recording::{
    Mended, Messages, Overview, PictureKind, mend, picture_in_json, picture_in_protobuf,
};
use albireo_router::authority::Entry;
use albireo_service::config::{Configuration, examine_text};
use albireo_vision::onnx::Metadata;
use albireo_vision::picture::{
    FrameLimits, Picture, PixelLayout, decode, read_part, read_png, read_ppm,
};
use albireo_wire::{
    BatchCompression, Desired, Heartbeat, NodeKeys, NodeStatus, ReportAnswer, ReportBatch,
    RevisionMessage, StatusMessage, TargetMessage, ThresholdChange, ThresholdMessage, read,
    stream_of_token,
};
use axum::body::Body;
use axum::http::Request;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::Debug;
use tokio::runtime::{Builder, Runtime};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tower_service::Service;
use zenoh::key_expr::KeyExpr;

/// A target: the name that it shares with its corpus, and the function that takes the bytes.
pub type Target = (&'static str, fn(&[u8]) -> bool);

/// All targets, by name.
pub const TARGETS: [Target; 17] = [
    ("access", access),
    ("attachment", attachment),
    ("desired", desired),
    ("frame", frame),
    ("http_body", http_body),
    ("hub_toml", toml::<HubConfig>),
    ("model_metadata", model_metadata),
    ("names", names),
    ("node_toml", toml::<NodeConfig>),
    ("picture_stream", picture_stream),
    ("position", position),
    ("recording", recording),
    ("report_batch", report_batch),
    ("rollout", rollout),
    ("ros2", ros2),
    ("status", status),
    ("tegrastats", tegrastats),
];

/// Feeds `data` to the target with that name.
pub fn fuzz(name: &str, data: &[u8]) {
    let named = TARGETS.into_iter().find(|(target, _)| *target == name);
    let (_, target) = named.expect("a target with that name");
    target(data);
}

/// Small limits, to keep each input fast.
fn limits() -> FrameLimits {
    FrameLimits {
        max_payload_bytes: 1 << 20,
        ..FrameLimits::default()
    }
}

/// True if this sample is a frame whose picture can be decoded.
fn sample(
    payload: &[u8],
    encoding: &str,
    attachment: Option<&[u8]>,
    format: PayloadFormat,
) -> bool {
    let raw = RawSample {
        payload: payload.to_vec().into(),
        encoding: encoding.into(),
        attachment: attachment.map(Into::into),
        timestamp_ns: None,
        arrival: 0,
        received: Instant::now(),
    };
    let (_, Ok(frame)) = read_frame(raw, format, &limits()) else {
        return false;
    };
    // A small input may declare a huge picture, which takes too long to decode.
    if frame.picture.size.pixels() > 1 << 20 {
        return false;
    }
    let mut into = Picture::black(PictureSize::new(1, 1));
    let target = Some(PictureSize::new(64, 64));
    let decodes = |layout| decode(&frame.picture, &limits(), layout, target, &mut into).is_ok();
    any([PixelLayout::Rgb8, PixelLayout::Gray8].map(decodes))
}

/// True if one of several attempts succeeded. Takes them done, unlike `||`, which would spare the second parser what the
/// first one takes.
fn any<const N: usize>(attempts: [bool; N]) -> bool {
    attempts.contains(&true)
}

/// A frame's payload: the first byte chooses the encoding that the sample names.
fn frame(data: &[u8]) -> bool {
    const ENCODINGS: [&str; 7] = [
        "",
        "image/jpeg",
        "image/png",
        "image/raw;rgb8",
        "image/raw;gray8",
        "image/raw;nv12",
        "image/webp",
    ];
    let Some((first, payload)) = data.split_first() else {
        return false;
    };
    let encoding = ENCODINGS[usize::from(*first) % ENCODINGS.len()];
    let size = br#"{"v":1,"width":16,"height":16}"#;
    sample(payload, encoding, Some(size), PayloadFormat::Encoding)
}

/// The attachment of an otherwise valid frame of 2 × 2 pixels.
fn attachment(data: &[u8]) -> bool {
    let raw = "image/raw;rgb8";
    sample(&[7; 12], raw, Some(data), PayloadFormat::Encoding)
}

/// A picture as ROS 2 sends it.
fn ros2(data: &[u8]) -> bool {
    sample(data, "", None, PayloadFormat::Ros2)
}

/// The output of a camera's program: a sequence of multipart parts, PNG files or PPM files.
fn picture_stream(data: &[u8]) -> bool {
    /// Reads to the end; true if there was a picture and no error after it.
    fn drain<T, E>(data: &[u8], mut next: impl FnMut(&mut &[u8]) -> Result<Option<T>, E>) -> bool {
        let mut stream = data;
        loop {
            let before = stream.len();
            match next(&mut stream) {
                Ok(Some(_)) => assert!(stream.len() < before, "nothing was read"),
                ended => return ended.is_ok() && before < data.len(),
            }
        }
    }
    any([
        drain(data, |stream| read_part(stream, 1 << 16)),
        drain(data, |stream| read_png(stream, 1 << 16)),
        drain(data, |stream| read_ppm(stream, &limits())),
    ])
}

/// Reads JSON. A valid value must be equal after it is written and read again.
fn json<T: DeserializeOwned + Serialize + PartialEq + Debug>(data: &[u8]) -> bool {
    let Ok(first) = serde_json::from_slice::<T>(data) else {
        return false;
    };
    let written = serde_json::to_vec(&first).expect("it can be written");
    let second: T = serde_json::from_slice(&written).expect("what was written can be read");
    assert_eq!(first, second);
    true
}

/// Does the same as [`json`] for a message with a version.
fn message<T: DeserializeOwned + Serialize + PartialEq + Debug>(data: &[u8]) -> bool {
    read::<T>(data).is_ok() && json::<T>(data)
}

/// The lines of a receiver of positions: NMEA 0183 or gpsd.
fn position(data: &[u8]) -> bool {
    let text = String::from_utf8_lossy(data);
    let found = positions_in(&text);
    assert!(found.iter().all(|position| position.check().is_ok()));
    !found.is_empty()
}

/// An MCAP file: what it holds, its pictures, and the file that takes its place if it has no end.
fn recording(data: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fuzzed.mcap");
    std::fs::write(&path, data).expect("the file can be written");
    let found = Overview::read(&path);
    for message in Messages::open(&path).expect("the file is there") {
        match PictureKind::of(&message.channel) {
            Some(PictureKind::FoxgloveProtobuf) => drop(picture_in_protobuf(&message.data)),
            Some(PictureKind::FoxgloveJson) => drop(picture_in_json(&message.data)),
            Some(PictureKind::Ros2) => drop(ros2(&message.data)),
            None => {}
        }
    }
    if let Ok(Mended::Mended { .. }) = mend(&path) {
        Overview::read(&path).expect("a mended file can be read");
    }
    found.is_ok_and(|overview| !overview.channels.is_empty())
}

/// A batch of reports, and the answer to one.
fn report_batch(data: &[u8]) -> bool {
    message::<ReportAnswer>(data);
    // Fuzzing rarely gets past the compression, so plain JSON is an input too.
    let Ok(mut batch) = read(data).or_else(|_| ReportBatch::from_payload(data)) else {
        return false;
    };
    for compression in [BatchCompression::Best, BatchCompression::Quick] {
        if let Ok(payload) = batch.to_payload(compression) {
            let again = ReportBatch::from_payload(&payload).expect("it can be read");
            assert_eq!(again, batch);
        }
    }
    for report in &mut batch.reports {
        report.round();
    }
    true
}

/// What a node sends of itself: its status, in full or in short, and heartbeats.
fn status(data: &[u8]) -> bool {
    let valid = any([message::<StatusMessage>(data), json::<NodeStatus>(data)]);
    let Ok(beat) = Heartbeat::read(data) else {
        return valid;
    };
    assert!(Heartbeat::is_one(data));
    let written = beat.to_payload().expect("a heartbeat can be written");
    assert_eq!(Heartbeat::read(&written).expect("it can be read"), beat);
    true
}

/// The settings that a hub or a user sends to a node.
fn desired(data: &[u8]) -> bool {
    any([
        message::<Desired>(data),
        message::<RevisionMessage>(data),
        json::<ThresholdMessage>(data),
        json::<ThresholdChange>(data),
        json::<TargetMessage>(data),
    ])
}

/// A configuration file. Without one there is a finding that says why.
fn toml<C: Configuration>(data: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(data) else {
        return false;
    };
    let (config, findings) = examine_text::<C>(text);
    assert!(config.is_some() || !findings.is_empty());
    findings.is_empty()
}

/// The metadata of a model: class names and size as exporters write them.
fn model_metadata(data: &[u8]) -> bool {
    let text = String::from_utf8_lossy(data).into_owned();
    let entry = |key: &str| (key.to_owned(), text.clone());
    let metadata = Metadata::new(["names", "imgsz", "args"].map(entry));
    let _ = (metadata.image_size(), metadata.is_end_to_end());
    let Ok(Some(names)) = metadata.class_names() else {
        return false;
    };
    assert!(!names.is_empty());
    if names.iter().all(|name| !name.contains(char::is_control)) {
        let written = serde_json::to_string(&names).expect("names can be written");
        let again = Metadata::new([("names".to_owned(), written)]);
        assert_eq!(again.class_names(), Ok(Some(names)));
    }
    true
}

/// A line of `tegrastats`.
fn tegrastats(data: &[u8]) -> bool {
    tegrastats_rails(&String::from_utf8_lossy(data)).is_some()
}

/// Names in Zenoh keys. The keys of an accepted name are valid in Zenoh and have no wildcard. The name is one chunk and
/// can be read back.
fn names(data: &[u8]) -> bool {
    let text = String::from_utf8_lossy(data);
    // Two lines are a prefix and a node, one is a node.
    let (prefix, node) = text.split_once('\n').unwrap_or(("albireo", &text));
    let _ = stream_of_token(&text);
    let _ = NodeKeys::node_of(&text);
    let Ok(keys) = NodeKeys::new(prefix, node) else {
        return false;
    };
    let status = keys.status();
    let key = KeyExpr::new(status.as_str()).expect("Zenoh takes the key");
    assert!(!key.is_wild(), "{key}");
    assert_eq!(NodeKeys::node_of(&status), Some(node));
    if let Ok(camera) = keys.camera(node) {
        let key = KeyExpr::new(camera.frame()).expect("Zenoh takes the key");
        assert!(!key.is_wild(), "{key}");
        let chunks = prefix.split('/').count() + 3;
        assert_eq!(key.split('/').count(), chunks, "{key}");
    }
    true
}

/// A selector of nodes, and the plan of a rollout, whose stages grow to all nodes and no further.
fn rollout(data: &[u8]) -> bool {
    if let Ok(selector) = Selector::new(&[String::from_utf8_lossy(data)]) {
        selector.selects(
            "car-7",
            &BTreeMap::from([("region".into(), "north".into())]),
        );
    }
    let Ok(plan) = serde_json::from_slice::<RolloutPlan>(data) else {
        return false;
    };
    if plan.check().is_err() {
        return false;
    }
    let written = serde_json::to_vec(&plan).expect("a plan can be written");
    let again: RolloutPlan = serde_json::from_slice(&written).expect("it can be read");
    assert_eq!(plan, again);
    for all in [1, 7, 100_000] {
        let ends = plan.stage_ends(all);
        assert!(ends.is_sorted(), "{ends:?}");
        assert!(ends.last() <= Some(&all), "{ends:?} of {all}");
    }
    true
}

/// A router's access rules, and the list of certificates that they are generated from.
fn access(data: &[u8]) -> bool {
    let text = String::from_utf8_lossy(data);
    let taken = zenoh::Config::default().insert_json5("access_control", &text);
    any([taken.is_ok(), json::<Vec<Entry>>(data)])
}

/// The routes of a node's HTTP API that take a body.
const CHANGES: [&str; 4] = [
    "/api/v1/threshold",
    "/api/v1/cameras/front/threshold",
    "/api/v1/policy",
    "/api/v1/target",
];

/// The body of a request: the first byte chooses its route.
fn http_body(data: &[u8]) -> bool {
    thread_local! {
        static RUNTIME: Runtime = Builder::new_current_thread().enable_all().build().expect("a runtime");
        static API: axum::Router = {
            let config = NodeConfig::default();
            let node = PreparedNode::new(&config).expect("a node in memory");
            node.router(&config, CancellationToken::new())
        };
    }
    let Some((first, body)) = data.split_first() else {
        return false;
    };
    let request = Request::put(CHANGES[usize::from(*first) % CHANGES.len()])
        .body(Body::from(body.to_vec()))
        .expect("a request");
    let answer = API.with(|api| api.clone().call(request));
    let answer = RUNTIME.with(|runtime| runtime.block_on(answer));
    let answer = answer.expect("an answer");
    assert!(!answer.status().is_server_error(), "{answer:?}");
    answer.status().is_success()
}
