//! Pictures before and after decoding.

use albireo_core::geometry::PictureSize;
use bytes::Bytes;

/// The encoding of a picture's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PictureFormat {
    /// A JPEG file (ITU-T T.81), baseline or progressive.
    Jpeg,
    /// A PNG file (W3C PNG, third edition).
    Png,
    /// Rows of red, green, blue, one byte each, without padding.
    Rgb8,
    /// Rows of blue, green, red, one byte each, without padding.
    Bgr8,
    /// Rows of red, green, blue, alpha, one byte each, without padding. Alpha is ignored.
    Rgba8,
    /// Rows of blue, green, red, alpha, one byte each, without padding. Alpha is ignored.
    Bgra8,
    /// Rows of luma, one byte each, without padding.
    Gray8,
    /// A plane of luma, then a plane of Cb, Cr pairs at half the size in each direction (rounded up):
    /// YCbCr 4:2:0, BT.601, limited range (luma 16 to 235).
    Nv12,
}

impl PictureFormat {
    /// The name used in messages and encodings.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Jpeg => "jpeg",
            Self::Png => "png",
            Self::Rgb8 => "rgb8",
            Self::Bgr8 => "bgr8",
            Self::Rgba8 => "rgba8",
            Self::Bgra8 => "bgra8",
            Self::Gray8 => "gray8",
            Self::Nv12 => "nv12",
        }
    }

    /// The raw format with this name.
    pub fn raw_from_name(name: &str) -> Option<Self> {
        [
            Self::Rgb8,
            Self::Bgr8,
            Self::Rgba8,
            Self::Bgra8,
            Self::Gray8,
            Self::Nv12,
        ]
        .into_iter()
        .find(|format| format.as_str().eq_ignore_ascii_case(name))
    }

    /// The number of bytes of a raw picture of `size`; `None` for the compressed formats and if the number does not fit
    /// in 64 bits.
    pub(crate) fn raw_bytes(self, size: PictureSize) -> Option<u64> {
        match self {
            Self::Jpeg | Self::Png => None,
            Self::Rgb8 | Self::Bgr8 => size.pixels().checked_mul(3),
            Self::Rgba8 | Self::Bgra8 => size.pixels().checked_mul(4),
            Self::Gray8 => Some(size.pixels()),
            Self::Nv12 => {
                let chroma = PictureSize::new(size.width.div_ceil(2), size.height.div_ceil(2));
                size.pixels().checked_add(chroma.pixels().checked_mul(2)?)
            }
        }
    }
}

/// A picture as the camera sent it. Its size is known without decoding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedPicture {
    /// The encoding of the bytes.
    pub format: PictureFormat,
    /// The bytes, shared with the network buffer they arrived in.
    pub bytes: Bytes,
    /// Columns and rows: from the file's header, or from the camera for raw pictures.
    pub size: PictureSize,
}

/// The layout of one pixel of a decoded picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelLayout {
    /// Red, green, blue, one byte each.
    Rgb8,
    /// Luma, one byte.
    Gray8,
}

impl PixelLayout {
    /// The number of bytes per pixel.
    pub const fn channels(self) -> usize {
        match self {
            Self::Rgb8 => 3,
            Self::Gray8 => 1,
        }
    }
}

/// A decoded picture. Passed to the next decoding, so that its buffer is reused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// The size of the picture in pixels.
    pub size: PictureSize,
    /// The size of the frame it comes from: larger than `size` if the picture was scaled down.
    pub source_size: PictureSize,
    /// The layout of one pixel.
    pub layout: PixelLayout,
    /// `size.width * size.height * layout.channels()` bytes, row by row, without padding.
    pub pixels: Vec<u8>,
}

impl Picture {
    /// A black picture.
    pub fn black(size: PictureSize) -> Self {
        let layout = PixelLayout::Rgb8;
        Self {
            size,
            source_size: size,
            layout,
            pixels: vec![0; size.width as usize * size.height as usize * layout.channels()],
        }
    }
}

impl Default for Picture {
    fn default() -> Self {
        Self {
            size: PictureSize::new(0, 0),
            source_size: PictureSize::new(0, 0),
            layout: PixelLayout::Rgb8,
            pixels: Vec::new(),
        }
    }
}
