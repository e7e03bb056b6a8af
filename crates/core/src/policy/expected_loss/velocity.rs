//! The expected velocity of a new object, learnt from the objects in view.
//!
//! In the picture of a moving camera, velocity depends on an object's position and apparent size. A
//! running ridge regression with forgetting learns this from the confirmed objects matched in each
//! detector frame. With the features
//!
//! ```text
//! φ = (1, 2·(2cx/W − 1), 2·(2cy/H − 1), ln(s/H))
//! ```
//!
//! and the velocities `y = v/U`, each detector frame multiplies the sums `A = Σ φφᵀ` and `B = Σ φyᵀ` by
//! the memory and adds its own; a newcomer at φ gets `yᵀ = φᵀ (A + ridge·I)⁻¹ B`, clamped.

use super::settings::{LARGEST_VELOCITY, VELOCITY_MEMORY, VELOCITY_RIDGE};
use nalgebra::{Matrix4, Matrix4x3, Vector4};

const FEATURES: usize = 4;
/// Horizontal and vertical in s per frame, and the common growth of both log-sides.
pub(super) const VELOCITIES: usize = 3;

pub(super) type Features = [f64; FEATURES];

/// Returns the features of a box from its centre as shares of the picture and `ln(s/H)`.
pub(super) fn features(center_x: f64, center_y: f64, log_size: f64) -> Features {
    [
        1.0,
        2.0 * (2.0 * center_x - 1.0),
        2.0 * (2.0 * center_y - 1.0),
        log_size,
    ]
}

/// The running regression.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct VelocityRegression {
    a: Matrix4<f64>,
    b: Matrix4x3<f64>,
    weights: Matrix4x3<f64>,
    solved: bool,
}

impl VelocityRegression {
    /// Fades the learnt sums, once per detector frame.
    pub(crate) fn fade(&mut self) {
        self.a *= VELOCITY_MEMORY;
        self.b *= VELOCITY_MEMORY;
        self.solved = false;
    }

    /// Adds an object at `features` that moves at `velocity`.
    pub(crate) fn learn(&mut self, features: &Features, velocity: &[f64; VELOCITIES]) {
        let features = Vector4::from(*features);
        self.a += features * features.transpose();
        self.b += features * nalgebra::RowVector3::from(*velocity);
        self.solved = false;
    }

    /// Returns the expected velocity at `features`, each component within ±[`LARGEST_VELOCITY`].
    pub(crate) fn expect(&mut self, features: &Features) -> [f64; VELOCITIES] {
        if !self.solved {
            self.weights = solve(self.a, &self.b);
            self.solved = true;
        }
        self.weights
            .tr_mul(&Vector4::from(*features))
            .map(|velocity| velocity.clamp(-LARGEST_VELOCITY, LARGEST_VELOCITY))
            .into()
    }
}

/// Solves `(a + ridge·I) w = b` by Cholesky's decomposition. `a` is a sum of squares, so with the ridge it is positive
/// definite; a pivot that rounding makes zero or less counts as the ridge.
fn solve(a: Matrix4<f64>, b: &Matrix4x3<f64>) -> Matrix4x3<f64> {
    let regularised = a + Matrix4::from_diagonal_element(VELOCITY_RIDGE);
    nalgebra::Cholesky::new_with_substitute(regularised, VELOCITY_RIDGE)
        .map(|decomposed| decomposed.solve(b))
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector};

    #[test]
    fn the_weights_solve_the_ridge_regression_and_without_data_there_is_no_velocity() {
        let mut regression = VelocityRegression::default();
        let phi = features(0.3, 0.8, -1.5);
        assert_eq!(regression.expect(&phi), [0.0; VELOCITIES]);
        let mut a = SMatrix::<f64, FEATURES, FEATURES>::zeros();
        let mut b = SMatrix::<f64, FEATURES, VELOCITIES>::zeros();
        for round in 0..30u32 {
            let t = f64::from(round);
            let (x, y) = (0.5 + 0.4 * t.sin(), 0.5 + 0.3 * (1.7 * t).cos());
            let phi = features(x, y, -2.0 - 0.05 * t);
            let velocity = [0.1 * (2.1 * t).sin(), 0.02 * t.cos(), 0.03];
            regression.fade();
            regression.learn(&phi, &velocity);
            let column = SVector::from(phi);
            a = a * VELOCITY_MEMORY + column * column.transpose();
            b = b * VELOCITY_MEMORY + column * SVector::from(velocity).transpose();
        }
        let ridge = a + SMatrix::<f64, FEATURES, FEATURES>::identity() * VELOCITY_RIDGE;
        let weights = ridge.lu().solve(&b).unwrap();
        let expected = weights.transpose() * SVector::from(phi);
        let found = regression.expect(&phi);
        for velocity in 0..VELOCITIES {
            assert!((expected[velocity] - found[velocity]).abs() < 1e-12);
        }
        // It gives no more than the largest velocity.
        for _ in 0..100 {
            regression.learn(&phi, &[9.0, -9.0, 0.1]);
        }
        let [x, y, growth] = regression.expect(&phi);
        assert_eq!([x, y], [LARGEST_VELOCITY, -LARGEST_VELOCITY]);
        assert!((0.05..0.15).contains(&growth), "{growth}");
    }
}
