//! Gets a policy the evidence it asks for: decodes the picture when the first need of pixels comes, asks
//! the screen and the detector, and keeps the times. A frame that needs nothing touches nothing here.

use crate::detector::{CameraSlot, Detected, DetectorHandle};
use crate::frame::{
    EncodedPicture, FrameFault, FrameLimits, Picture, PixelLayout, decode, decode_grey_half,
};
use crate::screen::{CameraScreen, ScreenCounts};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Where the time of one frame went.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// Decoding the picture.
    pub decode: Option<Duration>,
    /// The empty-scene screen.
    pub screen: Option<Duration>,
    /// When the detector was asked and when it had answered, waiting included.
    pub detector_span: Option<(Instant, Instant)>,
}

impl Times {
    /// The detector's time, waiting included.
    pub fn detector(&self) -> Option<Duration> {
        self.detector_span.map(|(start, end)| end - start)
    }
}

/// One camera's eyes.
pub struct Senses {
    detector: DetectorHandle,
    screen: CameraScreen,
    slot: CameraSlot,
    limits: FrameLimits,
    /// The decoded picture of the frame in hand; its buffer serves all frames.
    picture: Arc<Picture>,
    decoded: bool,
    grey: Picture,
    /// Times of the frame in hand.
    pub times: Times,
}

impl Senses {
    /// Eyes for the camera with this `slot` in the detector's queue.
    pub fn new(
        detector: DetectorHandle,
        screen: CameraScreen,
        slot: CameraSlot,
        limits: FrameLimits,
    ) -> Self {
        Self {
            detector,
            screen,
            slot,
            limits,
            picture: Arc::default(),
            decoded: false,
            grey: Picture::default(),
            times: Times::default(),
        }
    }

    /// Forgets the last frame's picture and times.
    pub fn next_frame(&mut self) {
        self.decoded = false;
        self.screen.next_frame();
        self.times = Times::default();
    }

    /// The screen's verdict: whether it says that nothing is in view. `None` when it cannot say, or when
    /// there is no screen.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub async fn screen(&mut self, encoded: &EncodedPicture) -> Result<Option<bool>, FrameFault> {
        if self.screen.is_none() {
            return Ok(None);
        }
        self.decode(encoded).await?;
        let start = Instant::now();
        let empty = self.screen.ask(self.slot, &self.picture).await;
        self.times.screen = Some(start.elapsed());
        Ok(empty)
    }

    /// What the detector finds; `None` when it cannot be had for this frame.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub async fn detect(
        &mut self,
        encoded: &EncodedPicture,
    ) -> Result<Option<Detected>, FrameFault> {
        self.decode(encoded).await?;
        let start = Instant::now();
        let answer = self
            .detector
            .detect(self.slot, Arc::clone(&self.picture))
            .await;
        self.times.detector_span = Some((start, Instant::now()));
        // The detector counts and logs its failures itself.
        let detected = answer.ok();
        if let Some(detected) = &detected {
            self.screen
                .detected(&self.picture, !detected.detections.is_empty());
        }
        Ok(detected)
    }

    /// What the screen has counted.
    pub fn screen_counts(&self) -> ScreenCounts {
        self.screen.counts()
    }

    /// The picture in grey at half its size.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub async fn grey(&mut self, encoded: &EncodedPicture) -> Result<&Picture, FrameFault> {
        let start = Instant::now();
        let (encoded, limits) = (encoded.clone(), self.limits);
        let mut grey = std::mem::take(&mut self.grey);
        self.grey = off_thread(move || {
            decode_grey_half(&encoded, &limits, &mut grey)?;
            Ok(grey)
        })
        .await?;
        self.times.decode = Some(self.times.decode.unwrap_or_default() + start.elapsed());
        Ok(&self.grey)
    }

    /// Decodes the picture unless that is done. Screen and detector share the pixels.
    async fn decode(&mut self, encoded: &EncodedPicture) -> Result<(), FrameFault> {
        if self.decoded {
            return Ok(());
        }
        let start = Instant::now();
        let (encoded, limits) = (encoded.clone(), self.limits);
        // The detector's thread may still hold the last picture after a time-out: then take a new buffer.
        let mut picture = Arc::try_unwrap(std::mem::take(&mut self.picture)).unwrap_or_default();
        self.picture = off_thread(move || {
            decode(&encoded, &limits, PixelLayout::Rgb8, None, &mut picture)?;
            Ok(Arc::new(picture))
        })
        .await?;
        self.decoded = true;
        self.times.decode = Some(start.elapsed());
        Ok(())
    }
}

/// Runs work that takes milliseconds on the blocking threads. A panic in it is a fault of the picture.
async fn off_thread<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, FrameFault> + Send + 'static,
) -> Result<T, FrameFault> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(error) => Err(FrameFault::Undecodable {
            reason: format!("the decoder failed: {error}"),
        }),
    }
}
