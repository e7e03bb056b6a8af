//! A node: its configuration, the live board its cameras write, and a camera's loop from frame to
//! published detections.

pub mod board;
pub mod config;
