//! Fetches the evidence that a policy needs: decodes the picture when pixels are first needed, runs the screen
//! and the detector, and records the times. A frame that needs nothing costs nothing here.

#[cfg(test)]
mod tests;

use crate::frame::{DetectorRun, Times};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Evidence, GreyPicture, Need};
use albireo_service::clock::milliseconds;
use albireo_vision::detector::{CameraSlot, Detected, DetectorHandle};
use albireo_vision::picture::{EncodedPicture, FrameFault};
use albireo_vision::pixel_work::{PixelWork, PreparedFrame, Stage};
use albireo_vision::screen::{EmptyRun, ScreenHandle};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// One camera's evidence, from its pictures, the screen and the detector.
pub struct LiveEvidence {
    detector: DetectorHandle,
    /// The model shared by all cameras, if there is one.
    screen: Option<ScreenHandle>,
    empty_run: EmptyRun,
    slot: CameraSlot,
    pixels: PixelWork,
    /// The current frame.
    current: Current,
    /// Once cancelled, it waits for neither detector nor screen.
    give_up: CancellationToken,
}

/// The evidence so far for the current frame.
#[derive(Default)]
struct Current {
    /// The pixels prepared from its picture.
    frame: PreparedFrame,
    /// The screen's verdict.
    empty: Option<bool>,
    /// The detected boxes.
    detected: Option<Detected>,
    times: Times,
    /// The time spent waiting for a decoding place: all cameras share just enough places to keep the detector busy.
    waited_for_place: Duration,
}

impl LiveEvidence {
    /// Creates the evidence of the camera with this `slot` in the detector's queue. All cameras of a detector share
    /// `pixels`. Once `give_up` is cancelled, no answer is awaited: the node is stopping and must not wait for a frame.
    pub fn new(
        detector: DetectorHandle,
        screen: Option<ScreenHandle>,
        empty_run: EmptyRun,
        slot: CameraSlot,
        pixels: PixelWork,
        give_up: CancellationToken,
    ) -> Self {
        Self {
            pixels,
            detector,
            screen,
            empty_run,
            slot,
            give_up,
            current: Current::default(),
        }
    }

    /// Resets for the next frame. Call it at the end of a frame: others wait for its decoding place.
    pub fn next_frame(&mut self) {
        self.current = Current::default();
    }

    /// The times of the current frame so far.
    pub(crate) fn times(&self) -> Times {
        self.current.times
    }

    /// The share of its threshold that the policy may fall short of on a frame of this size, as a run of the detector is
    /// about to begin for another camera; 0 if none is.
    pub(super) fn join(&self, picture: PictureSize) -> f64 {
        self.detector.join(picture)
    }

    /// Fetches `need` for the current frame, whose picture is `encoded`. [`fetched`](Self::fetched) returns the result.
    ///
    /// # Errors
    /// [`FrameFault`] if the picture cannot be decoded.
    pub async fn fetch(&mut self, need: Need, encoded: &EncodedPicture) -> Result<(), FrameFault> {
        match need {
            Need::Nothing => {}
            Need::Screen => self.current.empty = self.screen(encoded).await?,
            Need::GreyPicture => self.prepare(encoded, Stage::Grey).await?,
            Need::SmallGreyPicture { width } => {
                self.prepare(encoded, Stage::SmallGrey(width)).await?;
            }
            Need::Detections => self.current.detected = self.detect(encoded).await?,
        }
        Ok(())
    }

