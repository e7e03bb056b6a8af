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

/// Gives `each` the frames of a recording. Returns what could not be read, a sentence each.
pub(super) fn read(
    path: &Path,
    frames: ExportedFrames,
    mut each: impl FnMut(LabelledFrame) -> Result<(), EvalError>,
) -> Result<Vec<String>, EvalError> {
    let (image, boxes) = match frames {
        ExportedFrames::Audit => (Topic::AuditImage, Topic::Audit),
        ExportedFrames::Shown => (Topic::Image, Topic::Detections),
    };
    let mut messages = Messages::open(path).map_err(|error| EvalError::content(path, error))?;
    // When the newest picture of each camera was recorded, and the picture if it can be read: its boxes follow it.
    let mut pictures = BTreeMap::new();
    let mut incomplete = 0;
    for message in messages.by_ref() {
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
                Some(frame) => each(frame)?,
                None => incomplete += 1,
            }
        }
    }
    let mut left_out = Vec::new();
    let file = path.display();
    if incomplete > 0 {
        left_out.push(format!(
            "{file}: {incomplete} frames have no picture or no boxes"
        ));
    }
    if let Some(damage) = messages.damage() {
        left_out.push(format!("{file} is no whole recording: {damage}"));
    }
    Ok(left_out)
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
