//! The filter of one object: four independent axes, each with a position and a velocity.
//!
//! The axes are the centre (x, y) in a unit that is the same in both directions, and the natural logarithms of width
//! and height. With `s = √(w·h)` and `U = (s, s, 1, 1)`, per frame:
//!
//! ```text
//! ρ = clamp((v_lw + v_lh) / 2, ±largest_growth)
//! centre:     x ← x + v·(1 + ρ)       v ← g·v,  g = center_fading·(1 + 2ρ)
//! log-sides:  x ← x + v               v ← g·v,  g = size_fading·(1 + ρ)
//! all:        p00 ← p00 + 2·p01 + p11 + q/4
//!             p01 ← (p01 + p11)·g + q/2
//!             p11 ← g²·p11 + q
//! ```
//!
//! q is the variance of the change of velocity within a frame. Spread evenly over the frame, a change moves the
//! position by half of itself: so its effects on position and velocity are (½, 1), and their covariance is q/4, q/2, q.
//!
//! The terms in ρ are perspective: an object at distance d has a size and a place proportional to 1/d. If it approaches
//! at constant speed, both grow by the factor 1 + ρ per frame, ρ itself by as much, and the velocity of the place, which
//! goes with 1/d², by (1 + ρ)² ≈ 1 + 2ρ. The clamp keeps one bad pair of sides from throwing the place out of the
//! picture. A measurement z with variance R gives, with `S = p00 + R`,
//!
//! ```text
//! y = z − x    k0 = p00/S    k1 = p01/S
//! x ← x + k0·y    v ← v + k1·y
//! p11 ← p11 − k1·p01    p01 ← (1 − k0)·p01    p00 ← (1 − k0)·p00
//! ```
//!
//! and then both log-sides move at the mean of their velocities: an approaching object keeps its shape. When optical
//! flow follows a box, it measures a difference of two positions: see [`Earlier`].

use super::settings::{
    CENTER_FADING, CENTER_MEASUREMENT, CENTER_PROCESS, LARGEST_GROWTH, NEWCOMER_CENTER_VELOCITY,
    NEWCOMER_SIZE_VELOCITY, SIZE_FADING, SIZE_MEASUREMENT, SIZE_PROCESS,
};

/// Indices of the axes in arrays of four.
pub(super) const X: usize = 0;
pub(super) const Y: usize = 1;
pub(super) const LOG_WIDTH: usize = 2;
pub(super) const LOG_HEIGHT: usize = 3;

/// Boxes are limited to e^±30 picture heights, which keeps all arithmetic finite.
pub(super) const LARGEST_LOG: f64 = 30.0;

/// Position and velocity along one axis, with their covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Axis {
    pub x: f64,
    pub v: f64,
    pub p00: f64,
    pub p01: f64,
    pub p11: f64,
}

impl Axis {
    /// Advances by one frame: `stretch` is 1 + ρ for the centre and 1 for a log-side.
    fn predict(&mut self, stretch: f64, g: f64, q: f64) {
        self.x += self.v * stretch;
        self.v *= g;
        self.p00 += 2.0 * self.p01 + self.p11 + q / 4.0;
        self.p01 = (self.p01 + self.p11) * g + q / 2.0;
        self.p11 = g * g * self.p11 + q;
    }

    /// Applies a measurement; returns the squared normalised innovation y²/S.
    fn update(&mut self, z: f64, r: f64) -> f64 {
        let y = z - self.x;
        let s = self.p00 + r;
        let k0 = self.p00 / s;
        let k1 = self.p01 / s;
        self.x += k0 * y;
        self.v += k1 * y;
        self.p11 -= k1 * self.p01;
        self.p01 *= 1.0 - k0;
        self.p00 *= 1.0 - k0;
        y * y / s
    }
}

/// An object's position at an earlier frame, as the filter now estimates it: position a, its variance, and its
/// covariances with the current position and velocity.
///
/// Optical flow measures `x − a`, a difference of two positions whose errors are correlated. Keeping a copy of the
/// earlier state with its covariances makes it an ordinary measurement (Roumeliotis and Burdick, "Stochastic Cloning",
/// ICRA 2002).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Earlier {
    a: f64,
    paa: f64,
    pxa: f64,
    pva: f64,
}

impl Earlier {
    /// Copies the current state.
    fn of(axis: &Axis) -> Self {
        Self {
            a: axis.x,
            paa: axis.p00,
            pxa: axis.p00,
            pva: axis.p01,
        }
    }

