//! How vehicles are built from solids.

use super::brush::{Finish, Side, Solid};
use super::paint::{HEAD, TAIL, TYRE, paintwork};
use super::random::Random;
use super::space::{Color, point, scale_color};
use super::vehicles::Model;

const GLASS: Color = [0.12, 0.15, 0.19];
const DARK: Color = [0.13, 0.13, 0.14];
const PLATE: Color = [0.88, 0.88, 0.84];

impl Model {
    fn tyres(&mut self, axles: &[f32], thickness: f32) {
        for &axle in axles {
            for side in [-1.0, 1.0] {
                let outer = side * (self.half_width - 0.02);
                let inner = outer - side * thickness;
                let radius = self.wheel_radius;
                self.solids.push(Solid::cuboid(
                    0,
                    TYRE,
                    [
                        inner.min(outer),
                        inner.max(outer),
                        axle - radius * 0.8,
                        axle + radius * 0.8,
                    ],
                    0.0,
                    radius * 1.8,
                ));
                self.wheels
                    .push(point(side * self.half_width, radius, axle));
            }
        }
    }

    /// Builds a car.
    pub(super) fn car(&mut self, random: &mut Random) {
        // Length, width, height, and where the roof and the cabin's foot begin and end along the length.
        let (length, width, height, cabin, roof) = random.pick([
            (4.0, 1.76, 1.48, (-0.49, 0.24), (-0.40, 0.06)),
            (4.6, 1.80, 1.45, (-0.40, 0.22), (-0.24, 0.06)),
            (4.6, 1.90, 1.72, (-0.49, 0.25), (-0.42, 0.10)),
            (4.8, 1.92, 1.92, (-0.50, 0.36), (-0.48, 0.22)),
            (4.5, 1.82, 1.50, (-0.49, 0.23), (-0.43, 0.07)),
        ]);
        (self.half_length, self.half_width, self.height) = (length / 2.0, width / 2.0, height);
        let belt = 0.52 * height + 0.14;
        self.lamps = (0.46 * height, width * 0.40);
        let color = paintwork(random);
        self.tyres(&[-length * 0.30, length * 0.31], 0.24);
        let (w, l) = (self.half_width, self.half_length);
        let body = Solid::new(
            1,
            color,
            (0.24, [-w, w, -l, l]),
            (belt, [-w * 0.95, w * 0.95, -l * 0.98, l * 0.95]),
        )
        .with(Side::Back, DARK, &[[0.0, 0.0, 1.0, 0.22]])
        .with(Side::Back, PLATE, &[[0.36, 0.36, 0.64, 0.54]])
        .with(
            Side::Front,
            DARK,
            &[[0.0, 0.0, 1.0, 0.20], [0.26, 0.34, 0.74, 0.66]],
        )
        .with(Side::Front, PLATE, &[[0.38, 0.14, 0.62, 0.30]])
        .with(Side::Right, DARK, &[[0.0, 0.0, 1.0, 0.13]])
        .with(Side::Left, DARK, &[[0.0, 0.0, 1.0, 0.13]])
        .with(
            Side::Right,
            scale_color(color, 0.8),
            &[[0.3, 0.15, 0.31, 1.0], [0.55, 0.15, 0.56, 1.0]],
        )
        .with(
            Side::Left,
            scale_color(color, 0.8),
            &[[0.44, 0.15, 0.45, 1.0], [0.69, 0.15, 0.70, 1.0]],
        )
        .shining(
            Side::Back,
            TAIL,
            Finish::BrakeLamp,
            &[[0.02, 0.58, 0.20, 0.88], [0.80, 0.58, 0.98, 0.88]],
        )
        .shining(
            Side::Front,
            HEAD,
            Finish::Lamp,
            &[[0.03, 0.52, 0.22, 0.80], [0.78, 0.52, 0.97, 0.80]],
        );
        let foot = [-w * 0.93, w * 0.93, length * cabin.0, length * cabin.1];
        let top = [-w * 0.74, w * 0.74, length * roof.0, length * roof.1];
        let cabin = Solid::new(2, color, (belt, foot), (height, top))
            .with(Side::Back, GLASS, &[[0.08, 0.12, 0.92, 0.86]])
            .with(Side::Front, GLASS, &[[0.05, 0.06, 0.95, 0.90]])
            .with(
                Side::Right,
                GLASS,
                &[[0.10, 0.08, 0.48, 0.84], [0.52, 0.08, 0.92, 0.84]],
            )
            .with(
                Side::Left,
                GLASS,
                &[[0.08, 0.08, 0.48, 0.84], [0.52, 0.08, 0.90, 0.84]],
            );
        self.solids.push(body);
        self.solids.push(cabin);
    }

