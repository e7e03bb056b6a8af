//! The filter in textbook form: full matrices without structure. [`Filter`](crate::kalman::Filter) is tested against it, and it
//! is the one to read first.
//!
//! State `x` over `[cx, cy, w, h, vx, vy, vw, vh, ax, ay]`, covariance `P`; one frame is the unit of time.
//!
//! - predict: `x ← F x`, `P ← F P Fᵀ + Q`
//! - update with a measured box `z`: `S = H P Hᵀ + R`, `K = P Hᵀ S⁻¹`, `x ← x + K (z − H x)`,
//!   `P ← (I − K H) P`
//! - uncertainty: `τ = trace(H P Hᵀ)`

use crate::geometry::BoundingBox;
use crate::kalman::{Deviations, FilterModel};
use nalgebra::{SMatrix, SVector};

type Matrix = SMatrix<f64, 10, 10>;

pub(super) struct DenseFilter {
    /// x.
    pub mean: SVector<f64, 10>,
    /// P.
    pub covariance: Matrix,
    /// F.
    transition: Matrix,
    /// Q.
    process_noise: Matrix,
    /// H: picks cx, cy, w and h.
    observation: SMatrix<f64, 4, 10>,
    /// R.
    measurement_noise: SMatrix<f64, 4, 4>,
}

impl DenseFilter {
    /// Creates the paper's filter: constant acceleration of the centre, constant velocity of the size.
    pub(super) fn new(model: &FilterModel, first: BoundingBox) -> Self {
        let diagonal = |d: &Deviations| {
            let components = [
                d.center,
                d.size,
                d.center_velocity,
                d.size_velocity,
                d.acceleration,
            ];
            Matrix::from_diagonal(&SVector::from_fn(|component, _| components[component / 2]))
        };
        let mut transition = Matrix::identity();
        for axis in 0..2 {
            transition[(axis, 4 + axis)] = 1.0;
            transition[(axis, 8 + axis)] = 0.5;
            transition[(4 + axis, 8 + axis)] = 1.0;
            transition[(2 + axis, 6 + axis)] = 1.0;
        }
        let observation = SMatrix::<f64, 4, 10>::identity();
        Self {
            mean: observation.transpose() * measurement(first),
            covariance: diagonal(&model.initial),
            transition,
            process_noise: diagonal(&model.process),
            observation,
            measurement_noise: SMatrix::identity() * model.measurement,
        }
    }

    /// Advances by one frame.
    pub(super) fn predict(&mut self) {
        self.mean = self.transition * self.mean;
        self.covariance =
            self.transition * self.covariance * self.transition.transpose() + self.process_noise;
    }

    /// Applies a measured box.
    pub(super) fn update(&mut self, measured: BoundingBox) {
        let gain = self.covariance * self.observation.transpose() * self.precision();
        self.mean += gain * (measurement(measured) - self.observation * self.mean);
        self.covariance = (Matrix::identity() - gain * self.observation) * self.covariance;
    }

    /// Returns τ.
    pub(super) fn tau(&self) -> f64 {
        self.observed().trace()
    }

    /// Returns the squared Mahalanobis distance of a measured box.
    pub(super) fn squared_distance(&self, measured: BoundingBox) -> f64 {
        let innovation = measurement(measured) - self.observation * self.mean;
        (innovation.transpose() * self.precision() * innovation)[0]
    }

    /// Returns H P Hᵀ.
    fn observed(&self) -> SMatrix<f64, 4, 4> {
        self.observation * self.covariance * self.observation.transpose()
    }

    /// Returns S⁻¹.
    fn precision(&self) -> SMatrix<f64, 4, 4> {
        let innovation = self.observed() + self.measurement_noise;
        innovation.try_inverse().unwrap()
    }
}

fn measurement(measured: BoundingBox) -> SVector<f64, 4> {
    SVector::from(<[f64; 4]>::from(measured))
}
