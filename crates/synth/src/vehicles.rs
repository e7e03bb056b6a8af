//! What the participants look like, and drawing them with their shadows and lamps.

use super::brush::{Brush, Solid};
use super::kind::Kind;
use super::paint::{HEAD, TAIL, TYRE, paintwork};
use super::people::{self, Clothes, Stance};
use super::random::Random;
use super::space::{Color, Placement, Point, point};

/// The looks of one participant.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub(super) solids: Vec<Solid>,
    /// Centres of the wheels' outer faces.
    pub(super) wheels: Vec<Point>,
    pub(super) wheel_radius: f32,
    pub(super) half_width: f32,
    pub(super) half_length: f32,
    pub(super) height: f32,
    /// Height of the lamps, and their distance from the middle (0: a single one).
    pub(super) lamps: (f32, f32),
    /// Colour of a bicycle's frame.
    pub(super) accent: Color,
    pub(super) clothes: Clothes,
}

impl Model {
    pub(super) fn draw(kind: Kind, random: &mut Random) -> Self {
        let mut model = Self {
            solids: Vec::new(),
            wheels: Vec::new(),
            wheel_radius: 0.33,
            half_width: 0.3,
            half_length: 0.3,
            height: kind.size().2,
            lamps: (0.7, 0.7),
            accent: paintwork(random),
            clothes: Clothes::draw(random),
        };
        match kind {
            Kind::Pedestrian => {}
            Kind::Car => model.car(random),
            Kind::Truck => model.truck(random),
            Kind::Bus => model.bus(random),
            Kind::Motorcycle { .. } => model.motorcycle(random),
            Kind::Bicycle { .. } => {
                model.half_width = 0.22;
                model.half_length = 0.85;
                model.wheel_radius = 0.34;
            }
        }
        model
    }

    /// Draws it. `travelled` turns wheels and legs; `rider` is called between the vehicle and whoever
    /// sits on it, so that the two can be told apart.
    pub(super) fn paint(
        &self,
        kind: Kind,
        brush: &mut Brush,
        placement: &Placement,
        travelled: f32,
        braking: bool,
        rider: impl FnOnce(&mut Brush),
    ) {
        match kind {
            Kind::Pedestrian => {
                let stance = Stance::Walking(travelled);
                people::paint(brush, placement, stance, &self.clothes);
            }
            Kind::Bicycle { ridden } => {
                people::bicycle(brush, placement, self.accent, self.wheel_radius, travelled);
                if ridden {
                    rider(brush);
                    people::paint(brush, placement, Stance::Cycling(travelled), &self.clothes);
                }
            }
            Kind::Motorcycle { ridden } => {
                self.paint_solids(brush, placement, braking);
                if ridden {
                    rider(brush);
                    people::paint(brush, placement, Stance::Sitting, &self.clothes);
                }
            }
            Kind::Car | Kind::Truck | Kind::Bus => self.paint_solids(brush, placement, braking),
        }
    }

    fn paint_solids(&self, brush: &mut Brush, placement: &Placement, braking: bool) {
        brush.solids(placement, &self.solids, braking);
        if brush.camera.scale(placement.origin.z) * self.wheel_radius > 1.2 {
            for wheel in &self.wheels {
                let side = wheel.x.signum();
                brush.disc(placement, *wheel, self.wheel_radius, side, TYRE);
                let hub = self.wheel_radius * 0.55;
                brush.disc(placement, *wheel, hub, side, [0.45, 0.46, 0.48]);
            }
        }
    }

    /// Darkens the ground below it.
    pub(super) fn paint_shadow(&self, brush: &mut Brush, placement: &Placement) {
        brush.shadow(placement, (self.half_width, self.half_length), self.height);
    }

    /// Adds the light its lamps throw into the lens.
    pub(super) fn paint_lamps(
        &self,
        kind: Kind,
        brush: &mut Brush,
        placement: &Placement,
        braking: bool,
    ) {
        if !brush.air.lamps_lit || matches!(kind, Kind::Pedestrian | Kind::Bicycle { .. }) {
            return;
        }
        if matches!(kind, Kind::Motorcycle { ridden: false }) {
            return;
        }
        let ends = [
            (1.0_f32, HEAD, 0.8, 0.9),
            (-1.0, TAIL, if braking { 0.55 } else { 0.35 }, 0.5),
        ];
        for (end, color, strength, reach) in ends {
            let facing = placement.turn(point(0.0, 0.0, end));
            for side in [-1.0, 1.0] {
                let lamp = point(
                    side * self.lamps.1,
                    self.lamps.0,
                    end * self.half_length * 0.98,
                );
                let at = placement.place(lamp);
                let toward = -facing.dot(at.normalised());
                if toward < 0.15 || at.z < 1.0 {
                    continue;
                }
                let clear = 1.0 - brush.air.air(at.z) * 0.7;
                let resolution = brush.camera.focal / 985.0;
                let radius = (reach * brush.camera.scale(at.z))
                    .clamp(2.0 * resolution, 60.0 * resolution)
                    + 4.0 * resolution * end.max(0.0);
                let center = brush.camera.project(at);
                brush
                    .canvas
                    .glow(center, (radius, radius), color, strength * toward * clear);
                if brush.air.wetness > 0.0 {
                    let ground = brush.camera.project(point(at.x, 0.0, at.z));
                    let drop = ground.1 - center.1;
                    brush.canvas.glow(
                        (ground.0, ground.1 + drop * 0.8),
                        (radius * 0.5, drop.max(radius)),
                        color,
                        0.3 * strength * toward * clear,
                    );
                }
                if self.lamps.1 == 0.0 {
                    break;
                }
            }
        }
    }
}
