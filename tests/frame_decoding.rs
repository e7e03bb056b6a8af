//! Pictures are decoded correctly or rejected, without panics and within the memory limit.

use super::support::shared;
use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{
    EncodedPicture, FrameFault, FrameLimits, Picture, PictureFormat, PixelLayout, decode,
    decode_grey_half, decode_small_grey, picture_files, picture_of_file, read_picture_file,
    to_jpeg,
};
use bytes::Bytes;
use jpeg_encoder::ColorType as JpegColor;
use png::{BitDepth, ColorType};
use proptest::prelude::*;

fn encoded(format: PictureFormat, width: u32, height: u32, bytes: Vec<u8>) -> EncodedPicture {
    EncodedPicture {
        format,
        bytes: Bytes::from(bytes),
        size: PictureSize::new(width, height),
        mount: None,
    }
}

fn decoded(picture: &EncodedPicture, layout: PixelLayout) -> Result<Picture, FrameFault> {
    // A buffer that was used before, as most are.
    let mut into = Picture::black(PictureSize::new(7, 5));
    decode(picture, &FrameLimits::default(), layout, None, &mut into)?;
    assert_eq!([into.size, into.source_size], [picture.size; 2]);
    assert_eq!(into.layout, layout);
    let expected = picture.size.pixels() as usize * layout.channels();
    assert_eq!(into.pixels.len(), expected);
    Ok(into)
}

fn fault_of(picture: &EncodedPicture) -> &'static str {
    decoded(picture, PixelLayout::Rgb8).map_or_else(|fault| fault.kind(), |_| "none")
}

fn rgb(picture: &EncodedPicture) -> Vec<u8> {
    decoded(picture, PixelLayout::Rgb8).unwrap().pixels
}

fn grey(picture: &EncodedPicture) -> Vec<u8> {
    decoded(picture, PixelLayout::Gray8).unwrap().pixels
}

/// A smooth colourful picture: smooth, so that JPEG stays close to it.
fn gradient(width: u32, height: u32) -> Vec<u8> {
    let pixel = |place: u32| {
        let (x, y) = (place % width, place / width);
        [
            40 + x * 120 / width,
            60 + y * 120 / height,
            200 - (x + y) * 100 / (width + height),
        ]
    };
    (0..width * height).flat_map(pixel).map(|value| value as u8).collect()
}

/// How a JPEG file stores its picture: once, or in scans that get finer and finer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Process {
    Baseline,
    Progressive,
}

fn jpeg_file(width: u32, height: u32, color: JpegColor, process: Process) -> EncodedPicture {
    let pixels = match color {
        JpegColor::Luma => luma_of(&gradient(width, height)),
        _ => gradient(width, height),
    };
    let mut file = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut file, 95);
    encoder.set_progressive(process == Process::Progressive);
    encoder.encode(&pixels, width as u16, height as u16, color).unwrap();
    encoded(PictureFormat::Jpeg, width, height, file)
}

fn rgb_jpeg(width: u32, height: u32, process: Process) -> EncodedPicture {
    jpeg_file(width, height, JpegColor::Rgb, process)
}

fn png_file(
    width: u32,
    height: u32,
    color: ColorType,
    depth: BitDepth,
    samples: &[u8],
) -> EncodedPicture {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if color == ColorType::Indexed {
        encoder.set_palette(vec![10, 20, 30, 200, 100, 50]);
    }
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(samples).unwrap();
    writer.finish().unwrap();
    encoded(PictureFormat::Png, width, height, file)
}

