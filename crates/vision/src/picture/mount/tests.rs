use super::*;
use crate::picture::{
    FrameLimits, PictureFormat, PixelLayout, decode, decode_small_grey, picture_of_file,
    raw_picture, to_jpeg,
};
use albireo_scene::BoxScene;
use bytes::Bytes;
use proptest::prelude::*;

fn grey(size: PictureSize, pixels: Vec<u8>) -> EncodedPicture {
    let limits = FrameLimits::default();
    raw_picture(PictureFormat::Gray8, size, Bytes::from(pixels), &limits).unwrap()
}

fn decoded(picture: &EncodedPicture, target: Option<PictureSize>) -> Picture {
    let mut into = Picture::default();
    let limits = FrameLimits::default();
    decode(picture, &limits, PixelLayout::Gray8, target, &mut into).unwrap();
    into
}

fn mounted(picture: EncodedPicture, mount: &Mount) -> EncodedPicture {
    picture.mounted(Some(&Arc::new(mount.clone())))
}

#[test]
fn a_picture_is_turned_then_mirrored_then_cropped() {
    // Two rows of three pixels: 1 2 3 / 4 5 6.
    let sent = grey(PictureSize::new(3, 2), vec![1, 2, 3, 4, 5, 6]);
    let all = [0.0, 0.0, 1.0, 1.0];
    let (across, down) = (Some(Flip::Horizontal), Some(Flip::Vertical));
    for (rotate, flip, crop, columns, expected) in [
        (0, None, all, 3, &[1, 2, 3, 4, 5, 6][..]),
        (90, None, all, 2, &[4, 1, 5, 2, 6, 3]),
        (180, None, all, 3, &[6, 5, 4, 3, 2, 1]),
        (270, None, all, 2, &[3, 6, 2, 5, 1, 4]),
        (0, across, all, 3, &[3, 2, 1, 6, 5, 4]),
        (0, down, all, 3, &[4, 5, 6, 1, 2, 3]),
        (90, across, all, 2, &[1, 4, 2, 5, 3, 6]),
        (90, down, all, 2, &[6, 3, 5, 2, 4, 1]),
        (0, None, [0.0, 0.5, 0.67, 1.0], 2, &[4, 5]),
        (90, across, [0.5, 0.34, 1.0, 1.0], 1, &[5, 6]),
    ] {
        let mount = Mount {
            rotate,
            flip,
            crop: Some(crop),
            ..Mount::default()
        };
        let picture = mounted(sent.clone(), &mount);
        let seen = decoded(&picture, None);
        assert_eq!(seen.pixels, expected, "{mount:?}");
        assert_eq!(seen.size.width, columns);
        assert_eq!(seen.size, picture.size);
        assert_eq!(seen.source_size, picture.size);
    }
}

/// The share of the sent picture at a share of the published one, as docs/messages.md says.
fn back(mount: &Mount, [across, down]: [f64; 2]) -> [f64; 2] {
    let [left, top, right, bottom] = mount.crop.unwrap();
    let mut x = left + across * (right - left);
    let mut y = top + down * (bottom - top);
    match mount.flip {
        Some(Flip::Horizontal) => x = 1.0 - x,
        Some(Flip::Vertical) => y = 1.0 - y,
        None => {}
    }
    match mount.rotate {
        90 => [y, 1.0 - x],
        180 => [1.0 - x, 1.0 - y],
        270 => [1.0 - y, x],
        _ => [x, y],
    }
}

proptest! {
    #[test]
    fn every_published_pixel_is_found_again_in_the_picture_as_it_was_sent(
        rotate in prop::sample::select(vec![0_i64, 90, 180, 270]),
        flip in prop::sample::select(vec![None, Some(Flip::Horizontal), Some(Flip::Vertical)]),
        left in 0_u32..5, top in 0_u32..5, right in 5_u32..8, bottom in 5_u32..8,
    ) {
        let (columns, rows) = (24_u32, 40_u32);
        let sent: Vec<u8> = (0..columns * rows).map(|at| (at % 251) as u8).collect();
        let share = |eighths: u32| f64::from(eighths) / 8.0;
        let mount = Mount {
            rotate,
            flip,
            crop: Some([left, top, right, bottom].map(share)),
            ..Mount::default()
        };
        let picture = grey(PictureSize::new(columns, rows), sent.clone());
        let seen = decoded(&mounted(picture, &mount), None);
        let (width, height) = (seen.size.width, seen.size.height);
        let middle = |number: u32, side: u32| (f64::from(number) + 0.5) / f64::from(side);
        for (at, pixel) in (0_u32..).zip(&seen.pixels) {
            let column = at % width;
            let row = at / width;
            let published = [middle(column, width), middle(row, height)];
            let [sent_across, sent_down] = back(&mount, published);
            let x = (sent_across * f64::from(columns)) as u32;
            let y = (sent_down * f64::from(rows)) as u32;
            prop_assert_eq!(sent[(y * columns + x) as usize], *pixel);
        }
    }
}

