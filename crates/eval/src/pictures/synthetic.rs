//! One clip of the synthetic dashcam as footage, with the ground truth of every picture taken from it.

use crate::average_precision::TruthBox;
use crate::data::classes::{Meaning, from_name};
use crate::footage::{FootageError, FrameSource, Synthetic};
use albireo_core::detection::BDD100K_CLASSES;
use albireo_synth::{Dashcam, DashcamSettings, SynthError};
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use bytes::Bytes;

/// The pictures of one clip, as JPEG, as the dashcam sends them.
pub struct DashcamClip {
    dashcam: Dashcam,
    name: String,
    first: u64,
    frames: u64,
    at: u64,
    truth: Vec<Vec<TruthBox>>,
}

impl DashcamClip {
    /// Clip `number`, from 0, of the world that `settings` describe.
    ///
    /// # Errors
    /// [`SynthError`] when the settings cannot be used.
    pub fn new(settings: DashcamSettings, number: u64) -> Result<Self, SynthError> {
        let frames = (settings.clip_seconds * settings.frame_rate)
            .round()
            .max(1.0) as u64;
        Ok(Self {
            name: format!("seed-{}-clip-{number}", settings.seed),
            dashcam: Dashcam::new(settings)?,
            first: number * frames,
            frames,
            at: 0,
            truth: Vec::new(),
        })
    }

    /// Takes the ground truth of the frames taken so far: the objects a detector is expected to find.
    pub fn take_truth(&mut self) -> Vec<Vec<TruthBox>> {
        std::mem::take(&mut self.truth)
    }
}

impl FrameSource for DashcamClip {
    fn name(&self) -> &str {
        &self.name
    }

    fn rate(&self) -> f64 {
        self.dashcam.settings().frame_rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.frames)
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, FootageError> {
        if self.at == self.frames {
            return Ok(None);
        }
        let frame = self.dashcam.frame(self.first + self.at);
        self.at += 1;
        let boxes = frame.expected().filter_map(|object| {
            let name = BDD100K_CLASSES.get(usize::from(object.class.0))?;
            let Meaning::Class(class) = from_name(name) else {
                return None;
            };
            Some(TruthBox {
                corners: object.corners,
                class,
                object: Some(object.object),
            })
        });
        self.truth.push(boxes.collect());
        Ok(Some(EncodedPicture {
            format: PictureFormat::Jpeg,
            bytes: Bytes::from(frame.encode_jpeg(Synthetic::QUALITY)?),
            size: frame.size,
        }))
    }

    fn rewind(&mut self) -> Result<(), FootageError> {
        self.at = 0;
        self.truth.clear();
        Ok(())
    }
}
