//! Reads the ROS 2 messages `sensor_msgs/msg/CompressedImage` and `Image` in CDR (OMG CDR, plain encoding of XTypes version
//! 1), both byte orders. Nothing is copied, except the rows of an image with padding and samples in the other byte order.

use super::{
    EncodedPicture, FrameFault, FrameLimits, PictureFormat, format_of, picture_of_kind,
    raw_picture_of_rows,
};
use albireo_core::geometry::PictureSize;
use bytes::{Buf, Bytes};

/// A message's picture, and its header stamp in nanoseconds since the Unix epoch, if that is set.
pub type StampedPicture = (EncodedPicture, Option<u64>);

/// The longest text of a CompressedImage's format; `bgr8; jpeg compressed bgr8` is usual.
const LONGEST_FORMAT: usize = 64;

/// Reads a CompressedImage or an Image. Both begin with a header; a short text follows in the one, a number of rows in the
/// other.
///
/// # Errors
/// If it is cut, its pixels have an unknown encoding, or its picture is above a limit.
pub fn read_message(payload: &Bytes, limits: &FrameLimits) -> Result<StampedPicture, FrameFault> {
    let mut cdr = Cdr::new(payload)?;
    let time_ns = cdr.header()?;
    let picture = if cdr.begins_with_text() {
        compressed_picture(&mut cdr, limits)?
    } else {
        raw_pixels(&mut cdr, limits)?
    };
    Ok((picture, time_ns))
}

/// Reads the rest of a CompressedImage: format, data.
fn compressed_picture(cdr: &mut Cdr, limits: &FrameLimits) -> Result<EncodedPicture, FrameFault> {
    // Free text, such as `jpeg` or `bgr8; jpeg compressed bgr8`.
    let named = cdr.text("format")?;
    let file = cdr.bytes("data")?;
    let Some(format) = format_of(&file) else {
        return Err(FrameFault::unknown_format(format!(
            "the CompressedImage (format {named:?}) holds neither a JPEG nor a PNG file"
        )));
    };
    picture_of_kind(format, file, limits)
}

/// Reads the rest of an Image: height, width, encoding, is_bigendian, step, data.
fn raw_pixels(cdr: &mut Cdr, limits: &FrameLimits) -> Result<EncodedPicture, FrameFault> {
    let height = cdr.u32("height")?;
    let width = cdr.u32("width")?;
    let encoding = cdr.text("encoding")?;
    let is_big_endian = cdr.take(1, "is_bigendian")?.as_ref() != [0];
    let step = cdr.u32("step")? as usize;
    let data = cdr.bytes("data")?;
    // sensor_msgs/image_encodings.hpp; OpenCV's untyped names are treated like in cv_bridge.
    let known = match encoding.as_str() {
        "8UC3" => Some(PictureFormat::Bgr8),
        "8UC4" => Some(PictureFormat::Bgra8),
        "8UC1" => Some(PictureFormat::Gray8),
        named => PictureFormat::raw_from_name(named),
    };
    let Some(format) = known else {
        let start: String = encoding.chars().take(32).collect();
        return Err(FrameFault::unknown_format(format!(
            "ROS image encoding {start:?} is not supported; rgb8, bgr8, rgba8, bgra8, mono8, mono16, bayer_*, yuyv, \
             yuv422_yuy2, uyvy, yuv422, nv12, nv21 and nv24 are"
        )));
    };
    let size = PictureSize::new(width, height);
    let mut picture = raw_picture_of_rows(format, size, step, &data, limits)?;
    if format.is_wide() && is_big_endian {
        let mut swapped = picture.bytes.to_vec();
        for sample in swapped.chunks_exact_mut(2) {
            sample.reverse();
        }
        picture.bytes = swapped.into();
    }
    Ok(picture)
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
        let padding = self.read.next_multiple_of(4) - self.read;
        self.take(padding, what)?;
        let mut field = self.take(4, what)?;
        Ok(if self.little_endian {
            field.get_u32_le()
        } else {
            field.get_u32()
        })
    }

    fn bytes(&mut self, what: &str) -> Result<Bytes, FrameFault> {
        let length = self.u32(what)? as usize;
        self.take(length, what)
    }

    /// True if a short printable text follows, as in a CompressedImage; an Image has its number of rows there.
    fn begins_with_text(&self) -> bool {
        let mut ahead = Self {
            rest: self.rest.clone(),
            ..*self
        };
        let Ok(text) = ahead.bytes("text") else {
            return false;
        };
        match text.strip_suffix(b"\0") {
            Some(text) if text.len() >= LONGEST_FORMAT => false,
            Some(text) if !text.iter().all(|byte| matches!(byte, b' '..=b'~')) => false,
            // An Image of one, two or three rows may begin like a text, its columns being the letters. Only behind a text
            // follow the data, which reach to the end of the message.
            Some([] | [_] | [_, _]) => {
                ahead.u32("data").is_ok_and(|length| length as usize == ahead.rest.len())
            }
            Some(_) => true,
            None => false,
        }
    }

    /// Reads a string, whose length includes the NUL at its end.
    fn text(&mut self, what: &str) -> Result<String, FrameFault> {
        let bytes = self.bytes(what)?;
        let text = bytes.strip_suffix(b"\0").unwrap_or(&bytes);
        String::from_utf8(text.to_vec())
            .map_err(|_| FrameFault::undecodable(format!("the ROS message's {what} is not text")))
    }

    /// Reads the stamp of a `std_msgs/msg/Header` and skips the frame id. `None` if the stamp is not set or lies before
    /// 1970.
    fn header(&mut self) -> Result<Option<u64>, FrameFault> {
        let seconds = self.u32("header.stamp.sec")?.cast_signed();
        let nanoseconds = self.u32("header.stamp.nanosec")?;
        self.bytes("header.frame_id")?;
        // Before 1970 nothing was recorded; 31 bits of seconds stay far below 64 bits of nanoseconds.
        let Ok(seconds) = u64::try_from(seconds) else {
            return Ok(None);
        };
        match seconds * 1_000_000_000 + u64::from(nanoseconds) {
            0 => Ok(None),
            time_ns => Ok(Some(time_ns)),
        }
    }
}

fn cut_short(what: &str) -> FrameFault {
    FrameFault::undecodable(format!("the ROS message ends inside {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey Image of this size in CDR, little-endian.
    fn grey_image(width: u32, height: u32) -> Bytes {
        let mut message = vec![0, 1, 0, 0];
        // Seconds, nanoseconds, and an empty frame id, which is padded before the next number.
        message.extend([1_u32, 0, 1].map(u32::to_le_bytes).concat());
        message.extend([0, 0, 0, 0]);
        message.extend([height, width, 6].map(u32::to_le_bytes).concat());
        message.extend(b"mono8\0");
        let is_big_endian = 0;
        // And a byte of padding.
        message.extend([is_big_endian, 0]);
        message.extend([width, width * height].map(u32::to_le_bytes).concat());
        message.extend(vec![90; (width * height) as usize]);
        message.into()
    }

    #[test]
    fn an_image_of_few_rows_is_no_compressed_image() {
        for height in 1..=4 {
            // As letters: nothing, `@`, ` !`.
            for width in [256, 64, 0x2120] {
                let (picture, _) =
                    read_message(&grey_image(width, height), &FrameLimits::default()).unwrap();
                assert_eq!(picture.size, PictureSize::new(width, height));
            }
        }
    }
}
