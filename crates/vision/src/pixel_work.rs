//! Decodes pictures, makes them grey and prepares the detector's input, for all cameras, on blocking threads. Buffers
//! are reused, and no more pictures are decoded for the detector at once than keep it busy.

mod picture_buffers;

use crate::detector::{Preparation, PreparedPicture};
use crate::picture::{
    EncodedPicture, FrameFault, FrameLimits, InputFormat, PixelLayout, decode, decode_grey_half,
    decode_small_grey,
};
use crate::screen::decoding_target;
use picture_buffers::{PictureBuffers, PooledPicture};
use std::sync::Arc;
use std::thread::available_parallelism;
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The result that a caller needs from a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Grey at half its size.
    Grey,
    /// Grey, not much wider than this.
    SmallGrey(u32),
    /// The decoded picture.
    Picture,
    /// The detector's input, instead of the decoded picture.
    Prepared,
}

impl Stage {
    /// True if the picture is decoded in colour, which needs a [`Place`].
    pub const fn needs_place(self) -> bool {
        matches!(self, Self::Picture | Self::Prepared)
    }
}

/// The results made from one picture so far.
#[derive(Default)]
pub struct PreparedFrame {
    /// The decoded picture, if there is one.
    pub picture: Option<PooledPicture>,
    /// The detector's input, until it is taken.
    pub prepared: Option<PreparedPicture>,
    /// The grey picture, if there is one, and the stage that made it.
    grey: Option<(Stage, PooledPicture)>,
    /// The time that decoding took, grey included.
    pub decode: Option<Duration>,
    /// Its place among the pictures decoded at once, if it has one.
    pub place: Option<Place>,
}

/// The right to have a picture decoded for the detector.
pub type Place = OwnedSemaphorePermit;

impl PreparedFrame {
    /// True if `stage` needs no more work.
    pub fn has(&self, stage: Stage) -> bool {
        match stage {
            Stage::Grey | Stage::SmallGrey(_) => {
                self.grey.as_ref().is_some_and(|(made, _)| *made == stage)
            }
            Stage::Picture => self.picture.is_some(),
            Stage::Prepared => self.prepared.is_some(),
        }
    }

    /// The grey picture, if there is one.
    pub fn grey(&self) -> Option<&PooledPicture> {
        self.grey.as_ref().map(|(_, picture)| picture)
    }

    fn add(
        &mut self,
        stage: Stage,
        encoded: &EncodedPicture,
        pixels: &PixelWork,
    ) -> Result<(), FrameFault> {
        match stage {
            Stage::Grey | Stage::SmallGrey(_) => {
                let start = Instant::now();
                let SharedWork { limits, greys, .. } = &*pixels.0;
                self.grey = None;
                let mut grey = greys.take(0);
                let made = match stage {
                    Stage::SmallGrey(width) => decode_small_grey(encoded, limits, width, &mut grey),
                    _ => decode_grey_half(encoded, limits, &mut grey),
                };
                // The buffer goes back even after a fault.
                let grey = greys.pooled(grey);
                made?;
                self.grey = Some((stage, grey));
                self.decode = Some(self.decode.unwrap_or_default() + start.elapsed());
            }
            Stage::Picture => self.picture = Some(self.decoded(encoded, pixels)?),
            Stage::Prepared => {
                let picture = match self.picture.take() {
                    Some(picture) => picture,
                    None => self.decoded(encoded, pixels)?,
                };
                self.prepared = Some(pixels.0.preparation.prepare(&picture)?);
            }
        }
        Ok(())
    }

    /// The whole picture, as large as the detector or the screen needs it.
    fn decoded(
        &mut self,
        encoded: &EncodedPicture,
        pixels: &PixelWork,
    ) -> Result<PooledPicture, FrameFault> {
        let start = Instant::now();
        let SharedWork {
            limits,
            preparation,
            screen,
            pictures,
            ..
        } = &*pixels.0;
        let layout = PixelLayout::Rgb8;
        let most = encoded.size.pixels().saturating_mul(layout.channels() as u64);
        let mut picture = pictures.take(usize::try_from(most).unwrap_or(usize::MAX));
        let target = decoding_target(preparation.format(), *screen, encoded.size);
        let made = decode(encoded, limits, layout, Some(target), &mut picture);
        // The buffer goes back even after a fault.
        let picture = pictures.pooled(picture);
        made?;
        self.decode = Some(self.decode.unwrap_or_default() + start.elapsed());
        Ok(picture)
    }
}

/// The pixel work of all cameras. Clones share buffers and places.
#[derive(Clone)]
pub struct PixelWork(Arc<SharedWork>);

struct SharedWork {
    limits: FrameLimits,
    preparation: Preparation,
    /// The screen's input, which pictures are decoded for too.
    screen: Option<InputFormat>,
    /// Decoded pictures.
    pictures: PictureBuffers,
    /// Grey pictures, much smaller.
    greys: PictureBuffers,
    /// One permit per picture decoded for the detector, held from before decoding until the detector has answered.
    places: Arc<Semaphore>,
}

impl PixelWork {
    /// Creates the pixel work of a detector that runs on `batch_size` pictures at once, with inputs made by
    /// `preparation`, and of a `screen`, if there is one, with this input.
    ///
    /// At most 2 × `batch_size` + ⌈processors / 2⌉ pictures are decoded at once: those of the current run, those of the
    /// next, and those being prepared. The others wait encoded.
    pub fn new(
        preparation: Preparation,
        screen: Option<InputFormat>,
        limits: FrameLimits,
        batch_size: usize,
    ) -> Self {
        let processors = available_parallelism().map_or(1, usize::from);
        let in_runs = 2 * batch_size.max(1);
        let in_preparation = processors.div_ceil(2);
        let places = in_runs + in_preparation;
        Self(Arc::new(SharedWork {
            limits,
            preparation,
            screen,
            pictures: PictureBuffers::new(places),
            greys: PictureBuffers::new(places),
            places: Arc::new(Semaphore::new(places.min(Semaphore::MAX_PERMITS))),
        }))
    }

    /// The number of idle picture buffers.
    pub fn idle(&self) -> usize {
        self.0.pictures.idle()
    }

    /// Waits for a place; places are granted in the order of the calls.
    pub async fn place(&self) -> Option<Place> {
        Arc::clone(&self.0.places).acquire_owned().await.ok()
    }

    /// Makes the result of `stage` from the picture and adds it to `frame`.
    ///
    /// # Errors
    /// [`FrameFault`] if the picture cannot be decoded; a panic in the work counts as a fault of the picture.
    pub async fn prepare(
        &self,
        mut frame: PreparedFrame,
        encoded: EncodedPicture,
        stage: Stage,
    ) -> Result<PreparedFrame, FrameFault> {
        let pixels = self.clone();
        let work = tokio::task::spawn_blocking(move || {
            frame.add(stage, &encoded, &pixels)?;
            Ok(frame)
        });
        work.await.unwrap_or_else(|error| {
            Err(FrameFault::undecodable(format!(
                "the decoder failed: {error}"
            )))
        })
    }

    /// Returns the detector's input of a picture; `None` if the picture is broken. Takes no place: call it only while no
    /// frame waits.
    pub async fn prepared(&self, encoded: EncodedPicture) -> Option<PreparedPicture> {
        self.prepare(PreparedFrame::default(), encoded, Stage::Prepared)
            .await
            .ok()?
            .prepared
    }
}
