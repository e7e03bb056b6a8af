//! Drawing what stands beside the road: posts, rails, signs, lamps, bridges.

use super::brush::{Brush, Side, Solid};
use super::buildings;
use super::plants::{self, WOOD};
use super::random::Random;
use super::road::View;
use super::scenery::{Item, Placed};
use super::space::{Color, NEAR, Pixel, Placement, Point, point, scale_color};

const STEEL: Color = [0.58, 0.60, 0.62];

/// Draws an item.
pub(super) fn paint(
    brush: &mut Brush,
    view: &View,
    placed: &Placed,
    lamps: &mut Vec<(Point, f32)>,
) {
    let (origin, heading) = view.place(placed.along, placed.across);
    let placement = Placement::new(origin, heading);
    let mut random = Random::new(&[placed.seed, 7]);
    let side = placed.across.signum();
    match placed.item {
        Item::Tree => plants::tree(brush, &placement, &mut random),
        Item::Conifer => plants::conifer(brush, &placement, &mut random),
        Item::Bush => plants::bush(brush, &placement, &mut random),
        Item::Post => {
            brush.limbs(
                &placement,
                &[(point(0.0, 0.0, 0.0), 0.06, point(0.0, 0.9, 0.0), 0.06)],
                [0.9, 0.9, 0.9],
            );
            brush.limbs(
                &placement,
                &[(point(0.0, 0.66, 0.0), 0.065, point(0.0, 0.78, 0.0), 0.065)],
                [0.1, 0.1, 0.1],
            );
        }
        Item::Pole => {
            brush.limbs(
                &placement,
                &[
                    (point(0.0, 0.0, 0.0), 0.14, point(0.0, 8.0, 0.0), 0.10),
                    (point(-1.0, 7.4, 0.0), 0.07, point(1.0, 7.4, 0.0), 0.07),
                ],
                WOOD,
            );
        }
        Item::Lamp => {
            let (height, arm) = if side * placed.across < 2.0 {
                (10.0, 2.2)
            } else {
                (7.0, 1.8)
            };
            let tip = point(-side * arm, height + 0.2, 0.0);
            brush.limbs(
                &placement,
                &[
                    (point(0.0, 0.0, 0.0), 0.09, point(0.0, height, 0.0), 0.06),
                    (point(0.0, height, 0.0), 0.05, tip, 0.05),
                ],
                [0.36, 0.38, 0.40],
            );
            let head = point(-side * (arm + 0.25), height + 0.15, 0.0);
            brush.limbs(&placement, &[(tip, 0.08, head, 0.10)], [0.75, 0.75, 0.72]);
            if brush.air.lamps_lit {
                lamps.push((placement.place(head), 1.0));
            }
        }
        Item::Sign => sign(brush, &placement, &mut random),
        Item::House => buildings::house(brush, &placement, -side, &mut random),
        Item::Building => buildings::building(brush, &placement, side, &mut random),
        Item::Bin => {
            let color = random.pick([
                [0.20, 0.30, 0.22],
                [0.16, 0.17, 0.19],
                [0.42, 0.36, 0.20],
                [0.24, 0.30, 0.42],
            ]);
            let bin = Solid::cuboid(
                0,
                color,
                [-0.3, 0.3, -0.3, 0.3],
                0.0,
                random.range(0.8, 1.2),
            )
            .with(
                Side::Back,
                scale_color(color, 0.6),
                &[[0.0, 0.85, 1.0, 1.0]],
            );
            brush.solids(&placement, &[bin], false);
        }
        Item::Bale => {
            let color = [0.72, 0.60, 0.34];
            brush.shadow(&placement, (0.9, 0.7), 1.2);
            brush.solids(
                &placement,
                &[Solid::new(
                    0,
                    color,
                    (0.0, [-0.9, 0.9, -0.7, 0.7]),
                    (1.3, [-0.8, 0.8, -0.5, 0.5]),
                )],
                false,
            );
        }
        Item::Rail(length) => rail(brush, view, placed, length),
        Item::Board => {
            brush.limbs(
                &placement,
                &[
                    (point(-1.8, 0.0, 0.0), 0.1, point(-1.8, 5.0, 0.0), 0.1),
                    (point(1.8, 0.0, 0.0), 0.1, point(1.8, 5.0, 0.0), 0.1),
                ],
                STEEL,
            );
            let color = random.pick([[0.10, 0.34, 0.24], [0.10, 0.24, 0.56]]);
            let board = Solid::cuboid(0, color, [-2.6, 2.6, -0.1, 0.1], 3.2, 6.2).with(
                Side::Back,
                [0.85, 0.87, 0.85],
                &[
                    [0.08, 0.62, 0.7, 0.76],
                    [0.08, 0.38, 0.55, 0.50],
                    [0.08, 0.14, 0.62, 0.26],
                    [0.8, 0.2, 0.9, 0.75],
                ],
            );
            brush.solids(&placement, &[board], false);
        }
        Item::Bridge => {
            let concrete = [0.58, 0.57, 0.55];
            let deck = Solid::cuboid(1, concrete, [-40.0, 40.0, -4.0, 4.0], 5.6, 7.4).with(
                Side::Back,
                [0.40, 0.40, 0.40],
                &[[0.0, 0.0, 1.0, 0.25], [0.0, 0.9, 1.0, 1.0]],
            );
            let pier = |x: f32| {
                Solid::cuboid(
                    0,
                    scale_color(concrete, 0.85),
                    [x - 0.8, x + 0.8, -3.0, 3.0],
                    0.0,
                    5.6,
                )
            };
            brush.solids(&placement, &[pier(-18.6), pier(18.6), deck], false);
        }
    }
}

