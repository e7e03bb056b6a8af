//! The detector: ONNX Runtime session, output heads, execution providers, and the task all cameras share.

mod class_names;
mod config;
mod error;
mod handle;
pub mod head;
mod model;
mod network;
mod onnxruntime;
mod provider;
mod session;
mod signature;
mod status;
pub mod task;

pub use class_names::COCO_CLASSES;
pub use config::{DetectorConfig, ExecutionProvider, HeadName};
pub use error::{InferenceError, ModelError, StartError};
pub use handle::{Detected, DetectorCounters, DetectorHandle, Found};
pub use model::{CameraSlot, Interrupter, Model};
pub use network::HeadCounts;
pub(crate) use session::{OnnxSession, SessionSettings};
pub use signature::{Signature, TensorSpec};
pub use status::DetectorStatus;
