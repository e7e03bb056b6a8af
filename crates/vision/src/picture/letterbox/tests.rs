//! Compares the letterbox with a slow reference, and its inverse with the letterbox.

use super::super::PixelLayout;
use super::super::input_format::{ColorOrder, Fit, InputElement, ValueRange};
use super::*;
use albireo_core::geometry::Corners;
use proptest::prelude::*;

const FITS: [Fit; 3] = [Fit::TopLeft, Fit::Centre, Fit::Stretch];

fn picture(width: u32, height: u32) -> Picture {
    let size = PictureSize::new(width, height);
    let value = |place: u32| {
        let (pixel, channel) = (place / 3, place % 3);
        let (x, y) = (pixel % width, pixel / width);
        let edge = if (x / 7 + y / 5) % 2 == 0 { 90 } else { 0 };
        ((x * 3 + y * 5 + channel * 40 + edge) % 256) as u8
    };
    Picture {
        size,
        source_size: size,
        layout: PixelLayout::Rgb8,
        pixels: (0..width * height * 3).map(value).collect(),
    }
}

/// Bilinear interpolation with pixel centres at half-integers, like OpenCV's `INTER_LINEAR`.
fn reference(picture: &Picture, channel: usize, column: u32, row: u32, to: PictureSize) -> f64 {
    let at = |x: f64, y: f64| {
        let x = x.clamp(0.0, f64::from(picture.size.width - 1)) as usize;
        let y = y.clamp(0.0, f64::from(picture.size.height - 1)) as usize;
        f64::from(picture.pixels[(y * picture.size.width as usize + x) * 3 + channel])
    };
    let source = |position: u32, source_side: u32, scaled_side: u32| {
        (f64::from(position) + 0.5) * f64::from(source_side) / f64::from(scaled_side) - 0.5
    };
    let x = source(column, picture.size.width, to.width);
    let y = source(row, picture.size.height, to.height);
    let (left, top) = (x.floor(), y.floor());
    let (right_share, bottom_share) = (x - left, y - top);
    let upper = at(left, top) * (1.0 - right_share) + at(left + 1.0, top) * right_share;
    let lower = at(left, top + 1.0) * (1.0 - right_share) + at(left + 1.0, top + 1.0) * right_share;
    upper * (1.0 - bottom_share) + lower * bottom_share
}

fn format(width: u32, height: u32, fit: Fit) -> InputFormat {
    InputFormat {
        size: PictureSize::new(width, height),
        fit,
        color_order: ColorOrder::Rgb,
        value_range: ValueRange::To255,
        layout: TensorLayout::Nchw,
        element: InputElement::Float,
    }
}

fn place_in_largest(source: PictureSize, format: InputFormat) -> (Placement, InputMapping) {
    place(source, format, format.size)
}

/// Compares the tensor with the reference in the picture of size `used` at row `top`, and with the margin's grey elsewhere.
fn compare(picture: &Picture, format: InputFormat, top: u32, used: PictureSize) {
    let mut letterbox = Letterbox::new(format);
    // Nothing of an earlier picture, of another shape, may stay in the margin.
    let other = Picture::black(PictureSize::new(picture.size.height, picture.size.width));
    letterbox.fill(&other).unwrap();
    letterbox.fill(picture).unwrap();
    let size = format.size;
    for plane in 0..3_usize {
        let channel = match format.color_order {
            ColorOrder::Rgb => plane,
            ColorOrder::Bgr => 2 - plane,
        };
        for row in 0..size.height {
            for column in 0..size.width {
                let index = match format.layout {
                    TensorLayout::Nchw => (plane as u32 * size.height + row) * size.width + column,
                    TensorLayout::Nhwc => (row * size.width + column) * 3 + plane as u32,
                };
                let value = f64::from(letterbox.tensor().to_floats()[index as usize]);
                let inside = column < used.width && (top..top + used.height).contains(&row);
                let expected = if inside {
                    reference(picture, channel, column, row - top, used)
                } else {
                    114.0
                };
                let found = match format.value_range {
                    ValueRange::To255 => value,
                    ValueRange::ToOne => value * 255.0,
                    ValueRange::ImageNet => {
                        let mean = [0.485, 0.456, 0.406][channel];
                        let deviation = [0.229, 0.224, 0.225][channel];
                        (value * deviation + mean) * 255.0
                    }
                };
                // Two passes, each with its own rounding.
                let allowed = if inside { 1.01 } else { 1e-4 };
                assert!(
                    (found - expected).abs() <= allowed,
                    "plane {plane} row {row} column {column}: {found} instead of {expected}"
                );
            }
        }
    }
}

