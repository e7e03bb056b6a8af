//! The detector: ONNX Runtime session, output heads, execution providers, and the task all cameras share.

mod class_names;
mod classes;
mod config;
mod error;
mod gpu;
mod handle;
pub mod head;
mod head_name;
mod metadata;
mod model;
mod network;
mod onnxruntime;
mod preparation;
mod provider;
mod session;
mod sessions;
mod signature;
mod status;
pub mod task;

pub use class_names::COCO_CLASSES;
pub(crate) use config::LONGEST_TIMEOUT_MS;
pub use config::{ClassNames, DetectorConfig, ExecutionProvider};
pub use error::{InferenceError, RunError, StartError};
pub use gpu::GpuConfig;
pub use handle::{Detected, DetectorCounters, DetectorHandle, DetectorMeter, Found};
pub use head_name::HeadName;
pub use metadata::Metadata;
pub use model::{CameraSlot, Interrupter, Model};
pub use network::{HeadCounts, Network};
pub(crate) use preparation::prepare_off_thread;
pub use preparation::{Preparation, PreparedPicture};
pub(crate) use session::{OnnxSession, SessionSettings};
pub(crate) use sessions::end_all_sessions;
pub(crate) use signature::shape_text;
pub use signature::{ElementType, PictureInput, Signature, TensorSpec};
pub use status::DetectorStatus;
