//! The sizes of a model's input. A model with open height and width runs on each shape of picture at the smallest input
//! that holds it, once the boxes found there agree with those of the largest input on the first pictures.

mod agreement;

pub use agreement::Agreement;

use super::HeadName;
use crate::picture::InputFormat;
use albireo_core::geometry::PictureSize;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use tracing::{info, warn};

/// The shape of most cameras' pictures, for what is said before one has arrived.
pub const USUAL_PICTURE: PictureSize = PictureSize::new(1920, 1080);

/// The largest stride of most models, for those that do not tell.
pub(super) const STRIDE: u32 = 32;

/// A share of padding that is worth a word.
const WASTE: f64 = 0.25;

/// The input of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelInput {
    /// Its format; the size is the largest one.
    pub format: InputFormat,
    /// The sizes below, if its height and width are open.
    pub open: Option<OpenSides>,
    /// The head of a detector.
    pub head: Option<HeadName>,
}

/// The sizes that a model with open height and width may run at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OpenSides {
    /// Sides are multiples of it.
    pub stride: u32,
    /// No side is shorter.
    pub least: PictureSize,
}

impl From<InputFormat> for ModelInput {
    fn from(format: InputFormat) -> Self {
        Self {
            format,
            open: None,
            head: None,
        }
    }
}

impl ModelInput {
    /// The smallest input that holds a picture of `source`, whether or not the model can run at it.
    pub fn smallest_for(&self, source: PictureSize) -> PictureSize {
        let open = self.open.unwrap_or(OpenSides {
            stride: STRIDE,
            least: PictureSize::new(1, 1),
        });
        self.format.smallest_for(source, open.stride, open.least)
    }

    /// The input for pictures of this size, before any has come.
    pub fn first_use(&self, picture: PictureSize) -> InputUse {
        let padded = |size| PaddedInput {
            size,
            padding: self.format.padding(picture, size),
        };
        let largest = padded(self.format.size);
        let smallest = padded(self.smallest_for(picture));
        let choice = match self.open {
            None => Choice::Fixed,
            Some(_) if smallest == largest => Choice::Smallest(Agreement::default()),
            Some(_) => Choice::Comparing(Agreement::default()),
        };
        InputUse {
            picture,
            largest,
            smallest,
            choice,
            head: self.head,
        }
    }
}

/// Which input pictures of one shape run at, and why.
#[derive(Clone, Debug, PartialEq)]
pub enum Choice {
    /// The model has only one size.
    Fixed,
    /// The largest, while the smallest is compared with it.
    Comparing(Agreement),
    /// The smallest, whose boxes agree with those of the largest.
    Smallest(Agreement),
    /// The largest, for this reason.
    Largest(String),
}

impl Choice {
    /// Its name in answers.
    pub const fn as_str(&self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Comparing(_) => "comparing",
            Self::Smallest(_) => "smallest",
            Self::Largest(_) => "largest",
        }
    }
}

/// A size of the input, and what of it a picture leaves empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaddedInput {
    /// Columns and rows.
    pub size: PictureSize,
    /// The share that the picture does not cover, 0 to 1.
    pub padding: f64,
}

/// The input for pictures of one shape.
#[derive(Clone, Debug, PartialEq)]
pub struct InputUse {
    /// The size of the first such picture.
    pub picture: PictureSize,
    /// The largest input.
    pub largest: PaddedInput,
    /// The smallest input that holds it, whether or not the model can run at it.
    pub smallest: PaddedInput,
    /// The one of them at which it runs, and why.
    pub choice: Choice,
    /// The head, for the words about its exporter.
    head: Option<HeadName>,
}

/// The sizes of one model's input in use. Clones share them.
#[derive(Clone)]
pub(crate) struct Inputs(Arc<SharedInputs>);

struct SharedInputs {
    model: ModelInput,
    /// By the smallest input, see [`key`]: as many as it has strides, whatever pictures come.
    uses: Mutex<BTreeMap<(u32, u32), InputUse>>,
}

impl Inputs {
    pub(crate) fn new(model: ModelInput) -> Self {
        let uses = Mutex::default();
        Self(Arc::new(SharedInputs { model, uses }))
    }