#[test]
fn each_fit_puts_a_picture_scaled_by_bilinear_interpolation_in_its_place() {
    for ((width, height), (columns, rows), fit, top, (used_columns, used_rows)) in [
        ((72, 58), (42, 42), Fit::TopLeft, 0, (42, 33)),
        ((30, 90), (64, 64), Fit::TopLeft, 0, (21, 64)),
        ((19, 11), (96, 64), Fit::TopLeft, 0, (96, 55)),
        ((64, 64), (64, 64), Fit::TopLeft, 0, (64, 64)),
        ((40, 21), (32, 32), Fit::Centre, 7, (32, 17)),
        ((40, 21), (32, 24), Fit::Stretch, 0, (32, 24)),
    ] {
        let used = PictureSize::new(used_columns, used_rows);
        compare(
            &picture(width, height),
            format(columns, rows, fit),
            top,
            used,
        );
    }
}

#[test]
fn colour_order_range_and_layout_are_as_configured() {
    let picture = picture(40, 20);
    for color_order in [ColorOrder::Rgb, ColorOrder::Bgr] {
        for value_range in [ValueRange::To255, ValueRange::ToOne, ValueRange::ImageNet] {
            for layout in [TensorLayout::Nchw, TensorLayout::Nhwc] {
                let format = InputFormat {
                    color_order,
                    value_range,
                    layout,
                    ..format(32, 32, Fit::TopLeft)
                };
                compare(&picture, format, 0, PictureSize::new(32, 16));
            }
        }
    }
}

#[test]
fn a_picture_scaled_by_the_decoder_has_the_place_of_the_whole_one() {
    let mut whole = picture(41, 21);
    whole.pixels.fill(7);
    let half = Picture {
        size: PictureSize::new(21, 11),
        source_size: whole.size,
        layout: PixelLayout::Rgb8,
        pixels: vec![7; 21 * 11 * 3],
    };
    for fit in FITS {
        let format = format(32, 32, fit);
        let mut of_whole = Letterbox::new(format);
        let mut of_half = Letterbox::new(format);
        let mapping_of_whole = of_whole.fill(&whole).unwrap();
        let mapping_of_half = of_half.fill(&half).unwrap();
        assert_eq!(mapping_of_half, mapping_of_whole);
        assert_eq!(of_half.tensor().to_floats(), of_whole.tensor().to_floats());
    }
}

#[test]
fn the_fraction_is_truncated_as_in_yolox() {
    // In double precision 720 * (416 / 720) is just below 416.
    let (placement, _) =
        place_in_largest(PictureSize::new(720, 576), format(416, 416, Fit::TopLeft));
    assert_eq!((placement.width, placement.height), (415, 332));
}

#[test]
fn the_mapping_keeps_the_fraction_that_the_placement_loses() {
    let (_, mapping) = place_in_largest(PictureSize::new(720, 576), format(416, 416, Fit::TopLeft));
    assert!((mapping.width - 416.0).abs() < 1e-9);
    assert!((mapping.height - 332.8).abs() < 1e-9);
}

#[test]
fn the_smallest_input_has_whole_strides_and_holds_the_picture() {
    let any = PictureSize::new(1, 1);
    for (fit, (columns, rows), picture, smallest) in [
        (Fit::TopLeft, (416, 416), (1920, 1080), (416, 256)),
        (Fit::TopLeft, (416, 416), (1080, 1920), (256, 416)),
        (Fit::TopLeft, (416, 416), (640, 480), (416, 320)),
        (Fit::TopLeft, (416, 416), (720, 576), (416, 352)),
        (Fit::TopLeft, (416, 416), (500, 500), (416, 416)),
        (Fit::TopLeft, (416, 416), (3840, 1080), (416, 128)),
        (Fit::TopLeft, (416, 416), (8000, 1), (416, 32)),
        // Exactly 256 rows.
        (Fit::Centre, (416, 416), (1300, 800), (416, 256)),
        // 224 rows, which double precision makes 224.00000000000003.
        (Fit::Centre, (416, 416), (1950, 1050), (416, 224)),
        (Fit::Centre, (640, 640), (1280, 720), (640, 384)),
        (Fit::Centre, (640, 384), (1280, 720), (640, 384)),
        (Fit::Centre, (640, 384), (720, 1280), (224, 384)),
        (Fit::Centre, (600, 600), (1280, 720), (600, 352)),
        (Fit::Stretch, (640, 640), (1280, 720), (640, 640)),
    ] {
        let size = |(width, height)| PictureSize::new(width, height);
        let found = format(columns, rows, fit).smallest_for(size(picture), 32, any);
        assert_eq!(
            found,
            size(smallest),
            "{fit:?} {columns}x{rows} {picture:?}"
        );
    }
}

#[test]
fn the_smallest_input_has_no_side_below_the_least() {
    let least = PictureSize::new(224, 224);
    let wide = PictureSize::new(3840, 1080);
    let found = format(416, 416, Fit::TopLeft).smallest_for(wide, 32, least);
    assert_eq!(found, PictureSize::new(416, 224));
}

