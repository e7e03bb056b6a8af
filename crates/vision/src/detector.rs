//! The detector: ONNX Runtime session, output heads, execution providers, and the task all cameras share.

mod class_names;
mod classes;
mod config;
mod error;
pub(crate) mod fault;
mod gpu;
mod handle;
pub mod head;
mod head_name;
mod metadata;
mod network;
mod onnxruntime;
mod preparation;
mod provider;
mod reader;
mod session;
mod sessions;
mod signature;
mod status;

pub use config::{ClassNames, DetectorConfig, ExecutionProvider};
pub use error::{InferenceError, StartError};
pub use gpu::GpuConfig;
pub use handle::{Detected, DetectorHandle, SpareTurn};
pub use head_name::HeadName;
pub use metadata::Metadata;
pub use network::{DetectorNetwork, Found};
pub use onnxruntime::find_library;
pub(crate) use preparation::prepare_off_thread;
pub use preparation::{Preparation, PreparedPicture};
pub use reader::HeadCounts;
pub use session::OnnxSession;
pub use sessions::end_all_sessions;
pub(crate) use signature::shape_text;
pub use signature::{ElementType, PictureInput, Signature, TensorSpec};
pub use status::DetectorStatus;

/// A camera that shares a detector with others, by its place in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraSlot(pub usize);
