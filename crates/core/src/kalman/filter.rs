//! The production filter: the ten-dimensional filter with its covariance kept as two small blocks.
//!
//! The matrices F, Q, H, R and the initial P link no component of one axis to the other axis, nor the centre to the
//! size. So P always stays block diagonal: a 3x3 block (centre, velocity, acceleration) and a 2x2 block (size,
//! velocity) for each axis. As both axes have the same noise, their blocks are equal, and one of each suffices: 13
//! numbers instead of 100, and no matrix inverse, since each block is measured by one component. Leaving out the zeros
//! changes no sum, and the sums have the order of a matrix product: every number equals the full matrices' to the last
//! bit.

use super::FilterModel;
use crate::geometry::{BoundingBox, Corners};

/// State estimate of one object: mean and covariance over
/// `[cx, cy, w, h, vx, vy, vw, vh, ax, ay]`, normalised, one frame as the unit of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter {
    position: [f64; 2],
    size: [f64; 2],
    velocity: [f64; 2],
    size_velocity: [f64; 2],
    acceleration: [f64; 2],
    /// Covariance of one axis of the centre over position (0), velocity (1) and acceleration (2).
    ///
    /// Both triangles are kept: P ← (I − K H) P rounds them differently, and with both every number equals, to the last
    /// bit, the one from full matrices. Average precision ranks boxes by confidences, which may differ only in such
    /// bits.
    center_covariance: [[f64; 3]; 3],
    /// Covariance of one axis of the size over side (0) and velocity (1), both triangles.
    size_covariance: [[f64; 2]; 2],
}

impl Filter {
    /// Creates a filter for an object first seen at `bounding_box`, at rest.
    pub fn new(model: &FilterModel, bounding_box: BoundingBox) -> Self {
        let initial = model.initial;
        Self {
            position: [bounding_box.center_x, bounding_box.center_y],
            size: [bounding_box.width, bounding_box.height],
            velocity: [0.0; 2],
            size_velocity: [0.0; 2],
            acceleration: [0.0; 2],
            center_covariance: [
                [initial.center, 0.0, 0.0],
                [0.0, initial.center_velocity, 0.0],
                [0.0, 0.0, initial.acceleration],
            ],
            size_covariance: [[initial.size, 0.0], [0.0, initial.size_velocity]],
        }
    }

    /// Advances by one frame: x ← F x, P ← F P Fᵀ + Q.
    #[inline]
    pub(crate) fn predict(&mut self, model: &FilterModel) {
        for axis in 0..2 {
            self.position[axis] =
                self.position[axis] + self.velocity[axis] + 0.5 * self.acceleration[axis];
            self.velocity[axis] += self.acceleration[axis];
            self.size[axis] += self.size_velocity[axis];
        }
        let process = &model.process;
        // F P, then (F P) Fᵀ, with F = [1 1 ½; 0 1 1; 0 0 1]; sums in column order.
        let p = &mut self.center_covariance;
        let [position, velocity, acceleration] = &mut *p;
        for ((x, v), a) in position.iter_mut().zip(velocity).zip(acceleration) {
            *x = *x + *v + 0.5 * *a;
            *v += *a;
        }
        for row in p.iter_mut() {
            row[0] = row[0] + row[1] + 0.5 * row[2];
            row[1] += row[2];
        }
        p[0][0] += process.center;
        p[1][1] += process.center_velocity;
        p[2][2] += process.acceleration;
        let p = &mut self.size_covariance;
        let [size, velocity] = &mut *p;
        for (x, v) in size.iter_mut().zip(velocity) {
            *x += *v;
        }
        for row in p.iter_mut() {
            row[0] += row[1];
        }
        p[0][0] += process.size;
        p[1][1] += process.size_velocity;
    }

