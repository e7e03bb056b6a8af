//! Pixel work of one camera, on blocking threads: decoding, grey, the detector's input. Buffers go round.

use crate::detector::{Preparation, PreparedPicture};
use crate::frame::{
    EncodedPicture, FrameFault, FrameLimits, Picture, PixelLayout, decode, decode_grey_half,
};
use crate::geometry::PictureSize;
use crate::policy::Need;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;

/// What is to be made of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Look {
    /// Grey at half its size.
    Grey,
    /// The decoded picture.
    Picture,
    /// The detector's input, and the decoded picture with it.
    Prepared,
}

impl Look {
    /// What `need` begins with.
    pub(super) fn at(need: Need) -> Option<Self> {
        match need {
            Need::Nothing => None,
            Need::GreyPicture => Some(Self::Grey),
            Need::Screen => Some(Self::Picture),
            Need::Detections => Some(Self::Prepared),
        }
    }
}

/// What has been made of one picture so far.
#[derive(Default)]
pub(super) struct Sight {
    /// The decoded picture, if there is one.
    pub(super) picture: Arc<Picture>,
    decoded: bool,
    /// The detector's input, until it is taken.
    pub(super) prepared: Option<PreparedPicture>,
    /// The picture in grey, if there is one.
    pub(super) grey: Picture,
    greyed: bool,
    /// How long decoding took, grey included.
    pub(super) decode: Option<Duration>,
}

impl Sight {
    /// Whether nothing has been made of the picture yet.
    fn is_empty(&self) -> bool {
        !(self.decoded || self.greyed)
    }

    /// Whether nothing more has to be done for `look`.
    pub(super) fn has(&self, look: Look) -> bool {
        match look {
            Look::Grey => self.greyed,
            Look::Picture => self.decoded,
            Look::Prepared => self.prepared.is_some(),
        }
    }

    fn add(
        &mut self,
        look: Look,
        encoded: &EncodedPicture,
        target: PictureSize,
        limits: &FrameLimits,
        preparation: &Preparation,
    ) -> Result<(), FrameFault> {
        let start = Instant::now();
        match look {
            Look::Grey => {
                decode_grey_half(encoded, limits, &mut self.grey)?;
                self.greyed = true;
                self.decode = Some(self.decode.unwrap_or_default() + start.elapsed());
            }
            Look::Picture => {
                // Whoever still holds the old picture keeps it, and this one gets a buffer of its own.
                let mut picture =
                    Arc::try_unwrap(std::mem::take(&mut self.picture)).unwrap_or_default();
                let layout = PixelLayout::Rgb8;
                decode(encoded, limits, layout, Some(target), &mut picture)?;
                self.picture = Arc::new(picture);
                self.decoded = true;
                self.decode = Some(self.decode.unwrap_or_default() + start.elapsed());
            }
            Look::Prepared => {
                if !self.decoded {
                    self.add(Look::Picture, encoded, target, limits, preparation)?;
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

/// Where pictures are looked at.
pub(super) struct Workshop {
    limits: FrameLimits,
    preparation: Preparation,
    /// A sight of an earlier frame, for its buffers.
    spare: Sight,
}

impl Workshop {
    pub(super) fn new(limits: FrameLimits, preparation: Preparation) -> Self {
        Self {
            limits,
            preparation,
            spare: Sight::default(),
        }
    }

    /// Takes the buffers of a frame that is done.
    pub(super) fn take_back(&mut self, sight: Sight) {
        // Without anything, the buffers are elsewhere: spare, or with what is made ready ahead.
        if !sight.is_empty() {
            self.spare = Sight {
                picture: sight.picture,
                grey: sight.grey,
                ..Sight::default()
            };
        }
    }

    /// Makes of the picture what is missing in `sight`. It may be decoded to fewer pixels, down to `target`.
    pub(super) async fn look(
        &mut self,
        sight: Sight,
        encoded: &EncodedPicture,
        target: PictureSize,
        look: Look,
    ) -> Result<Sight, FrameFault> {
        joined(self.spawn(sight, encoded.clone(), target, look)).await
    }

    /// Begins with a picture that is needed later.
    pub(super) fn begin(
        &mut self,
        encoded: EncodedPicture,
        target: PictureSize,
        look: Look,
    ) -> Ahead {
        Ahead {
            work: self.spawn(Sight::default(), encoded.clone(), target, look),
            encoded,
        }
    }

    fn spawn(
        &mut self,
        mut sight: Sight,
        encoded: EncodedPicture,
        target: PictureSize,
        look: Look,
    ) -> JoinHandle<Result<Sight, FrameFault>> {
        if sight.is_empty() {
            sight = std::mem::take(&mut self.spare);
        }
        let (limits, preparation) = (self.limits, self.preparation.clone());
        tokio::task::spawn_blocking(move || {
            sight.add(look, &encoded, target, &limits, &preparation)?;
            Ok(sight)
        })
    }
}

/// A picture that is being looked at before its frame's turn has come.
pub(super) struct Ahead {
    encoded: EncodedPicture,
    work: JoinHandle<Result<Sight, FrameFault>>,
}

impl Ahead {
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
    pub(super) async fn sight(self) -> Result<Sight, FrameFault> {
        joined(self.work).await
    }
}

/// A panic in the work is a fault of the picture.
async fn joined(work: JoinHandle<Result<Sight, FrameFault>>) -> Result<Sight, FrameFault> {
    work.await.unwrap_or_else(|error| {
        Err(FrameFault::Undecodable {
            reason: format!("the decoder failed: {error}"),
        })
    })
}
