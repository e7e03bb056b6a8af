//! The detector: a model, the head that reads its output, its classes, and the task all cameras share.

mod class_names;
mod classes;
mod config;
mod handle;
pub mod head;
mod head_name;
mod heads;
mod inputs;
mod network;
mod open_outputs;
mod opening;
mod precision;
mod preparation;
mod reader;

pub use crate::onnx::{ExecutionProvider, GpuConfig, StartError};
pub use crate::worker::{Announcement, ModelStatus, RunError};
pub use class_names::are_of_coco;
pub use classes::named_classes;
pub use config::{ClassNames, DetectorConfig};
pub use handle::{Detected, DetectorHandle, EngineBuild, SpareTurn};
pub use head_name::{HeadName, HeadSetting};
pub use inputs::{Agreement, Choice, InputUse, ModelInput, OpenSides, PaddedInput, USUAL_PICTURE};
pub use network::{DetectorNetwork, Found};
pub use precision::{
    Precision, PrecisionError, PrecisionProof, ProviderAgreement, compare_with_cpu,
};
pub(crate) use preparation::prepare_off_thread;
pub use preparation::{Preparation, PreparedPicture};
pub use reader::{HeadCounts, HeadMeter};

/// A camera that shares a detector with others, by its place in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraSlot(pub usize);
