//! Pixel work of one camera, on blocking threads: decoding, grey, the detector's input. Buffers go round.

use crate::detector::{Preparation, PreparedPicture};
use crate::frame::{
    EncodedPicture, FrameFault, FrameLimits, Picture, PixelLayout, decode, decode_grey_half,
    decode_small_grey,
};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::Need;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;

/// What is to be made of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// Grey at half its size.
    Grey,
    /// Grey, not much wider than this.
    SmallGrey(u32),
    /// The decoded picture.
    Picture,
    /// The detector's input, and the decoded picture with it.
    Prepared,
}

impl Stage {
    /// What `need` begins with.
    pub(super) fn at(need: Need) -> Option<Self> {
        match need {
            Need::Nothing => None,
            Need::GreyPicture => Some(Self::Grey),
            Need::SmallGreyPicture { width } => Some(Self::SmallGrey(width)),
            Need::Screen => Some(Self::Picture),
            Need::Detections => Some(Self::Prepared),
        }
    }
}

/// What has been made of one picture so far.
#[derive(Default)]
pub(super) struct PreparedFrame {
    /// The decoded picture, if there is one.
    pub(super) picture: Arc<Picture>,
    decoded: bool,
    /// The detector's input, until it is taken.
    pub(super) prepared: Option<PreparedPicture>,
    /// The picture in grey, if there is one.
    pub(super) grey: Picture,
    /// Which of the grey pictures that is.
    greyed: Option<Stage>,
    /// How long decoding took, grey included.
    pub(super) decode: Option<Duration>,
}

impl PreparedFrame {
    /// Whether nothing has been made of the picture yet.
    fn is_empty(&self) -> bool {
        !self.decoded && self.greyed.is_none()
    }

    /// Whether nothing more has to be done for `look`.
    pub(super) fn has(&self, stage: Stage) -> bool {
        match stage {
            Stage::Grey | Stage::SmallGrey(_) => self.greyed == Some(stage),
            Stage::Picture => self.decoded,
            Stage::Prepared => self.prepared.is_some(),
        }
    }

    fn add(
        &mut self,
        stage: Stage,
        encoded: &EncodedPicture,
        target: PictureSize,
        limits: &FrameLimits,
        preparation: &Preparation,
    ) -> Result<(), FrameFault> {
        let start = Instant::now();
        match stage {
            Stage::Grey | Stage::SmallGrey(_) => {
                self.greyed = None;
                match stage {
                    Stage::SmallGrey(width) => {
                        decode_small_grey(encoded, limits, width, &mut self.grey)?;
                    }
                    _ => decode_grey_half(encoded, limits, &mut self.grey)?,
                }
                self.greyed = Some(stage);
                self.decode = Some(self.decode.unwrap_or_default() + start.elapsed());
            }
            Stage::Picture => {
                // Whoever still holds the old picture keeps it, and this one gets a buffer of its own.
                let mut picture =
                    Arc::try_unwrap(std::mem::take(&mut self.picture)).unwrap_or_default();
                let layout = PixelLayout::Rgb8;
                decode(encoded, limits, layout, Some(target), &mut picture)?;
                self.picture = Arc::new(picture);
                self.decoded = true;
                self.decode = Some(self.decode.unwrap_or_default() + start.elapsed());
            }
            Stage::Prepared => {
                if !self.decoded {
                    self.add(Stage::Picture, encoded, target, limits, preparation)?;
                }
                let prepared = preparation.prepare(&self.picture);
                self.prepared = Some(prepared.map_err(|error| FrameFault::Undecodable {
                    reason: error.to_string(),
                })?);
            }
        }
        Ok(())
    }
}

/// Buffers of this size are kept for the next picture, whatever that is.
const ALWAYS_KEPT: usize = 2 << 20;

/// Larger ones are kept when they are at most so many times what the picture before needed.
const KEPT_TIMES: usize = 4;

/// Where pictures are looked at.
pub(super) struct PictureWorker {
    limits: FrameLimits,
    preparation: Preparation,
    /// A frame of an earlier frame, for its buffers.
    spare: PreparedFrame,
    /// What the buffers of the last picture came to.
    usual: usize,
}

impl PictureWorker {
    pub(super) fn new(limits: FrameLimits, preparation: Preparation) -> Self {
        Self {
            limits,
            preparation,
            spare: PreparedFrame::default(),
            usual: 0,
        }
    }

