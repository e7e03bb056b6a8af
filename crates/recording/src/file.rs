//! Writes a recording, which is whole up to its last `keep` whatever happens to the machine.

use crate::annotations::annotations;
use crate::foxglove::{CompressedImage, Figures, LocationFix, timestamp};
use crate::message::{AuditMessage, EventMessage, Topic};
use crate::{RecordingError, schema};
use albireo_core::policy::FrameState;
use albireo_wire::{DetectionsMessage, Position};
use bytes::Bytes;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{WriteOptions, Writer};
use prost::Message;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// A chunk is written when it is as large as this, and whenever the file is [kept](RecordingFile::keep). Until then it
/// is in memory. It is certain to survive a power cut only after `keep`, which waits for the disk.
const CHUNK_BYTES: u64 = 1 << 20;

/// Only the node's user may read recordings: they show people.
const OWNER_ONLY: u32 = 0o600;

/// A recording that is being written. Dropping it writes the index, too, but neither waits for the disk, as
/// [`finish`](Self::finish) does, nor says whether that worked.
pub struct RecordingFile {
    writer: Writer<NoSeek<File>>,
    /// The same file, to wait for the disk.
    file: File,
    /// The channel of each topic, by its name.
    channels: BTreeMap<String, u16>,
    messages: u32,
    bytes: u64,
}

impl RecordingFile {
    /// Creates a file that did not exist, which only this user may read.
    ///
    /// # Errors
    /// If there is one of this name, or the file system refuses.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let (writer, file) = create_writer(path)?;
        Ok(Self {
            writer,
            file,
            channels: BTreeMap::new(),
            messages: 0,
            bytes: 0,
        })
    }

    /// Adds a frame: its picture as a JPEG file, its published message, and where it was taken if that is known.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn frame(
        &mut self,
        camera: &str,
        picture: Bytes,
        detections: &DetectionsMessage,
        position: Option<&Position>,
    ) -> Result<(), RecordingError> {
        let t_ns = detections.t_ns;
        let boxes = annotations(&detections.boxes, t_ns, detections.height);
        self.picture(camera, Topic::Image, t_ns, picture)?;
        self.put(camera, Topic::Boxes, t_ns, &boxes.encode_to_vec())?;
        let figures = figures(detections, position).encode_to_vec();
        self.put(camera, Topic::Figures, t_ns, &figures)?;
        if let Some(position) = position {
            let fix = LocationFix {
                latitude: position.latitude,
                longitude: position.longitude,
                timestamp: timestamp(t_ns),
                frame_id: camera.to_owned(),
            };
            self.put(camera, Topic::Position, t_ns, &fix.encode_to_vec())?;
        }
        self.put_json(camera, Topic::Detections, t_ns, detections)
    }

    /// Adds a frame on which the audit found a difference, with its picture as a JPEG file.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn audited(
        &mut self,
        camera: &str,
        picture: Bytes,
        audit: &AuditMessage,
    ) -> Result<(), RecordingError> {
        let t_ns = audit.t_ns;
        let boxes = annotations(&audit.detected, t_ns, audit.height);
        self.picture(camera, Topic::AuditImage, t_ns, picture)?;
        self.put(camera, Topic::AuditBoxes, t_ns, &boxes.encode_to_vec())?;
        self.put_json(camera, Topic::Audit, t_ns, audit)
    }

    /// Adds the reason for the recording.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn event(&mut self, camera: &str, event: &EventMessage) -> Result<(), RecordingError> {
        self.put_json(camera, Topic::Event, event.t_ns, event)
    }

    /// The bytes of its messages, without the index.
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Ends the chunk, so that what was added until now survives a power cut. Waits for the disk.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn keep(&mut self) -> Result<(), RecordingError> {
        self.writer.flush()?;
        self.file.sync_data()?;
        Ok(())
    }

    /// Ends the file with its index. Waits for the disk.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish()?;
        self.file.sync_all()?;
        Ok(())
    }

    fn picture(
        &mut self,
        camera: &str,
        topic: Topic,
        t_ns: u64,
        data: Bytes,
    ) -> Result<(), RecordingError> {
        let image = CompressedImage {
            timestamp: timestamp(t_ns),
            data,
            format: "jpeg".to_owned(),
            frame_id: camera.to_owned(),
        };
        self.put(camera, topic, t_ns, &image.encode_to_vec())
    }

    fn put_json(
        &mut self,
        camera: &str,
        topic: Topic,
        t_ns: u64,
        message: &impl serde::Serialize,
    ) -> Result<(), RecordingError> {
        let text = serde_json::to_vec(message)
            .map_err(|error| RecordingError::Message(error.to_string()))?;
        self.put(camera, topic, t_ns, &text)
    }

    fn put(
        &mut self,
        camera: &str,
        topic: Topic,
        t_ns: u64,
        message: &[u8],
    ) -> Result<(), RecordingError> {
        let channel_id = self.channel(camera, topic)?;
        let header = MessageHeader {
            channel_id,
            sequence: self.messages,
            log_time: t_ns,
            publish_time: t_ns,
        };
        self.messages = self.messages.wrapping_add(1);
        self.writer.write_to_known_channel(&header, message)?;
        self.bytes += message.len() as u64;
        Ok(())
    }

    /// The channel of a topic, which is added with its first message.
    fn channel(&mut self, camera: &str, topic: Topic) -> Result<u16, RecordingError> {
        let name = topic.of(camera);
        if let Some(known) = self.channels.get(&name) {
            return Ok(*known);
        }
        let encoding;
        let schema;
        match topic.json_schema() {
            Some(json) => {
                let text = json.to_string().into_bytes();
                encoding = "json";
                schema = self.writer.add_schema(topic.schema(), "jsonschema", &text)?;
            }
            None => {
                let text = schema::protobuf();
                encoding = "protobuf";
                schema = self.writer.add_schema(topic.schema(), "protobuf", &text)?;
            }
        }
        let no_metadata = BTreeMap::new();
        let channel = self.writer.add_channel(schema, &name, encoding, &no_metadata)?;
        self.channels.insert(name, channel);
        Ok(channel)
    }
}

