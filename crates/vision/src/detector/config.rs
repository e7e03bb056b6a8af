//! The `[detector]` section of the configuration.

use super::{GpuConfig, HeadName, StartError};
use albireo_core::geometry::PictureSize;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What runs the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum ExecutionProvider {
    /// NVIDIA TensorRT.
    #[cfg_attr(feature = "cli", value(name = "tensorrt"))]
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

/// The longest time limit that can be set: a day.
pub(crate) const LONGEST_TIMEOUT_MS: u64 = 24 * 3600 * 1000;

/// Where the names of a model's classes are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ClassNames {
    /// In a text file, one per line.
    File(PathBuf),
    /// Here, in the order of the model's class numbers.
    List(Vec<String>),
}

/// The detector: which model, how its output is read, and what runs it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorConfig {
    /// ONNX file.
    pub model: PathBuf,
    /// How its output is read.
    pub head: HeadName,
    /// Columns and rows of the input, for a model that leaves them open; without it those of its metadata.
    pub input_size: Option<[u32; 2]>,
    /// Names of the model's classes. Without them those of its metadata, else the list that belongs to its head
    /// when it is as long (80: COCO; 91: COCO's category numbers).
    pub class_names: Option<ClassNames>,
    /// Other names for classes: the model's name to the one reported. Several may have the same new name.
    pub class_map: BTreeMap<String, String>,
    /// Names of the classes to report; an empty list for all of the model. Without it the seven of BDD100K, or
    /// all when the model has none of these.
    pub report_classes: Option<Vec<String>>,
    /// Detections below this confidence are dropped (paper: 0.5).
    pub confidence: f64,
    /// Non-maximum suppression drops a box that overlaps a better one of its class more than this. Models that
    /// end with finished boxes have no use for it.
    pub suppression_overlap: f64,
    /// The most detections of a frame, the most confident ones. No setting of a node.
    #[serde(skip)]
    pub most_detections: usize,
    /// Execution providers in order of preference. The first that works is used; a list of one has no other.
    pub providers: Vec<ExecutionProvider>,
    /// Settings of a provider on a GPU.
    pub gpu: GpuConfig,
    /// Threads ONNX Runtime uses inside one run; 0 for one less than the machine has cores.
    pub threads: usize,
    /// A run that takes longer is answered by prediction.
    pub timeout_ms: u64,
    /// The most frames that one run of the model takes, each of another camera; more than 1 for a model with an
    /// open batch.
    pub batch_size: usize,
    /// How long a frame waits for those of other cameras to share its run, from being asked. No setting of a node.
    #[serde(skip)]
    pub batch_wait_ms: u64,
    /// The ONNX Runtime library; empty to look at `ORT_DYLIB_PATH`, beside the program, in
    /// `.cache/onnxruntime`, and where the system keeps libraries.
    pub onnxruntime: Option<PathBuf>,
}

impl Default for DetectorConfig {
    fn default() -> Self {
        Self {
            model: PathBuf::from("models/yolox_nano.onnx"),
            head: HeadName::Auto,
            input_size: None,
            class_names: None,
            class_map: BTreeMap::new(),
            report_classes: None,
            confidence: 0.5,
            suppression_overlap: 0.45,
            most_detections: 300,
            providers: vec![ExecutionProvider::Cpu],
            gpu: GpuConfig::default(),
            threads: 0,
            timeout_ms: 2000,
            batch_size: 1,
            batch_wait_ms: 5,
            onnxruntime: None,
        }
    }
}

impl DetectorConfig {
    /// The size that the configuration names for an open input.
    pub(crate) fn input_size(&self) -> Option<PictureSize> {
        self.input_size
            .map(|[width, height]| PictureSize::new(width, height))
    }

    /// Everything that is wrong and can be seen without opening a file: the key within `[detector]`, and what
    /// its value should be.
    pub fn problems(&self) -> Vec<(&'static str, String)> {
        let mut problems = Vec::new();
        let mut check = |key, is_right: bool, reason: String| {
            if !is_right {
                problems.push((key, reason));
            }
        };
        for (key, value) in [
            ("confidence", self.confidence),
            ("suppression_overlap", self.suppression_overlap),
        ] {
            let reason = format!("must be a number from 0 to 1, not {value}");
            check(key, (0.0..=1.0).contains(&value), reason);
        }
        for (key, value, least, most) in [
            ("threads", self.threads as u64, 0, 1024),
            ("timeout_ms", self.timeout_ms, 1, LONGEST_TIMEOUT_MS),
            ("batch_size", self.batch_size as u64, 1, 64),
        ] {
            let reason = format!("must be from {least} to {most}, not {value}");
            check(key, (least..=most).contains(&value), reason);
        }
        if let Some(sides) = self.input_size {
            let is_right = sides.iter().all(|side| (1..=8192).contains(side));
            let reason = format!("sides must be from 1 to 8192, not {sides:?}");
            check("input_size", is_right, reason);
        }
        if let Some(ClassNames::List(names)) = &self.class_names {
            let reason = "is an empty list; leave it out for the model's own names".to_owned();
            check("class_names", !names.is_empty(), reason);
        }
        let reason = "is empty; `[\"cpu\"]` runs everywhere".to_owned();
        check("providers", !self.providers.is_empty(), reason);
        for (place, provider) in self.providers.iter().enumerate() {
            let is_new = !self.providers[..place].contains(provider);
            let reason = format!("`{}` is there twice", provider.as_str());
            check("providers", is_new, reason);
        }
        problems
    }

    /// The first of the [`problems`](Self::problems), as an error.
    ///
    /// # Errors
    /// The first key whose value cannot be.
    pub fn check(&self) -> Result<(), StartError> {
        match self.problems().into_iter().next() {
            None => Ok(()),
            Some((key, reason)) => Err(StartError::Configuration {
                key: format!("detector.{key}"),
                reason,
            }),
        }
    }
}
