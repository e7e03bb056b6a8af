//! To be built.

pub mod synth;
