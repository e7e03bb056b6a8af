use super::*;
use albireo_core::detection::ObjectId;
use albireo_core::policy::{BoxSource, FrameState};
use albireo_wire::{BoxMessage, DetectionsMessage, Latency, Position, Threshold, VERSION};
use bytes::Bytes;
use std::fs::OpenOptions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn detections(seq: u64) -> DetectionsMessage {
    DetectionsMessage {
        v: VERSION,
        seq,
        t_ns: 1_700_000_000_000_000_000 + seq * 100_000_000,
        clip: "drive".to_owned(),
        state: FrameState::P,
        pending: false,
        degraded: false,
        cause: None,
        passed: None,
        tau_max: Some(2e-4),
        threshold: Some(Threshold::new("u", 3e-4)),
        width: 64,
        height: 48,
        boxes: vec![BoxMessage {
            corners: [1.0, 2.0, 30.0, 40.0],
            class: "car".to_owned(),
            confidence: 0.75,
            source: BoxSource::Predicted,
            object: Some(ObjectId(7)),
            confirmed: true,
        }],
        latency_ms: Latency::default(),
    }
}

const HERE: Position = Position {
    latitude: 48.1,
    longitude: 11.6,
    speed_m_s: Some(12.5),
};

/// A picture so large that eleven of them fill a chunk.
fn picture(seq: u64) -> Bytes {
    vec![seq as u8; 100_000].into()
}

/// A recording of thirty frames.
fn recording(folder: &TempDir) -> (PathBuf, RecordingFile) {
    let path = folder.path().join("front.mcap");
    let mut file = RecordingFile::create(&path).unwrap();
    for seq in 0..30 {
        file.frame("front", picture(seq), &detections(seq), Some(&HERE)).unwrap();
    }
    (path, file)
}

/// The numbers of the frames whose picture and message are in a file, and its damage.
fn read(path: &Path) -> (Vec<u64>, Option<String>) {
    let mut pictures = 0;
    let mut numbers = Vec::new();
    let mut messages = Messages::open(path).unwrap();
    for message in messages.by_ref() {
        match Topic::parse(&message.channel.topic) {
            Some(("front", Topic::Image)) => {
                assert_eq!(
                    PictureKind::of(&message.channel),
                    Some(PictureKind::FoxgloveProtobuf)
                );
                assert_eq!(
                    picture_in_protobuf(&message.data).unwrap(),
                    picture(pictures)
                );
                pictures += 1;
            }
            Some(("front", Topic::Detections)) => {
                let read: DetectionsMessage = serde_json::from_slice(&message.data).unwrap();
                assert_eq!(read, detections(read.seq));
                assert_eq!(message.time_ns, read.t_ns);
                numbers.push(read.seq);
            }
            Some(("front", Topic::Boxes | Topic::Figures | Topic::Position)) => {}
            other => panic!("{other:?}"),
        }
    }
    (numbers, messages.damage().map(str::to_owned))
}

fn cut(path: &Path, bytes: u64) {
    OpenOptions::new().write(true).open(path).unwrap().set_len(bytes).unwrap();
}

#[test]
fn what_is_recorded_is_read_again_and_only_its_owner_may_read_it() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = recording(&folder);
    assert!(file.bytes() > 3_000_000);
    file.finish().unwrap();
    let (numbers, damage) = read(&path);
    assert_eq!(numbers, Vec::from_iter(0..30));
    assert_eq!(damage, None);
    let overview = Overview::read(&path).unwrap();
    let topics = overview.channels.iter().map(|(channel, count)| (&*channel.topic, *count));
    let expected = [
        "/front/boxes",
        "/front/detections",
        "/front/figures",
        "/front/image",
        "/front/position",
    ];
    assert!(topics.eq(expected.map(|topic| (topic, 30))));
    assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    assert!(
        RecordingFile::create(&path).is_err(),
        "no recording is written over"
    );
}