fn masked(polygons: &[&[[f64; 2]]]) -> Mount {
    Mount {
        mask: Mask(polygons.iter().map(|polygon| polygon.to_vec()).collect()),
        ..Mount::default()
    }
}

const LOWER_HALF: &[[f64; 2]] = &[[0.0, 0.5], [1.0, 0.5], [1.0, 1.0], [0.0, 1.0]];
const LOWER_LEFT: &[[f64; 2]] = &[[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]];

#[test]
fn what_is_masked_is_grey_in_the_decoded_picture() {
    let white = grey(PictureSize::new(8, 8), vec![255; 64]);
    let seen = decoded(&mounted(white, &masked(&[LOWER_HALF])), None);
    let (upper, lower) = seen.pixels.split_at(32);
    assert!(upper.iter().all(|pixel| *pixel == 255));
    assert!(lower.iter().all(|pixel| *pixel == MASKED));
}

#[test]
fn a_pixel_that_the_edge_of_a_mask_crosses_is_masked() {
    let white = grey(PictureSize::new(8, 8), vec![255; 64]);
    let seen = decoded(&mounted(white, &masked(&[LOWER_LEFT])), None);
    for (row, pixels) in seen.pixels.chunks(8).enumerate() {
        // The edge crosses the pixel on the diagonal.
        let (hidden, shown) = pixels.split_at(row + 1);
        assert!(hidden.iter().all(|pixel| *pixel == MASKED), "{pixels:?}");
        assert!(shown.iter().all(|pixel| *pixel == 255), "{pixels:?}");
    }
}

/// A JPEG file of 640x360 pixels.
fn jpeg_file() -> EncodedPicture {
    let file = BoxScene::new(3, PictureSize::new(640, 360)).frame(0).jpeg(90).unwrap();
    picture_of_file(Bytes::from(file), &FrameLimits::default()).unwrap()
}

#[test]
fn a_jpeg_file_of_a_camera_without_a_mount_is_passed_on_unchanged() {
    let sent = jpeg_file();
    let passed_on = to_jpeg(&sent, &FrameLimits::default()).unwrap();
    assert_eq!(passed_on, sent.bytes);
}

#[test]
fn a_jpeg_file_is_encoded_again_with_its_mask() {
    let limits = FrameLimits::default();
    let hidden = mounted(jpeg_file(), &masked(&[LOWER_HALF]));
    let encoded = to_jpeg(&hidden, &limits).unwrap();
    let shown = decoded(&picture_of_file(encoded, &limits).unwrap(), None);
    // JPEG smears the edge in row 180 over its block. From row 192 on no block touches the edge, be they of 8 rows or 16.
    let lower = &shown.pixels[640 * 192..];
    assert!(lower.iter().all(|pixel| pixel.abs_diff(MASKED) < 3));
}

#[test]
fn a_small_grey_picture_is_masked_too() {
    let hidden = mounted(jpeg_file(), &masked(&[LOWER_HALF]));
    let mut small = Picture::default();
    decode_small_grey(&hidden, &FrameLimits::default(), 160, &mut small).unwrap();
    let (_, lower) = small.pixels.split_at(small.pixels.len() / 2);
    assert!(lower.iter().all(|pixel| *pixel == MASKED));
}

/// The mean of a square of pixels.
#[cfg(feature = "turbojpeg")]
fn mean_of_square(picture: &Picture, left: usize, top: usize, side: usize) -> u32 {
    let mut sum = 0;
    for y in top..top + side {
        let begin = y * picture.size.width as usize + left;
        let row = &picture.pixels[begin..begin + side];
        sum += row.iter().copied().map(u32::from).sum::<u32>();
    }
    sum / (side * side) as u32
}

