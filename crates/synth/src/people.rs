//! Pedestrians, riders, and the bicycles under them, built from limbs.

use super::brush::Brush;
use super::random::Random;
use super::space::{Color, Placement, point};

/// Build and clothing of a person.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clothes {
    /// Body height over 1.75 m.
    scale: f32,
    coat: Color,
    trousers: Color,
    skin: Color,
    /// Hair, or a helmet.
    hair: Color,
    helmet: Color,
    bag: Option<Color>,
    phase: f32,
}

impl Clothes {
    pub(super) fn draw(random: &mut Random) -> Self {
        let coat = random.pick([
            [0.70, 0.14, 0.14],
            [0.16, 0.28, 0.56],
            [0.14, 0.14, 0.16],
            [0.85, 0.84, 0.80],
            [0.84, 0.66, 0.16],
            [0.22, 0.44, 0.30],
            [0.46, 0.34, 0.24],
            [0.48, 0.48, 0.52],
            [0.58, 0.24, 0.46],
        ]);
        let trousers = random.pick([
            [0.12, 0.16, 0.28],
            [0.10, 0.10, 0.11],
            [0.30, 0.28, 0.26],
            [0.50, 0.46, 0.38],
        ]);
        let skin = random.pick([
            [0.86, 0.68, 0.56],
            [0.70, 0.50, 0.38],
            [0.45, 0.30, 0.22],
            [0.90, 0.74, 0.64],
        ]);
        let hair = random.pick([
            [0.12, 0.09, 0.07],
            [0.36, 0.24, 0.14],
            [0.65, 0.55, 0.35],
            [0.6, 0.6, 0.6],
        ]);
        let helmet = random.pick([
            [0.9, 0.9, 0.9],
            [0.1, 0.1, 0.12],
            [0.8, 0.2, 0.15],
            [0.9, 0.7, 0.1],
        ]);
        Self {
            scale: if random.chance(0.15) {
                random.range(0.66, 0.82)
            } else {
                random.range(0.92, 1.08)
            },
            coat,
            trousers,
            skin,
            hair,
            helmet,
            bag: random
                .chance(0.35)
                .then(|| random.pick([[0.2, 0.2, 0.22], [0.55, 0.2, 0.15], [0.2, 0.35, 0.3]])),
            phase: random.range(0.0, 6.0),
        }
    }
}

/// What a person is doing; the number is the way travelled, metres.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stance {
    Walking(f32),
    Cycling(f32),
    Sitting,
}

/// Draws a person.
pub(super) fn paint(brush: &mut Brush, placement: &Placement, stance: Stance, clothes: &Clothes) {
    match stance {
        Stance::Walking(travelled) => walking(brush, placement, travelled, clothes),
        Stance::Cycling(travelled) => seated(brush, placement, 0.92, travelled * 1.6, clothes),
        Stance::Sitting => seated(brush, placement, 0.86, 0.9, clothes),
    }
}

fn walking(brush: &mut Brush, placement: &Placement, travelled: f32, clothes: &Clothes) {
    let k = clothes.scale;
    let swing =
        (travelled * 4.3 / k + clothes.phase).sin() * if travelled > 0.01 { 0.5 } else { 0.12 };
    let mut legs = Vec::with_capacity(4);
    for (side, angle) in [(-1.0, swing), (1.0, -swing)] {
        let hip = point(side * 0.10 * k, 0.90 * k, 0.0);
        let knee = point(side * 0.10 * k, 0.48 * k, 0.42 * k * (angle + 0.10).sin());
        let bend = if angle < 0.0 {
            angle * 1.6
        } else {
            angle * 0.9
        };
        let foot = point(side * 0.10 * k, 0.06 * k, knee.z + 0.42 * k * bend.sin());
        legs.push((hip, 0.095 * k, knee, 0.075 * k));
        legs.push((knee, 0.075 * k, foot, 0.055 * k));
        let toe = point(foot.x, 0.04 * k, foot.z + 0.13 * k);
        legs.push((foot, 0.05 * k, toe, 0.04 * k));
    }
    brush.limbs(placement, &legs, clothes.trousers);
    if let Some(bag) = clothes.bag {
        let (top, bottom) = (
            point(0.0, 1.30 * k, -0.16 * k),
            point(0.0, 1.02 * k, -0.18 * k),
        );
        brush.limbs(placement, &[(top, 0.14 * k, bottom, 0.15 * k)], bag);
    }
    let mut upper = vec![
        (
            point(-0.09 * k, 1.36 * k, 0.0),
            0.13 * k,
            point(-0.07 * k, 0.93 * k, 0.0),
            0.12 * k,
        ),
        (
            point(0.09 * k, 1.36 * k, 0.0),
            0.13 * k,
            point(0.07 * k, 0.93 * k, 0.0),
            0.12 * k,
        ),
    ];
    for (side, angle) in [(-1.0, -swing), (1.0, swing)] {
        let shoulder = point(side * 0.21 * k, 1.38 * k, 0.0);
        let elbow = point(side * 0.25 * k, 1.10 * k, 0.26 * k * angle.sin());
        let hand = point(
            side * 0.24 * k,
            0.86 * k,
            elbow.z + 0.26 * k * (angle + 0.25).sin(),
        );
        upper.push((shoulder, 0.065 * k, elbow, 0.055 * k));
        upper.push((elbow, 0.055 * k, hand, 0.045 * k));
    }
    brush.limbs(placement, &upper, clothes.coat);
    head(
        brush,
        placement,
        point(0.0, 1.62 * k, 0.02),
        k,
        clothes.skin,
        clothes.hair,
    );
}

