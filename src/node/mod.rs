//! A node: its configuration, the live board its cameras write, and a camera's loop from frame to
//! published detections.

mod answer;
pub mod board;
mod camera;
pub mod config;
mod counters;
mod intake;
mod rate_limit;
mod report;
mod senses;
pub mod session;
mod spool;
mod start;
mod threshold;

pub use answer::{AnswerContext, detections_message};
pub use start::{Node, PreparedNode};
