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
    /// As [`Nv12`](Self::Nv12), with pairs of Cr, Cb.
    Nv21,
    /// As [`Nv12`](Self::Nv12), with a pair of Cb, Cr for each pixel: YCbCr 4:4:4.
    Nv24,
    /// Rows of luma, two bytes each, the lower first. The upper eight of the used bits are kept.
    Gray16,
    /// Rows of single colours behind a colour filter, one byte each.
    Bayer(BayerPattern),
    /// The same with two bytes each, the lower first. The upper eight of the used bits are kept.
    Bayer16(BayerPattern),
}

/// The colours of the filter of a Bayer picture: those of its upper left square, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BayerPattern {
    /// Red, green; green, blue.
    Rggb,
    /// Blue, green; green, red.
    Bggr,
    /// Green, blue; red, green.
    Gbrg,
    /// Green, red; blue, green.
    Grbg,
}

impl BayerPattern {
    const ALL: [Self; 4] = [Self::Rggb, Self::Bggr, Self::Gbrg, Self::Grbg];

    /// The name with one byte per pixel.
    const fn narrow_name(self) -> &'static str {
        match self {
            Self::Rggb => "bayer_rggb8",
            Self::Bggr => "bayer_bggr8",
            Self::Gbrg => "bayer_gbrg8",
            Self::Grbg => "bayer_grbg8",
        }
    }

    /// The name with two bytes per pixel.
    const fn wide_name(self) -> &'static str {
        match self {
            Self::Rggb => "bayer_rggb16",
            Self::Bggr => "bayer_bggr16",
            Self::Gbrg => "bayer_gbrg16",
            Self::Grbg => "bayer_grbg16",
        }
    }

    /// Column and row of the red pixel in a square of four.
    pub(super) const fn red(self) -> (usize, usize) {
        match self {
            Self::Rggb => (0, 0),
            Self::Bggr => (1, 1),
            Self::Gbrg => (0, 1),
            Self::Grbg => (1, 0),
        }
    }
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
            Self::Nv21 => "nv21",
            Self::Nv24 => "nv24",
            Self::Gray16 => "gray16",
            Self::Bayer(pattern) => pattern.narrow_name(),
            Self::Bayer16(pattern) => pattern.wide_name(),
        }
    }

    /// The raw format with this name, or one of the names that cameras, ffmpeg and ROS 2 give it.
    pub fn raw_from_name(name: &str) -> Option<Self> {
        let plain = [
            Self::Rgb8,
            Self::Bgr8,
            Self::Rgba8,
            Self::Bgra8,
            Self::Gray8,
            Self::Nv12,
            Self::I420,
            Self::Yuyv,
            Self::Uyvy,
            Self::Nv21,
            Self::Nv24,
            Self::Gray16,
        ];
        let eight_bits = BayerPattern::ALL.map(Self::Bayer);
        let sixteen_bits = BayerPattern::ALL.map(Self::Bayer16);
        let mut raw = plain.into_iter().chain(eight_bits).chain(sixteen_bits);
        raw.find(|format| {
            let has_name = |known: &str| known.eq_ignore_ascii_case(name);
            has_name(format.as_str()) || format.other_names().iter().any(|other| has_name(other))
        })
    }

    /// The names that others give it.
    const fn other_names(self) -> &'static [&'static str] {
        match self {
            Self::Yuyv => &["yuyv422", "yuy2", "yuv422_yuy2"],
            Self::Uyvy => &["uyvy422", "yuv422"],
            Self::I420 => &["yuv420p"],
            Self::Gray8 => &["mono8", "grey"],
            Self::Gray16 => &["mono16", "gray16le"],
            _ => &[],
        }
    }

    /// True if a sample has two bytes.
    pub const fn is_wide(self) -> bool {
        matches!(self, Self::Gray16 | Self::Bayer16(_))
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
            Self::Gray8 | Self::Bayer(_) => Some(size.pixels()),
            Self::Gray16 | Self::Bayer16(_) => size.pixels().checked_mul(2),
            Self::Nv24 => size.pixels().checked_mul(3),
            Self::Nv12 | Self::Nv21 | Self::I420 => {
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
            Self::Gray8 | Self::Bayer(_) => vec![whole(width)],
            Self::Gray16 | Self::Bayer16(_) => vec![whole(2 * width)],
            Self::Yuyv | Self::Uyvy => vec![whole(4 * half_width)],
            Self::Nv24 => vec![
                whole(width),
                Plane {
                    share: 4,
                    ..whole(2 * width)
                },
            ],
            Self::Nv12 | Self::Nv21 => vec![whole(width), chroma(2 * half_width, 2)],
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