fn largest_difference(left: &[u8], right: &[u8]) -> u8 {
    assert_eq!(left.len(), right.len());
    left.iter().zip(right).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// BT.601 luma in floating point, the reference for the fixed-point one.
fn luma_of(pixels: &[u8]) -> Vec<u8> {
    let luma = |pixel: &[u8]| {
        let r = f64::from(pixel[0]);
        let g = f64::from(pixel[1]);
        let b = f64::from(pixel[2]);
        (0.299 * r + 0.587 * g + 0.114 * b).round() as u8
    };
    pixels.chunks(3).map(luma).collect()
}

#[test]
fn a_jpeg_decodes_to_the_encoded_picture_in_colour_and_in_grey() {
    // Among them sizes other than multiples of a block, and one below a block.
    for (width, height) in [(64, 48), (61, 35), (5, 3)] {
        let pixels = gradient(width, height);
        for process in [Process::Baseline, Process::Progressive] {
            let picture = rgb_jpeg(width, height, process);
            assert!(largest_difference(&rgb(&picture), &pixels) <= 12);
            assert!(largest_difference(&grey(&picture), &luma_of(&pixels)) <= 6);
        }
        let luma = luma_of(&pixels);
        let picture = jpeg_file(width, height, JpegColor::Luma, Process::Baseline);
        assert!(largest_difference(&grey(&picture), &luma) <= 6);
        let rgb = rgb(&picture);
        let is_grey = |pixel: &[u8]| pixel[0] == pixel[1] && pixel[1] == pixel[2];
        assert!(rgb.chunks(3).all(is_grey));
    }
}

#[test]
fn a_truncated_jpeg_is_undecodable_and_bytes_after_its_end_are_ignored() {
    for process in [Process::Baseline, Process::Progressive] {
        let whole = rgb_jpeg(64, 48, process);
        for length in 0..whole.bytes.len() - 1 {
            let cut = EncodedPicture {
                bytes: whole.bytes.slice(..length),
                ..whole.clone()
            };
            assert_eq!(fault_of(&cut), "undecodable", "{length}");
        }
    }
    let whole = rgb_jpeg(32, 16, Process::Baseline);
    let padded = [&whole.bytes[..], &[0; 64]].concat();
    let padded = encoded(PictureFormat::Jpeg, 32, 16, padded);
    assert_eq!(rgb(&padded), rgb(&whole));
}

/// `picture` with its pixels ending after `share` of their bytes, and an end-of-image marker there.
fn ended_after(picture: &EncodedPicture, share: f64) -> EncodedPicture {
    let bytes = &picture.bytes;
    let start = bytes.windows(2).position(|pair| pair == [0xFF, 0xDA]).unwrap() + 14;
    let mut end = start + ((bytes.len() - 2 - start) as f64 * share) as usize;
    // Not between the two bytes of an escape or a restart marker.
    while bytes[end - 1] == 0xFF {
        end -= 1;
    }
    EncodedPicture {
        bytes: [&bytes[..end], &[0xFF, 0xD9]].concat().into(),
        ..picture.clone()
    }
}

#[test]
fn a_jpeg_that_ends_before_its_last_pixels_is_told_from_one_that_ends_in_grey() {
    let grey = vec![128; 64 * 48 * 3];
    let ending_in_grey: Vec<u8> = [&gradient(64, 24)[..], &grey[..64 * 24 * 3]].concat();
    // A progressive file that is cut is coarse, and each of its scans may be its last.
    for (restarts, process) in [
        (0, Process::Baseline),
        (3, Process::Baseline),
        (0, Process::Progressive),
    ] {
        for pixels in [&gradient(64, 48), &ending_in_grey, &grey] {
            let mut bytes = Vec::new();
            let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
            encoder.set_progressive(process == Process::Progressive);
            encoder.set_restart_interval(restarts);
            encoder.encode(pixels, 64, 48, JpegColor::Rgb).unwrap();
            let whole = encoded(PictureFormat::Jpeg, 64, 48, bytes);
            for layout in [PixelLayout::Rgb8, PixelLayout::Gray8] {
                let about = format!("{restarts} {process:?} {layout:?}");
                assert!(decoded(&whole, layout).is_ok(), "{about}");
                if process == Process::Progressive {
                    continue;
                }
                for share in [0.1, 0.5, 0.9] {
                    let fault = decoded(&ended_after(&whole, share), layout)
                        .map_or_else(|fault| fault.to_string(), |_| "none".to_owned());
                    assert!(fault.contains("cut short"), "{about} {share}: {fault}");
                }
            }
        }
    }
}

#[test]
fn a_picture_of_another_size_than_announced_is_undecodable() {
    let jpeg = rgb_jpeg(32, 16, Process::Baseline);
    let png = png_file(32, 16, ColorType::Rgb, BitDepth::Eight, &gradient(32, 16));
    for picture in [jpeg, png] {
        for (width, height) in [(16, 16), (32, 32), (64, 64)] {
            let other = EncodedPicture {
                size: PictureSize::new(width, height),
                ..picture.clone()
            };
            assert_eq!(fault_of(&other), "undecodable");
        }
    }
    let raw = encoded(PictureFormat::Rgb8, 4, 4, vec![0; 47]);
    assert_eq!(fault_of(&raw), "undecodable");
}

#[test]
fn every_kind_of_png_and_raw_layout_gives_its_colours_and_their_luma() {
    use BitDepth::{Eight, One, Sixteen};
    use ColorType::{Grayscale, GrayscaleAlpha, Indexed, Rgb, Rgba};
    use PictureFormat::{Bgr8, Bgra8, Gray8, Rgb8, Rgba8};
    let colour = [10, 20, 30, 200, 100, 50];
    let deep = [10, 99, 20, 1, 30, 2, 200, 3, 100, 4, 50, 5];
    let clear = [10, 20, 30, 0, 200, 100, 50, 9];
    let grey_pixels = [7, 7, 7, 200, 200, 200];
    let png = |color, depth, samples: &[u8]| png_file(2, 1, color, depth, samples);
    let raw = |format, bytes: &[u8]| encoded(format, 2, 1, bytes.to_vec());
    for (picture, expected) in [
        (png(Rgb, Eight, &colour), colour),
        (png(Rgba, Eight, &clear), colour),
        (png(Indexed, Eight, &[0, 1]), colour),
        (png(Indexed, One, &[0b0100_0000]), colour),
        (png(Rgb, Sixteen, &deep), colour),
        (png(Grayscale, Eight, &[7, 200]), grey_pixels),
        (png(GrayscaleAlpha, Eight, &[7, 0, 200, 255]), grey_pixels),
        (raw(Rgb8, &colour), colour),
        (raw(Rgba8, &clear), colour),
        (raw(Bgr8, &[30, 20, 10, 50, 100, 200]), colour),
        (raw(Bgra8, &[30, 20, 10, 0, 50, 100, 200, 7]), colour),
        (raw(Gray8, &[7, 200]), grey_pixels),
    ] {
        assert_eq!(rgb(&picture), expected, "{picture:?}");
        assert_eq!(grey(&picture), luma_of(&expected), "{picture:?}");
    }
}

#[test]
fn an_interlaced_png_is_decoded() {
    // 3x2 grey, Adam7 (W3C PNG, 8.2), not compressed: pass 1 has (0,0), pass 4 (2,0), pass 6 (1,0), pass 7 row 1.
    let rows = [0, 10, 0, 30, 0, 20, 0, 40, 50, 60];
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8; 4], data: &[u8]| {
        file.extend_from_slice(&(data.len() as u32).to_be_bytes());
        let content = [&kind[..], data].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&content);
        file.extend_from_slice(&content);
        file.extend_from_slice(&crc.sum().to_be_bytes());
    };
    chunk(b"IHDR", &[0, 0, 0, 3, 0, 0, 0, 2, 8, 0, 0, 0, 1]);
    let mut deflate = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::none());
    std::io::Write::write_all(&mut deflate, &rows).unwrap();
    chunk(b"IDAT", &deflate.finish().unwrap());
    chunk(b"IEND", &[]);
    let picture = encoded(PictureFormat::Png, 3, 2, file);
    assert_eq!(grey(&picture), [10, 20, 30, 40, 50, 60]);
}

