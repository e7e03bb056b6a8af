//! The state of a running node.

pub mod advice;
pub mod board;
pub mod readiness;
pub mod target;
