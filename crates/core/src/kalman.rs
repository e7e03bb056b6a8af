//! The Kalman filter of one object: a box whose centre moves with constant acceleration and whose size changes with
//! constant velocity, in normalised coordinates; its uncertainty τ and its distance to a detection.
//!
//! [`Filter`] is the production filter. `tests/dense.rs` has the same filter in textbook form, with full matrices: slower,
//! easier to read, and the reference for the first.

mod filter;
mod parameters;

pub use filter::{Filter, Gauge};
pub use parameters::{
    Deviations, FilterModel, FilterParameters, MeasurementNoise, MeasurementUnit, MotionModel,
};

#[cfg(test)]
mod tests;
