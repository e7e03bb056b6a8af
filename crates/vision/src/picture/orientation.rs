//! How a picture's pixels must be turned to stand upright: as its Exif data say (JEITA CP-3451, tag 0x0112), as browsers
//! and vision libraries show it, and as its camera is mounted.

use super::mount::Flip;
use super::{Picture, PictureFormat, PixelLayout};
use albireo_core::geometry::PictureSize;
use std::ops::Range;

/// How stored pixels become upright ones, by the eight values of the tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Orientation {
    /// True if rows become columns.
    transposed: bool,
    /// True if the stored picture, before it is transposed, is mirrored left to right.
    from_right: bool,
    /// True if it is mirrored top to bottom.
    from_bottom: bool,
}

impl Orientation {
    pub(super) const UPRIGHT: Self = Self {
        transposed: false,
        from_right: false,
        from_bottom: false,
    };

    /// The orientation of a value of the tag. A value that the standard does not have is upright.
    fn from_tag(value: u16) -> Self {
        Self {
            transposed: matches!(value, 5..=8),
            from_right: matches!(value, 2 | 3 | 7 | 8),
            from_bottom: matches!(value, 3 | 4 | 6 | 7),
        }
    }

    /// The size of the upright picture whose stored size is `size`, and the other way round.
    pub(super) fn turned(self, size: PictureSize) -> PictureSize {
        if self.transposed {
            PictureSize::new(size.height, size.width)
        } else {
            size
        }
    }

    /// Turned clockwise by so many degrees, in steps of a right angle.
    pub(super) fn clockwise(degrees: i64) -> Self {
        match degrees {
            90 => Self::from_tag(6),
            180 => Self::from_tag(3),
            270 => Self::from_tag(8),
            _ => Self::UPRIGHT,
        }
    }

    pub(super) const fn mirrored(flip: Flip) -> Self {
        match flip {
            Flip::Horizontal => Self {
                from_right: true,
                ..Self::UPRIGHT
            },
            Flip::Vertical => Self {
                from_bottom: true,
                ..Self::UPRIGHT
            },
        }
    }

    /// This orientation, and then `next` of what it has made.
    pub(super) const fn then(self, next: Self) -> Self {
        let (from_right, from_bottom) = if self.transposed {
            (next.from_bottom, next.from_right)
        } else {
            (next.from_right, next.from_bottom)
        };
        Self {
            transposed: self.transposed != next.transposed,
            from_right: self.from_right != from_right,
            from_bottom: self.from_bottom != from_bottom,
        }
    }

    /// Turns the pixels of `picture` upright, and keeps `part` of that.
    pub(super) fn apply(self, picture: &mut Picture, part: Part) {
        let is_whole = part.size == self.turned(picture.size);
        if self == Self::UPRIGHT && is_whole {
            return;
        }
        picture.pixels = match picture.layout {
            PixelLayout::Rgb8 => self.turned_pixels::<3>(picture, part),
            PixelLayout::Gray8 => self.turned_pixels::<1>(picture, part),
        };
        picture.size = part.size;
    }

    /// The pixels of `part` of the upright picture, of which each has `BYTES` bytes.
    fn turned_pixels<const BYTES: usize>(self, picture: &Picture, part: Part) -> Vec<u8> {
        let (stored, _) = picture.pixels.as_chunks::<BYTES>();
        let columns = picture.size.width as usize;
        let rows = picture.size.height as usize;
        let mut turned =
            Vec::with_capacity(part.size.width as usize * part.size.height as usize * BYTES);
        for y in part.rows() {
            for x in part.columns() {
                let (column, row) = if self.transposed { (y, x) } else { (x, y) };
                let column = if self.from_right {
                    columns - 1 - column
                } else {
                    column
                };
                let row = if self.from_bottom {
                    rows - 1 - row
                } else {
                    row
                };
                turned.extend_from_slice(&stored[row * columns + column]);
            }
        }
        turned
    }
}

