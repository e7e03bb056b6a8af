//! The evaluation: data sets, replay of any policy over them, average precision, statistics, reports.
//!
//! `albireo eval` answers what frame skipping costs in accuracy and what it saves. It drives the very
//! policies the node runs, on stored detections or on pictures.

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
pub mod replay;
pub mod report;
pub mod result;
pub mod run;
pub mod scoring;
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