fn sign(brush: &mut Brush, placement: &Placement, random: &mut Random) {
    brush.limbs(
        placement,
        &[(point(0.0, 0.0, 0.0), 0.04, point(0.0, 2.6, 0.0), 0.04)],
        STEEL,
    );
    let center = placement.place(point(0.0, 2.4, -0.06));
    if center.z < NEAR + 0.5 {
        return;
    }
    let (middle, radius) = (
        brush.camera.project(center),
        0.38 * brush.camera.scale(center.z),
    );
    let (corners, rim, face) = random.pick([
        (12, [0.75, 0.10, 0.10], [0.92, 0.92, 0.90]),
        (3, [0.75, 0.10, 0.10], [0.92, 0.92, 0.90]),
        (4, [0.90, 0.90, 0.90], [0.12, 0.28, 0.60]),
        (8, [0.92, 0.92, 0.92], [0.72, 0.08, 0.08]),
    ]);
    let outline = |share: f32| -> Vec<Pixel> {
        (0..corners)
            .map(|index| {
                let start = if corners == 4 {
                    0.785
                } else {
                    -std::f32::consts::FRAC_PI_2
                };
                let angle = start + std::f32::consts::TAU * index as f32 / corners as f32;
                (
                    middle.0 + radius * share * angle.cos(),
                    middle.1 + radius * share * angle.sin(),
                )
            })
            .collect()
    };
    let facing = point(0.0, 0.2, -0.98);
    let (rim, face) = (
        brush.air.shade(rim, facing, center),
        brush.air.shade(face, facing, center),
    );
    brush.canvas.solid([outline(1.0).as_slice()], rim);
    brush.canvas.overlay(&outline(0.76), face, 1.0);
}

fn rail(brush: &mut Brush, view: &View, placed: &Placed, length: f32) {
    let (from, to) = (placed.along, placed.along + length);
    let mut pixels = Vec::with_capacity(6);
    let foot = Placement::new(view.place(from, placed.across).0, 0.0);
    if foot.origin.z < 90.0 {
        brush.limbs(
            &foot,
            &[(point(0.0, 0.0, 0.0), 0.06, point(0.0, 0.6, 0.0), 0.06)],
            scale_color(STEEL, 0.7),
        );
    }
    for (low, high, tone) in [(0.42, 0.74, 1.0), (0.55, 0.61, 0.7)] {
        let corners = [
            view.lift(from, placed.across, low),
            view.lift(to, placed.across, low),
            view.lift(to, placed.across, high),
            view.lift(from, placed.across, high),
        ];
        let middle = corners[0].lerp(corners[2], 0.5);
        brush.camera.project_polygon(&corners, &mut pixels);
        let facing = point(-placed.across.signum() * 0.8, 0.1, -0.6);
        let color = brush.air.shade(scale_color(STEEL, tone), facing, middle);
        brush.canvas.solid([pixels.as_slice()], color);
        if foot.origin.z > 60.0 {
            break;
        }
    }
}
