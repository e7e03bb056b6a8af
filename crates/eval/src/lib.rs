//! Evaluates policies on recordings: reads data sets, replays policies, computes accuracy, and writes reports.
//!
//! `albireo eval` answers what frame skipping costs in accuracy and what it saves. It runs the same policy code as the
//! node, on stored detections or on pictures.

pub mod advise;
pub mod against_detector;
pub mod average_precision;
pub mod compare;
pub mod conclusion;
pub mod data;
pub mod energy_model;
pub mod error;
pub mod files;
pub mod footage;
pub mod pictures;
mod replay;
pub mod report;
pub mod result;
pub mod run;
mod scoring;
pub mod source;
pub mod spec;
pub mod statistics;
pub mod streams;
pub mod summary;
pub mod table;
pub mod text;
pub mod trace;
pub mod tracking;
pub mod worst;
