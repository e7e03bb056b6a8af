//! Gets a policy the evidence it asks for: decodes the picture when the first need of pixels comes, asks
//! the screen and the detector, and keeps the times. A frame that needs nothing touches nothing here. While
//! the detector is at work, the next frame's picture can be made ready if it is sure to be needed.

mod picture_worker;
#[cfg(test)]
mod tests;

use crate::detector::{CameraSlot, Detected, DetectorHandle};
use crate::frame::{EncodedPicture, FrameFault, FrameLimits, Picture};
use crate::screen::{CameraScreen, ScreenCounts};
use albireo_core::policy::Need;
use picture_worker::{PictureWorker, Prefetch, PreparedFrame, Stage};
use std::future::Future;
use std::time::Duration;
use tokio::time::Instant;

/// Where the time of one frame went.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Times {
    /// Decoding the picture, also when that was done while the detector looked at the frame before.
    pub decode: Option<Duration>,
    /// The empty-scene screen.
    pub screen: Option<Duration>,
    /// Resizing the picture to the detector's input; done ahead like decoding.
    pub letterbox: Option<Duration>,
    /// When the detector was asked and when it had answered, waiting included.
    pub detector_span: Option<(Instant, Instant)>,
    /// The run that answered, and this frame's part in it.
    pub detector_run: Option<DetectorRun>,
}

/// The detector's run for a frame: what the frame's camera used of it. A run that failed or took too long is
/// nobody's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DetectorRun {
    /// When it began.
    pub start: Instant,
    /// When it had ended.
    pub end: Instant,
    /// The frame's part of the time between: an even part for each of the pictures it looked at.
    pub used: Duration,
}

impl Times {
    /// The detector's time, letterbox and waiting included.
    pub(crate) fn detector(&self) -> Option<Duration> {
        self.detector_span
            .map(|(start, end)| self.letterbox.unwrap_or_default() + (end - start))
    }
}

/// One camera's eyes.
pub(crate) struct LiveEvidence {
    detector: DetectorHandle,
    screen: CameraScreen,
    slot: CameraSlot,
    worker: PictureWorker,
    /// What has been made of the picture of the frame in hand.
    frame: PreparedFrame,
    /// What is being made of the next one.
    prefetch: Option<Prefetch>,
    /// Times of the frame in hand.
    pub times: Times,
}

impl LiveEvidence {
    /// Eyes for the camera with this `slot` in the detector's queue.
    pub(crate) fn new(
        detector: DetectorHandle,
        screen: CameraScreen,
        slot: CameraSlot,
        limits: FrameLimits,
    ) -> Self {
        Self {
            worker: PictureWorker::new(limits, detector.preparation().clone()),
            detector,
            screen,
            slot,
            frame: PreparedFrame::default(),
            prefetch: None,
            times: Times::default(),
        }
    }

    /// Forgets the last frame's picture and times.
    pub(crate) fn next_frame(&mut self) {
        self.worker.take_back(std::mem::take(&mut self.frame));
        self.screen.next_frame();
        self.times = Times::default();
    }

    /// The screen's verdict: whether it says that nothing is in view. `None` when it cannot say, or when
    /// there is no screen.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub(crate) async fn screen(
        &mut self,
        encoded: &EncodedPicture,
    ) -> Result<Option<bool>, FrameFault> {
        if self.screen.is_none() {
            return Ok(None);
        }
        self.look(encoded, Stage::Picture).await?;
        let start = Instant::now();
        let empty = self.screen.ask(self.slot, &self.frame.picture).await;
        self.times.screen = Some(start.elapsed());
        Ok(empty)
    }

    /// What the detector finds; `None` when it cannot be had for this frame. `next` is the next frame's
    /// picture and what it will need: when it comes before the detector's answer, it is made ready meanwhile.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub(crate) async fn detect(
        &mut self,
        encoded: &EncodedPicture,
        next: impl Future<Output = (EncodedPicture, Need)>,
    ) -> Result<Option<Detected>, FrameFault> {
        // A picture that nobody will look at is not decoded.
        if self.detector.accepts().is_err() {
            return Ok(None);
        }
        self.look(encoded, Stage::Prepared).await?;
        let Some(prepared) = self.frame.prepared.take() else {
            return Ok(None);
        };
        self.times.letterbox = Some(prepared.took());
        let start = Instant::now();
        let input = self.detector.preparation().format();
        let answer = {
            let answer = self.detector.detect_prepared(self.slot, prepared);
            tokio::pin!(answer);
            // A frame that waits already is begun with before the detector is asked: that is only a word to
            // another thread.
            tokio::select! {
                biased;
                (picture, need) = next => {
                    let target = self.screen.decoding_target(input, picture.size);
                    self.prefetch =
                        Stage::at(need).map(|stage| self.worker.begin(picture, target, stage));
                    answer.await
                }
                answer = &mut answer => answer,
            }
        };
        let end = Instant::now();
        self.times.detector_span = Some((start, end));
        // The detector counts and logs its failures itself.
        let detected = answer.ok();
        if let Some(detected) = &detected {
            self.times.detector_run = Some(DetectorRun {
                start: end.checked_sub(detected.took).unwrap_or(start),
                end,
                used: detected.took / detected.pictures.max(1),
            });
            self.screen
                .detected(&self.frame.picture, !detected.detections.is_empty());
        }
        Ok(detected)
    }

    /// What the screen has counted.
    pub(crate) fn screen_counts(&self) -> ScreenCounts {
        self.screen.counts()
    }

    /// The picture in grey at half its size.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub(crate) async fn grey(&mut self, encoded: &EncodedPicture) -> Result<&Picture, FrameFault> {
        self.look(encoded, Stage::Grey).await?;
        Ok(&self.frame.grey)
    }

    /// Makes of the picture what is needed, unless that is done. Screen and detector share the pixels.
    async fn look(&mut self, encoded: &EncodedPicture, stage: Stage) -> Result<(), FrameFault> {
        if let Some(prefetch) = self.prefetch.take()
            && prefetch.is_of(encoded)
        {
            self.frame = prefetch.frame().await?;
        }
        if !self.frame.has(stage) {
            let frame = std::mem::take(&mut self.frame);
            let input = self.detector.preparation().format();
            let target = self.screen.decoding_target(input, encoded.size);
            self.frame = self.worker.look(frame, encoded, target, stage).await?;
        }
        self.times.decode = self.frame.decode;
        Ok(())
    }
}