    /// Builds a truck.
    pub(super) fn truck(&mut self, random: &mut Random) {
        let length = random.pick([6.8, 8.2, 9.8]);
        let height = random.range(2.9, 3.5);
        (self.half_length, self.half_width, self.height) = (length / 2.0, 1.23, height);
        self.wheel_radius = 0.48;
        self.lamps = (0.85, 1.0);
        let (w, l) = (self.half_width, self.half_length);
        let cargo = random.pick([
            [0.90, 0.90, 0.88],
            [0.90, 0.90, 0.88],
            [0.78, 0.80, 0.82],
            [0.20, 0.32, 0.55],
            [0.70, 0.20, 0.14],
            [0.85, 0.68, 0.20],
            [0.24, 0.42, 0.30],
        ]);
        let accent = paintwork(random);
        self.tyres(&[-l * 0.62, -l * 0.40, l * 0.72], 0.34);
        self.solids.push(
            Solid::cuboid(1, DARK, [-w * 0.9, w * 0.9, -l, l * 0.9], 0.5, 0.95)
                .with(Side::Back, PLATE, &[[0.4, 0.2, 0.6, 0.6]])
                .shining(
                    Side::Back,
                    TAIL,
                    Finish::BrakeLamp,
                    &[[0.02, 0.25, 0.16, 0.75], [0.84, 0.25, 0.98, 0.75]],
                ),
        );
        let split = l - 2.0;
        let stripe = random.range(0.2, 0.5);
        self.solids.push(
            Solid::cuboid(2, cargo, [-w, w, -l, split - 0.15], 0.95, height)
                .with(
                    Side::Back,
                    scale_color(cargo, 0.72),
                    &[
                        [0.49, 0.02, 0.51, 0.98],
                        [0.0, 0.0, 1.0, 0.035],
                        [0.0, 0.965, 1.0, 1.0],
                    ],
                )
                .with(Side::Right, accent, &[[0.08, stripe, 0.92, stripe + 0.25]])
                .with(Side::Left, accent, &[[0.08, stripe, 0.92, stripe + 0.25]]),
        );
        let cab = paintwork(random);
        self.solids.push(
            Solid::new(
                2,
                cab,
                (0.5, [-w * 0.96, w * 0.96, split, l]),
                (height.min(2.75), [-w * 0.92, w * 0.92, split, l - 0.25]),
            )
            .with(Side::Front, GLASS, &[[0.07, 0.52, 0.93, 0.90]])
            .with(
                Side::Front,
                DARK,
                &[[0.0, 0.0, 1.0, 0.12], [0.2, 0.2, 0.8, 0.42]],
            )
            .with(Side::Right, GLASS, &[[0.30, 0.52, 0.90, 0.88]])
            .with(Side::Left, GLASS, &[[0.10, 0.52, 0.70, 0.88]])
            .shining(
                Side::Front,
                HEAD,
                Finish::Lamp,
                &[[0.03, 0.14, 0.17, 0.26], [0.83, 0.14, 0.97, 0.26]],
            ),
        );
    }

