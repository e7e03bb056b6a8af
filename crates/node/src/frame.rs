//! What is known of a frame: its newest picture, the times spent on its answer, and the record that everything counts.

use albireo_core::policy::BoxSource;
use albireo_recording::colour;
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, LineStyle, Picture, PictureFormat, PixelLayout, decode, outline,
    to_jpeg,
};
use albireo_wire::{DetectionsMessage, Latency};
use bytes::Bytes;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::time::Instant;

/// The last picture received, still encoded.
#[derive(Debug)]
pub struct LatestFrame {
    /// The frame's sequence number.
    pub(crate) seq: u64,
    /// The picture; a cheap clone of the received one.
    picture: EncodedPicture,
    /// The picture as a JPEG file, once requested.
    jpeg: OnceLock<Result<Bytes, String>>,
}

impl LatestFrame {
    /// Creates the picture of frame `seq`.
    pub fn new(seq: u64, picture: EncodedPicture) -> Self {
        let jpeg = match picture.format {
            PictureFormat::Jpeg if picture.mount.is_none() => {
                OnceLock::from(Ok(picture.bytes.clone()))
            }
            _ => OnceLock::new(),
        };
        Self { seq, picture, jpeg }
    }

    /// The picture as a JPEG file, converted from another format at most once. Decodes and encodes: call it outside
    /// async workers.
    ///
    /// # Errors
    /// The reason it cannot be shown.
    pub(crate) fn jpeg(&self, limits: &FrameLimits) -> Result<Bytes, String> {
        let make = || to_jpeg(&self.picture, limits).map_err(|fault| fault.to_string());
        self.jpeg.get_or_init(make).clone()
    }

    /// True if the file exists, or is known to be impossible.
    pub(crate) fn is_made(&self) -> bool {
        self.jpeg.get().is_some()
    }
}

/// An answered frame: its picture, and the boxes that were published for it.
#[derive(Debug)]
pub(crate) struct AnsweredFrame {
    picture: EncodedPicture,
    detections: Arc<DetectionsMessage>,
    /// The picture with its boxes as a JPEG file, once requested.
    drawn: OnceLock<Result<Bytes, String>>,
}

impl AnsweredFrame {
    pub(crate) fn new(picture: EncodedPicture, detections: Arc<DetectionsMessage>) -> Self {
        Self {
            picture,
            detections,
            drawn: OnceLock::new(),
        }
    }

    /// The frame's sequence number.
    pub(crate) fn seq(&self) -> u64 {
        self.detections.seq
    }

    /// The picture with its boxes as a JPEG file, drawn at most once however many read it. Decodes and encodes: call it
    /// outside async workers.
    ///
    /// # Errors
    /// The reason it cannot be shown.
    pub(crate) fn drawn(&self, limits: &FrameLimits) -> Result<Bytes, String> {
        self.drawn.get_or_init(|| self.draw(limits)).clone()
    }

    fn draw(&self, limits: &FrameLimits) -> Result<Bytes, String> {
        let mut picture = Picture::default();
        decode(&self.picture, limits, PixelLayout::Rgb8, None, &mut picture)
            .map_err(|fault| fault.to_string())?;
        for found in &self.detections.boxes {
            let colour = colour(found.source);
            let style = match found.source {
                BoxSource::Detected => LineStyle::Solid,
                _ => LineStyle::Dashed,
            };
            outline(&mut picture, found.corners.map(f64::from), colour, style);
        }
        let drawn = EncodedPicture {
            bytes: picture.pixels.into(),
            format: PictureFormat::Rgb8,
            size: picture.size,
            mount: None,
        };
        to_jpeg(&drawn, limits).map_err(|fault| fault.to_string())
    }
}

/// The times of the steps for one frame.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Times {
    /// The time of each step. The detector's includes resizing the picture, waiting for a decoding place and waiting
    /// for other cameras. `total` and `waiting` are not set here.
    pub latency: Latency,
    /// The detector run that answered, and this frame's part of it.
    pub detector_run: Option<DetectorRun>,
    /// True if the detector was called because the screen reported "empty" too often in a row.
    pub overruled: bool,
}

/// A camera's part of a detector run. Runs that failed or timed out are charged to no camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DetectorRun {
    /// The end of the run.
    pub end: Instant,
    /// The frame's part of the run time: an equal part for each of its pictures.
    pub used: Duration,
}

/// A frame with its final answer, passed once to everything that counts frames.
#[derive(Clone, Debug)]
pub struct FrameRecord {
    /// The final answer, as published.
    pub detections: Arc<DetectionsMessage>,
    /// The time of publication.
    pub answered: Instant,
    /// The time from reception to the first answer, which may have been pending.
    pub first_answer: Duration,
    /// The time spent on the final answer.
    pub(crate) times: Times,
}

impl FrameRecord {
    /// A frame that neither detector nor flow examined, answered now and `first_answer` after its reception.
    pub fn new(detections: Arc<DetectionsMessage>, first_answer: Duration) -> Self {
        Self {
            detections,
            answered: Instant::now(),
            first_answer,
            times: Times::default(),
        }
    }
}
