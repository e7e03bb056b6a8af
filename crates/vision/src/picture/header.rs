//! Reads format and size from the first bytes of a JPEG or PNG file, without decoding it.

use super::huffman::with_tables;
use super::limits::{check_payload, check_picture};
use super::orientation::orientation;
use super::{EncodedPicture, FrameFault, FrameLimits, PictureFormat};
use albireo_core::geometry::PictureSize;
use bytes::Bytes;

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Start of image, then the first byte of the next marker.
const JPEG_SIGNATURE: &[u8] = &[0xFF, 0xD8, 0xFF];

const START_OF_SCAN: u8 = 0xDA;
const END_OF_IMAGE: u8 = 0xD9;

/// Recognises JPEG or PNG by the file's first bytes.
pub fn format_of(bytes: &[u8]) -> Option<PictureFormat> {
    if bytes.starts_with(JPEG_SIGNATURE) {
        Some(PictureFormat::Jpeg)
    } else if bytes.starts_with(PNG_SIGNATURE) {
        Some(PictureFormat::Png)
    } else {
        None
    }
}

/// The size in a PNG file's `IHDR` chunk (W3C PNG, section 11.2.1: always the first chunk).
pub(super) fn png_size(bytes: &[u8]) -> Result<PictureSize, FrameFault> {
    let broken = |what: &str| FrameFault::undecodable(format!("the PNG file {what}"));
    let rest = bytes
        .strip_prefix(PNG_SIGNATURE)
        .ok_or_else(|| broken("does not begin with the PNG signature"))?;
    if rest.get(4..8) != Some(b"IHDR") {
        return Err(broken("does not begin with an IHDR chunk"));
    }
    match (big_endian_u32(rest, 8), big_endian_u32(rest, 12)) {
        (Some(width), Some(height)) => Ok(PictureSize::new(width, height)),
        _ => Err(broken("ends inside its header")),
    }
}

fn big_endian_u32(bytes: &[u8], at: usize) -> Option<u32> {
    let field = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_be_bytes(field.try_into().ok()?))
}

fn big_endian_u16(bytes: &[u8], at: usize) -> Option<u16> {
    let field = bytes.get(at..at.checked_add(2)?)?;
    Some(u16::from_be_bytes(field.try_into().ok()?))
}

/// The size in a JPEG file's frame header (ITU-T T.81, B.2.2).
pub(super) fn jpeg_size(bytes: &[u8]) -> Result<PictureSize, FrameFault> {
    let mut segments = JpegSegments::new(bytes)?;
    while let Some((marker, content)) = segments.next()? {
        match marker {
            // Baseline, extended sequential and progressive Huffman coding.
            0xC0..=0xC2 => return size_in_frame_header(content),
            0xC3 | 0xC5..=0xC7 | 0xC9..=0xCB | 0xCD..=0xCF => {
                return Err(FrameFault::undecodable(format!(
                    "the JPEG file uses coding process SOF{}; only baseline and progressive \
                     Huffman coding are supported",
                    marker - 0xC0
                )));
            }
            START_OF_SCAN => break,
            _ => {}
        }
    }
    Err(FrameFault::undecodable(
        "the JPEG file has no frame header before its pixels",
    ))
}

/// The size in the content of a frame header: the bits per sample, then the rows and the columns, two bytes each.
fn size_in_frame_header(content: &[u8]) -> Result<PictureSize, FrameFault> {
    let [
        precision,
        height_high,
        height_low,
        width_high,
        width_low,
        ..,
    ] = *content
    else {
        return Err(FrameFault::undecodable(
            "the JPEG file's frame header is cut short",
        ));
    };
    if precision != 8 {
        return Err(FrameFault::undecodable(format!(
            "the JPEG file has {precision} bits per sample; only 8 are supported"
        )));
    }
    let width = u16::from_be_bytes([width_high, width_low]);
    let height = u16::from_be_bytes([height_high, height_low]);
    Ok(PictureSize::new(u32::from(width), u32::from(height)))
}

/// Checks that an end-of-image marker follows the pixels. Decoders fill missing data with grey and report success; a
/// detector would then look at a picture that never existed.
pub(super) fn check_jpeg_is_whole(bytes: &[u8]) -> Result<(), FrameFault> {
    let mut segments = JpegSegments::new(bytes)?;
    while let Some((marker, _)) = segments.next()? {
        if marker == START_OF_SCAN {
            // An embedded thumbnail has its own markers, but inside an earlier segment.
            let pixels = segments.rest();
            return if pixels.windows(2).rev().any(|pair| pair == [0xFF, END_OF_IMAGE]) {
                Ok(())
            } else {
                Err(FrameFault::undecodable(
                    "the JPEG file is cut short: no end-of-image marker after its pixels",
                ))
            };
        }
    }
    Err(FrameFault::undecodable("the JPEG file has no pixels"))
}