    /// Builds a bus.
    pub(super) fn bus(&mut self, random: &mut Random) {
        (self.half_length, self.half_width, self.height) = (random.range(5.2, 5.9), 1.27, 3.1);
        self.wheel_radius = 0.5;
        self.lamps = (0.8, 1.05);
        let (w, l) = (self.half_width, self.half_length);
        let color = random.pick([
            [0.82, 0.64, 0.14],
            [0.70, 0.14, 0.12],
            [0.16, 0.36, 0.62],
            [0.88, 0.88, 0.86],
            [0.22, 0.52, 0.36],
        ]);
        let windows: Vec<[f32; 4]> = (0..7)
            .map(|index| {
                let start = 0.03 + index as f32 * 0.136;
                [start, 0.47, start + 0.122, 0.84]
            })
            .collect();
        self.tyres(&[-l * 0.52, l * 0.55], 0.32);
        let pale = [0.90, 0.90, 0.87];
        self.solids.push(
            Solid::new(
                1,
                color,
                (0.3, [-w, w, -l, l]),
                (self.height, [-w * 0.96, w * 0.96, -l * 0.99, l * 0.985]),
            )
            .with(Side::Right, pale, &[[0.0, 0.30, 1.0, 0.40]])
            .with(Side::Left, pale, &[[0.0, 0.30, 1.0, 0.40]])
            .with(Side::Back, pale, &[[0.0, 0.30, 1.0, 0.40]])
            .with(Side::Right, GLASS, &windows)
            .with(Side::Left, GLASS, &windows)
            .with(Side::Back, GLASS, &[[0.12, 0.50, 0.88, 0.82]])
            .with(
                Side::Back,
                DARK,
                &[[0.0, 0.0, 1.0, 0.10], [0.25, 0.12, 0.75, 0.26]],
            )
            .with(Side::Front, GLASS, &[[0.04, 0.32, 0.96, 0.82]])
            .with(Side::Front, DARK, &[[0.0, 0.0, 1.0, 0.10]])
            .shining(
                Side::Front,
                [1.0, 0.75, 0.25],
                Finish::Lamp,
                &[[0.2, 0.86, 0.8, 0.96]],
            )
            .shining(
                Side::Back,
                TAIL,
                Finish::BrakeLamp,
                &[[0.02, 0.14, 0.12, 0.28], [0.88, 0.14, 0.98, 0.28]],
            )
            .shining(
                Side::Front,
                HEAD,
                Finish::Lamp,
                &[[0.03, 0.12, 0.18, 0.20], [0.82, 0.12, 0.97, 0.20]],
            ),
        );
    }

    /// Builds a motorcycle.
    pub(super) fn motorcycle(&mut self, random: &mut Random) {
        (self.half_length, self.half_width, self.height) = (1.05, 0.36, 1.1);
        self.wheel_radius = 0.32;
        self.lamps = (0.75, 0.0);
        let color = paintwork(random);
        for axle in [-0.70, 0.72] {
            self.solids.push(Solid::cuboid(
                0,
                TYRE,
                [-0.08, 0.08, axle - 0.28, axle + 0.28],
                0.0,
                0.62,
            ));
            for side in [-1.0, 1.0] {
                self.wheels
                    .push(point(side * 0.085, self.wheel_radius, axle));
            }
        }
        let body =
            |layer, color, rectangle, low, high| Solid::cuboid(layer, color, rectangle, low, high);
        self.solids
            .push(body(1, DARK, [-0.16, 0.16, -0.45, 0.42], 0.28, 0.62));
        self.solids.push(
            body(2, color, [-0.15, 0.15, -0.95, 0.45], 0.62, 0.86).shining(
                Side::Back,
                TAIL,
                Finish::BrakeLamp,
                &[[0.2, 0.35, 0.8, 0.8]],
            ),
        );
        self.solids.push(
            Solid::new(
                3,
                color,
                (0.62, [-0.17, 0.17, 0.45, 0.85]),
                (1.06, [-0.12, 0.12, 0.42, 0.62]),
            )
            .shining(Side::Front, HEAD, Finish::Lamp, &[[0.2, 0.35, 0.8, 0.75]]),
        );
        self.solids
            .push(body(3, DARK, [-0.36, 0.36, 0.44, 0.52], 1.00, 1.07));
    }
}
