//! The filter that runs: the ten-dimensional filter with its covariance kept as two small blocks.
//!
//! The matrices F, Q, H, R and the initial P link no component of one axis to the other axis, nor the
//! centre to the size. So P stays block diagonal for ever: a 3x3 block (centre, velocity, acceleration)
//! and a 2x2 block (size, velocity) for each axis. As both axes have the same noise, their blocks are
//! equal numbers, and one of each is enough: 9 numbers in place of 100, and no matrix inverse, since
//! each block is measured by one component. Written with plain numbers, not small matrices: with the
//! zeros and the symmetry worked out by hand a predict is some 30 additions, and the covariance is
//! symmetric by construction.

use super::FilterModel;
use crate::geometry::BoundingBox;
use nalgebra::{SMatrix, SVector};

/// Covariance of one axis of the centre: upper triangle over position (0), velocity (1) and
/// acceleration (2).
#[derive(Clone, Copy, Debug, PartialEq)]
struct CenterCovariance {
    p00: f64,
    p01: f64,
    p02: f64,
    p11: f64,
    p12: f64,
    p22: f64,
}

/// Covariance of one axis of the size: upper triangle over side (0) and velocity (1).
#[derive(Clone, Copy, Debug, PartialEq)]
struct SizeCovariance {
    p00: f64,
    p01: f64,
    p11: f64,
}

/// State estimate of one object: mean and covariance over
/// `[cx, cy, w, h, vx, vy, vw, vh, ax, ay]`, normalised, one frame as the unit of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter {
    position: [f64; 2],
    size: [f64; 2],
    velocity: [f64; 2],
    size_velocity: [f64; 2],
    acceleration: [f64; 2],
    center_covariance: CenterCovariance,
    size_covariance: SizeCovariance,
}

impl Filter {
    /// A new object seen at `bounding_box`, at rest.
    pub fn new(model: &FilterModel, bounding_box: BoundingBox) -> Self {
        let initial = model.initial;
        Self {
            position: [bounding_box.center_x, bounding_box.center_y],
            size: [bounding_box.width, bounding_box.height],
            velocity: [0.0; 2],
            size_velocity: [0.0; 2],
            acceleration: [0.0; 2],
            center_covariance: CenterCovariance {
                p00: initial.center,
                p01: 0.0,
                p02: 0.0,
                p11: initial.center_velocity,
                p12: 0.0,
                p22: initial.acceleration,
            },
            size_covariance: SizeCovariance {
                p00: initial.size,
                p01: 0.0,
                p11: initial.size_velocity,
            },
        }
    }

    /// Advances by one frame: x ← F x, P ← F P Fᵀ + Q.
    #[inline]
    pub fn predict(&mut self, model: &FilterModel) {
        for axis in 0..2 {
            self.position[axis] += self.velocity[axis] + 0.5 * self.acceleration[axis];
            self.velocity[axis] += self.acceleration[axis];
            self.size[axis] += self.size_velocity[axis];
        }
        let process = &model.process;
        // Row 0 of F P for the centre, F = [1 1 ½; 0 1 1; 0 0 1]; the other rows are sums of two.
        let p = &mut self.center_covariance;
        let m00 = p.p00 + p.p01 + 0.5 * p.p02;
        let m01 = p.p01 + p.p11 + 0.5 * p.p12;
        let m02 = p.p02 + p.p12 + 0.5 * p.p22;
        let m12 = p.p12 + p.p22;
        *p = CenterCovariance {
            p00: m00 + m01 + 0.5 * m02 + process.center,
            p01: m01 + m02,
            p02: m02,
            p11: p.p11 + p.p12 + m12 + process.center_velocity,
            p12: m12,
            p22: p.p22 + process.acceleration,
        };
        let p = &mut self.size_covariance;
        let m01 = p.p01 + p.p11;
        *p = SizeCovariance {
            p00: p.p00 + p.p01 + m01 + process.size,
            p01: m01,
            p11: p.p11 + process.size_velocity,
        };
    }

