//! Pictures before and after decoding.

use super::mount::Mounted;
use super::raw::Plane;
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
    /// As [`Nv12`](Self::Nv12), with a plane of Cb, then one of Cr.
    I420,
    /// Pairs of pixels as luma, Cb, luma, Cr: YCbCr 4:2:2, BT.601, limited range. Rows of an odd number of pixels end with
    /// a whole pair.
    Yuyv,
    /// The same as Cb, luma, Cr, luma.
    Uyvy,
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
            Self::I420 => "i420",
            Self::Yuyv => "yuyv",
            Self::Uyvy => "uyvy",
        }
    }

    /// The raw format with this name, or one of the names that cameras and ffmpeg give it.
    pub fn raw_from_name(name: &str) -> Option<Self> {
        [
            Self::Rgb8,
            Self::Bgr8,
            Self::Rgba8,
            Self::Bgra8,
            Self::Gray8,
            Self::Nv12,
            Self::I420,
            Self::Yuyv,
            Self::Uyvy,
        ]
        .into_iter()
        .find(|format| {
            let others: &[&str] = match format {
                Self::Yuyv => &["yuyv422", "yuy2"],
                Self::Uyvy => &["uyvy422"],
                Self::I420 => &["yuv420p"],
                Self::Gray8 => &["mono8", "grey"],
                _ => &[],
            };
            let known = others.iter().copied().chain([format.as_str()]);
            known.into_iter().any(|known| known.eq_ignore_ascii_case(name))
        })
    }

    /// The number of bytes of a raw picture of `size`; `None` for the compressed formats and if the number does not fit
    /// in 64 bits.
    pub(crate) fn raw_bytes(self, size: PictureSize) -> Option<u64> {
        let pairs = u64::from(size.width.div_ceil(2));
        match self {
            Self::Jpeg | Self::Png => None,
            Self::Yuyv | Self::Uyvy => (4 * pairs).checked_mul(u64::from(size.height)),
            Self::Rgb8 | Self::Bgr8 => size.pixels().checked_mul(3),
            Self::Rgba8 | Self::Bgra8 => size.pixels().checked_mul(4),
            Self::Gray8 => Some(size.pixels()),
            Self::Nv12 | Self::I420 => {
                let chroma = PictureSize::new(size.width.div_ceil(2), size.height.div_ceil(2));
                size.pixels().checked_add(chroma.pixels().checked_mul(2)?)
            }
        }
    }

    /// The planes of a raw picture of `size`, which is within the limits; none for the compressed formats.
    pub(super) fn planes(self, size: PictureSize) -> Vec<Plane> {
        let width = size.width as usize;
        let rows = size.height as usize;
        let half_width = width.div_ceil(2);
        let half_rows = rows.div_ceil(2);
        let whole = |row: usize| Plane {
            rows,
            row,
            share: 2,
        };
        let chroma = |row: usize, share: usize| Plane {
            rows: half_rows,
            row,
            share,
        };
        match self {
            Self::Jpeg | Self::Png => Vec::new(),
            Self::Rgb8 | Self::Bgr8 => vec![whole(3 * width)],
            Self::Rgba8 | Self::Bgra8 => vec![whole(4 * width)],
            Self::Gray8 => vec![whole(width)],
            Self::Yuyv | Self::Uyvy => vec![whole(4 * half_width)],
            Self::Nv12 => vec![whole(width), chroma(2 * half_width, 2)],
            Self::I420 => vec![whole(width), chroma(half_width, 1), chroma(half_width, 1)],
        }
    }
}

/// A picture as the camera sent it. Its size is known without decoding.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedPicture {
    /// The encoding of the bytes.
    pub format: PictureFormat,
    /// The bytes, shared with the network buffer they arrived in.
    pub bytes: Bytes,
    /// Columns and rows: from the file's header, or from the camera for raw pictures; turned and cropped as its camera is
    /// mounted.
    pub size: PictureSize,
    /// How its camera is mounted, if it must be turned, cropped or masked; see [`EncodedPicture::mounted`].
    pub mount: Option<Mounted>,
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
