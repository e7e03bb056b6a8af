//! ONNX models on ONNX Runtime: the library, sessions and their execution providers, a model's signature and metadata.

mod conversion;
mod engine_cache;
mod error;
pub(crate) mod fault;
mod file_kind;
mod gpu;
mod graph;
mod metadata;
mod onnxruntime;
mod provider;
mod recorded;
mod session;
mod signature;
mod waiting;

pub(crate) use engine_cache::{EngineCache, last_build};
pub use error::{StartError, StartErrorKind};
pub use gpu::GpuConfig;
pub use graph::external_files;
pub(crate) use graph::has_half_weights;
pub use metadata::Metadata;
#[cfg(test)]
pub(crate) use metadata::tests::metadata;
pub use onnxruntime::find_library;
pub use provider::ExecutionProvider;
pub(crate) use session::NOT_RECORDED;
pub use session::{OnnxSession, SessionSettings, ShapeRange, TensorView};
pub(crate) use signature::shape_text;
pub use signature::{ElementType, PictureInput, Signature, TensorSpec};