    /// Takes a measured box: the usual update with gain K = P Hᵀ (H P Hᵀ + R)⁻¹ and P ← (I − K H) P.
    #[inline]
    pub fn update(&mut self, model: &FilterModel, measured: BoundingBox) {
        let p = &mut self.center_covariance;
        let inverse = 1.0 / (p.p00 + model.measurement);
        let gain = [p.p00 * inverse, p.p01 * inverse, p.p02 * inverse];
        for (axis, measured) in [measured.center_x, measured.center_y]
            .into_iter()
            .enumerate()
        {
            let innovation = measured - self.position[axis];
            self.position[axis] += gain[0] * innovation;
            self.velocity[axis] += gain[1] * innovation;
            self.acceleration[axis] += gain[2] * innovation;
        }
        // The share of the old variance that remains, R / (P₀₀ + R), is 1 − K₀ without cancellation.
        let kept = model.measurement * inverse;
        *p = CenterCovariance {
            p00: p.p00 * kept,
            p01: p.p01 * kept,
            p02: p.p02 * kept,
            p11: p.p11 - gain[1] * p.p01,
            p12: p.p12 - gain[1] * p.p02,
            p22: p.p22 - gain[2] * p.p02,
        };
        let p = &mut self.size_covariance;
        let inverse = 1.0 / (p.p00 + model.measurement);
        let gain = [p.p00 * inverse, p.p01 * inverse];
        for (axis, measured) in [measured.width, measured.height].into_iter().enumerate() {
            let innovation = measured - self.size[axis];
            self.size[axis] += gain[0] * innovation;
            self.size_velocity[axis] += gain[1] * innovation;
        }
        let kept = model.measurement * inverse;
        *p = SizeCovariance {
            p00: p.p00 * kept,
            p01: p.p01 * kept,
            p11: p.p11 - gain[1] * p.p01,
        };
    }

    /// Keeps the sides from falling below `width` and `height`; velocities stay.
    #[inline]
    pub fn clamp_size(&mut self, width: f64, height: f64) {
        self.size[0] = self.size[0].max(width);
        self.size[1] = self.size[1].max(height);
    }

    /// The estimated box.
    #[inline]
    pub fn bounding_box(&self) -> BoundingBox {
        BoundingBox::new(
            self.position[0],
            self.position[1],
            self.size[0],
            self.size[1],
        )
    }

    /// The uncertainty τ = trace(H P Hᵀ) (paper): the summed variances of cx, cy, w and h.
    #[inline]
    pub fn tau(&self) -> f64 {
        2.0 * (self.center_covariance.p00 + self.size_covariance.p00)
    }

    /// What a measured box is compared with: see [`Gauge::squared_distance`].
    #[inline]
    pub fn gauge(&self, model: &FilterModel) -> Gauge {
        Gauge {
            expected: self.bounding_box(),
            center: 1.0 / (self.center_covariance.p00 + model.measurement),
            size: 1.0 / (self.size_covariance.p00 + model.measurement),
        }
    }

    /// Squared Mahalanobis distance of `measured`, with S = H P Hᵀ + R.
    pub fn squared_distance(&self, model: &FilterModel, measured: BoundingBox) -> f64 {
        self.gauge(model).squared_distance(measured)
    }

    /// The mean as a vector, in the order of the state.
    pub fn mean(&self) -> SVector<f64, 10> {
        let mut mean = SVector::zeros();
        for axis in 0..2 {
            mean[axis] = self.position[axis];
            mean[2 + axis] = self.size[axis];
            mean[4 + axis] = self.velocity[axis];
            mean[6 + axis] = self.size_velocity[axis];
            mean[8 + axis] = self.acceleration[axis];
        }
        mean
    }

    /// The full 10x10 covariance, in the order of the state.
    pub fn covariance(&self) -> SMatrix<f64, 10, 10> {
        let (c, s) = (&self.center_covariance, &self.size_covariance);
        let mut full = SMatrix::zeros();
        for axis in 0..2 {
            let (position, size) = (axis, 2 + axis);
            let (velocity, size_velocity, acceleration) = (4 + axis, 6 + axis, 8 + axis);
            for (row, column, value) in [
                (position, position, c.p00),
                (position, velocity, c.p01),
                (position, acceleration, c.p02),
                (velocity, velocity, c.p11),
                (velocity, acceleration, c.p12),
                (acceleration, acceleration, c.p22),
                (size, size, s.p00),
                (size, size_velocity, s.p01),
                (size_velocity, size_velocity, s.p11),
            ] {
                full[(row, column)] = value;
                full[(column, row)] = value;
            }
        }
        full
    }
}

/// Where one object expects its next measurement, and how surely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gauge {
    /// The expected box.
    pub expected: BoundingBox,
    /// Inverse variance of the innovation of cx and cy.
    center: f64,
    /// Inverse variance of the innovation of w and h.
    size: f64,
}

impl Gauge {
    /// Squared Mahalanobis distance of `measured`. S is diagonal, as H picks one component a block.
    #[inline]
    pub fn squared_distance(&self, measured: BoundingBox) -> f64 {
        let (dx, dy) = (
            measured.center_x - self.expected.center_x,
            measured.center_y - self.expected.center_y,
        );
        let (dw, dh) = (
            measured.width - self.expected.width,
            measured.height - self.expected.height,
        );
        (dx * dx + dy * dy) * self.center + (dw * dw + dh * dh) * self.size
    }
}
