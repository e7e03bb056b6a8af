//! The parameters of the filter, and their values for a picture of a given size.

use crate::geometry::PictureSize;

/// Standard deviations of the components of the state, per frame, in normalised coordinates. Both axes share them, so
/// that the filter can keep one covariance for both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviations {
    /// Standard deviation of the centre.
    pub center: f64,
    /// Standard deviation of width and height.
    pub size: f64,
    /// Standard deviation of the centre's velocity.
    pub center_velocity: f64,
    /// Standard deviation of the velocity of width and height.
    pub size_velocity: f64,
    /// Standard deviation of the centre's acceleration.
    pub acceleration: f64,
}

/// The assumed motion and growth of an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotionModel {
    /// Ten dimensions: the centre has an acceleration and the size a velocity (the paper's filter).
    #[default]
    ConstantAcceleration,
    /// Eight dimensions: the centre has an acceleration and the size no velocity (the paper's ablation, "8D CA"). The
    /// paper names its filter so but does not specify its noise; the published code does not contain it. Assumed here:
    /// the same noise on the remaining components. Ten dimensions whose size velocity starts at zero with zero variance
    /// and no process noise are exactly this filter, because that velocity stays zero and correlates with nothing.
    ConstantSize,
}

/// The unit of a measurement's standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasurementUnit {
    /// Pixels, divided by the longer side of the picture after both sides are rounded up to a multiple of 32 (published
    /// code). The noise, and with it τ, then depends on the picture's size.
    PaddedPixels,
    /// Shares of the picture, independent of its size.
    Normalised,
}

/// Noise of a measured box, the same for all four components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasurementNoise {
    /// Standard deviation, in `unit`.
    pub deviation: f64,
    /// Unit of `deviation`.
    pub unit: MeasurementUnit,
}

impl MeasurementNoise {
    /// Returns the variance, in normalised coordinates, in a picture of `size`.
    pub fn variance(self, size: PictureSize) -> f64 {
        let deviation = match self.unit {
            MeasurementUnit::Normalised => self.deviation,
            MeasurementUnit::PaddedPixels => {
                let padded = |side: u32| u64::from(side.max(1)).next_multiple_of(32);
                self.deviation / padded(size.width).max(padded(size.height)) as f64
            }
        };
        deviation * deviation
    }
}

/// All parameters of the filter. The defaults are those of the published code; the paper gives none of them ("fixed
/// implementation parameters").
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterParameters {
    /// Motion model.
    pub motion: MotionModel,
    /// Process noise Q, added per predicted frame.
    pub process: Deviations,
    /// Initial covariance P of an object.
    pub initial: Deviations,
    /// Measurement noise R.
    pub measurement: MeasurementNoise,
}

impl Default for FilterParameters {
    fn default() -> Self {
        Self {
            motion: MotionModel::ConstantAcceleration,
            process: Deviations {
                center: 0.003,
                size: 0.002,
                center_velocity: 0.002,
                size_velocity: 0.002,
                acceleration: 0.001,
            },
            initial: Deviations {
                center: 0.01,
                size: 0.005,
                center_velocity: 0.005,
                size_velocity: 0.005,
                acceleration: 0.001,
            },
            measurement: MeasurementNoise {
                deviation: 5.0,
                unit: MeasurementUnit::PaddedPixels,
            },
        }
    }
}

/// The squared [`FilterParameters`] for one picture size, as used by [`Filter`](super::Filter).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterModel {
    /// Variances of the process noise Q.
    pub process: Deviations,
    /// Variances of a new object.
    pub initial: Deviations,
    /// Variance of each component of a measurement.
    pub measurement: f64,
}

impl FilterModel {
    /// Creates the model for pictures of `size`.
    pub fn new(parameters: &FilterParameters, size: PictureSize) -> Self {
        let variances = |deviations: Deviations| Deviations {
            center: deviations.center.powi(2),
            size: deviations.size.powi(2),
            center_velocity: deviations.center_velocity.powi(2),
            size_velocity: match parameters.motion {
                MotionModel::ConstantAcceleration => deviations.size_velocity.powi(2),
                MotionModel::ConstantSize => 0.0,
            },
            acceleration: deviations.acceleration.powi(2),
        };
        Self {
            process: variances(parameters.process),
            initial: variances(parameters.initial),
            measurement: parameters.measurement.variance(size),
        }
    }
}