    /// Applies a measured box: the usual update with gain K = P Hᵀ (H P Hᵀ + R)⁻¹ and P ← (I − K H) P.
    #[inline]
    pub fn update(&mut self, model: &FilterModel, measured: BoundingBox) {
        let p = &mut self.center_covariance;
        let inverse = 1.0 / (p[0][0] + model.measurement);
        let gain = [p[0][0] * inverse, p[1][0] * inverse, p[2][0] * inverse];
        for (axis, measured) in [measured.center_x, measured.center_y].into_iter().enumerate() {
            let innovation = measured - self.position[axis];
            self.position[axis] += gain[0] * innovation;
            self.velocity[axis] += gain[1] * innovation;
            self.acceleration[axis] += gain[2] * innovation;
        }
        let first = p[0];
        for column in 0..3 {
            p[0][column] = (1.0 - gain[0]) * first[column];
            p[1][column] -= gain[1] * first[column];
            p[2][column] -= gain[2] * first[column];
        }
        let p = &mut self.size_covariance;
        let inverse = 1.0 / (p[0][0] + model.measurement);
        let gain = [p[0][0] * inverse, p[1][0] * inverse];
        for (axis, measured) in [measured.width, measured.height].into_iter().enumerate() {
            let innovation = measured - self.size[axis];
            self.size[axis] += gain[0] * innovation;
            self.size_velocity[axis] += gain[1] * innovation;
        }
        let first = p[0];
        for column in 0..2 {
            p[0][column] = (1.0 - gain[0]) * first[column];
            p[1][column] -= gain[1] * first[column];
        }
    }

    /// Limits the sides to at least `width` and `height`; keeps the velocities.
    #[inline]
    pub(crate) fn clamp_size(&mut self, width: f64, height: f64) {
        self.size[0] = self.size[0].max(width);
        self.size[1] = self.size[1].max(height);
    }

    /// Returns the estimated box.
    #[inline]
    pub fn bounding_box(&self) -> BoundingBox {
        BoundingBox::new(
            self.position[0],
            self.position[1],
            self.size[0],
            self.size[1],
        )
    }

    /// Returns the uncertainty τ = trace(H P Hᵀ) (paper): the summed variances of cx, cy, w and h.
    #[inline]
    pub fn tau(&self) -> f64 {
        let (center, size) = (self.center_covariance[0][0], self.size_covariance[0][0]);
        center + center + size + size
    }

    /// Returns the gauge for comparison with measured boxes: see `Gauge::squared_distance`.
    #[inline]
    pub fn gauge(&self, model: &FilterModel) -> Gauge {
        Gauge {
            expected: self.bounding_box(),
            center: 1.0 / (self.center_covariance[0][0] + model.measurement),
            size: 1.0 / (self.size_covariance[0][0] + model.measurement),
        }
    }
}

/// An object's expected next measurement and its precision.
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
    /// Returns the squared Mahalanobis distance of `measured`, with S = H P Hᵀ + R. S is diagonal, as H selects one
    /// component per block.
    #[inline]
    pub(crate) fn squared_distance(&self, measured: BoundingBox) -> f64 {
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

    /// Returns an area that contains the centres of all boxes within the squared distance `gate`, with a margin for
    /// rounding errors, both in the distance and here.
    pub(crate) fn reach(&self, gate: f64) -> Corners {
        let side = 2.0 * (gate / self.center).sqrt() * (1.0 + 1e-9) + 1e-12;
        let BoundingBox {
            center_x, center_y, ..
        } = self.expected;
        BoundingBox::new(center_x, center_y, side, side).corners()
    }
}

#[cfg(test)]
mod tests {
    use super::Filter;
    use nalgebra::{SMatrix, SVector};

    impl Filter {
        /// Returns the mean as a vector, in state order.
        pub(crate) fn mean(&self) -> SVector<f64, 10> {
            let parts = [
                self.position,
                self.size,
                self.velocity,
                self.size_velocity,
                self.acceleration,
            ];
            SVector::from_column_slice(parts.as_flattened())
        }

        /// Returns the full 10x10 covariance, in state order: components a multiple of four apart share a block.
        pub(crate) fn covariance(&self) -> SMatrix<f64, 10, 10> {
            SMatrix::from_fn(|row, column| match row % 4 {
                block if block != column % 4 => 0.0,
                0 | 1 => self.center_covariance[row / 4][column / 4],
                _ => self.size_covariance[row / 4][column / 4],
            })
        }
    }
}
