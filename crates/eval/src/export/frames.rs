//! Reads the frames of a recording: each picture with its boxes.

use super::ExportedFrames;
use crate::error::EvalError;
use albireo_recording::{AuditMessage, Messages, Topic, picture_in_protobuf};
use albireo_wire::{BoxMessage, DetectionsMessage};
use bytes::Bytes;
use std::collections::BTreeMap;
use std::path::Path;

/// A frame with its boxes.
pub(super) struct LabelledFrame {
    pub camera: String,
    /// Capture time, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    pub seq: u64,
    /// Columns and rows of the picture.
    pub size: [u32; 2],
    /// A JPEG file.
    pub picture: Bytes,
    pub boxes: Vec<BoxMessage>,
}

/// What was read of a file.
#[derive(Debug, Default)]
pub(super) struct ReadFrames {
    /// False if nothing in it can be read.
    pub is_recording: bool,
    /// What is not in the export, a sentence each.
    pub left_out: Vec<String>,
    /// What a user of its frames must know, a sentence each.
    pub notes: Vec<String>,
}

/// Gives `each` the frames of a recording.
pub(super) fn read(
    path: &Path,
    frames: ExportedFrames,
    mut each: impl FnMut(LabelledFrame) -> Result<(), EvalError>,
) -> Result<ReadFrames, EvalError> {
    let (image, boxes) = match frames {
        ExportedFrames::Audit => (Topic::AuditImage, Topic::Audit),
        ExportedFrames::Shown => (Topic::Image, Topic::Detections),
    };
    let mut messages = Messages::open(path).map_err(|error| EvalError::content(path, error))?;
    // When the newest picture of each camera was recorded, and the picture if it can be read: its boxes follow it.
    let mut pictures = BTreeMap::new();
    let mut incomplete = 0;
    let mut used = 0;
    let mut read = ReadFrames::default();
    for message in messages.by_ref() {
        read.is_recording = true;
        let Some((camera, topic)) = Topic::parse(&message.channel.topic) else {
            continue;
        };
        if topic == image {
            let picture = picture_in_protobuf(&message.data).ok();
            pictures.insert(camera.to_owned(), (message.time_ns, picture));
        } else if topic == boxes {
            let newest = pictures.remove(camera);
            let labelled = match newest {
                Some((time_ns, Some(picture))) if time_ns == message.time_ns => {
                    frame(camera, frames, picture, &message.data)
                }
                _ => None,
            };
            match labelled {
                Some(frame) => {
                    each(frame)?;
                    used += 1;
                }
                None => incomplete += 1,
            }
        }
    }
    let file = path.display();
    if incomplete > 0 {
        read.left_out.push(format!(
            "{file}: {incomplete} frames have no picture or no boxes"
        ));
    }
    match messages.damage() {
        None => read.is_recording = true,
        Some(damage) if read.is_recording => read.notes.push(format!(
            "{file} ends early ({damage}), as one that is being written: the {used} frames before that are used"
        )),
        Some(damage) => read.left_out.push(format!(
            "{file} is no MCAP file, or was cut before its first frame: {damage}"
        )),
    }
    Ok(read)
}

/// The frame with its boxes, which are in the `text` of a message; `None` if that cannot be read.
fn frame(
    camera: &str,
    frames: ExportedFrames,
    picture: Bytes,
    text: &Bytes,
) -> Option<LabelledFrame> {
    let camera = camera.to_owned();
    match frames {
        ExportedFrames::Audit => {
            let audit: AuditMessage = serde_json::from_slice(text).ok()?;
            Some(LabelledFrame {
                camera,
                t_ns: audit.t_ns,
                seq: audit.seq,
                size: [audit.width, audit.height],
                picture,
                boxes: audit.detected,
            })
        }
        ExportedFrames::Shown => {
            let shown: DetectionsMessage = serde_json::from_slice(text).ok()?;
            Some(LabelledFrame {
                camera,
                t_ns: shown.t_ns,
                seq: shown.seq,
                size: [shown.width, shown.height],
                picture,
                boxes: shown.boxes,
            })
        }
    }
}