#[test]
fn a_recording_that_is_cut_anywhere_is_read_and_mended_up_to_its_last_whole_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = recording(&folder);
    file.finish().unwrap();
    let whole = std::fs::read(&path).unwrap();
    let mut least = 0;
    for part in 0..20 {
        std::fs::write(&path, &whole).unwrap();
        cut(&path, whole.len() as u64 * part / 20);
        let (numbers, damage) = read(&path);
        assert!(damage.is_some(), "{part}");
        assert!(
            numbers.iter().copied().eq(0..numbers.len() as u64),
            "in order, none missing"
        );
        assert!(
            numbers.len() >= least,
            "{part}: more of the file holds no fewer frames"
        );
        least = numbers.len();
        let mended = mend(&path).unwrap();
        if mended == Mended::Removed {
            assert!(numbers.is_empty() && !path.exists(), "{part}");
            continue;
        }
        assert!(matches!(mended, Mended::Mended { .. }), "{part}");
        let (mended_numbers, damage) = read(&path);
        assert_eq!(mended_numbers, numbers, "{part}");
        assert_eq!(damage, None, "{part}");
        assert_eq!(mend(&path).unwrap(), Mended::Whole);
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    }
    // Of the thirty frames' three chunks the longest cut left the first two whole.
    assert!(least >= 20, "{least}");
}

#[test]
fn what_is_kept_is_read_while_the_file_is_being_written() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut file) = recording(&folder);
    file.keep().unwrap();
    let (numbers, damage) = read(&path);
    assert_eq!(numbers.len(), 30);
    assert!(damage.is_some(), "it has no end yet");
    let overview = Overview::read(&path).unwrap();
    assert!(overview.damage.is_some());
    assert_eq!(overview.channels.len(), 5);
    drop(file);
    let (numbers, damage) = read(&path);
    assert_eq!(numbers, Vec::from_iter(0..30));
    assert_eq!(damage, None);
}

#[test]
fn a_changed_byte_costs_the_messages_from_its_chunk_on() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = recording(&folder);
    file.finish().unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let (numbers, damage) = read(&path);
    assert!((10..20).contains(&numbers.len()), "{}", numbers.len());
    assert!(damage.is_some());
}

#[test]
fn every_field_of_a_message_is_in_its_schema() {
    let mut message = detections(0);
    message.pending = true;
    message.degraded = true;
    message.passed = Some(albireo_core::policy::PassCause::Unchanged);
    message.cause = Some(albireo_core::policy::CallCause::EmptyLimit);
    let value = serde_json::to_value(&message).unwrap();
    let schema = Topic::Detections.json_schema().unwrap();
    for (field, value) in value.as_object().unwrap() {
        let known = &schema["properties"][field];
        let written_type = if value.is_string() {
            "string"
        } else if value.is_boolean() {
            "boolean"
        } else if value.is_u64() {
            "integer"
        } else if value.is_number() {
            "number"
        } else if value.is_array() {
            "array"
        } else {
            "object"
        };
        assert_eq!(known["type"], written_type, "{field}");
    }
    let written = value["boxes"][0].as_object().unwrap();
    let known = schema["properties"]["boxes"]["items"]["properties"].as_object().unwrap();
    assert!(written.keys().eq(known.keys()));
}

#[test]
fn what_is_no_recording_is_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for text in ["", "no recording", "\u{89}MCAP0\r\n"] {
        std::fs::write(&path, text).unwrap();
        let error = Overview::read(&path).err().unwrap().to_string();
        assert!(!error.is_empty());
        let (_, damage) = read(&path);
        assert!(damage.is_some());
    }
    assert!(Overview::read(Path::new("no/such.mcap")).is_err());
}

#[test]
fn a_full_disk_is_called_a_full_disk() {
    let full = || std::io::Error::from(std::io::ErrorKind::StorageFull);
    let error = RecordingError::from(McapError::Io(full()));
    assert_eq!(error.to_string(), full().to_string());
}
