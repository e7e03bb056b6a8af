//! `albireo`: an adaptive efficiency layer around an unchanged video object detector.
//!
//! The rooms of the house, from the ground up. A floor uses only the floors below it; floors 0 and 1
//! know no runtime, no network, no clock and no file.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

// Floor 0: plain values and plain functions.
pub mod detection;
pub mod geometry;
pub mod kalman;

// Floor 1: what decides a frame.
pub mod objects;
pub mod policy;

// Floor 2: the outside world, one room a kind of thing.
pub mod detector;
pub mod frame;
pub mod power;
pub mod screen;
pub mod synth;
pub mod wire;

// Floor 3: a clip's books, and recordings played as a camera would send them.
pub mod clip;
pub mod footage;

// Floor 4: whole jobs.
pub mod eval;
pub mod node;

// Floor 5: how people and programs reach it.
pub mod cli;
pub mod http;