#[test]
#[cfg(feature = "turbojpeg")]
fn scaled_while_it_is_decoded_a_picture_is_cropped_at_the_same_place() {
    let file = BoxScene::new(5, PictureSize::new(1280, 720)).frame(0).jpeg(90).unwrap();
    let limits = FrameLimits::default();
    let sent = picture_of_file(Bytes::from(file), &limits).unwrap();
    let mount = Mount {
        rotate: 180,
        crop: Some([0.25, 0.0, 0.75, 0.5]),
        ..Mount::default()
    };
    let picture = mounted(sent, &mount);
    assert_eq!(picture.size, PictureSize::new(640, 360));
    let whole = decoded(&picture, None);
    let target = PictureSize::new(160, 90);
    let small = decoded(&picture, Some(target));
    assert_eq!(small.size, target);
    assert_eq!(small.source_size, picture.size);
    let factor = 4;
    let mut far_off = 0;
    for (at, pixel) in small.pixels.iter().enumerate() {
        let column = at % 160;
        let row = at / 160;
        let mean = mean_of_square(&whole, column * factor, row * factor, factor);
        // A tenth of the range.
        if mean.abs_diff(u32::from(*pixel)) > 24 {
            far_off += 1;
        }
    }
    // At edges, few pixels of a JPEG file differ by more.
    assert!(
        far_off < small.pixels.len() / 200,
        "{far_off} pixels differ"
    );
}

#[test]
fn a_box_is_hidden_once_more_than_half_of_it_lies_in_the_mask() {
    let mount = masked(&[LOWER_HALF, LOWER_LEFT]);
    for (bounding_box, hidden) in [
        ([0.75, 0.25, 0.2, 0.2], false),
        ([0.75, 0.75, 0.2, 0.2], true),
        // In the second polygon only.
        ([0.1, 0.3, 0.1, 0.1], true),
        // Three quarters of it.
        ([0.9, 0.55, 0.1, 0.2], true),
        // One quarter of it.
        ([0.9, 0.45, 0.1, 0.2], false),
        // Three eighths of a large box.
        ([0.8, 0.4, 0.4, 0.8], false),
        // Half of it is below the picture, and what is seen lies in the mask.
        ([0.5, 1.0, 0.2, 0.6], true),
    ] {
        assert_eq!(mount.hides(bounding_box.into()), hidden, "{bounding_box:?}");
    }
}

#[test]
fn without_a_mask_no_box_is_hidden() {
    let whole_picture = [0.5, 0.5, 1.0, 1.0];
    assert!(!Mount::default().hides(whole_picture.into()));
}

#[test]
fn what_cannot_be_meant_is_said_with_its_key() {
    let cropped = |shares| Mount {
        crop: Some(shares),
        ..Mount::default()
    };
    let turned = Mount {
        rotate: 45,
        ..Mount::default()
    };
    let line = [[0.1, 0.1], [0.5, 0.5], [0.9, 0.9]];
    let all = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    for (mount, key, part) in [
        (turned, "rotate", "0, 90, 180 or 270"),
        (cropped([0.0, 0.0, 1280.0, 720.0]), "crop", "from 0 to 1"),
        (cropped([0.0, f64::NAN, 1.0, 1.0]), "crop", "from 0 to 1"),
        (
            cropped([0.6, 0.0, 0.4, 1.0]),
            "crop",
            "left is 0.6 and right 0.4",
        ),
        (
            cropped([0.0, 0.5, 1.0, 0.5]),
            "crop",
            "top is 0.5 and bottom 0.5",
        ),
        (
            masked(&[LOWER_HALF, &line[..2]]),
            "mask",
            "polygon 2 has 2 points",
        ),
        (masked(&[&line]), "mask", "polygon 1 has no area"),
        (
            masked(&[&[[0.0, 0.0], [320.0, 0.0], [0.0, 1.0]]]),
            "mask",
            "the point [320.0, 0.0]",
        ),
        (masked(&[&all]), "mask", "covers the whole picture"),
    ] {
        let problems = mount.problems();
        let [(found_key, reason)] = problems.as_slice() else {
            panic!("not one problem: {problems:?}");
        };
        assert_eq!(*found_key, key);
        assert!(reason.contains(part), "{problems:?}");
    }
}

#[test]
fn a_mount_that_can_be_meant_has_no_problems() {
    let usable = Mount {
        rotate: 270,
        flip: Some(Flip::Vertical),
        ..masked(&[LOWER_HALF, LOWER_LEFT])
    };
    assert_eq!(usable.problems(), []);
    let nearly_all = masked(&[&[[0.0, 0.0], [0.97, 0.0], [0.97, 1.0], [0.0, 1.0]]]);
    assert_eq!(nearly_all.problems(), []);
    let smallest = Mount {
        crop: Some([0.34, 0.0, 0.35, 1.0]),
        ..Mount::default()
    };
    assert_eq!(smallest.problems(), []);
}
