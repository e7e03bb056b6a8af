//! Cuts a byte stream, such as ffmpeg's output, into pictures: parts of a multipart stream, PNG files, PPM files.

use super::{EncodedPicture, FrameFault, FrameLimits, PictureFormat, check_picture};
use albireo_core::geometry::PictureSize;
use bytes::Bytes;
use std::io::{self, BufRead, Read};

/// The longest line of a head. What is longer is passed over in pieces.
const LONGEST_HEAD_LINE: u64 = 1024;

/// The most bytes in which a head must come: a stream without heads would be searched without end.
const HEAD_WITHIN: usize = 64 * 1024;

/// Returns the next part of a multipart stream with a `Content-length` in the head of every part, as ffmpeg's `mpjpeg`
/// and GStreamer's `multipartmux` write it; `None` at its end.
///
/// # Errors
/// If it is cut short, its head has no length or does not come, or it has more than `most` bytes.
pub fn read_part(stream: &mut impl BufRead, most: u64) -> io::Result<Option<Vec<u8>>> {
    let mut length = None;
    let mut in_head = false;
    let mut searched = 0;
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = stream.by_ref().take(LONGEST_HEAD_LINE).read_until(b'\n', &mut line)?;
        if read == 0 {
            return if in_head {
                Err(io::Error::other("it ends inside a head"))
            } else {
                Ok(None)
            };
        }
        searched += read;
        if searched > HEAD_WITHIN {
            return Err(io::Error::other(format!(
                "{HEAD_WITHIN} bytes without the head of a part: it is no multipart stream; end the pipeline with \
                 `! jpegenc ! multipartmux`"
            )));
        }
        let whole = String::from_utf8_lossy(&line);
        let text = whole.trim();
        if let Some((name, value)) = text.split_once(':') {
            let value = value.trim();
            if name.eq_ignore_ascii_case("content-length") {
                let Ok(bytes) = value.parse::<u64>() else {
                    let what = format!("`{value}` is not a Content-length");
                    return Err(io::Error::other(what));
                };
                in_head = true;
                length = Some(bytes);
            }
            if name.eq_ignore_ascii_case("content-type") {
                in_head = true;
                if value != "image/jpeg" {
                    return Err(io::Error::other(format!(
                        "its pictures are {value} and not image/jpeg: end the pipeline with an encoder, `! jpegenc`"
                    )));
                }
            }
        }
        // Before a head there may be blank lines: the end of the part before it.
        if text.is_empty() && in_head {
            let Some(length) = length else {
                return Err(io::Error::other("the head of a part has no Content-length"));
            };
            return read_exactly(stream, length, most).map(Some);
        }
    }
}

/// Returns the next PNG file of a sequence; `None` at its end.
///
/// # Errors
/// If it is cut short, or has more than `most` bytes.
pub fn read_png(stream: &mut impl BufRead, most: u64) -> io::Result<Option<Vec<u8>>> {
    if stream.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut file = read_exactly(stream, 8, most)?;
    loop {
        let head = read_exactly(stream, 8, most)?;
        let [a, b, c, d, kind @ ..] = head.as_slice() else {
            return Err(io::Error::other("a PNG chunk has no head"));
        };
        let length = u64::from(u32::from_be_bytes([*a, *b, *c, *d]));
        let last = kind == b"IEND";
        file.extend_from_slice(&head);
        let rest = most.saturating_sub(file.len() as u64);
        let content_and_checksum = read_exactly(stream, length + 4, rest)?;
        file.extend_from_slice(&content_and_checksum);
        if last {
            return Ok(Some(file));
        }
    }
}

/// Returns the next PPM file of a sequence (`P6`, one byte per colour), as rows of red, green, blue; `None` at its end.
///
/// # Errors
/// If it is cut short. A picture above `limits` is skipped and reported in the inner result.
pub fn read_ppm(
    stream: &mut impl BufRead,
    limits: &FrameLimits,
) -> io::Result<Option<Result<EncodedPicture, FrameFault>>> {
    if stream.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let magic = read_exactly(stream, 3, 3)?;
    if magic != b"P6\n" {
        return Err(io::Error::other("a picture is not a PPM file"));
    }
    let width = read_number(stream)?;
    let height = read_number(stream)?;
    let highest = read_number(stream)?;
    if highest != 255 {
        return Err(io::Error::other(format!(
            "a PPM file has {highest} levels per colour, not 255"
        )));
    }
    let size = PictureSize::new(width, height);
    let bytes = size.pixels().saturating_mul(3);
    if let Err(fault) = check_picture(size, limits) {
        let passed = std::io::copy(&mut stream.by_ref().take(bytes), &mut std::io::sink())?;
        return if passed == bytes {
            Ok(Some(Err(fault)))
        } else {
            Err(early(bytes - passed))
        };
    }
    let pixels = read_exactly(stream, bytes, bytes)?;
    Ok(Some(Ok(EncodedPicture {
        format: PictureFormat::Rgb8,
        bytes: Bytes::from(pixels),
        size,
        mount: None,
    })))
}

