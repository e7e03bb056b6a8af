//! The evaluation: data sets, replay of any policy over them, average precision, statistics, reports.
//!
//! `albireo eval` answers what frame skipping costs in accuracy and what it saves. It drives the very
//! policies the node runs, on stored detections or on pictures.

pub mod average_precision;
pub mod data;
pub mod pareto;
pub mod replay;
pub mod scoring;
pub mod source;
pub mod statistics;
pub mod trace;