#[test]
fn nv12_is_limited_range_bt601() {
    // Studio black, white and grey, and the red, green and blue of the 75 % bars (ITU-R BT.801-1).
    for (luma, cb, cr, expected) in [
        (16, 128, 128, [0, 0, 0]),
        (235, 128, 128, [255, 255, 255]),
        (126, 128, 128, [128, 128, 128]),
        (65, 100, 212, [191, 0, 0]),
        (112, 72, 58, [0, 191, 0]),
        (35, 212, 114, [0, 0, 191]),
    ] {
        let mut bytes = vec![luma; 9];
        bytes.extend([cb, cr].repeat(4));
        let pixels = rgb(&encoded(PictureFormat::Nv12, 3, 3, bytes));
        let difference = largest_difference(&pixels, &expected.repeat(9));
        assert!(difference <= 2, "{pixels:?}, not {expected:?}");
    }
    // The last column and row use their own chroma pair.
    let mut bytes = vec![126; 9];
    bytes.extend([128, 128, 128, 128, 128, 128, 128, 200]);
    let pixels = rgb(&encoded(PictureFormat::Nv12, 3, 3, bytes));
    assert!(pixels[..24].iter().all(|value| *value == 128));
    assert!(pixels[24] > 200);
    let black = encoded(PictureFormat::Nv12, 2, 2, vec![16, 235, 126, 255, 9, 200]);
    assert_eq!(grey(&black), [0, 255, 128, 255]);
}