fn head(
    brush: &mut Brush,
    placement: &Placement,
    at: super::space::Point,
    k: f32,
    skin: Color,
    cover: Color,
) {
    let chin = point(at.x, at.y - 0.05 * k, at.z + 0.02);
    let neck = point(at.x, at.y - 0.20 * k, at.z - 0.02);
    brush.limbs(
        placement,
        &[
            (at, 0.105 * k, chin, 0.09 * k),
            (chin, 0.055 * k, neck, 0.06 * k),
        ],
        skin,
    );
    let crown = point(at.x, at.y + 0.055 * k, at.z - 0.03 * k);
    let back = point(at.x, at.y + 0.01 * k, at.z - 0.05 * k);
    brush.limbs(placement, &[(crown, 0.105 * k, back, 0.10 * k)], cover);
}

fn seated(brush: &mut Brush, placement: &Placement, seat: f32, crank: f32, clothes: &Clothes) {
    let k = clothes.scale.max(0.9);
    let mut legs = Vec::with_capacity(4);
    for (side, turn) in [(-1.0, crank), (1.0, crank + std::f32::consts::PI)] {
        let hip = point(side * 0.09, seat, -0.22);
        let foot = point(
            side * 0.13,
            0.30 + 0.16 * turn.cos(),
            0.08 + 0.16 * turn.sin(),
        );
        let knee = point(
            side * 0.15,
            (hip.y + foot.y) / 2.0 + 0.10,
            (hip.z + foot.z) / 2.0 + 0.22,
        );
        legs.push((hip, 0.10 * k, knee, 0.075 * k));
        legs.push((knee, 0.075 * k, foot, 0.055 * k));
    }
    brush.limbs(placement, &legs, clothes.trousers);
    let shoulder = seat + 0.50 * k;
    let lean = 0.10;
    let mut upper = vec![
        (
            point(-0.08, shoulder, lean),
            0.14 * k,
            point(-0.06, seat + 0.04, -0.22),
            0.13 * k,
        ),
        (
            point(0.08, shoulder, lean),
            0.14 * k,
            point(0.06, seat + 0.04, -0.22),
            0.13 * k,
        ),
    ];
    for side in [-1.0, 1.0] {
        let top = point(side * 0.20, shoulder - 0.02, lean);
        let elbow = point(side * 0.28, seat + 0.27, 0.26);
        let hand = point(side * 0.27, seat + 0.14, 0.48);
        upper.push((top, 0.065 * k, elbow, 0.055 * k));
        upper.push((elbow, 0.055 * k, hand, 0.045 * k));
    }
    brush.limbs(placement, &upper, clothes.coat);
    let at = point(0.0, shoulder + 0.25 * k, lean + 0.07);
    head(brush, placement, at, k * 1.1, clothes.skin, clothes.helmet);
}

/// Draws a bicycle; its wheels turn with the way travelled.
pub(super) fn bicycle(
    brush: &mut Brush,
    placement: &Placement,
    color: Color,
    radius: f32,
    travelled: f32,
) {
    let fine = brush.camera.scale(placement.origin.z) * radius > 7.0;
    let count = if fine { 14 } else { 8 };
    let mut tyres = Vec::with_capacity(2 * count);
    let mut spokes = Vec::new();
    for axle in [-0.52_f32, 0.52] {
        let rim = |index: usize| {
            let angle = std::f32::consts::TAU * index as f32 / count as f32;
            point(
                0.0,
                radius + radius * angle.cos(),
                axle + radius * angle.sin(),
            )
        };
        for index in 0..count {
            tyres.push((rim(index), 0.028, rim(index + 1), 0.028));
        }
        if fine {
            for index in 0..3 {
                let angle = travelled / radius + index as f32 * 2.1;
                let end = point(0.0, radius + 0.3 * angle.cos(), axle + 0.3 * angle.sin());
                spokes.push((point(0.0, radius, axle), 0.008, end, 0.008));
            }
        }
    }
    brush.limbs(placement, &tyres, [0.10, 0.10, 0.11]);
    if fine {
        brush.limbs(placement, &spokes, [0.55, 0.56, 0.58]);
    }
    let (rear, front) = (point(0.0, radius, -0.52), point(0.0, radius, 0.52));
    let (crank, seat, head) = (
        point(0.0, 0.30, -0.06),
        point(0.0, 0.86, -0.24),
        point(0.0, 0.88, 0.38),
    );
    let r = 0.024;
    brush.limbs(
        placement,
        &[
            (rear, r, crank, r),
            (rear, r, seat, r),
            (crank, r, seat, r),
            (crank, r, head, r),
            (seat, r, head, r),
            (head, r, front, r),
        ],
        color,
    );
    brush.limbs(
        placement,
        &[
            (
                point(-0.26, 1.02, 0.38),
                0.022,
                point(0.26, 1.02, 0.38),
                0.022,
            ),
            (head, 0.022, point(0.0, 1.02, 0.38), 0.022),
            (point(0.0, 0.92, -0.34), 0.05, point(0.0, 0.92, -0.14), 0.04),
        ],
        [0.10, 0.10, 0.11],
    );
}
