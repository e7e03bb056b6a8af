//! Decoding to fewer pixels: how many, which, and that broken files are refused as at full size.

use super::*;
use crate::picture::{FrameLimits, PictureFormat, decode};
use albireo_scene::BoxScene;
use bytes::Bytes;

fn scene(size: PictureSize) -> EncodedPicture {
    EncodedPicture {
        format: PictureFormat::Jpeg,
        bytes: BoxScene::new(5, size).frame(10).jpeg(90).unwrap().into(),
        size,
        mount: None,
    }
}

fn decoded(
    picture: &EncodedPicture,
    layout: PixelLayout,
    target: Option<PictureSize>,
) -> Result<Picture, FrameFault> {
    let mut into = Picture::default();
    decode(picture, &FrameLimits::default(), layout, target, &mut into)?;
    Ok(into)
}

#[test]
fn scaled_pictures_are_never_smaller_than_required() {
    let source = PictureSize::new(1280, 720);
    let size = PictureSize::new;
    for (target, expected) in [
        (size(640, 360), Some(size(640, 360))),
        (size(641, 360), None),
        (size(640, 361), None),
        (size(416, 234), Some(size(640, 360))),
        (size(320, 180), Some(size(320, 180))),
        (size(64, 36), Some(size(160, 90))),
        (size(1280, 720), None),
        (size(4000, 10), None),
    ] {
        let scale = Scale::towards(target, source);
        assert_eq!(scale.map(|scale| scale.size), expected, "{target:?}");
    }
}

#[test]
fn sides_that_do_not_divide_are_rounded_up() {
    let odd = Scale::towards(PictureSize::new(300, 100), PictureSize::new(641, 359)).unwrap();
    assert_eq!(odd.size, PictureSize::new(321, 180));
}

#[test]
fn scaled_decoding_gives_the_mean_of_the_covered_pixels() {
    let picture = scene(PictureSize::new(642, 358));
    for layout in [PixelLayout::Rgb8, PixelLayout::Gray8] {
        let full = decoded(&picture, layout, None).unwrap();
        let half = decoded(&picture, layout, Some(PictureSize::new(300, 100))).unwrap();
        assert_eq!(full.size, picture.size);
        assert_eq!(half.size, PictureSize::new(321, 179));
        assert_eq!(half.source_size, picture.size);
        let channels = layout.channels();
        let at = |x: usize, y: usize, channel| {
            f64::from(full.pixels[(y * full.size.width as usize + x) * channels + channel])
        };
        let mut off = 0.0;
        for (index, &value) in half.pixels.iter().enumerate() {
            let channel = index % channels;
            let pixel = index / channels;
            let x = 2 * (pixel % 321);
            let y = 2 * (pixel / 321);
            let covered = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
            let sum: f64 = covered.iter().map(|&(x, y)| at(x, y, channel)).sum();
            off += (f64::from(value) - sum / 4.0).abs();
        }
        let mean = off / half.pixels.len() as f64;
        // The mean difference is smaller in grey, which has no chroma to scale; the limit holds for both.
        assert!(mean < 2.0, "{layout:?}: {mean} grey levels");
    }
}

#[test]
fn scaled_decoding_rejects_a_truncated_or_damaged_file() {
    let picture = scene(PictureSize::new(640, 360));
    let target = Some(PictureSize::new(320, 180));
    assert!(decoded(&picture, PixelLayout::Rgb8, target).is_ok());
    let half = picture.bytes.slice(..picture.bytes.len() / 2);
    // The end marker is present, but pixels before it are missing.
    let without_middle = Bytes::from([&half[..], &[0xFF, 0xD9]].concat());
    for (what, bytes) in [("truncated", half), ("without its middle", without_middle)] {
        let damaged = EncodedPicture {
            bytes,
            ..picture.clone()
        };
        let read = decoded(&damaged, PixelLayout::Rgb8, target);
        assert!(read.is_err(), "{what}");
    }
}

#[test]
fn scaled_decoding_rejects_a_file_of_another_size_than_stated() {
    let picture = scene(PictureSize::new(640, 360));
    let target = Some(PictureSize::new(320, 180));
    let misstated = EncodedPicture {
        size: PictureSize::new(1280, 720),
        ..picture
    };
    assert!(decoded(&misstated, PixelLayout::Rgb8, target).is_err());
}