/// A baseline JPEG file up to its end-of-image marker, with a few zeros in the place of it: a decoder that reads ahead
/// finds enough, and one that still waits for pixels runs out of data. `None` for a progressive file, and for one
/// without pixels or without an end.
pub(super) fn with_open_end(bytes: &[u8]) -> Option<Vec<u8>> {
    /// A decoder reads ahead by less than this.
    const AHEAD: [u8; 8] = [0; 8];
    let mut segments = JpegSegments::new(bytes).ok()?;
    let mut is_baseline = false;
    loop {
        let (marker, _) = segments.next().ok()??;
        match marker {
            0xC0 | 0xC1 => is_baseline = true,
            START_OF_SCAN => break,
            _ => {}
        }
    }
    if !is_baseline {
        return None;
    }
    let is_end = |pair: &[u8]| pair == [0xFF, END_OF_IMAGE];
    let length = segments.rest().windows(2).position(is_end)?;
    Some([&bytes[..segments.at + length], &AHEAD].concat())
}

/// True if a JPEG file is coded with the tables of Motion JPEG, which it does not contain.
fn lacks_huffman_tables(bytes: &[u8]) -> bool {
    let Ok(mut segments) = JpegSegments::new(bytes) else {
        return false;
    };
    while let Ok(Some((marker, _))) = segments.next() {
        match marker {
            // Its own tables (0xC4), or a coding that those of Motion JPEG are not for.
            0xC2..=0xCF => return false,
            START_OF_SCAN => return true,
            _ => {}
        }
    }
    false
}

/// The Exif data of a JPEG file: a TIFF structure in its first application segment of that name.
pub(super) fn jpeg_exif(bytes: &[u8]) -> Option<&[u8]> {
    let mut segments = JpegSegments::new(bytes).ok()?;
    while let Ok(Some((marker, content))) = segments.next() {
        match marker {
            0xE1 => {
                if let Some(exif) = content.strip_prefix(b"Exif\0\0") {
                    return Some(exif);
                }
            }
            START_OF_SCAN => return None,
            _ => {}
        }
    }
    None
}

/// The Exif data of a PNG file, which come before its pixels.
pub(super) fn png_exif(bytes: &[u8]) -> Option<&[u8]> {
    let mut rest = bytes.strip_prefix(PNG_SIGNATURE)?;
    loop {
        let length = usize::try_from(big_endian_u32(rest, 0)?).ok()?;
        let content = rest.get(8..length.checked_add(8)?)?;
        match rest.get(4..8)? {
            b"eXIf" => return Some(content),
            b"IDAT" | b"IEND" => return None,
            _ => {}
        }
        rest = rest.get(length.checked_add(12)?..)?;
    }
}

/// The marker segments of a JPEG file up to its first scan.
struct JpegSegments<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> JpegSegments<'a> {
    fn new(bytes: &'a [u8]) -> Result<Self, FrameFault> {
        if bytes.starts_with(JPEG_SIGNATURE) {
            Ok(Self { bytes, at: 2 })
        } else {
            Err(FrameFault::undecodable(
                "the JPEG file does not begin with a start-of-image marker",
            ))
        }
    }

    /// The bytes after the last segment.
    fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// Returns the next marker and the content of its segment; `None` at the end of the bytes.
    fn next(&mut self) -> Result<Option<(u8, &'a [u8])>, FrameFault> {
        loop {
            // Any number of 0xFF bytes may fill the space before a marker.
            match self.bytes.get(self.at) {
                None => return Ok(None),
                Some(0xFF) => {}
                Some(byte) => {
                    return Err(FrameFault::undecodable(format!(
                        "the JPEG file has byte {byte:#04x} where a marker should begin, at {}",
                        self.at
                    )));
                }
            }
            while self.bytes.get(self.at) == Some(&0xFF) {
                self.at += 1;
            }
            let Some(&marker) = self.bytes.get(self.at) else {
                return Ok(None);
            };
            self.at += 1;
            match marker {
                // Markers without a segment.
                0x01 | 0xD0..=0xD7 => continue,
                END_OF_IMAGE => return Ok(None),
                _ => {}
            }
            // The length counts its own two bytes. One that is missing or below 2 makes a range that ends before it
            // begins, and `get` finds no content.
            let length = big_endian_u16(self.bytes, self.at).map_or(0, usize::from);
            let Some(content) = self.bytes.get(self.at + 2..self.at + length) else {
                return Err(FrameFault::undecodable(format!(
                    "the JPEG file is cut short inside segment {marker:#04x}"
                )));
            };
            self.at += length;
            return Ok(Some((marker, content)));
        }
    }
}

