//! The `[detector]` section of the configuration.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What runs the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExecutionProvider {
    /// NVIDIA TensorRT.
    TensorRt,
    /// NVIDIA CUDA.
    Cuda,
    /// ONNX Runtime's own CPU kernels.
    Cpu,
}

impl ExecutionProvider {
    /// The name in configuration and reports.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::TensorRt => "tensorrt",
            Self::Cuda => "cuda",
            Self::Cpu => "cpu",
        }
    }
}

/// How a model's output tensors are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HeadName {
    /// YOLOX: `[1, cells, 5 + classes]`, not decoded.
    Yolox,
    /// The demonstration detector of `models/`: `[1, cells, 4 + classes]`, decoded.
    Demonstration,
}

/// The detector: which model, how its output is read, and what runs it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorConfig {
    /// ONNX file.
    pub model: PathBuf,
    /// How its output is read.
    pub head: HeadName,
    /// Text file with one class name a line; empty for the head's own list (COCO for YOLOX, BDD100K for
    /// the demonstration detector).
    pub class_names: Option<PathBuf>,
    /// Names of the classes to report; empty for all.
    pub report_classes: Vec<String>,
    /// Detections below this confidence are dropped (paper: 0.5).
    pub confidence: f64,
    /// Non-maximum suppression drops a box that overlaps a better one of its class more than this.
    pub suppression_overlap: f64,
    /// Execution providers in order of preference. The first that works is used.
    pub providers: Vec<ExecutionProvider>,
    /// Whether a later provider of the list may stand in for the first. Otherwise a missing first
    /// provider is an error at start.
    pub may_fall_back: bool,
    /// Threads ONNX Runtime uses inside one run; 0 for one less than the machine has cores.
    pub threads: usize,
    /// A run that takes longer counts as failed and the session is rebuilt.
    pub timeout_ms: u64,
    /// Frames that may wait for the detector, all cameras together.
    pub queue: usize,
    /// The ONNX Runtime library; empty to look at `ORT_DYLIB_PATH`, beside the program, in
    /// `.cache/onnxruntime`, and where the system keeps libraries.
    pub onnxruntime: Option<PathBuf>,
}

impl Default for DetectorConfig {
    fn default() -> Self {
        Self {
            model: PathBuf::from("models/detector.onnx"),
            head: HeadName::Demonstration,
            class_names: None,
            report_classes: Vec::new(),
            confidence: 0.5,
            suppression_overlap: 0.45,
            providers: vec![ExecutionProvider::Cpu],
            may_fall_back: false,
            threads: 0,
            timeout_ms: 2000,
            queue: 8,
            onnxruntime: None,
        }
    }
}