/// A part of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Part {
    pub left: u32,
    pub top: u32,
    pub size: PictureSize,
}

impl Part {
    /// All of a picture of `size`.
    pub(super) const fn all(size: PictureSize) -> Self {
        Self {
            left: 0,
            top: 0,
            size,
        }
    }

    fn columns(self) -> Range<usize> {
        self.left as usize..(self.left + self.size.width) as usize
    }

    fn rows(self) -> Range<usize> {
        self.top as usize..(self.top + self.size.height) as usize
    }
}

/// The orientation of a file; upright if it has none or it cannot be read.
pub(super) fn orientation(format: PictureFormat, bytes: &[u8]) -> Orientation {
    let tag = match format {
        PictureFormat::Jpeg => super::header::jpeg_exif(bytes).and_then(tag),
        PictureFormat::Png => super::header::png_exif(bytes).and_then(tag),
        _ => None,
    };
    tag.map_or(Orientation::UPRIGHT, Orientation::from_tag)
}

/// The orientation in a TIFF structure, whose first directory lists it.
fn tag(tiff: &[u8]) -> Option<u16> {
    const ORIENTATION: u16 = 0x0112;
    let is_little = match tiff.get(..4)? {
        b"II*\0" => true,
        b"MM\0*" => false,
        _ => return None,
    };
    let short = |at: usize| {
        let pair = *tiff.get(at..)?.first_chunk::<2>()?;
        Some(if is_little {
            u16::from_le_bytes(pair)
        } else {
            u16::from_be_bytes(pair)
        })
    };
    let first_directory = *tiff.get(4..)?.first_chunk::<4>()?;
    let begins_at = if is_little {
        u32::from_le_bytes(first_directory)
    } else {
        u32::from_be_bytes(first_directory)
    };
    let directory = usize::try_from(begins_at).ok()?;
    let entries = usize::from(short(directory)?);
    for entry in 0..entries {
        // An entry has 12 bytes: tag, type, count, value. Its number precedes them.
        let at = directory.checked_add(2 + 12 * entry)?;
        if short(at)? == ORIENTATION {
            return short(at.checked_add(8)?);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_orientation_turns_the_picture_as_the_standard_says() {
        // Two rows of three pixels: 1 2 3 / 4 5 6.
        for (value, columns, expected) in [
            (1, 3, [1, 2, 3, 4, 5, 6]),
            (2, 3, [3, 2, 1, 6, 5, 4]),
            (3, 3, [6, 5, 4, 3, 2, 1]),
            (4, 3, [4, 5, 6, 1, 2, 3]),
            (5, 2, [1, 4, 2, 5, 3, 6]),
            (6, 2, [4, 1, 5, 2, 6, 3]),
            (7, 2, [6, 3, 5, 2, 4, 1]),
            (8, 2, [3, 6, 2, 5, 1, 4]),
            (9, 3, [1, 2, 3, 4, 5, 6]),
        ] {
            let size = PictureSize::new(3, 2);
            let mut picture = Picture {
                size,
                source_size: size,
                layout: PixelLayout::Gray8,
                pixels: vec![1, 2, 3, 4, 5, 6],
            };
            let orientation = Orientation::from_tag(value);
            let whole = Part::all(orientation.turned(size));
            orientation.apply(&mut picture, whole);
            assert_eq!(picture.size.width, columns, "{value}");
            assert_eq!(picture.pixels, expected, "{value}");
        }
    }

    #[test]
    fn the_tag_is_read_in_either_byte_order_and_damage_is_no_orientation() {
        let little = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        let big = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        assert_eq!(tag(little), Some(6));
        assert_eq!(tag(big), Some(6));
        // The value ends behind the twentieth byte.
        for length in 0..20 {
            assert_eq!(tag(&little[..length]), None);
        }
        assert_eq!(tag(b"II*\0\xff\xff\xff\xff"), None);
    }
}
