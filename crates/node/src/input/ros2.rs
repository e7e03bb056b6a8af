//! ROS 2 `sensor_msgs/msg/CompressedImage` and `Image` in CDR (OMG CDR, plain encoding of XTypes
//! version 1), both byte orders. Nothing is copied, except the rows of an image with padding.

use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{
    EncodedPicture, FrameFault, FrameLimits, PictureFormat, check_picture, format_of,
    picture_of_kind,
};
use bytes::{Buf, Bytes};

/// A message's picture, and its header stamp in nanoseconds since the Unix epoch, if that is set.
pub(super) type StampedPicture = (EncodedPicture, Option<u64>);

/// Reads a CompressedImage: header, format, data.
pub(super) fn read_compressed_image(
    payload: &Bytes,
    limits: &FrameLimits,
) -> Result<StampedPicture, FrameFault> {
    let mut cdr = Cdr::new(payload)?;
    let time_ns = cdr.header()?;
    // Free text, such as `jpeg` or `bgr8; jpeg compressed bgr8`.
    let named = cdr.text("format")?;
    let file = cdr.bytes("data")?;
    let Some(format) = format_of(&file) else {
        let text: String = named.chars().take(48).collect();
        return Err(FrameFault::unknown_format(format!(
            "the CompressedImage (format {text:?}) holds neither a JPEG nor a PNG file"
        )));
    };
    Ok((picture_of_kind(format, file, limits)?, time_ns))
}

/// Reads an Image: header, height, width, encoding, is_bigendian, step, data. `is_bigendian` is irrelevant
/// for the one-byte samples read here.
pub(super) fn read_image(
    payload: &Bytes,
    limits: &FrameLimits,
) -> Result<StampedPicture, FrameFault> {
    let mut cdr = Cdr::new(payload)?;
    let time_ns = cdr.header()?;
    let height = cdr.u32("height")?;
    let width = cdr.u32("width")?;
    let encoding = cdr.text("encoding")?;
    cdr.take(1, "is_bigendian")?;
    let step = cdr.u32("step")? as usize;
    let data = cdr.bytes("data")?;
    // sensor_msgs/image_encodings.hpp; OpenCV's untyped names are treated like in cv_bridge.
    let format = match encoding.as_str() {
        "rgb8" => PictureFormat::Rgb8,
        "bgr8" | "8UC3" => PictureFormat::Bgr8,
        "rgba8" => PictureFormat::Rgba8,
        "bgra8" | "8UC4" => PictureFormat::Bgra8,
        "mono8" | "8UC1" => PictureFormat::Gray8,
        "nv12" => PictureFormat::Nv12,
        other => {
            let start: String = other.chars().take(32).collect();
            return Err(FrameFault::unknown_format(format!(
                "ROS image encoding {start:?} is not supported; rgb8, bgr8, rgba8, bgra8, mono8 and nv12 are"
            )));
        }
    };
    let size = PictureSize::new(width, height);
    check_picture(size, limits)?;
    let bytes = without_padding(&data, step, format, size)?;
    let picture = EncodedPicture {
        format,
        bytes,
        size,
        mount: None,
    };
    Ok((picture, time_ns))
}

/// The rows of a ROS image, packed: the data itself if its rows have no padding, else a copy that is no larger.
fn without_padding(
    data: &Bytes,
    step: usize,
    format: PictureFormat,
    size: PictureSize,
) -> Result<Bytes, FrameFault> {
    let (width, height) = (size.width as usize, size.height as usize);
    // Rows of pixels; for NV12, then rows of chroma: a Cb and a Cr byte per two columns.
    let (row, chroma_row, chroma_rows) = match format {
        PictureFormat::Gray8 => (width, 0, 0),
        PictureFormat::Rgba8 | PictureFormat::Bgra8 => (4 * width, 0, 0),
        PictureFormat::Nv12 => (width, 2 * width.div_ceil(2), height.div_ceil(2)),
        _ => (3 * width, 0, 0),
    };
    let longest = row.max(chroma_row);
    if step < longest {
        return Err(FrameFault::undecodable(format!(
            "a row of the {size} image has {longest} bytes, but its step is {step}"
        )));
    }
    let rows = height + chroma_rows;
    if step.checked_mul(rows).is_none_or(|needed| needed > data.len()) {
        return Err(FrameFault::undecodable(format!(
            "{rows} rows of {step} bytes do not fit in the {} bytes of the ROS image",
            data.len()
        )));
    }
    if step == row {
        return Ok(data.slice(..row * rows));
    }
    let mut packed = Vec::with_capacity(row * height + chroma_row * chroma_rows);
    for (index, padded) in data.chunks(step).take(rows).enumerate() {
        let used = if index < height { row } else { chroma_row };
        packed.extend_from_slice(&padded[..used]);
    }
    Ok(Bytes::from(packed))
}

/// A reader of plain CDR.
struct Cdr {
    rest: Bytes,
    /// The number of bytes read; alignment counts from the end of the encapsulation header.
    read: usize,
    little_endian: bool,
}

/// The length of the encapsulation header.
const ENCAPSULATION: usize = 4;

impl Cdr {
    fn new(payload: &Bytes) -> Result<Self, FrameFault> {
        let little_endian = match payload.get(..ENCAPSULATION) {
            Some([0, 0, ..]) => false,
            Some([0, 1, ..]) => true,
            Some(other) => {
                return Err(FrameFault::unknown_format(format!(
                    "the payload is not a ROS 2 message in plain CDR: it begins with {other:02x?}, not \
                     with 00 00 or 00 01"
                )));
            }
            None => return Err(cut_short("its encapsulation header")),
        };
        Ok(Self {
            rest: payload.slice(ENCAPSULATION..),
            read: 0,
            little_endian,
        })
    }

    fn take(&mut self, length: usize, what: &str) -> Result<Bytes, FrameFault> {
        if length > self.rest.len() {
            return Err(cut_short(what));
        }
        self.read += length;
        Ok(self.rest.split_to(length))
    }

    fn u32(&mut self, what: &str) -> Result<u32, FrameFault> {
        self.take(self.read.next_multiple_of(4) - self.read, what)?;
        let mut field = self.take(4, what)?;
        Ok(match self.little_endian {
            true => field.get_u32_le(),
            false => field.get_u32(),
        })
    }

    fn bytes(&mut self, what: &str) -> Result<Bytes, FrameFault> {
        let length = self.u32(what)? as usize;
        self.take(length, what)
    }

    /// Reads a string, whose length includes the NUL at its end.
    fn text(&mut self, what: &str) -> Result<String, FrameFault> {
        let bytes = self.bytes(what)?;
        let text = bytes.strip_suffix(b"\0").unwrap_or(&bytes);
        String::from_utf8(text.to_vec())
            .map_err(|_| FrameFault::undecodable(format!("the ROS message's {what} is not text")))
    }

    /// Reads the stamp of a `std_msgs/msg/Header` and skips the frame id.
    fn header(&mut self) -> Result<Option<u64>, FrameFault> {
        let seconds = self.u32("header.stamp.sec")?.cast_signed();
        let nanoseconds = self.u32("header.stamp.nanosec")?;
        self.bytes("header.frame_id")?;
        Ok(u64::try_from(seconds)
            .ok()
            .and_then(|seconds| seconds.checked_mul(1_000_000_000))
            .and_then(|time| time.checked_add(u64::from(nanoseconds)))
            .filter(|time| *time > 0))
    }
}

fn cut_short(what: &str) -> FrameFault {
    FrameFault::undecodable(format!("the ROS message ends inside {what}"))
}
