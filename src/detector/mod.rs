//! The detector: ONNX Runtime session, output heads, execution providers, and the task all cameras share.

mod config;
mod status;

pub use config::{DetectorConfig, ExecutionProvider, HeadName};
pub use status::DetectorStatus;