    pub(crate) fn model(&self) -> ModelInput {
        self.0.model
    }

    /// The inputs in use, by shape of picture.
    pub(crate) fn uses(&self) -> Vec<InputUse> {
        self.0.uses.lock().values().cloned().collect()
    }

    /// The input at which a picture of `source` runs now. Notes the first picture of each shape, and warns if it leaves
    /// much of the only input empty.
    pub(crate) fn size_for(&self, source: PictureSize) -> PictureSize {
        let model = &self.0.model;
        let smallest = model.smallest_for(source);
        let mut uses = self.0.uses.lock();
        if let Some(known) = uses.get(&key(smallest)) {
            return known.input().size;
        }
        let first = model.first_use(source);
        if first.is_wasteful() && first.choice == Choice::Fixed {
            warn!("{first}");
        }
        let size = first.input().size;
        uses.insert(key(smallest), first);
        size
    }

    /// The smallest input for a picture of `source`, if it is still being compared.
    pub(crate) fn compared(&self, source: PictureSize) -> Option<PictureSize> {
        let smallest = self.0.model.smallest_for(source);
        let uses = self.0.uses.lock();
        match uses.get(&key(smallest))?.choice {
            Choice::Comparing(_) => Some(smallest),
            Choice::Fixed | Choice::Smallest(_) | Choice::Largest(_) => None,
        }
    }

    /// Adds the comparison of one picture's boxes, or the reason why the model did not run at the smallest input; decides
    /// when enough has been compared, and logs the decision.
    pub(crate) fn add(&self, smallest: PictureSize, compared: Result<Agreement, String>) {
        let mut uses = self.0.uses.lock();
        let Some(found) = uses.get_mut(&key(smallest)) else {
            return;
        };
        let Choice::Comparing(so_far) = &found.choice else {
            return;
        };
        found.choice = match compared {
            Err(reason) => {
                Choice::Largest(format!("the model does not run at {smallest}: {reason}"))
            }
            Ok(agreement) => so_far.plus(agreement).decided(),
        };
        match &found.choice {
            Choice::Smallest(_) => info!("{found}"),
            Choice::Largest(_) => warn!("{found}"),
            Choice::Comparing(_) | Choice::Fixed => {}
        }
    }
}

/// A size as rows and columns, which have an order.
fn key(size: PictureSize) -> (u32, u32) {
    (size.height, size.width)
}

impl InputUse {
    /// The input at which such pictures run.
    pub fn input(&self) -> PaddedInput {
        match self.choice {
            Choice::Smallest(_) => self.smallest,
            Choice::Fixed | Choice::Comparing(_) | Choice::Largest(_) => self.largest,
        }
    }

    /// True if more than a quarter of the input is empty, and less need be.
    pub fn is_wasteful(&self) -> bool {
        let input = self.input();
        input.padding > WASTE && self.smallest.size.pixels() < input.size.pixels()
    }
}

impl fmt::Display for InputUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PaddedInput { size, padding } = self.input();
        write!(
            f,
            "{} of the input {size} is padding for pictures of {}",
            percent(padding),
            self.picture
        )?;
        let smallest = self.smallest.size;
        let least = percent(self.smallest.padding);
        match &self.choice {
            Choice::Fixed if self.is_wasteful() => {
                let words = self.head.map(|head| head.export_for(smallest)).unwrap_or_default();
                write!(f, "; {smallest} would have {least}: {words}")
            }
            Choice::Fixed => Ok(()),
            Choice::Comparing(agreement) => {
                write!(
                    f,
                    "; {smallest} ({least}) is used once it has found the same in the first pictures"
                )?;
                if agreement.pictures > 0 {
                    write!(f, " ({agreement} so far)")?;
                }
                Ok(())
            }
            Choice::Smallest(agreement) if agreement.pictures > 0 => {
                let largest = self.largest;
                write!(
                    f,
                    ", not {} of {}, which finds the same: {agreement}",
                    percent(largest.padding),
                    largest.size
                )
            }
            Choice::Smallest(_) => Ok(()),
            Choice::Largest(reason) => write!(
                f,
                " and stays so, instead of {least} of {smallest}: {reason}"
            ),
        }
    }
}

/// A share as a whole number of percent.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}