    /// Advances by one frame: the earlier position itself stays.
    fn predict(&mut self, g: f64) {
        self.pxa += self.pva;
        self.pva *= g;
    }

    /// Updates the copy before `axis` applies a measurement z of x with variance `r`.
    fn update(&mut self, axis: &Axis, z: f64, r: f64) {
        let s = axis.p00 + r;
        let gain = self.pxa / s;
        self.a += gain * (z - axis.x);
        self.paa -= gain * self.pxa;
        self.pva -= axis.p01 / s * self.pxa;
        self.pxa *= 1.0 - axis.p00 / s;
    }

    /// Returns the variance of `x − a` measured with variance `r`, and the covariance of x with it.
    fn difference(&self, axis: &Axis, r: f64) -> (f64, f64) {
        let s = axis.p00 - 2.0 * self.pxa + self.paa + r;
        (s, axis.p00 - self.pxa)
    }

    /// Applies to `axis` a measurement d of x − a with variance `r`. The earlier state is invalid afterwards.
    fn measure(&self, axis: &mut Axis, d: f64, r: f64) {
        let (s, covariance) = self.difference(axis, r);
        let y = d - (axis.x - self.a);
        // Covariances with the measurement, and the gains.
        let c0 = covariance;
        let c1 = axis.p01 - self.pva;
        let k0 = c0 / s;
        let k1 = c1 / s;
        axis.x += k0 * y;
        axis.v += k1 * y;
        axis.p00 -= k0 * c0;
        axis.p01 -= k0 * c1;
        axis.p11 -= k1 * c1;
    }
}

/// A box in the filter's measurement space: centre and logarithms of the sides.
pub(super) type AxisValues = [f64; 4];

/// The filter of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MotionFilter {
    pub axes: [Axis; 4],
    /// Width and height: the exponentials of the log-sides, cached because they are used often.
    sides: [f64; 2],
    /// Position of the object in the last picture used.
    earlier: Option<[Earlier; 4]>,
}

impl MotionFilter {
    /// Creates a filter for an object at `measured`, moving at `velocity` in units of U.
    pub(crate) fn new(measured: &AxisValues, velocity: &[f64; 3]) -> Self {
        let sides = [LOG_WIDTH, LOG_HEIGHT].map(|axis| measured[axis].exp());
        let s = (sides[0] * sides[1]).sqrt();
        let r = measurement_variance(s);
        let unit = [s, s, 1.0, 1.0];
        let velocity = [velocity[0], velocity[1], velocity[2], velocity[2]];
        let deviation = [
            NEWCOMER_CENTER_VELOCITY,
            NEWCOMER_CENTER_VELOCITY,
            NEWCOMER_SIZE_VELOCITY,
            NEWCOMER_SIZE_VELOCITY,
        ];
        Self {
            axes: std::array::from_fn(|axis| Axis {
                x: measured[axis],
                v: velocity[axis] * unit[axis],
                p00: r[axis],
                p01: 0.0,
                p11: (deviation[axis] * unit[axis]).powi(2),
            }),
            sides,
            earlier: None,
        }
    }

    /// Returns width and height.
    pub(crate) fn sides(&self) -> [f64; 2] {
        self.sides
    }

    /// Returns the object's position and log-sides.
    pub(crate) fn position(&self) -> AxisValues {
        std::array::from_fn(|axis| self.axes[axis].x)
    }

    /// Returns the size s.
    pub(crate) fn size(&self) -> f64 {
        (self.sides[0] * self.sides[1]).sqrt()
    }

    fn refresh_sides(&mut self) {
        self.sides = [LOG_WIDTH, LOG_HEIGHT].map(|axis| self.axes[axis].x.exp());
    }

    /// Advances by one frame.
    pub(crate) fn predict(&mut self) {
        self.predict_growing(LARGEST_GROWTH);
    }

