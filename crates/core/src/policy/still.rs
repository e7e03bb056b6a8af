//! Pictures without news: those in which nothing has changed since the detector looked.
//!
//! A small grey picture is compared with an earlier one, block by block. Once nothing has changed for a second, what the
//! detector found stands, and it looks again only now and then, and at the first picture that has changed. In the dark
//! little changes even if something moves, so nothing must have changed for 30 s. The comparison is made only where the
//! detector would be called: while the picture moves, once a second.

use super::{Evidence, GreyPicture, PauseFrames};
use crate::detection::Detection;
use crate::geometry::PictureSize;
use serde::{Deserialize, Serialize};

/// Columns of the pictures that are compared. A JPEG file of 720p gives them at an eighth of its size.
pub(super) const WIDTH: u32 = 160;

/// Columns of blocks in a picture: of 4x4 pixels in one of 160 columns.
const BLOCKS: usize = 40;

/// A block has changed if its mean differs by this many grey levels of 255. Between two frames a second apart of clips from
/// moving cars, the block that changes most does so by 37 and more in 99 of 100 cases, at night too; made dark to a mean
/// below one, by 2.4. Noise and compression of a camera that stands still move the mean of a block by about one.
const CHANGE: u32 = 4;

/// A picture with a lower mean, in grey levels of 255, is dark.
const DARK: u32 = 16;

/// Seconds without a change after which a dark picture has no news.
const DARK_AFTER_S: u32 = 30;

/// The reason why a frame was passed over by a pause.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PassCause {
    /// The road was empty at the last looks.
    EmptyRoad,
    /// The picture has not changed since the detector looked.
    Unchanged,
    /// The same, and the picture is dark.
    Dark,
}

impl PassCause {
    /// All causes, in counting order.
    pub const ALL: [Self; 3] = [Self::EmptyRoad, Self::Unchanged, Self::Dark];

    /// The name on the wire.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::EmptyRoad => "empty_road",
            Self::Unchanged => "unchanged",
            Self::Dark => "dark",
        }
    }
}

/// What the decision depends on, in frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Still {
    /// Since the picture last changed: since the one that others are compared with.
    since_change: u32,
    /// Since the last comparison.
    since_comparison: u32,
    /// Since the detector looked.
    since_look: u32,
    /// True if the last comparison found no change.
    same: bool,
    is_dark: bool,
    /// True once there is a picture to compare with.
    begun: bool,
}

impl Still {
    pub(super) fn advance(&mut self, step: u32) {
        for since in [
            &mut self.since_change,
            &mut self.since_comparison,
            &mut self.since_look,
        ] {
            *since = since.saturating_add(step);
        }
    }

    /// True if the picture should be compared before the detector is called.
    pub(super) fn is_due(self, pause: PauseFrames) -> bool {
        pause.still > 1 && (self.same || !self.begun || self.since_comparison >= pause.second)
    }

    /// The reason why the picture has no news, and for how many frames.
    pub(super) fn cause(self, pause: PauseFrames) -> Option<(PassCause, u32)> {
        let (cause, after_s) = if self.is_dark {
            (PassCause::Dark, DARK_AFTER_S)
        } else {
            (PassCause::Unchanged, 1)
        };
        let after = pause.second.saturating_mul(after_s);
        let is_still = pause.still > 1 && self.same && self.since_change >= after;
        is_still.then_some((cause, self.since_change))
    }

    /// The reason to pass over the current frame, which was compared.
    fn passes(self, pause: PauseFrames) -> Option<PassCause> {
        let looked = self.since_look <= self.since_change && self.since_look < pause.still;
        let (cause, _) = self.cause(pause)?;
        (looked && self.since_comparison == 0).then_some(cause)
    }

    /// Compares the current picture, if there is one.
    pub(super) fn compare(
        &mut self,
        evidence: Evidence<'_>,
        memory: &mut Memory,
        pause: PauseFrames,
    ) -> Option<PassCause> {
        let Evidence::GreyPicture(picture) = evidence else {
            return None;
        };
        self.same = self.begun && memory.is_same(picture);
        self.since_comparison = 0;
        if !self.same {
            memory.keep(picture);
            self.is_dark = memory.is_dark();
            self.since_change = 0;
            self.begun = true;
        }
        self.passes(pause)
    }

    /// Notes that the detector has looked at the current frame.
    pub(super) fn looked(&mut self) {
        self.since_look = 0;
    }
}

/// What is kept of earlier frames: it is written only from evidence, so a rewound policy need not restore it.
#[derive(Clone, Debug, Default)]
pub(super) struct Memory {
    /// Size of the pictures, and the block means of the one that others are compared with.
    size: Option<PictureSize>,
    blocks: Vec<u8>,
    /// The block means of the current picture.
    current: Vec<u8>,
    /// What the detector found at its last look.
    pub(super) found: Vec<Detection>,
}

impl Memory {
    /// Keeps what the detector found.
    pub(super) fn looked(&mut self, found: &[Detection]) {
        self.found.clear();
        self.found.extend_from_slice(found);
    }

    fn is_same(&mut self, picture: GreyPicture<'_>) -> bool {
        block_means(picture, &mut self.current);
        let mut pairs = self.current.iter().zip(&self.blocks);
        let has_changed = |(now, before): (&u8, &u8)| u32::from(now.abs_diff(*before)) >= CHANGE;
        self.size == Some(picture.size) && !pairs.any(has_changed)
    }

    fn keep(&mut self, picture: GreyPicture<'_>) {
        self.size = Some(picture.size);
        block_means(picture, &mut self.blocks);
    }

    fn is_dark(&self) -> bool {
        let sum: u32 = self.blocks.iter().map(|mean| u32::from(*mean)).sum();
        sum < DARK.saturating_mul(self.blocks.len() as u32)
    }
}

/// Overwrites `means` with the mean of each block. What does not fill a block at the right and the bottom belongs to the
/// last ones.
fn block_means(picture: GreyPicture<'_>, means: &mut Vec<u8>) {
    let width = (picture.size.width as usize).max(1);
    let height = picture.size.height as usize;
    let side = (width / BLOCKS).max(1);
    let columns = width / side;
    let rows = (height / side).max(1);
    means.clear();
    for row in 0..rows {
        let top = row * side;
        let bottom = if row + 1 == rows { height } else { top + side };
        for column in 0..columns {
            let left = column * side;
            let right = if column + 1 == columns {
                width
            } else {
                left + side
            };
            let mut sum = 0_u32;
            let mut number = 0_u32;
            for y in top..bottom {
                let line = picture.pixels.get(y * width + left..y * width + right);
                for pixel in line.unwrap_or_default() {
                    sum += u32::from(*pixel);
                    number += 1;
                }
            }
            means.push((sum / number.max(1)) as u8);
        }
    }
}

#[cfg(test)]
mod tests;
