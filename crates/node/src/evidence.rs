//! Gets a policy the evidence it asks for: decodes the picture when the first need of pixels comes, asks
//! the screen and the detector, and keeps the times. A frame that needs nothing touches nothing here. While
//! the detector is at work, the next frame's picture can be made ready if it is sure to be needed.

mod picture_worker;
#[cfg(test)]
mod tests;

use crate::detector::{CameraSlot, Detected, DetectorHandle};
use crate::frame::{EncodedPicture, FrameFault, FrameLimits};
use crate::screen::{CameraScreen, ScreenCounts};
use albireo_core::policy::{CallCause, Evidence, GreyPicture, Need};
use picture_worker::{PictureWorker, Prefetch, PreparedFrame, Stage};
use std::future::Future;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Where the time of one frame went.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// Decoding the picture, also when that was done while the detector looked at the frame before.
    pub decode: Option<Duration>,
    /// The empty-scene screen.
    pub screen: Option<Duration>,
    /// Resizing the picture to the detector's input; done ahead like decoding.
    pub letterbox: Option<Duration>,
    /// When the detector was asked and when it had answered, waiting included.
    pub detector_span: Option<(Instant, Instant)>,
    /// The run that answered, and this frame's part in it.
    pub(crate) detector_run: Option<DetectorRun>,
    /// Whether a grey picture was looked at.
    pub looked: bool,
    /// All of it together: what is left of the frame's time is the policy's own.
    pub evidence: Duration,
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

/// One camera's evidence: what its pictures, the screen and the detector say.
pub struct LiveEvidence {
    detector: DetectorHandle,
    screen: CameraScreen,
    slot: CameraSlot,
    worker: PictureWorker,
    /// What has been made of the picture of the frame in hand.
    frame: PreparedFrame,
    /// What is being made of the next one.
    prefetch: Option<Prefetch>,
    /// What the detector found in the frame in hand.
    detected: Option<Detected>,
    /// Times of the frame in hand.
    times: Times,
    /// Once cancelled neither detector nor screen is waited for.
    hurry: CancellationToken,
}

impl LiveEvidence {
    /// For the camera with this `slot` in the detector's queue.
    pub fn new(
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
            detected: None,
            times: Times::default(),
            hurry: CancellationToken::new(),
        }
    }

    /// Once `hurry` is cancelled no answer is waited for: the node stops, and a frame must not keep it.
    #[must_use]
    pub fn hurried_by(mut self, hurry: CancellationToken) -> Self {
        self.hurry = hurry;
        self
    }

    /// Forgets the last frame's picture and times.
    pub fn next_frame(&mut self) {
        self.worker.take_back(std::mem::take(&mut self.frame));
        self.screen.next_frame();
        self.detected = None;
        self.times = Times::default();
    }

    /// Where the time of the frame in hand went so far.
    pub const fn times(&self) -> Times {
        self.times
    }

    /// What `need` asks for of the frame in hand, whose picture is `encoded`. While the detector looks, `next` is
    /// waited for: the next frame's picture and what it will need, to be made ready meanwhile.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub async fn evidence<Next>(
        &mut self,
        need: Need,
        encoded: &EncodedPicture,
        next: impl FnOnce() -> Next + Send,
    ) -> Result<Evidence<'_>, FrameFault>
    where
        Next: Future<Output = (EncodedPicture, Need)> + Send,
    {
        let start = Instant::now();
        let mut empty = None;
        match need {
            Need::Nothing => {}
            Need::Screen => empty = self.screen(encoded).await?,
            Need::GreyPicture => self.look(encoded, Stage::Grey).await?,
            Need::SmallGreyPicture { width } => {
                self.look(encoded, Stage::SmallGrey(width)).await?;
                self.times.looked = true;
            }
            Need::Detections => self.detected = self.detect(encoded, next()).await?,
        }
        self.times.evidence += start.elapsed();
        let known = match need {
            Need::Nothing => None,
            Need::Screen => empty.map(|empty| Evidence::Screen { empty }),
            Need::GreyPicture | Need::SmallGreyPicture { .. } => {
                Some(Evidence::GreyPicture(GreyPicture {
                    size: self.frame.grey.size,
                    pixels: &self.frame.grey.pixels,
                }))
            }
            Need::Detections => {
                let detected = self.detected.as_ref();
                detected.map(|detected| Evidence::Detections(&detected.detections))
            }
        };
        Ok(known.unwrap_or(Evidence::Unavailable))
    }

    /// The screen's verdict: whether it says that nothing is in view. `None` when it cannot say, or when
    /// there is no screen.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    async fn screen(&mut self, encoded: &EncodedPicture) -> Result<Option<bool>, FrameFault> {
        if self.screen.is_none() {
            return Ok(None);
        }
        self.look(encoded, Stage::Picture).await?;
        let start = Instant::now();
        let empty = tokio::select! {
            biased;
            empty = self.screen.ask(self.slot, &self.frame.picture) => empty,
            () = self.hurry.cancelled() => None,
        };
        self.times.screen = Some(start.elapsed());
        Ok(empty)
    }

    /// What the detector finds; `None` when it cannot be had for this frame. `next` is the next frame's
    /// picture and what it will need: when it comes before the detector's answer, it is made ready meanwhile.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    async fn detect(
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
            let hurry = &self.hurry;
            let answer = self.detector.detect_prepared(self.slot, prepared);
            let answer = async {
                tokio::select! {
                    biased;
                    // The detector counts and logs its failures itself.
                    answer = answer => answer.ok(),
                    () = hurry.cancelled() => None,
                }
            };
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
        if let Some(detected) = &answer {
            self.times.detector_run = Some(DetectorRun {
                start: end.checked_sub(detected.took).unwrap_or(start),
                end,
                used: detected.took / detected.pictures.max(1),
            });
            self.screen
                .detected(&self.frame.picture, !detected.detections.is_empty());
        }
        Ok(answer)
    }

    /// Why the detector looks at the frame in hand although the screen would say "empty".
    pub(crate) fn overruled(&self) -> Option<CallCause> {
        self.screen.overruled()
    }

    /// What the screen has counted.
    pub fn screen_counts(&self) -> ScreenCounts {
        self.screen.counts()
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
