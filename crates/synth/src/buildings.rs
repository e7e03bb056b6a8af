//! Houses beside the road and rows of houses in a town.

use super::brush::{Brush, Finish, Side, Solid};
use super::random::Random;
use super::space::{Placement, scale_color};

/// Draws a house whose front looks to `inward` (-1 left, 1 right).
pub(super) fn house(brush: &mut Brush, placement: &Placement, inward: f32, random: &mut Random) {
    let wall = random.pick([
        [0.84, 0.78, 0.68],
        [0.88, 0.87, 0.84],
        [0.66, 0.46, 0.38],
        [0.74, 0.70, 0.56],
    ]);
    let roof = random.pick([[0.48, 0.22, 0.17], [0.32, 0.30, 0.31], [0.42, 0.30, 0.22]]);
    let (half, deep, high) = (
        random.range(4.0, 6.0),
        random.range(4.0, 5.0),
        random.range(3.0, 5.0),
    );
    let face = if inward < 0.0 {
        Side::Left
    } else {
        Side::Right
    };
    let finish = if random.chance(0.6) {
        Finish::Lamp
    } else {
        Finish::Paint
    };
    let panes = [
        [0.12, 0.35, 0.26, 0.72],
        [0.42, 0.35, 0.56, 0.72],
        [0.74, 0.35, 0.88, 0.72],
    ];
    let glass = if brush.air.lamps_lit {
        [0.95, 0.80, 0.48]
    } else {
        [0.20, 0.24, 0.28]
    };
    let body = Solid::cuboid(0, wall, [-deep, deep, -half, half], 0.0, high)
        .shining(Side::Back, glass, finish, &panes)
        .shining(face, glass, finish, &panes);
    let top = Solid::new(
        1,
        roof,
        (high, [-deep - 0.4, deep + 0.4, -half - 0.4, half + 0.4]),
        (high + 2.6, [-0.2, 0.2, -half * 0.8, half * 0.8]),
    );
    brush.solids(placement, &[body, top], false);
}

/// Draws a town house on the given side of the road.
pub(super) fn building(brush: &mut Brush, placement: &Placement, side: f32, random: &mut Random) {
    let wall = random.pick([
        [0.62, 0.44, 0.37],
        [0.72, 0.67, 0.58],
        [0.56, 0.57, 0.60],
        [0.80, 0.76, 0.70],
        [0.50, 0.40, 0.36],
        [0.66, 0.62, 0.48],
    ]);
    let floors = 2 + random.below(4);
    let high = 3.6 + floors as f32 * 3.1;
    let (near, far) = if side > 0.0 {
        (0.0, 12.0)
    } else {
        (-12.0, 0.0)
    };
    let face = if side > 0.0 { Side::Left } else { Side::Right };
    let mut body = Solid::cuboid(0, wall, [near, far, -5.9, 5.9], 0.0, high);
    if placement.origin.z < 150.0 {
        let (mut dark, mut lit) = (Vec::new(), Vec::new());
        let first = 3.6 / high;
        let step = (1.0 - first) / floors as f32;
        for floor in 0..floors {
            let low = first + (floor as f32 + 0.25) * step;
            for window in 0..4 {
                let left = 0.08 + window as f32 * 0.23;
                let pane = [left, low, left + 0.14, low + 0.52 * step];
                if random.chance(0.4) {
                    lit.push(pane);
                } else {
                    dark.push(pane);
                }
            }
        }
        let (glass, shine) = ([0.17, 0.20, 0.25], [0.92, 0.76, 0.46]);
        let open = random.chance(0.6);
        let shop = random.pick([[0.20, 0.26, 0.30], [0.28, 0.22, 0.20], [0.16, 0.18, 0.20]]);
        let sign = random.pick([
            [0.62, 0.16, 0.14],
            [0.14, 0.34, 0.44],
            [0.74, 0.62, 0.22],
            [0.22, 0.40, 0.26],
        ]);
        let gone = scale_color(wall, 0.82);
        body = body
            .with(face, gone, &[[0.0, 0.97, 1.0, 1.0]])
            .with(face, glass, &dark)
            .with(Side::Back, glass, &dark)
            .shining(
                face,
                if brush.air.lamps_lit { shine } else { glass },
                Finish::Lamp,
                &lit,
            )
            .with(face, sign, &[[0.06, first * 0.80, 0.94, first * 0.96]])
            .shining(
                face,
                if open && brush.air.lamps_lit {
                    [0.85, 0.78, 0.60]
                } else {
                    shop
                },
                if open { Finish::Lamp } else { Finish::Paint },
                &[
                    [0.06, first * 0.12, 0.52, first * 0.76],
                    [0.68, first * 0.12, 0.94, first * 0.76],
                ],
            )
            .with(
                face,
                scale_color(shop, 0.7),
                &[[0.56, 0.0, 0.65, first * 0.72]],
            );
        if !brush.air.lamps_lit {
            // By day all panes look alike.
            body = body.with(face, glass, &lit).with(Side::Back, glass, &lit);
        }
    }
    brush.solids(placement, &[body], false);
}
