//! Gets a policy the evidence it asks for: decodes the picture when the first need of pixels comes, asks
//! the screen and the detector, and keeps the times. A frame that needs nothing touches nothing here.

#[cfg(test)]
mod tests;

use albireo_core::policy::{Evidence, GreyPicture, Need};
use albireo_service::clock::milliseconds;
use albireo_vision::detector::{CameraSlot, Detected, DetectorHandle};
use albireo_vision::picture::{EncodedPicture, FrameFault};
use albireo_vision::pixel_work::{PixelWork, PreparedFrame, Source, Stage};
use albireo_vision::screen::CameraScreen;
use albireo_wire::Latency;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// The times of the steps of one frame.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Times {
    /// The time of each step. That of the detector includes resizing the picture, waiting for a place to decode it in and
    /// waiting for other cameras. `total` and `waiting` are not known here.
    pub latency: Latency,
    /// The run that answered, and this frame's part in it.
    pub detector_run: Option<DetectorRun>,
    /// It is true if a grey picture was looked at.
    pub examined: bool,
    /// The detector was asked although the screen said "empty", too often in a row.
    pub overruled: bool,
}

/// The part of a detector's run that a frame's camera used. A run that failed or took too long is nobody's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DetectorRun {
    /// It ended at this time.
    pub end: Instant,
    /// The frame's part of its time: an even part for each of the pictures it looked at.
    pub used: Duration,
}

/// One camera's evidence: what its pictures, the screen and the detector say.
pub struct LiveEvidence {
    detector: DetectorHandle,
    screen: CameraScreen,
    slot: CameraSlot,
    pixels: PixelWork,
    /// The current frame.
    current: Current,
    /// Once cancelled neither detector nor screen is waited for.
    give_up: CancellationToken,
}

/// All that is known of the current frame.
#[derive(Default)]
struct Current {
    /// The pixels that were prepared from its picture.
    frame: PreparedFrame,
    /// The screen's verdict on it.
    empty: Option<bool>,
    /// The boxes that the detector found in it.
    detected: Option<Detected>,
    times: Times,
    /// It waited this long until its picture might be decoded: all cameras share as many places as keep the detector busy.
    place: Duration,
}

impl LiveEvidence {
    /// For the camera with this `slot` in the detector's queue. All cameras of a detector share `pixels`. Once `give_up` is
    /// cancelled no answer is waited for: the node stops, and a frame must not keep it.
    pub fn new(
        detector: DetectorHandle,
        screen: CameraScreen,
        slot: CameraSlot,
        pixels: PixelWork,
        give_up: CancellationToken,
    ) -> Self {
        Self {
            pixels,
            detector,
            screen,
            slot,
            give_up,
            current: Current::default(),
        }
    }

    /// Forgets the last frame.
    pub fn next_frame(&mut self) {
        self.screen.next_frame();
        self.current = Current::default();
    }

    /// Drops what was prepared from the current frame's picture: others wait for its place.
    pub(crate) fn end_frame(&mut self) {
        self.current.frame = PreparedFrame::default();
    }

    /// Returns the times of the current frame so far.
    pub(crate) fn times(&self) -> Times {
        Times {
            overruled: self.screen.is_overruled(),
            ..self.current.times
        }
    }

    /// Fetches what `need` asks for of the current frame, whose picture is `encoded`, for [`fetched`](Self::fetched).
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    pub async fn fetch(&mut self, need: Need, encoded: &EncodedPicture) -> Result<(), FrameFault> {
        match need {
            Need::Nothing => {}
            Need::Screen => self.current.empty = self.screen(encoded).await?,
            Need::GreyPicture => self.look(encoded, Stage::Grey).await?,
            Need::SmallGreyPicture { width } => {
                self.look(encoded, Stage::SmallGrey(width)).await?;
                self.current.times.examined = true;
            }
            Need::Detections => self.current.detected = self.detect(encoded).await?,
        }
        Ok(())
    }