/// Reads a number, of at most ten digits, and the one blank after it.
fn read_number(stream: &mut impl BufRead) -> io::Result<u32> {
    let mut text = String::new();
    for _ in 0..11 {
        match read_exactly(stream, 1, 1)?.first() {
            Some(digit) if digit.is_ascii_digit() => text.push(char::from(*digit)),
            _ => break,
        }
    }
    let no_size = || io::Error::other("a PPM file has no size");
    if text.len() > 10 {
        return Err(no_size());
    }
    text.parse().map_err(|_| no_size())
}

fn early(missing: u64) -> io::Error {
    io::Error::other(format!("it ends {missing} bytes early"))
}

fn read_exactly(stream: &mut impl BufRead, length: u64, most: u64) -> io::Result<Vec<u8>> {
    if length > most {
        return Err(io::Error::other(format!(
            "a picture has {length} bytes; at most {most} are accepted"
        )));
    }
    // Reserves room for all bytes at once; for bytes that never arrive, at most up to the limit.
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or_default());
    stream.by_ref().take(length).read_to_end(&mut bytes)?;
    if bytes.len() as u64 != length {
        return Err(early(length - bytes.len() as u64));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: &[u8] = b"--ffmpeg\r\nContent-type: image/jpeg\r\nContent-length: 5\r\n\r\nab\r\nc\r\n\
                           --ffmpeg\r\nContent-Type: image/jpeg\r\nContent-Length: 1\r\n\r\nd\r\n--ffmpeg\r\n";

    #[test]
    fn parts_are_split_by_their_heads() {
        let mut stream = PARTS;
        let first = read_part(&mut stream, 9).unwrap();
        assert_eq!(first.unwrap(), b"ab\r\nc");
        let second = read_part(&mut stream, 9).unwrap();
        assert_eq!(second.unwrap(), b"d");
        let third = read_part(&mut stream, 9).unwrap();
        assert_eq!(third, None);
    }

    #[test]
    fn a_part_that_is_cut_short_or_too_long_or_of_another_kind_is_an_error() {
        let cut_short = &PARTS[..60];
        let raw = b"--b\r\nContent-Type: video/x-raw\r\nContent-Length: 1\r\n\r\nd\r\n";
        for (mut stream, most, said) in [
            (cut_short, 9, "it ends 2 bytes early"),
            (PARTS, 4, "a picture has 5 bytes; at most 4 are accepted"),
            (raw, 9, "! jpegenc"),
        ] {
            let error = read_part(&mut stream, most).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn a_head_without_a_length_is_an_error() {
        let no_length = b"--b\r\nContent-Type: image/jpeg\r\n\r\nd\r\n--b\r\n";
        let error = read_part(&mut &no_length[..], 9).unwrap_err().to_string();
        assert_eq!(error, "the head of a part has no Content-length");
    }

    /// A stream of another kind would be searched for a head without end, and a person would see no picture and no
    /// word.
    #[test]
    fn a_stream_without_heads_is_an_error_and_not_an_empty_one() {
        let pictures_alone = [0xff; 2 * HEAD_WITHIN];
        let error = read_part(&mut &pictures_alone[..], 9).unwrap_err().to_string();
        assert!(error.contains("no multipart stream"), "{error}");
    }

    #[test]
    fn pictures_of_changing_size_are_split_and_oversized_ones_skipped() {
        let stream = b"P6\n2 1\n255\nabcdefP6\n3 1\n255\nabcdefghiP6\n1 1\n255\nxyz";
        let mut reader = &stream[..];
        let limits = FrameLimits {
            max_pixels: 2,
            ..FrameLimits::default()
        };
        let mut next = || read_ppm(&mut reader, &limits).unwrap();
        let first = next().unwrap().unwrap();
        assert_eq!(first.size, PictureSize::new(2, 1));
        assert_eq!(&first.bytes[..], b"abcdef");
        let second = next().unwrap();
        assert_eq!(second.unwrap_err().kind(), "oversized");
        let third = next().unwrap().unwrap();
        assert_eq!(&third.bytes[..], b"xyz");
        assert_eq!(next(), None);
    }

    #[test]
    fn a_picture_that_is_cut_short_or_no_ppm_file_of_one_byte_per_colour_is_an_error() {
        for broken in [
            "P6\n2 1\n255\nabc",
            "P6\n2 1\n65535\nab",
            "P5\n1 1\n255\na",
            "P6\nx",
        ] {
            let read = read_ppm(&mut broken.as_bytes(), &FrameLimits::default());
            assert!(read.is_err(), "{broken}");
        }
    }
}