    /// The evidence fetched for `need` of the current frame.
    pub fn fetched(&self, need: Need) -> Evidence<'_> {
        match need {
            Need::Nothing => {}
            Need::Screen => {
                if let Some(empty) = self.current.empty {
                    return Evidence::Screen { empty };
                }
            }
            Need::GreyPicture | Need::SmallGreyPicture { .. } => {
                if let Some(grey) = self.current.frame.grey() {
                    return Evidence::GreyPicture(GreyPicture {
                        size: grey.size,
                        pixels: &grey.pixels,
                    });
                }
            }
            Need::Detections => {
                if let Some(detected) = &self.current.detected {
                    return Evidence::Detections(&detected.output.detections);
                }
            }
        }
        Evidence::Unavailable
    }

    /// Returns the screen's verdict, true if the scene is empty; `None` if it has none or there is no screen.
    ///
    /// # Errors
    /// [`FrameFault`] if the picture cannot be decoded.
    async fn screen(&mut self, encoded: &EncodedPicture) -> Result<Option<bool>, FrameFault> {
        if self.screen.is_none() {
            return Ok(None);
        }
        self.prepare(encoded, Stage::Picture).await?;
        let (Some(screen), Some(picture)) = (&self.screen, &self.current.frame.picture) else {
            return Ok(None);
        };
        let start = Instant::now();
        let verdict = tokio::select! {
            biased;
            // The screen counts and logs its failures itself.
            verdict = screen.ask(self.slot, Arc::clone(picture.shared())) => verdict.ok(),
            () = self.give_up.cancelled() => None,
        };
        let times = &mut self.current.times;
        times.latency.screen = Some(milliseconds(start.elapsed()));
        let Some(verdict) = verdict else {
            return Ok(None);
        };
        let empty = self.empty_run.limit(verdict.empty);
        times.overruled = verdict.empty && !empty;
        Ok(Some(empty))
    }

    /// Returns the detected boxes; `None` if the detector is not available for this frame.
    ///
    /// # Errors
    /// [`FrameFault`] if the picture cannot be decoded.
    async fn detect(&mut self, encoded: &EncodedPicture) -> Result<Option<Detected>, FrameFault> {
        // Does not decode a picture that nobody would use.
        if self.detector.accepts().is_err() {
            return Ok(None);
        }
        let _until_answered = self.detector.announce(self.slot, encoded.size);
        self.prepare(encoded, Stage::Prepared).await?;
        let Some(prepared) = self.current.frame.prepared.take() else {
            return Ok(None);
        };
        let preparing = self.current.waited_for_place + prepared.took();
        let start = Instant::now();
        let mut answer = tokio::select! {
            biased;
            // The detector counts and logs its failures itself.
            answer = self.detector.detect_prepared(self.slot, prepared) => answer.ok(),
            () = self.give_up.cancelled() => None,
        };
        let end = Instant::now();
        self.current.times.latency.detector = Some(milliseconds(preparing + (end - start)));
        if let Some(detected) = &mut answer {
            let detections = &mut detected.output.detections;
            detections.retain(|found| !encoded.hides(found.bounding_box));
            self.current.times.detector_run = Some(DetectorRun {
                end,
                used: detected.took / detected.pictures.max(1),
            });
            self.empty_run.detector_ran();
        }
        Ok(answer)
    }

    /// True if the detector is called for this frame because the screen reported "empty" too often in a row.
    pub fn screen_is_overruled(&self) -> bool {
        self.current.times.overruled
    }

    /// Prepares the pixels for `stage`, unless that is done or `give_up` is cancelled. The screen and the detector
    /// share the pixels.
    async fn prepare(&mut self, encoded: &EncodedPicture, stage: Stage) -> Result<(), FrameFault> {
        if !self.current.frame.has(stage) {
            if stage.needs_place() && self.current.frame.place.is_none() {
                let start = Instant::now();
                self.current.frame.place = tokio::select! {
                    biased;
                    place = self.pixels.place() => place,
                    () = self.give_up.cancelled() => return Ok(()),
                };
                self.current.waited_for_place += start.elapsed();
            }
            let frame = std::mem::take(&mut self.current.frame);
            self.current.frame = self.pixels.prepare(frame, encoded.clone(), stage).await?;
        }
        self.current.times.latency.decode = self.current.frame.decode.map(milliseconds);
        Ok(())
    }
}