/// A writer of a new file, and the file itself, to wait for the disk.
pub(crate) fn create_writer(path: &Path) -> Result<(Writer<NoSeek<File>>, File), RecordingError> {
    let file = OpenOptions::new().write(true).create_new(true).mode(OWNER_ONLY).open(path)?;
    let written = file.try_clone()?;
    // Without seeking, a chunk reaches the file in one piece, after those before it.
    let writer = WriteOptions::new()
        .compression(None)
        .disable_seeking(true)
        .chunk_size(Some(CHUNK_BYTES))
        .library(concat!("albireo ", env!("CARGO_PKG_VERSION")))
        .create(NoSeek::new(written))?;
    Ok((writer, file))
}

/// What a viewer plots of a frame.
fn figures(detections: &DetectionsMessage, position: Option<&Position>) -> Figures {
    // As a number, because viewers plot no names.
    let state_number = FrameState::ALL
        .iter()
        .position(|state| *state == detections.state)
        .and_then(|index| i32::try_from(index).ok());
    let threshold = detections.threshold.map(|threshold| threshold.value);
    let objects = detections.boxes.iter().filter_map(|found| found.object);
    Figures {
        timestamp: timestamp(detections.t_ns),
        seq: detections.seq,
        state: state_number.unwrap_or(-1),
        skipped: detections.skipped_detector(),
        degraded: detections.degraded,
        tau_max: detections.tau_max.unwrap_or(f64::NAN),
        threshold: threshold.unwrap_or(f64::NAN),
        boxes: u32::try_from(detections.boxes.len()).unwrap_or(u32::MAX),
        objects: objects.map(|object| object.0).collect(),
        latency_ms: detections.latency_ms.total,
        speed_m_s: position.and_then(|position| position.speed_m_s).unwrap_or(f64::NAN),
    }
}
