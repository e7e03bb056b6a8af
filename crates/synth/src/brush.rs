//! Drawing shapes that stand in the scene: solids with flat faces, limbs, wheels, shadows, lamps.

use super::atmosphere::Atmosphere;
use super::canvas::Canvas;
use super::space::{Camera, Color, NEAR, Pixel, Placement, Point, point};

/// A side of a [`Solid`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Back,
    Right,
    Front,
    Left,
    Top,
}

const SIDES: [(Side, [usize; 4]); 5] = [
    (Side::Back, [0, 1, 5, 4]),
    (Side::Right, [1, 2, 6, 5]),
    (Side::Front, [2, 3, 7, 6]),
    (Side::Left, [3, 0, 4, 7]),
    (Side::Top, [4, 5, 6, 7]),
];

/// What a painted patch does in the dark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finish {
    /// Paint: as bright as the light on it.
    Paint,
    /// Shines by itself when lamps are lit.
    Lamp,
    /// As a lamp, and brightens when braking.
    BrakeLamp,
}

/// A patch on a side: the share of the side's width and height it covers, from its lower left corner as
/// seen from outside.
#[derive(Clone, Debug)]
pub(super) struct Decal {
    pub side: Side,
    pub patches: Vec<[f32; 4]>,
    pub color: Color,
    pub finish: Finish,
}

/// A six-sided solid, its bottom never seen. Corners: bottom back left, back right, front right, front
/// left, then the same four at the top.
#[derive(Clone, Debug)]
pub(super) struct Solid {
    pub corners: [Point; 8],
    pub color: Color,
    /// Solids of a lower layer are drawn first; within a layer, the farther one.
    pub layer: u8,
    pub decals: Vec<Decal>,
}

/// Left, right, back and front end of a solid's bottom or top, metres.
pub(super) type Rectangle = [f32; 4];

impl Solid {
    /// A solid between the rectangle `bottom` at height `low` and `top` at height `high`.
    pub(super) fn new(
        layer: u8,
        color: Color,
        (low, bottom): (f32, Rectangle),
        (high, top): (f32, Rectangle),
    ) -> Self {
        let ring = |r: Rectangle, y: f32| {
            [
                point(r[0], y, r[2]),
                point(r[1], y, r[2]),
                point(r[1], y, r[3]),
                point(r[0], y, r[3]),
            ]
        };
        let (below, above) = (ring(bottom, low), ring(top, high));
        Self {
            corners: [
                below[0], below[1], below[2], below[3], above[0], above[1], above[2], above[3],
            ],
            color,
            layer,
            decals: Vec::new(),
        }
    }

    /// An upright box.
    pub(super) fn cuboid(
        layer: u8,
        color: Color,
        rectangle: Rectangle,
        low: f32,
        high: f32,
    ) -> Self {
        Self::new(layer, color, (low, rectangle), (high, rectangle))
    }

    /// With patches painted on a side.
    pub(super) fn with(mut self, side: Side, color: Color, patches: &[[f32; 4]]) -> Self {
        self.decals.push(Decal {
            side,
            patches: patches.to_vec(),
            color,
            finish: Finish::Paint,
        });
        self
    }

    /// With patches that shine.
    pub(super) fn shining(
        mut self,
        side: Side,
        color: Color,
        finish: Finish,
        patches: &[[f32; 4]],
    ) -> Self {
        self.decals.push(Decal {
            side,
            patches: patches.to_vec(),
            color,
            finish,
        });
        self
    }
}

/// Draws into a canvas from a camera under an atmosphere.
pub(super) struct Brush<'a> {
    pub canvas: &'a mut Canvas,
    pub camera: Camera,
    pub air: &'a Atmosphere,
}

