//! albireo's pure floors, compiled from the same files as the service but without its dependencies, and
//! what the benches beside other trackers share.
//!
//! That this compiles also shows that these files know nothing but numbers.
#![allow(dead_code)]
#![allow(unused_imports)]

#[path = "../../../src/detection.rs"]
pub mod detection;
#[path = "../../../src/geometry.rs"]
pub mod geometry;
#[path = "../../../src/kalman/mod.rs"]
pub mod kalman;
#[path = "../../../src/objects/mod.rs"]
pub mod objects;
#[path = "../../../src/policy/mod.rs"]
pub mod policy;

#[path = "../../../src/eval/average_precision.rs"]
pub mod average_precision;

pub mod scene;
