mod opencv;

use super::*;
use crate::geometry::{Corners, PictureSize};
use proptest::prelude::*;
use std::f64::consts::TAU;

const WIDTH: usize = 320;
const HEIGHT: usize = 180;

/// A sum of waves of different directions and lengths.
struct Texture([[f64; 4]; 40]);

impl Texture {
    fn new(seed: u32) -> Self {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        Self(std::array::from_fn(|_| {
            let length = 6.0 * 10f64.powf(next());
            let (sin, cos) = (TAU * next()).sin_cos();
            let k = TAU / length;
            [k * cos, k * sin, TAU * next(), 1.0 + 0.1 * length]
        }))
    }

    /// The picture in which the point p has moved to `middle + scale·(p − middle) + shift`.
    fn picture(&self, middle: [f64; 2], shift: [f64; 2], scale: f64) -> Vec<u8> {
        let place = |at: usize, axis: usize| {
            (at as f64 - middle[axis] - shift[axis]) / scale + middle[axis]
        };
        // Sine and cosine of each wave's share of its angle, so that pixels need only products of them.
        let along = |axis: usize, length: usize| {
            let angle = |wave: [f64; 4], at| wave[axis] * place(at, axis) + wave[2] / 2.0;
            let waves = (0..length).map(|at| self.0.map(|wave| angle(wave, at).sin_cos()));
            waves.collect::<Vec<_>>()
        };
        let columns = along(0, WIDTH);
        let rows = along(1, HEIGHT);
        let value = |index: usize| {
            let angles = columns[index % WIDTH].iter().zip(&rows[index / WIDTH]);
            let waves =
                angles.map(|((sin_x, cos_x), (sin_y, cos_y))| cos_x * cos_y - sin_x * sin_y);
            let sum: f64 = waves.zip(&self.0).map(|(wave, [.., weight])| weight * wave).sum();
            (128.0 + 7.0 * sum).clamp(0.0, 255.0) as u8
        };
        (0..WIDTH * HEIGHT).map(value).collect()
    }
}

fn corners([x1, y1, x2, y2]: [f64; 4]) -> Corners {
    Corners { x1, y1, x2, y2 }
}

fn filled(width: usize, height: usize, pixels: &[u8]) -> Pyramid {
    let size = PictureSize::new(width as u32, height as u32);
    let mut pyramid = Pyramid::default();
    assert!(pyramid.fill(GreyPicture { size, pixels }));
    pyramid
}

fn pyramid(pixels: &[u8]) -> Pyramid {
    filled(WIDTH, HEIGHT, pixels)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn a_box_moves_as_its_picture_does(
        seed in any::<u32>(),
        x in 60.0..260.0,
        y in 50.0..130.0,
        width in 24.0..80.0,
        height in 24.0..70.0,
        shift_x in -9.0..9.0,
        shift_y in -6.0..6.0,
        scale in 0.9..1.1,
    ) {
        let texture = Texture::new(seed);
        let before = pyramid(&texture.picture([x, y], [0.0; 2], 1.0));
        let after = pyramid(&texture.picture([x, y], [shift_x, shift_y], scale));
        let half_width = width / 2.0;
        let half_height = height / 2.0;
        let area = corners([x - half_width, y - half_height, x + half_width, y + half_height]);
        let followed = BoxFlow::new(6).follow(&before, &after, area, [0.0; 2]);
        prop_assert_eq!(followed.points, 36);
        prop_assert!(followed.kept >= 24, "{:?}", followed);
        let motion = followed.motion.unwrap();
        prop_assert!((motion.shift[0] - shift_x).abs() < 0.2, "{:?}", motion);
        prop_assert!((motion.shift[1] - shift_y).abs() < 0.2, "{:?}", motion);
        // Half a pixel is more than 1 % of a small box's side.
        let relative = 0.01f64.max(0.5 / f64::min(width, height));
        prop_assert!((motion.scale - scale).abs() < relative, "{:?}", motion);
        prop_assert!(motion.spread < relative, "{:?}", motion);
    }

    #[test]
    fn no_picture_and_no_box_breaks_the_flow(
        width in 1usize..50,
        height in 1usize..50,
        bytes in prop::collection::vec(any::<u8>(), 2500),
        sides in prop::array::uniform4(prop_oneof![
            8 => -60.0..60.0,
            1 => Just(f64::NAN),
            1 => Just(f64::INFINITY),
            1 => Just(-1e300),
        ]),
        guess in prop_oneof![4 => -50.0..50.0, 1 => Just(f64::NAN), 1 => Just(1e300)],
        grid in 0usize..20,
    ) {
        let mut flow = BoxFlow::new(grid);
        let before = filled(width, height, &bytes[..width * height]);
        let after = filled(width, height, &bytes[bytes.len() - width * height..]);
        let followed = flow.follow(&before, &after, corners(sides), [guess, -guess]);
        prop_assert!(followed.kept <= followed.points);
        if let Some(motion) = followed.motion {
            prop_assert!(motion.scale > 0.0 && motion.scale.is_finite());
            prop_assert!(motion.shift[0].is_finite() && motion.shift[1].is_finite());
        }
    }
}

#[test]
fn a_hidden_box_is_not_followed() {
    let texture = Texture::new(5);
    let before = texture.picture([0.0; 2], [0.0; 2], 1.0);
    let other = Texture::new(6).picture([0.0; 2], [0.0; 2], 1.0);
    let area = corners([100.0, 60.0, 160.0, 110.0]);
    let mut flow = BoxFlow::new(6);
    let seen = flow.follow(&pyramid(&before), &pyramid(&before), area, [0.0; 2]);
    assert_eq!((seen.points, seen.kept), (36, 36));
    let motion = seen.motion.unwrap();
    assert_eq!((motion.shift, motion.scale), ([0.0; 2], 1.0));
    // Another texture replaces the box.
    let hidden = flow.follow(&pyramid(&before), &pyramid(&other), area, [0.0; 2]);
    assert!(hidden.agreement() < 0.3, "{hidden:?}");
    // Another texture replaces half of the box.
    let mut half = before.clone();
    for y in 0..HEIGHT {
        let row = y * WIDTH + 130..(y + 1) * WIDTH;
        half[row.clone()].copy_from_slice(&other[row]);
    }
    let half = flow.follow(&pyramid(&before), &pyramid(&half), area, [0.0; 2]);
    assert!((0.2..0.8).contains(&half.agreement()), "{half:?}");
    let wall = pyramid(&vec![90; WIDTH * HEIGHT]);
    let lost = flow.follow(&wall, &wall, area, [0.0; 2]);
    assert_eq!((lost.points, lost.kept, lost.motion), (36, 0, None));
}

#[test]
fn a_guess_finds_boxes_that_moved_too_far_otherwise() {
    let texture = Texture::new(11);
    let middle = [160.0, 90.0];
    let shift = [60.0, -20.0];
    let before = pyramid(&texture.picture(middle, [0.0; 2], 1.0));
    let after = pyramid(&texture.picture(middle, shift, 1.0));
    let area = corners([130.0, 70.0, 190.0, 110.0]);
    let mut flow = BoxFlow::new(6);
    let off = |[x, y]: [f64; 2]| (x - shift[0]).abs() + (y - shift[1]).abs();
    let found = |followed: Followed| followed.motion.is_some_and(|m| off(m.shift) < 0.2);
    assert!(!found(flow.follow(&before, &after, area, [0.0; 2])));
    let followed = flow.follow(&before, &after, area, [56.0, -17.0]);
    assert!(found(followed), "{followed:?}");
    assert!(followed.agreement() > 0.9, "{followed:?}");
}