impl Brush<'_> {
    /// Draws solids that stand together.
    pub(super) fn solids(&mut self, placement: &Placement, solids: &[Solid], braking: bool) {
        let eye = self.camera.eye();
        let mut order: Vec<(u8, f32, usize)> = solids
            .iter()
            .enumerate()
            .map(|(index, solid)| {
                let middle = solid.corners[0].lerp(solid.corners[6], 0.5);
                let distance = placement.place(middle).minus(eye).length();
                (solid.layer, distance, index)
            })
            .collect();
        order.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        for (_, _, index) in order {
            self.solid(placement, &solids[index], braking);
        }
    }

    fn solid(&mut self, placement: &Placement, solid: &Solid, braking: bool) {
        let corners = solid.corners.map(|corner| placement.place(corner));
        if corners.iter().all(|corner| corner.z < NEAR) {
            return;
        }
        let eye = self.camera.eye();
        let mut pixels = Vec::with_capacity(8);
        for (side, indices) in SIDES {
            let face = indices.map(|index| corners[index]);
            let normal = face[3]
                .minus(face[0])
                .cross(face[1].minus(face[0]))
                .normalised();
            if normal.dot(eye.minus(face[0])) <= 0.0 {
                continue;
            }
            let middle = face[0].lerp(face[2], 0.5);
            self.camera.project_polygon(&face, &mut pixels);
            let color = self.air.shade(solid.color, normal, middle);
            self.canvas.solid([pixels.as_slice()], color);
            // Patches that would be smaller than a pixel only cost time.
            if self.camera.scale(middle.z) < 4.0 {
                continue;
            }
            for decal in solid.decals.iter().filter(|decal| decal.side == side) {
                self.decal(decal, &face, normal, middle, braking);
            }
        }
    }

    fn decal(
        &mut self,
        decal: &Decal,
        face: &[Point; 4],
        normal: Point,
        middle: Point,
        braking: bool,
    ) {
        let mut quads: Vec<Vec<Pixel>> = Vec::with_capacity(decal.patches.len());
        for patch in &decal.patches {
            let at = |u: f32, v: f32| face[0].lerp(face[1], u).lerp(face[3].lerp(face[2], u), v);
            let corners = [
                at(patch[0], patch[1]),
                at(patch[2], patch[1]),
                at(patch[2], patch[3]),
                at(patch[0], patch[3]),
            ];
            let mut pixels = Vec::with_capacity(6);
            self.camera.project_polygon(&corners, &mut pixels);
            quads.push(pixels);
        }
        let lit = match decal.finish {
            Finish::Paint => None,
            Finish::Lamp => self.air.lamps_lit.then_some(1.0),
            Finish::BrakeLamp if braking => Some(1.0),
            Finish::BrakeLamp => self.air.lamps_lit.then_some(0.75),
        };
        let color = match lit {
            Some(strength) => self.air.through_air(
                super::space::scale_color(decal.color, strength),
                middle.z * 0.6,
            ),
            None => self.air.shade(decal.color, normal, middle),
        };
        self.canvas
            .overlays(quads.iter().map(Vec::as_slice), color, 1.0);
    }

    /// Draws tapered limbs of one colour: from a point and radius to a point and radius.
    pub(super) fn limbs(
        &mut self,
        placement: &Placement,
        limbs: &[(Point, f32, Point, f32)],
        color: Color,
    ) {
        let mut polygons: Vec<Vec<Pixel>> = Vec::with_capacity(limbs.len());
        let mut distance = placement.origin;
        for &(from, from_radius, to, to_radius) in limbs {
            let (a, b) = (placement.place(from), placement.place(to));
            if a.z < NEAR || b.z < NEAR {
                continue;
            }
            distance = a.lerp(b, 0.5);
            let (p, q) = (self.camera.project(a), self.camera.project(b));
            let (rp, rq) = (
                (from_radius * self.camera.scale(a.z)).max(0.3),
                (to_radius * self.camera.scale(b.z)).max(0.3),
            );
            let (mut dx, mut dy) = (q.0 - p.0, q.1 - p.1);
            let length = (dx * dx + dy * dy).sqrt();
            if length < 1e-3 {
                (dx, dy) = (0.0, 1.0);
            } else {
                (dx, dy) = (dx / length, dy / length);
            }
            let around = |c: Pixel, r: f32, along: f32, aside: f32| {
                (
                    c.0 + r * (along * dx - aside * dy),
                    c.1 + r * (along * dy + aside * dx),
                )
            };
            polygons.push(vec![
                around(p, rp, 0.0, 1.0),
                around(p, rp, -0.7, 0.7),
                around(p, rp, -1.0, 0.0),
                around(p, rp, -0.7, -0.7),
                around(p, rp, 0.0, -1.0),
                around(q, rq, 0.0, -1.0),
                around(q, rq, 0.7, -0.7),
                around(q, rq, 1.0, 0.0),
                around(q, rq, 0.7, 0.7),
                around(q, rq, 0.0, 1.0),
            ]);
        }
        let color = self.air.shade(color, point(0.0, 0.3, -0.95), distance);
        self.canvas.solid(polygons.iter().map(Vec::as_slice), color);
    }

    /// Draws an upright disc that faces sideways (a wheel): `side` is -1 for the left face of an object.
    pub(super) fn disc(
        &mut self,
        placement: &Placement,
        center: Point,
        radius: f32,
        side: f32,
        color: Color,
    ) {
        let normal = placement.turn(point(side, 0.0, 0.0));
        let middle = placement.place(center);
        if middle.z < NEAR + radius || normal.dot(self.camera.eye().minus(middle)) <= 0.0 {
            return;
        }
        let count = if radius * self.camera.scale(middle.z) > 12.0 {
            14
        } else {
            8
        };
        let polygon: Vec<Pixel> = (0..count)
            .map(|index| {
                let angle = std::f32::consts::TAU * index as f32 / count as f32;
                let rim = point(
                    center.x,
                    center.y + radius * angle.cos(),
                    center.z + radius * angle.sin(),
                );
                self.camera.project(placement.place(rim))
            })
            .collect();
        let color = self.air.shade(color, normal, middle);
        self.canvas.solid([polygon.as_slice()], color);
    }

    /// Darkens the ground under an object of the given half width, half length and height.
    pub(super) fn shadow(&mut self, placement: &Placement, half: (f32, f32), height: f32) {
        let cast = if self.air.sun[0] > 0.15 {
            let sun = self.air.sun_direction;
            let stretch = (height / sun.y.max(0.25)).min(height * 2.2) * 0.8;
            point(-sun.x * stretch, 0.0, -sun.z * stretch)
        } else {
            Point::default()
        };
        let mut corners = Vec::with_capacity(8);
        for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let base = placement.place(point(x * half.0 * 1.06, 0.0, z * half.1 * 1.04));
            corners.push(base);
            if cast != Point::default() {
                corners.push(base.plus(cast));
            }
        }
        if corners.iter().any(|corner| corner.z < NEAR) {
            return;
        }
        let mut pixels: Vec<Pixel> = corners.iter().map(|&c| self.camera.project(c)).collect();
        let hull = convex_hull(&mut pixels);
        let strength = self.air.shadow * (1.0 - self.air.air(placement.origin.z));
        self.canvas.overlay(&hull, [0.0, 0.0, 0.02], strength);
    }
}

/// The convex hull of points (Andrew's monotone chain).
pub(super) fn convex_hull(points: &mut [Pixel]) -> Vec<Pixel> {
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut hull: Vec<Pixel> = Vec::with_capacity(points.len() + 1);
    for pass in 0..2 {
        let start = hull.len();
        let walk: Box<dyn Iterator<Item = &Pixel>> = if pass == 0 {
            Box::new(points.iter())
        } else {
            Box::new(points.iter().rev())
        };
        for &next in walk {
            while hull.len() >= start + 2 {
                let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
                if (b.0 - a.0) * (next.1 - a.1) - (b.1 - a.1) * (next.0 - a.0) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(next);
        }
        hull.pop();
    }
    hull
}