    /// Returns what was fetched from the current frame for `need`.
    pub fn fetched(&self, need: Need) -> Evidence<'_> {
        let known = match need {
            Need::Nothing => None,
            Need::Screen => self.current.empty.map(|empty| Evidence::Screen { empty }),
            Need::GreyPicture | Need::SmallGreyPicture { .. } => {
                self.current.frame.grey().map(|grey| {
                    Evidence::GreyPicture(GreyPicture {
                        size: grey.size,
                        pixels: &grey.pixels,
                    })
                })
            }
            Need::Detections => {
                let detected = self.current.detected.as_ref();
                detected.map(|detected| Evidence::Detections(&detected.detections))
            }
        };
        known.unwrap_or(Evidence::Unavailable)
    }

    /// Asks the screen whether nothing is in view. `None` when it cannot say, or when there is no screen.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    async fn screen(&mut self, encoded: &EncodedPicture) -> Result<Option<bool>, FrameFault> {
        if self.screen.is_none() {
            return Ok(None);
        }
        self.look(encoded, Stage::Picture).await?;
        let Some(picture) = &self.current.frame.picture else {
            return Ok(None);
        };
        let start = Instant::now();
        let empty = tokio::select! {
            biased;
            empty = self.screen.ask(self.slot, picture.shared()) => empty,
            () = self.give_up.cancelled() => None,
        };
        self.current.times.latency.screen = Some(milliseconds(start.elapsed()));
        Ok(empty)
    }

    /// Returns what the detector finds; `None` when it is not available for this frame.
    ///
    /// # Errors
    /// [`FrameFault`] when the picture cannot be decoded.
    async fn detect(&mut self, encoded: &EncodedPicture) -> Result<Option<Detected>, FrameFault> {
        // A picture without a use is not decoded.
        if self.detector.accepts().is_err() {
            return Ok(None);
        }
        self.look(encoded, Stage::Prepared).await?;
        let Some(prepared) = self.current.frame.prepared.take() else {
            return Ok(None);
        };
        let preparing = self.current.place + prepared.took();
        let start = Instant::now();
        let answer = tokio::select! {
            biased;
            // The detector counts and logs its failures itself.
            answer = self.detector.detect_prepared(self.slot, prepared) => answer.ok(),
            () = self.give_up.cancelled() => None,
        };
        let end = Instant::now();
        self.current.times.latency.detector = Some(milliseconds(preparing + (end - start)));
        if let Some(detected) = &answer {
            self.current.times.detector_run = Some(DetectorRun {
                end,
                used: detected.took / detected.pictures.max(1),
            });
            self.screen.detector_ran();
        }
        Ok(answer)
    }

    /// Says whether the detector is asked about this frame although the screen said "empty", too often in a row.
    pub fn screen_is_overruled(&self) -> bool {
        self.screen.is_overruled()
    }

    /// Makes of the picture what is needed, unless that is done, or nothing is waited for any more. Screen and detector
    /// share the pixels.
    async fn look(&mut self, encoded: &EncodedPicture, stage: Stage) -> Result<(), FrameFault> {
        if !self.current.frame.has(stage) {
            if stage.needs_place() && self.current.frame.place.is_none() {
                let start = Instant::now();
                self.current.frame.place = tokio::select! {
                    biased;
                    place = self.pixels.place() => place,
                    () = self.give_up.cancelled() => return Ok(()),
                };
                self.current.place += start.elapsed();
            }
            let input = self.detector.preparation().format();
            let source = Source {
                target: self.screen.decoding_target(input, encoded.size),
                encoded: encoded.clone(),
            };
            let frame = std::mem::take(&mut self.current.frame);
            self.current.frame = self.pixels.look(frame, source, stage).await?;
        }
        self.current.times.latency.decode = self.current.frame.decode.map(milliseconds);
        Ok(())
    }
}
