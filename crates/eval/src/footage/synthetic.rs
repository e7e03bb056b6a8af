//! The synthetic dashcam as a source of frames.

use super::error::FootageError;
use super::source::FrameSource;
use albireo_synth::{Dashcam, DashcamSettings};
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use bytes::Bytes;

/// The dashcam's pictures as JPEG, without end.
pub struct Synthetic {
    dashcam: Dashcam,
    name: String,
}

impl Synthetic {
    /// Frames per second unless said otherwise.
    pub const RATE: f64 = 10.0;

    /// Quality of the JPEG files, 1 to 100: what dashcams use.
    pub(crate) const QUALITY: u8 = 85;

    /// The world with this seed, filmed at `rate` frames per second.
    ///
    /// # Errors
    /// When the rate is not usable.
    pub fn open(seed: u64, rate: f64) -> Result<Self, FootageError> {
        let dashcam = Dashcam::new(DashcamSettings {
            seed,
            frame_rate: rate,
            ..DashcamSettings::default()
        })?;
        Ok(Self {
            dashcam,
            name: format!("synth-{seed}"),
        })
    }
}

impl FrameSource for Synthetic {
    fn name(&self) -> &str {
        &self.name
    }

    fn rate(&self) -> f64 {
        self.dashcam.settings().frame_rate
    }

    fn frames(&self) -> Option<u64> {
        None
    }

    fn clip_seconds(&self) -> Option<f64> {
        // Road, weather and light change with each of its clips.
        Some(self.dashcam.settings().clip_seconds)
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, FootageError> {
        let frame = self.dashcam.next_frame();
        Ok(Some(EncodedPicture {
            format: PictureFormat::Jpeg,
            bytes: Bytes::from(frame.encode_jpeg(Self::QUALITY)?),
            size: frame.size,
        }))
    }

    fn rewind(&mut self) -> Result<(), FootageError> {
        self.dashcam = Dashcam::new(self.dashcam.settings().clone())?;
        Ok(())
    }
}