#[test]
fn the_padding_is_the_share_of_an_input_that_the_picture_does_not_cover() {
    let wide = PictureSize::new(3840, 1080);
    let format = format(416, 416, Fit::TopLeft);
    // 3840 x 1080 pixels become 416 x 117.
    let padding = format.padding(wide, PictureSize::new(416, 224));
    assert!((padding - (1.0 - 117.0 / 224.0)).abs() < 1e-9, "{padding}");
}

#[test]
fn a_picture_of_any_shape_is_taken() {
    for fit in FITS {
        let mut letterbox = Letterbox::new(format(32, 32, fit));
        for (width, height) in [(1, 1), (4000, 1), (1, 4000), (33, 32)] {
            letterbox.fill(&picture(width, height)).unwrap();
        }
    }
}

#[test]
fn a_picture_that_is_empty_too_short_or_grey_is_refused_with_a_reason() {
    let mut short = picture(8, 8);
    short.pixels.pop();
    let mut grey = picture(8, 8);
    grey.layout = PixelLayout::Gray8;
    grey.pixels = vec![7; 64];
    for (refused, reason) in [
        (Picture::default(), "the picture is empty (0x0)"),
        (short, "an RGB picture of 8x8 needs 192 bytes and has 191"),
        (grey, "an RGB picture of 8x8 needs 192 bytes and has 64"),
    ] {
        for fit in FITS {
            let error = Letterbox::new(format(32, 32, fit)).fill(&refused).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}

proptest! {
    #[test]
    fn the_smallest_input_is_the_largest_without_some_of_its_margin(
        width in 1_u32..200, height in 1_u32..200,
        fit in prop::sample::select(FITS.to_vec()),
        layout in prop::sample::select(vec![TensorLayout::Nchw, TensorLayout::Nhwc]),
    ) {
        let format = InputFormat { layout, ..format(64, 48, fit) };
        let picture = picture(width, height);
        let smallest = format.smallest_for(picture.size, 8, PictureSize::new(1, 1));
        let mut largest = Letterbox::new(format);
        largest.fill(&picture).unwrap();
        let (cut, mapping) = largest.tensor().cut(format, picture.size, smallest);
        let mut filled = Letterbox::of_size(format, smallest);
        let mapping_of_smallest = filled.fill(&picture).unwrap();
        prop_assert_eq!(mapping_of_smallest, mapping);
        prop_assert_eq!(filled.tensor(), &cut);
    }

    #[test]
    fn the_inverse_mapping_undoes_the_mapping(
        width in 1_u32..3000, height in 1_u32..3000,
        columns in 1_u32..700, rows in 1_u32..700,
        fit in prop::sample::select(FITS.to_vec()),
        x1 in 0.0..1.0_f64, y1 in 0.0..1.0_f64, w in 0.0..1.0_f64, h in 0.0..1.0_f64,
    ) {
        let (placement, mapping) = place_in_largest(PictureSize::new(width, height), format(columns, rows, fit));
        let across = f64::from(columns) / f64::from(width);
        let down = f64::from(rows) / f64::from(height);
        let (scale_x, scale_y) = match fit {
            Fit::Stretch => (across, down),
            Fit::TopLeft | Fit::Centre => (across.min(down), across.min(down)),
        };
        let to_input = |x: f64, y: f64| (
            x * f64::from(width) * scale_x + f64::from(placement.left),
            y * f64::from(height) * scale_y + f64::from(placement.top),
        );
        let (left, top) = to_input(x1, y1);
        let (right, bottom) = to_input(x1 + w, y1 + h);
        let back = mapping.to_source(Corners { x1: left, y1: top, x2: right, y2: bottom });
        for (found, expected) in [
            (back.center_x, x1 + w / 2.0),
            (back.center_y, y1 + h / 2.0),
            (back.width, w),
            (back.height, h),
        ] {
            prop_assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
        }
    }

    #[test]
    fn a_picture_is_placed_inside_the_input_and_at_most_a_pixel_off_the_size_of_its_mapping(
        width in 1_u32..3000, height in 1_u32..3000,
        columns in 1_u32..700, rows in 1_u32..700,
        fit in prop::sample::select(FITS.to_vec()),
    ) {
        let (placement, mapping) = place_in_largest(PictureSize::new(width, height), format(columns, rows, fit));
        prop_assert!(placement.left + placement.width <= columns);
        prop_assert!(placement.top + placement.height <= rows);
        prop_assert!((f64::from(placement.width) - mapping.width).abs() <= 1.0 + 1e-9);
        prop_assert!((f64::from(placement.height) - mapping.height).abs() <= 1.0 + 1e-9);
    }
}
