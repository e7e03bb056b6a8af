//! To be built.
pub mod eval;