    /// Takes the buffers of a frame that is done. Those of one giant picture among small ones are given back at once:
    /// there may not be another picture for minutes.
    pub(super) fn take_back(&mut self, frame: PreparedFrame) {
        // Without anything, the buffers are elsewhere: spare, or with what is made ready ahead.
        if frame.is_empty() {
            return;
        }
        let bytes = frame.picture.pixels.capacity() + frame.grey.pixels.capacity();
        let usual = std::mem::replace(&mut self.usual, bytes);
        if bytes <= ALWAYS_KEPT || bytes / KEPT_TIMES <= usual {
            self.spare = PreparedFrame {
                picture: frame.picture,
                grey: frame.grey,
                ..PreparedFrame::default()
            };
        }
    }

    /// Makes of the picture what is missing in `frame`. It may be decoded to fewer pixels, down to `target`.
    pub(super) async fn look(
        &mut self,
        frame: PreparedFrame,
        encoded: &EncodedPicture,
        target: PictureSize,
        stage: Stage,
    ) -> Result<PreparedFrame, FrameFault> {
        joined(self.spawn(frame, encoded.clone(), target, stage)).await
    }

    /// Begins with a picture that is needed later.
    pub(super) fn begin(
        &mut self,
        encoded: EncodedPicture,
        target: PictureSize,
        stage: Stage,
    ) -> Prefetch {
        Prefetch {
            work: self.spawn(PreparedFrame::default(), encoded.clone(), target, stage),
            encoded,
        }
    }

    fn spawn(
        &mut self,
        mut frame: PreparedFrame,
        encoded: EncodedPicture,
        target: PictureSize,
        stage: Stage,
    ) -> JoinHandle<Result<PreparedFrame, FrameFault>> {
        if frame.is_empty() {
            frame = std::mem::take(&mut self.spare);
        }
        let (limits, preparation) = (self.limits, self.preparation.clone());
        tokio::task::spawn_blocking(move || {
            frame.add(stage, &encoded, target, &limits, &preparation)?;
            Ok(frame)
        })
    }
}

/// A picture that is being looked at before its frame's turn has come.
pub(super) struct Prefetch {
    encoded: EncodedPicture,
    work: JoinHandle<Result<PreparedFrame, FrameFault>>,
}

impl Prefetch {
    /// Whether it is this very picture, not only an equal one.
    pub(super) fn is_of(&self, encoded: &EncodedPicture) -> bool {
        // As long as this holds on to the bytes, nothing else can lie where they are.
        std::ptr::eq(self.encoded.bytes.as_ptr(), encoded.bytes.as_ptr())
            && self.encoded.bytes.len() == encoded.bytes.len()
    }

    /// What was made of it.
    ///
    /// # Errors
    /// [`FrameFault`] when it cannot be decoded.
    pub(super) async fn frame(self) -> Result<PreparedFrame, FrameFault> {
        joined(self.work).await
    }
}

/// A panic in the work is a fault of the picture.
async fn joined(
    work: JoinHandle<Result<PreparedFrame, FrameFault>>,
) -> Result<PreparedFrame, FrameFault> {
    work.await.unwrap_or_else(|error| {
        Err(FrameFault::Undecodable {
            reason: format!("the decoder failed: {error}"),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{ColorOrder, Fit, InputFormat, TensorLayout, ValueRange};

    fn worker() -> PictureWorker {
        let format = InputFormat {
            size: PictureSize::new(4, 2),
            fit: Fit::Stretch,
            color_order: ColorOrder::Rgb,
            value_range: ValueRange::To255,
            layout: TensorLayout::Nchw,
        };
        PictureWorker::new(FrameLimits::default(), Preparation::new(format))
    }

    fn seen(bytes: usize) -> PreparedFrame {
        PreparedFrame {
            picture: Arc::new(Picture {
                pixels: vec![0; bytes],
                ..Picture::default()
            }),
            decoded: true,
            ..PreparedFrame::default()
        }
    }

    #[test]
    fn the_buffer_of_one_giant_picture_is_given_back_and_that_of_a_stream_of_them_is_kept() {
        const HD: usize = 1920 * 1080 * 3;
        const GIANT: usize = 16 * HD;
        let mut worker = worker();
        let mut kept = |bytes| {
            worker.take_back(seen(bytes));
            std::mem::take(&mut worker.spare).picture.pixels.capacity()
        };
        assert_eq!(kept(HD), 0, "nothing is known yet of what is usual");
        assert_eq!(kept(HD), HD);
        assert_eq!(kept(GIANT), 0);
        assert_eq!(kept(GIANT), GIANT);
        assert_eq!(kept(HD), HD);
        assert_eq!(kept(640 * 360 * 3), 640 * 360 * 3);
        assert_eq!(kept(ALWAYS_KEPT), ALWAYS_KEPT);
    }
}