#[test]
fn grey_is_halved_by_area() {
    let bytes = vec![
        10, 20, 0, 255, 99, //
        30, 40, 0, 255, 99, //
        1, 1, 200, 201, 99, //
        1, 2, 201, 201, 99, //
        88, 88, 88, 88, 88,
    ];
    let picture = encoded(PictureFormat::Gray8, 5, 5, bytes);
    let mut into = Picture::default();
    decode_grey_half(&picture, &FrameLimits::default(), &mut into).unwrap();
    assert_eq!(into.size, PictureSize::new(2, 2));
    assert_eq!(into.source_size, PictureSize::new(5, 5));
    // (10+20+30+40)/4 = 25; 127.5 up; 1.25 down; 200.75 up.
    assert_eq!(into.pixels, [25, 128, 1, 201]);
    let thin = encoded(PictureFormat::Gray8, 5, 1, vec![0; 5]);
    assert!(decode_grey_half(&thin, &FrameLimits::default(), &mut into).is_err());
}

#[test]
fn small_grey_is_the_smallest_fraction_that_is_wide_enough() {
    const LEAST_WIDTH: u32 = 320;
    for (width, height, expected) in [
        (1280, 720, PictureSize::new(320, 180)),
        (960, 540, PictureSize::new(480, 270)),
        (1920, 1080, PictureSize::new(480, 270)),
        (638, 360, PictureSize::new(638, 360)),
        (200, 100, PictureSize::new(200, 100)),
    ] {
        let bytes = vec![77; width as usize * height as usize];
        let raw = encoded(PictureFormat::Gray8, width, height, bytes);
        for picture in [raw, rgb_jpeg(width, height, Process::Baseline)] {
            let mut into = Picture::default();
            decode_small_grey(&picture, &FrameLimits::default(), LEAST_WIDTH, &mut into).unwrap();
            assert_eq!(into.size, expected);
            assert_eq!(into.pixels.len() as u64, expected.pixels());
            assert_eq!(into.source_size, PictureSize::new(width, height));
        }
    }
}

#[test]
fn every_format_can_be_shown_as_jpeg() {
    let limits = FrameLimits::default();
    let jpeg = rgb_jpeg(32, 16, Process::Baseline);
    assert_eq!(to_jpeg(&jpeg, &limits).unwrap(), jpeg.bytes);
    let pixels = gradient(32, 16);
    let png = png_file(32, 16, ColorType::Rgb, BitDepth::Eight, &pixels);
    for (picture, most) in [
        (png, 16),
        (encoded(PictureFormat::Rgb8, 32, 16, pixels.clone()), 16),
        (encoded(PictureFormat::Gray8, 32, 16, luma_of(&pixels)), 12),
    ] {
        let file = to_jpeg(&picture, &limits).unwrap();
        let shown = encoded(PictureFormat::Jpeg, 32, 16, file.to_vec());
        assert!(largest_difference(&rgb(&shown), &rgb(&picture)) <= most);
    }
}

