//! Evaluates policies on recordings: reads data sets, replays policies, computes accuracy, and writes reports.
//!
//! `albireo eval` answers what frame skipping costs in accuracy and what it saves. It runs the same policy code as the
//! node, on stored detections or on pictures.
//!
//! The rooms, from the ground up; each uses only those before it:
//!
//! ```text
//! error, statistics, text, boxes | files, footage, export, judge | data, result | energy_model
//! settings | spec | chart | pictures, replay, summary | run | report | board, advise, compare
//! ```

pub mod advise;
pub mod board;
pub mod boxes;
mod chart;
pub mod compare;
pub mod data;
pub mod energy_model;
pub mod error;
pub mod export;
pub mod files;
pub mod footage;
pub mod judge;
pub mod pictures;
pub mod replay;
pub mod report;
pub mod result;
pub mod run;
pub mod settings;
pub mod spec;
pub mod statistics;
pub mod summary;
pub mod text;
