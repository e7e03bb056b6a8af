//! The method: per-object Kalman filters, matching, and the policies that decide for each frame whether the detector
//! must run. Numbers in, numbers out: it uses no runtime, clock, file or network, so that other programs can embed it.
//!
//! Start with [`policy`]: a [`policy::Policy`] receives the head of a frame, asks for the evidence that it needs, and
//! returns the frame's state and boxes.

pub mod audit;
pub mod detection;
pub mod flow;
pub mod geometry;
pub mod kalman;
pub mod objects;
pub mod policy;
pub mod target;

/// The README example, which `cargo test --doc` runs.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