/// Makes a picture of a JPEG or PNG file: reads its header and checks its size. A JPEG file without Huffman tables gets
/// those of Motion JPEG.
///
/// # Errors
/// If it is neither, or exceeds a limit.
pub fn picture_of_file(bytes: Bytes, limits: &FrameLimits) -> Result<EncodedPicture, FrameFault> {
    check_payload(bytes.len(), limits)?;
    let Some(format) = format_of(&bytes) else {
        let reason = "a picture is neither a JPEG nor a PNG file";
        return Err(FrameFault::unknown_format(reason));
    };
    picture_of_kind(format, bytes, limits)
}

/// Like [`picture_of_file`], for a file declared as `format`: JPEG or PNG.
///
/// # Errors
/// If it has another format, or exceeds a limit.
pub fn picture_of_kind(
    format: PictureFormat,
    file: Bytes,
    limits: &FrameLimits,
) -> Result<EncodedPicture, FrameFault> {
    let stored_size = match format {
        PictureFormat::Png => png_size(&file)?,
        _ => jpeg_size(&file)?,
    };
    check_picture(stored_size, limits)?;
    let size = orientation(format, &file).turned(stored_size);
    let bytes = if format == PictureFormat::Jpeg && lacks_huffman_tables(&file) {
        with_tables(&file)
    } else {
        file
    };
    Ok(EncodedPicture {
        format,
        bytes,
        size,
        mount: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOF: [u8; 10] = [0xFF, 0xC0, 0, 8, 8, 0x01, 0x20, 0x02, 0xD0, 0];

    fn jpeg(parts: &[&[u8]]) -> Vec<u8> {
        [&[0xFF, 0xD8][..], &parts.concat()].concat()
    }

    #[test]
    fn a_jpeg_file_without_a_size_is_refused_with_a_reason() {
        for (file, part) in [
            (jpeg(&[&SOF[..6]]), "cut short inside segment 0xc0"),
            (jpeg(&[&[0xFF, 0xDA, 0, 2]]), "no frame header"),
            (jpeg(&[&[0xFF, 0xC9, 0, 2]]), "SOF9"),
            (jpeg(&[&[0xFF, 0xE0, 0, 1]]), "cut short"),
            (jpeg(&[&[0xFF, 0xE0, 0, 2, 7]]), "where a marker should"),
            (jpeg(&[&[0xFF]]), "no frame header"),
            (vec![], "does not begin"),
        ] {
            let text = jpeg_size(&file).unwrap_err().to_string();
            assert!(text.contains(part), "{text} / {part}");
        }
    }

    #[test]
    fn a_png_file_without_a_size_is_undecodable() {
        for file in [
            &b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0\x01"[..],
            b"\x89PNG\r\n\x1a\n\0\0\0\x0dIDAT\0\0\0\x01\0\0\0\x01",
            b"\x89PN",
        ] {
            assert_eq!(png_size(file).unwrap_err().kind(), "undecodable");
        }
    }

    /// A file without an end, whose first segment holds markers of a header and of an end, as a thumbnail does.
    fn without_end() -> Vec<u8> {
        let application = [0xFF, 0xE1, 0, 6, 0xFF, 0xC0, 0xFF, 0xD9];
        let scan = [0xFF, 0xDA, 0, 2, 1, 2, 3];
        jpeg(&[&application, &[0xFF, 0xFF], &SOF, &scan])
    }

    #[test]
    fn segments_before_the_header_are_skipped_whatever_they_hold() {
        let size = jpeg_size(&without_end()).unwrap();
        assert_eq!(size, PictureSize::new(720, 288));
    }

    #[test]
    fn a_jpeg_file_is_whole_if_an_end_comes_after_its_pixels() {
        let mut file = without_end();
        assert!(check_jpeg_is_whole(&file).is_err());
        file.extend_from_slice(&[0xFF, 0xD9, 0, 0]);
        assert!(check_jpeg_is_whole(&file).is_ok());
    }
}