    /// Advances by one frame; limits the growth to ±`largest_growth`.
    fn predict_growing(&mut self, largest_growth: f64) {
        let s = self.size();
        let growth = (self.axes[LOG_WIDTH].v + self.axes[LOG_HEIGHT].v) / 2.0;
        let rho = growth.clamp(-largest_growth, largest_growth);
        let q_center = (CENTER_PROCESS * s).powi(2);
        let q_size = SIZE_PROCESS.powi(2);
        let g_center = CENTER_FADING * (1.0 + 2.0 * rho);
        let g_size = SIZE_FADING * (1.0 + rho);
        for axis in [X, Y] {
            self.axes[axis].predict(1.0 + rho, g_center, q_center);
        }
        for axis in [LOG_WIDTH, LOG_HEIGHT] {
            let axis = &mut self.axes[axis];
            axis.predict(1.0, g_size, q_size);
            axis.x = axis.x.clamp(-LARGEST_LOG, LARGEST_LOG);
        }
        if let Some(earlier) = &mut self.earlier {
            let g = [g_center, g_center, g_size, g_size];
            for (earlier, g) in earlier.iter_mut().zip(g) {
                earlier.predict(g);
            }
        }
        self.refresh_sides();
    }

    /// Moves the box without changing its velocity or variance.
    pub(crate) fn shift(&mut self, offset: &AxisValues) {
        for (axis, offset) in self.axes.iter_mut().zip(offset) {
            axis.x += offset;
        }
        self.refresh_sides();
    }

    /// Applies a measurement; returns the four squared normalised innovations y²/S.
    pub(crate) fn update(&mut self, measured: &AxisValues) -> [f64; 4] {
        let r = measurement_variance(self.size());
        if let Some(earlier) = &mut self.earlier {
            for (axis, earlier) in earlier.iter_mut().enumerate() {
                earlier.update(&self.axes[axis], measured[axis], r[axis]);
            }
        }
        let innovations =
            std::array::from_fn(|axis| self.axes[axis].update(measured[axis], r[axis]));
        self.share_growth();
        self.refresh_sides();
        innovations
    }

    /// An approaching object keeps its shape.
    fn share_growth(&mut self) {
        let growth = (self.axes[LOG_WIDTH].v + self.axes[LOG_HEIGHT].v) / 2.0;
        self.axes[LOG_WIDTH].v = growth;
        self.axes[LOG_HEIGHT].v = growth;
    }

    /// Remembers the current position as the reference for [`follow`](Self::follow).
    pub(crate) fn remember(&mut self) {
        self.earlier = Some(std::array::from_fn(|axis| Earlier::of(&self.axes[axis])));
    }

    /// Returns the remembered position.
    pub(crate) fn remembered(&self) -> Option<AxisValues> {
        let earlier = self.earlier?;
        Some(std::array::from_fn(|axis| earlier[axis].a))
    }

    /// Applies the measured motion and growth since the remembered position, with their variances.
    pub(crate) fn follow(&mut self, moved: &AxisValues, variance: &[f64; 4]) {
        let Some(earlier) = self.earlier.take() else {
            return;
        };
        for (axis, earlier) in earlier.iter().enumerate() {
            earlier.measure(&mut self.axes[axis], moved[axis], variance[axis]);
        }
        for axis in [LOG_WIDTH, LOG_HEIGHT] {
            let axis = &mut self.axes[axis];
            axis.x = axis.x.clamp(-LARGEST_LOG, LARGEST_LOG);
        }
        self.share_growth();
        self.refresh_sides();
    }

    /// Returns the variances S of the next innovations.
    pub(crate) fn innovation_variance(&self) -> [f64; 4] {
        let r = measurement_variance(self.size());
        std::array::from_fn(|axis| self.axes[axis].p00 + r[axis])
    }

    /// Returns the velocity in units of U, with one value for both log-sides.
    pub(crate) fn velocity(&self) -> [f64; 3] {
        let s = self.size();
        [
            self.axes[X].v / s,
            self.axes[Y].v / s,
            self.axes[LOG_WIDTH].v,
        ]
    }

    /// Returns the relative variance of the box: `4·p_x/w² + 4·p_y/h² + p_lw + p_lh`. A variance of one half means an
    /// edge that is off by about half a side.
    pub(crate) fn relative_variance(&self) -> f64 {
        let [width, height] = self.sides;
        let [x, y, log_width, log_height] = &self.axes;
        4.0 * x.p00 / (width * width)
            + 4.0 * y.p00 / (height * height)
            + log_width.p00
            + log_height.p00
    }
}