fn specimens() -> Vec<EncodedPicture> {
    let pixels = gradient(40, 24);
    let clear = |p: &[u8]| [p[0], p[1], p[2], 5];
    let rgba: Vec<u8> = pixels.chunks(3).flat_map(clear).collect();
    vec![
        rgb_jpeg(40, 24, Process::Baseline),
        rgb_jpeg(40, 24, Process::Progressive),
        png_file(40, 24, ColorType::Rgb, BitDepth::Eight, &pixels),
        png_file(40, 24, ColorType::Rgba, BitDepth::Eight, &rgba),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Not even a contained panic happens.
    #[test]
    fn a_damaged_file_is_rejected_or_decoded_within_its_memory_limit(
        specimen in 0_usize..4,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..12),
        cut in prop::option::weighted(0.3, any::<prop::sample::Index>()),
        grey in any::<bool>(),
    ) {
        let mut picture = specimens().swap_remove(specimen);
        let mut bytes = picture.bytes.to_vec();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        picture.bytes = Bytes::from(bytes);
        let limits = FrameLimits { max_pixels: 40 * 24, ..FrameLimits::default() };
        let layout = if grey { PixelLayout::Gray8 } else { PixelLayout::Rgb8 };
        let mut into = Picture::default();
        let result = decode(&picture, &limits, layout, None, &mut into);
        prop_assert!(into.pixels.capacity() <= 40 * 24 * 4);
        match result {
            Ok(()) => prop_assert_eq!(into.pixels.len(), 40 * 24 * layout.channels()),
            Err(fault) => prop_assert!(!fault.to_string().contains("panicked"), "{}", fault),
        }
    }
}

/// The forms of one frame that cameras send: decoded as the frame, or refused with the reason.
#[test]
#[ignore = "needs ../shared"]
fn shared_a_frame_in_the_forms_of_cameras_is_decoded_or_refused() {
    let read = |name: &str| {
        let picture = read_picture_file(&shared(&format!("cases/pictures/{name}"))).unwrap();
        let mut into = Picture::default();
        let limits = FrameLimits::default();
        decode(&picture, &limits, PixelLayout::Rgb8, None, &mut into).map(|()| (picture.size, into))
    };
    let (size, plain) = read("plain.jpg").unwrap();
    let (_, without_tables) = read("no_huffman_tables.jpg").unwrap();
    assert_eq!(without_tables.size, size);
    // The stored picture lies on its side.
    let (turned_size, turned) = read("exif_orientation_6.jpg").unwrap();
    assert_eq!([turned.size, turned.source_size], [turned_size; 2]);
    let mean = |picture: &Picture| {
        let sum: u64 = picture.pixels.iter().map(|&value| u64::from(value)).sum();
        sum as f64 / picture.pixels.len() as f64
    };
    let (_, thermal) = read("png_12_bits_in_16.png").unwrap();
    assert!(mean(&thermal) > 0.5 * mean(&plain), "{}", mean(&thermal));
    for cut in ["no_end_marker.jpg", "half_then_end_marker.jpg"] {
        let fault = read(cut).map_or_else(|fault| fault.to_string(), |_| "none".to_owned());
        assert!(fault.contains("cut short"), "{cut}: {fault}");
    }
}

/// Reads every picture of the folder, with a comment before each of its segments and with flipped bits: comments change no
/// pixel, and a flipped bit gives a picture or a fault.
#[test]
#[ignore = "needs ../shared"]
fn shared_frames_of_cameras_with_comments_or_flipped_bits_are_decoded_or_refused() {
    let files = picture_files(&shared("cases/pictures")).unwrap();
    assert!(files.len() >= 6, "{files:?}");
    let limits = FrameLimits::default();
    for file in files {
        let bytes = std::fs::read(&file).unwrap();
        let read = |bytes: Vec<u8>| {
            let picture = picture_of_file(bytes.into(), &limits)?;
            let mut into = Picture::default();
            decode(&picture, &limits, PixelLayout::Rgb8, None, &mut into).map(|()| into.pixels)
        };
        let plain = read(bytes.clone());
        if bytes.starts_with(&[0xFF, 0xD8]) {
            // A comment may contain what looks like markers, and may be as long as its length can say.
            for length in [2_u16, 9, u16::MAX] {
                let content = [0xFF, 0xD9, 0xFF, 0xD8].repeat(usize::from(length) / 4 + 1);
                let comment = [
                    &[0xFF, 0xFE],
                    &length.to_be_bytes()[..],
                    &content[..usize::from(length) - 2],
                ];
                let commented = [&bytes[..2], &comment.concat(), &bytes[2..]].concat();
                assert_eq!(read(commented), plain, "{} {length}", file.display());
            }
        }
        let step = bytes.len() * 8 / 97;
        for bit in (0..bytes.len() * 8).step_by(step) {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            if let Err(fault) = read(flipped) {
                let fault = fault.to_string();
                assert!(
                    !fault.contains("panicked"),
                    "{}, bit {bit}: {fault}",
                    file.display()
                );
            }
        }
    }
}
