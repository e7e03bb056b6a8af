//! The filter in textbook form: full matrices without structure. [`Filter`](crate::kalman::Filter) is tested against it, and it
//! is the one to read first.
//!
//! State `x`, covariance `P`; one frame is the unit of time.
//!
//! - predict: `x ← F x`, `P ← F P Fᵀ + Q`
//! - update with a measured box `z`: `S = H P Hᵀ + R`, `K = P Hᵀ S⁻¹`, `x ← x + K (z − H x)`,
//!   `P ← (I − K H) P`
//! - uncertainty: `τ = trace(H P Hᵀ)`

use crate::geometry::BoundingBox;
use crate::kalman::{Deviations, FilterModel};
use nalgebra::{SMatrix, SVector};

/// A filter of `N` dimensions: 10 over `[cx, cy, w, h, vx, vy, vw, vh, ax, ay]`, or 8 without `vw` and `vh`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DenseFilter<const N: usize> {
    /// x.
    pub mean: SVector<f64, N>,
    /// P.
    pub covariance: SMatrix<f64, N, N>,
    /// F.
    pub transition: SMatrix<f64, N, N>,
    /// Q.
    pub process_noise: SMatrix<f64, N, N>,
    /// H: picks cx, cy, w and h.
    pub observation: SMatrix<f64, 4, N>,
    /// R.
    pub measurement_noise: SMatrix<f64, 4, 4>,
}

impl DenseFilter<10> {
    /// Creates the paper's filter: constant acceleration of the centre, constant velocity of the size.
    pub(super) fn constant_acceleration(model: &FilterModel, bounding_box: BoundingBox) -> Self {
        let mut filter = Self::with_acceleration(model, bounding_box);
        for axis in 0..2 {
            filter.transition[(2 + axis, 6 + axis)] = 1.0;
            filter.process_noise[(6 + axis, 6 + axis)] = model.process.size_velocity;
            filter.covariance[(6 + axis, 6 + axis)] = model.initial.size_velocity;
        }
        filter
    }
}

impl DenseFilter<8> {
    /// Creates the ablation's filter: constant acceleration of the centre, a size without velocity.
    pub(super) fn constant_size(model: &FilterModel, bounding_box: BoundingBox) -> Self {
        Self::with_acceleration(model, bounding_box)
    }
}

impl<const N: usize> DenseFilter<N> {
    /// Creates a filter with centre, size, and the centre's velocity and acceleration, as in both filters; any further
    /// components have zero mean and variance.
    fn with_acceleration(model: &FilterModel, bounding_box: BoundingBox) -> Self {
        let diagonal = |d: &Deviations| {
            let mut full = SMatrix::<f64, N, N>::zeros();
            for axis in 0..2 {
                full[(axis, axis)] = d.center;
                full[(2 + axis, 2 + axis)] = d.size;
                full[(4 + axis, 4 + axis)] = d.center_velocity;
                full[(N - 2 + axis, N - 2 + axis)] = d.acceleration;
            }
            full
        };
        let mut transition = SMatrix::<f64, N, N>::identity();
        for axis in 0..2 {
            transition[(axis, 4 + axis)] = 1.0;
            transition[(axis, N - 2 + axis)] = 0.5;
            transition[(4 + axis, N - 2 + axis)] = 1.0;
        }
        let mut observation = SMatrix::<f64, 4, N>::zeros();
        for component in 0..4 {
            observation[(component, component)] = 1.0;
        }
        let mut mean = SVector::<f64, N>::zeros();
        mean.fixed_rows_mut::<4>(0)
            .copy_from(&measurement(bounding_box));
        Self {
            mean,
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

    /// Applies a measured box. `None`, with nothing changed, if S cannot be inverted, which happens only without
    /// measurement noise.
    pub(super) fn update(&mut self, measured: BoundingBox) -> Option<()> {
        let inverse = self.innovation_covariance().try_inverse()?;
        let gain = self.covariance * self.observation.transpose() * inverse;
        self.mean += gain * (measurement(measured) - self.observation * self.mean);
        self.covariance =
            (SMatrix::<f64, N, N>::identity() - gain * self.observation) * self.covariance;
        Some(())
    }

    /// Returns τ.
    pub(super) fn tau(&self) -> f64 {
        (self.observation * self.covariance * self.observation.transpose()).trace()
    }

    /// Returns the squared Mahalanobis distance of a measured box; `None` if S cannot be inverted.
    pub(super) fn squared_distance(&self, measured: BoundingBox) -> Option<f64> {
        let innovation = measurement(measured) - self.observation * self.mean;
        let inverse = self.innovation_covariance().try_inverse()?;
        Some((innovation.transpose() * inverse * innovation)[0])
    }

    /// Returns S.
    fn innovation_covariance(&self) -> SMatrix<f64, 4, 4> {
        self.observation * self.covariance * self.observation.transpose() + self.measurement_noise
    }
}

fn measurement(bounding_box: BoundingBox) -> SVector<f64, 4> {
    SVector::from([
        bounding_box.center_x,
        bounding_box.center_y,
        bounding_box.width,
        bounding_box.height,
    ])
}