/// Returns R of the four axes for a box of size `s`.
fn measurement_variance(s: f64) -> [f64; 4] {
    let center = (CENTER_MEASUREMENT * s).powi(2);
    let size = SIZE_MEASUREMENT.powi(2);
    [center, center, size, size]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3, RowVector3, Vector2, Vector3, Vector4};

    /// The textbook's filter, in matrices, of position, velocity and the earlier position.
    #[derive(Clone, Copy)]
    struct Textbook {
        x: Vector3<f64>,
        p: Matrix3<f64>,
    }

    impl Textbook {
        fn predict(&mut self, stretch: f64, g: f64, q: f64) {
            // The covariance moves without perspective's stretch of the step, as the equations say.
            let f = |stretch| Matrix3::new(1.0, stretch, 0.0, 0.0, g, 0.0, 0.0, 0.0, 1.0);
            let noise = Vector3::new(0.5, 1.0, 0.0);
            self.x = f(stretch) * self.x;
            self.p = f(1.0) * self.p * f(1.0).transpose() + noise * noise.transpose() * q;
        }

        fn update(&mut self, h: RowVector3<f64>, z: f64, r: f64) {
            let s = (h * self.p * h.transpose())[0] + r;
            let k = self.p * h.transpose() / s;
            self.x += k * (z - (h * self.x)[0]);
            self.p = (Matrix3::identity() - k * h) * self.p;
        }

        fn differs(&self, axis: &Axis) -> f64 {
            let x = self.x.fixed_rows::<2>(0) - Vector2::new(axis.x, axis.v);
            let p = Matrix2::new(axis.p00, axis.p01, axis.p01, axis.p11);
            x.norm() + (self.p.fixed_view::<2, 2>(0, 0) - p).norm()
        }

        fn differs_earlier(&self, earlier: &Earlier) -> f64 {
            let differences = Vector4::new(
                self.x[2] - earlier.a,
                self.p[(0, 2)] - earlier.pxa,
                self.p[(1, 2)] - earlier.pva,
                self.p[(2, 2)] - earlier.paa,
            );
            differences.norm()
        }
    }

    #[test]
    fn an_axis_is_the_textbook_filter_and_a_shift_a_measurement_of_a_difference() {
        let mut axis = Axis {
            x: 1.0,
            v: 0.2,
            p00: 0.3,
            p01: 0.05,
            p11: 0.1,
        };
        let mut earlier = Earlier::of(&axis);
        let mut textbook = Textbook {
            x: Vector3::new(1.0, 0.2, 1.0),
            p: Matrix3::new(0.3, 0.05, 0.3, 0.05, 0.1, 0.05, 0.3, 0.05, 0.3),
        };
        for round in 0..50 {
            let stretch = 1.0 + 0.01 * f64::from(round % 5);
            let g = 0.97;
            axis.predict(stretch, g, 0.02);
            earlier.predict(g);
            textbook.predict(stretch, g, 0.02);
            assert!(textbook.differs(&axis) < 1e-12);
            assert!(textbook.differs_earlier(&earlier) < 1e-12);
            // A shift since the earlier position, which ends the comparison with it.
            let mut shifted = axis;
            let mut expected = textbook;
            let (s, covariance) = earlier.difference(&axis, 0.01);
            earlier.measure(&mut shifted, 0.7, 0.01);
            expected.update(RowVector3::new(1.0, 0.0, -1.0), 0.7, 0.01);
            assert!(expected.differs(&shifted) < 1e-12);
            let variance = axis.p00 - covariance * covariance / s;
            assert!((shifted.p00 - variance).abs() < 1e-12);
            let z = 1.0 + 0.1 * f64::from(round);
            let y = z - axis.x;
            let s = axis.p00 + 0.04;
            earlier.update(&axis, z, 0.04);
            assert!((axis.update(z, 0.04) - y * y / s).abs() < 1e-12);
            textbook.update(RowVector3::new(1.0, 0.0, 0.0), z, 0.04);
            assert!(textbook.differs(&axis) < 1e-12);
        }
    }

    /// An object that comes nearer at constant speed: its picture at distance d is s = 1/d, x = 1/d.
    #[test]
    fn perspective_improves_the_prediction_of_approaching_objects() {
        let error = |largest_growth: f64| {
            let at = |frame: u32| {
                let s: f64 = 1.0 / (4.0 - 0.1 * f64::from(frame));
                [s, 0.5 * s, s.ln(), s.ln()]
            };
            let mut filter = MotionFilter::new(&at(0), &[0.0; 3]);
            for frame in 1..=20 {
                filter.predict_growing(largest_growth);
                filter.update(&at(frame));
            }
            for _ in 0..8 {
                filter.predict_growing(largest_growth);
            }
            (filter.axes[X].x - at(28)[X]).abs()
        };
        let with = error(0.15);
        let without = error(0.0);
        assert!(with < 0.5 * without, "{with} {without}");
    }
}
