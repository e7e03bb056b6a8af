//! What stands beside the road: trees, posts, rails, signs, lamps, houses, bridges.

use super::brush::{Brush, Finish, Side, Solid};
use super::random::{Random, mix};
use super::road::{HORIZON, Road, Setting, View};
use super::space::{Color, NEAR, Pixel, Placement, Point, point, scale_color};

/// One thing beside the road.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Item {
    Tree,
    Conifer,
    Bush,
    Post,
    Pole,
    Lamp,
    Sign,
    House,
    Building,
    Bin,
    Bale,
    /// A piece of guard rail, its length in metres.
    Rail(f32),
    /// A board over or beside a highway.
    Board,
    Bridge,
}

/// An item at its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub item: Item,
    pub along: f32,
    pub across: f32,
    seed: u64,
}

/// Everything beside `road` between `from` and `to`.
pub(super) fn items(road: &Road, seed: u64, from: f32, to: f32) -> Vec<Placed> {
    let mut found = Vec::with_capacity(160);
    let mut every =
        |step: f32,
         purpose: u64,
         place: &mut dyn FnMut(f32, &mut Random) -> Option<(Item, f32)>| {
            let first = (from / step).floor() as i64;
            let last = (to / step).ceil() as i64;
            for cell in first..=last {
                let seed = mix(&[seed, purpose, cell as u64]);
                let mut random = Random::new(&[seed]);
                let along = cell as f32 * step;
                if let Some((item, across)) = place(along, &mut random) {
                    found.push(Placed {
                        item,
                        along,
                        across,
                        seed,
                    });
                }
            }
        };
    let clear = |along: f32, margin: f32| !road.near_junction(along, margin);
    match road.setting {
        Setting::Country => {
            let wooded = |along: f32| mix(&[seed, 40, (along / 90.0).floor() as i64 as u64]) % 3;
            for side in [-1.0, 1.0] {
                let purpose = if side > 0.0 { 100 } else { 200 };
                for row in 0..2 {
                    every(8.0, purpose + row, &mut |along, random| {
                        let share = [0.12, 0.45, 0.85][wooded(along) as usize];
                        let item = random.pick([Item::Tree, Item::Tree, Item::Conifer, Item::Bush]);
                        let across = random.range(8.0, 16.0) + row as f32 * 14.0;
                        (random.chance(share) && clear(along, 11.0))
                            .then_some((item, side * across))
                    });
                }
                every(25.0, purpose + 3, &mut |along, _| {
                    (!road.rails && clear(along, 6.0)).then_some((Item::Post, side * 5.1))
                });
                every(6.0, purpose + 4, &mut |along, _| {
                    (road.rails && clear(along, 13.0)).then_some((Item::Rail(6.0), side * 6.0))
                });
                every(70.0, purpose + 5, &mut |along, random| {
                    let item = random.pick([Item::House, Item::Bale, Item::Sign]);
                    let across = match item {
                        Item::House => random.range(20.0, 34.0),
                        Item::Bale => random.range(12.0, 26.0),
                        _ => 6.0,
                    };
                    (random.chance(0.5) && clear(along, 14.0)).then_some((item, side * across))
                });
            }
            every(45.0, 300, &mut |along, _| {
                clear(along, 6.0).then_some((Item::Pole, -11.5))
            });
        }
        Setting::Highway => {
            for side in [-1.0, 1.0] {
                let purpose = if side > 0.0 { 100 } else { 200 };
                every(8.0, purpose, &mut |_, random| {
                    let item = random.pick([Item::Tree, Item::Conifer, Item::Bush, Item::Tree]);
                    random
                        .chance(0.45)
                        .then_some((item, side * random.range(24.0, 46.0)))
                });
                every(6.0, purpose + 1, &mut |_, _| {
                    Some((Item::Rail(6.0), side * 16.4))
                });
                every(50.0, purpose + 2, &mut |_, _| {
                    Some((Item::Post, side * 15.8))
                });
            }
            every(6.0, 300, &mut |_, _| Some((Item::Rail(6.0), 0.0)));
            every(240.0, 301, &mut |_, random| {
                let item = random.pick([Item::Bridge, Item::Board, Item::Board]);
                random
                    .chance(0.7)
                    .then_some((item, if item == Item::Bridge { 0.0 } else { 19.0 }))
            });
            every(40.0, 302, &mut |_, _| Some((Item::Lamp, 0.4)));
        }
        Setting::Town => {
            for side in [-1.0, 1.0] {
                let purpose = if side > 0.0 { 100 } else { 200 };
                every(12.0, purpose, &mut |along, random| {
                    (clear(along, 10.0) && random.chance(0.92))
                        .then_some((Item::Building, side * 10.2))
                });
                every(27.0, purpose + 1, &mut |along, _| {
                    clear(along + side * 6.0, 6.0).then_some((Item::Lamp, side * 6.5))
                });
                every(11.0, purpose + 2, &mut |along, random| {
                    (clear(along, 9.0) && random.chance(0.28)).then_some((Item::Tree, side * 6.9))
                });
                every(19.0, purpose + 3, &mut |along, random| {
                    let item = random.pick([Item::Bin, Item::Sign, Item::Bin]);
                    (clear(along, 8.0) && random.chance(0.4)).then_some((item, side * 6.7))
                });
            }
        }
    }
    found
}

/// How far an item is drawn, metres.
pub(super) fn reach(item: Item) -> f32 {
    match item {
        Item::Bush | Item::Bin | Item::Bale => 110.0,
        Item::Post | Item::Sign => 130.0,
        Item::Rail(_) => 170.0,
        _ => HORIZON - 15.0,
    }
}

const GREENS: [Color; 5] = [
    [0.20, 0.34, 0.14],
    [0.26, 0.40, 0.16],
    [0.32, 0.42, 0.18],
    [0.18, 0.30, 0.17],
    [0.44, 0.40, 0.16],
];
const STEEL: Color = [0.58, 0.60, 0.62];
const WOOD: Color = [0.30, 0.23, 0.17];

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
        Item::Tree => tree(brush, &placement, &mut random),
        Item::Conifer => conifer(brush, &placement, &mut random),
        Item::Bush => {
            let (color, r) = (random.pick(GREENS), random.range(0.7, 1.5));
            blob(
                brush,
                placement.place(point(0.0, r * 0.6, 0.0)),
                (r, r * 0.7),
                color,
                &mut random,
            );
        }
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
        Item::House => house(brush, &placement, -side, &mut random),
        Item::Building => building(brush, &placement, side, &mut random),
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

fn tree(brush: &mut Brush, placement: &Placement, random: &mut Random) {
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

fn conifer(brush: &mut Brush, placement: &Placement, random: &mut Random) {
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

fn house(brush: &mut Brush, placement: &Placement, inward: f32, random: &mut Random) {
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

fn building(brush: &mut Brush, placement: &Placement, side: f32, random: &mut Random) {
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
