//! The edge node: frames in, and for each the policy's decision, detections and clip reports out. As a library, with
//! its HTTP routes; [`run`] is the service.

pub mod advice;
pub mod answer;
pub mod audit;
pub mod board;
mod camera;
pub mod clip;
pub mod config;
mod counters;
pub mod detector;
mod error;
mod evidence;
pub mod frame;
pub mod http;
mod intake;
mod key_service;
pub mod name;
pub mod online;
pub mod outbox;
pub mod power;
mod publishing;
mod rate_limit;
pub mod readiness;
mod report;
mod run;
pub mod screen;
pub mod source;
mod start;
pub mod target;
mod threshold;
mod uplink;

pub use error::NodeError;
pub use evidence::{LiveEvidence, PixelWork, Times};
pub use run::{run, run_prepared};
pub use start::{Node, PolicyMaker, PreparedNode};
