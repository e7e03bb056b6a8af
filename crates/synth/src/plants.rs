//! Trees and bushes.

use super::brush::Brush;
use super::random::Random;
use super::space::{Color, NEAR, Pixel, Placement, Point, point, scale_color};

const GREENS: [Color; 5] = [
    [0.20, 0.34, 0.14],
    [0.26, 0.40, 0.16],
    [0.32, 0.42, 0.18],
    [0.18, 0.30, 0.17],
    [0.44, 0.40, 0.16],
];

/// Bark and poles.
pub(super) const WOOD: Color = [0.30, 0.23, 0.17];

/// Draws a bush.
pub(super) fn bush(brush: &mut Brush, placement: &Placement, random: &mut Random) {
    let (color, r) = (random.pick(GREENS), random.range(0.7, 1.5));
    let center = placement.place(point(0.0, r * 0.6, 0.0));
    blob(brush, center, (r, r * 0.7), color, random);
}

/// An upright blot of foliage, turned to the camera.
fn blob(brush: &mut Brush, center: Point, radii: (f32, f32), color: Color, random: &mut Random) {
    if center.z < NEAR + 1.0 {
        return;
    }
    let scale = brush.camera.scale(center.z);
    let middle = brush.camera.project(center);
    let count = if radii.0 * scale > 14.0 { 11 } else { 7 };
    let turn = random.unit();
    let ring: Vec<f32> = (0..count).map(|_| random.range(0.82, 1.08)).collect();
    let outline = |share: f32, shift: Pixel| -> Vec<Pixel> {
        ring.iter()
            .enumerate()
            .map(|(index, wobble)| {
                let angle = std::f32::consts::TAU * (index as f32 + turn) / count as f32;
                (
                    middle.0 + shift.0 + angle.cos() * radii.0 * scale * wobble * share,
                    middle.1 + shift.1 + angle.sin() * radii.1 * scale * wobble * share,
                )
            })
            .collect()
    };
    let dark = brush
        .air
        .shade(scale_color(color, 0.8), point(0.0, -0.2, -0.9), center);
    brush
        .canvas
        .solid([outline(1.0, (0.0, 0.0)).as_slice()], dark);
    if radii.0 * scale > 4.0 {
        let sun = brush.air.sun_direction;
        let light = brush
            .air
            .shade(color, point(sun.x * 0.5, 0.8, -0.4).normalised(), center);
        let shift = (sun.x * 0.18 * radii.0 * scale, -0.20 * radii.1 * scale);
        brush.canvas.overlay(&outline(0.72, shift), light, 1.0);
    }
}

/// Draws a broad-leaved tree.
pub(super) fn tree(brush: &mut Brush, placement: &Placement, random: &mut Random) {
    let (height, color) = (random.range(5.0, 10.0), random.pick(GREENS));
    let crown = height * random.range(0.26, 0.36);
    brush.shadow(placement, (crown * 0.6, crown * 0.6), height * 0.5);
    let trunk = [(
        point(0.0, 0.0, 0.0),
        0.16,
        point(0.0, height * 0.6, 0.0),
        0.12,
    )];
    brush.limbs(placement, &trunk, WOOD);
    for (x, y, share) in [(-0.45, 0.60, 0.75), (0.45, 0.64, 0.75), (0.0, 0.76, 1.0)] {
        let center = placement.place(point(x * crown, height * y, 0.0));
        blob(
            brush,
            center,
            (crown * share, crown * share * 0.85),
            color,
            random,
        );
    }
}

/// Draws a conifer.
pub(super) fn conifer(brush: &mut Brush, placement: &Placement, random: &mut Random) {
    let height = random.range(6.0, 12.0);
    let color = scale_color([0.13, 0.25, 0.16], random.range(0.85, 1.2));
    brush.limbs(
        placement,
        &[(point(0.0, 0.0, 0.0), 0.15, point(0.0, 1.2, 0.0), 0.15)],
        WOOD,
    );
    let center = placement.origin;
    if center.z < NEAR + 1.0 {
        return;
    }
    for (low, high, half) in [(0.10, 0.55, 0.22), (0.32, 0.78, 0.17), (0.55, 1.0, 0.12)] {
        let corner = |x: f32, y: f32| {
            brush
                .camera
                .project(placement.origin.plus(point(x * height, y * height, 0.0)))
        };
        let (left, right, top) = (corner(-half, low), corner(half, low), corner(0.0, high));
        let middle = corner(0.0, low);
        let (dark, light) = (
            brush
                .air
                .shade(scale_color(color, 0.85), point(0.5, 0.2, -0.8), center),
            brush.air.shade(color, point(-0.4, 0.6, -0.7), center),
        );
        brush.canvas.solid([[left, right, top].as_slice()], dark);
        brush.canvas.overlay(&[left, middle, top], light, 1.0);
    }
}
