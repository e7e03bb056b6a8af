//! The `[detector]` section of the configuration.

use super::class_names::listed_as;
use super::head::HeadOverrides;
use super::{ExecutionProvider, GpuConfig, HeadSetting, StartError};
use crate::onnx::SessionSettings;
use crate::picture::{ColorOrder, Fit, ValueRange};
use albireo_core::geometry::PictureSize;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The longest time limit that can be set: one day.
pub(crate) const LONGEST_TIMEOUT_MS: u64 = 24 * 3600 * 1000;

/// The source of a model's class names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ClassNames {
    /// A text file, one name per line; or `coco` or `coco91`, the lists of that data set.
    File(PathBuf),
    /// The names, in the order of the model's class numbers.
    List(Vec<String>),
}

impl ClassNames {
    /// The file that they are read from; `None` for a list, and for `coco` and `coco91` unless a file has that name.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) if listed_as(path).is_none() => Some(path),
            _ => None,
        }
    }
}

/// The detector: its model, the head that reads the output, and the providers that run it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorConfig {
    /// The ONNX file.
    pub model: PathBuf,
    /// The head that reads its output.
    pub head: HeadSetting,
    /// Columns and rows of the input, for a model that leaves them open: the most, of which pictures get what they need.
    /// Default: those of its metadata.
    pub input_size: Option<[u32; 2]>,
    /// The range of the input's values, of a model that does not take bytes. Default: as the head's models are trained.
    pub range: Option<ValueRange>,
    /// The order of the input's colours. Default: as the head's models are trained.
    pub color_order: Option<ColorOrder>,
    /// The way a picture is fitted to the input. Default: as the head's models are trained.
    pub fit: Option<Fit>,
    /// Names of the model's classes. Default: those of its metadata, else the list that belongs to its head if it is as
    /// long (80: COCO; 91: COCO's category numbers).
    pub class_names: Option<ClassNames>,
    /// Other names for classes: from the model's name to the reported one. Several may get the same new name.
    pub class_map: BTreeMap<String, String>,
    /// Names of the classes to report; an empty list for all of the model. Default: all, or the seven of BDD100K if the
    /// model's classes are COCO's eighty.
    pub report_classes: Option<Vec<String>>,
    /// Detections below this confidence are dropped (paper: 0.5).
    pub confidence: f64,
    /// Non-maximum suppression drops a box that overlaps a better one of its class more than this. Without effect on
    /// models that output final boxes.
    pub suppression_overlap: f64,
    /// The maximum number of detections per frame; the most confident ones stay. Not a node setting.
    #[serde(skip)]
    pub most_detections: usize,
    /// Execution providers in order of preference. The first that works is used; a list of one has no fallback.
    pub providers: Vec<ExecutionProvider>,
    /// True if the providers after TensorRT answer while it builds its engine. What is measured waits for the engine. Not a
    /// node setting: a node answers.
    #[serde(skip)]
    pub answers_while_building: bool,
    /// Settings of the GPU providers.
    pub gpu: GpuConfig,
    /// Threads that ONNX Runtime uses within a run; 0 for one fewer than the machine has cores.
    pub threads: usize,
    /// A frame whose run takes longer is answered by prediction.
    pub timeout_ms: u64,
    /// The maximum number of frames in a run, each from another camera; more than 1 only for a model with an open
    /// batch.
    pub batch_size: usize,
    /// The share of its threshold that a camera's policy may fall short of, and still call the detector, if a run is about to
    /// begin for another camera and has room: with 0.3, from 70 % of the threshold on. 0 for never.
    pub join: f64,
    /// The longest time that a frame waits for frames of other cameras, from its request: it waits only for those that are
    /// announced or likely to come, and no longer than a run takes. Not a node setting.
    #[serde(skip)]
    pub batch_wait_ms: u64,
    /// The ONNX Runtime library; if empty, it is searched for in `ORT_DYLIB_PATH`, beside the program, in
    /// `.cache/onnxruntime`, and in the system's library folders.
    pub onnxruntime: Option<PathBuf>,
}

impl Default for DetectorConfig {
    fn default() -> Self {
        Self {
            model: PathBuf::from("models/yolox_nano.onnx"),
            head: HeadSetting::default(),
            input_size: None,
            range: None,
            color_order: None,
            fit: None,
            class_names: None,
            class_map: BTreeMap::new(),
            report_classes: None,
            confidence: 0.5,
            suppression_overlap: 0.45,
            most_detections: 300,
            providers: vec![ExecutionProvider::Cpu],
            answers_while_building: false,
            gpu: GpuConfig::default(),
            threads: 0,
            timeout_ms: 2000,
            batch_size: 1,
            join: 0.0,
            batch_wait_ms: 50,
            onnxruntime: None,
        }
    }
}

impl DetectorConfig {
    /// The configured size for an open input.
    pub(crate) fn input_size(&self) -> Option<PictureSize> {
        self.input_size.map(|[width, height]| PictureSize::new(width, height))
    }

    /// The file of the model, and what runs it.
    pub fn session_settings(&self) -> SessionSettings {
        SessionSettings {
            model: self.model.clone(),
            providers: self.providers.clone(),
            gpu: self.gpu.clone(),
            threads: self.threads,
            onnxruntime: self.onnxruntime.clone(),
            shapes: None,
            engines: None,
        }
    }

    /// How the model wants its pictures, where that is configured.
    pub(super) fn overrides(&self) -> HeadOverrides {
        HeadOverrides {
            value_range: self.range,
            color_order: self.color_order,
            fit: self.fit,
        }
    }

    /// Returns every problem that can be found without opening a file: the key within `[detector]`, and the reason.
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
        let reason = format!("must be a number from 0 to 0.9, not {}", self.join);
        check("join", (0.0..=0.9).contains(&self.join), reason);
        let reason = "has no effect while a run takes one frame: set detector.batch_size, too";
        check(
            "join",
            self.join == 0.0 || self.batch_size > 1,
            reason.to_owned(),
        );
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
            let reason = format!("`{}` is listed twice", provider.as_str());
            check("providers", is_new, reason);
        }
        problems
    }

    /// Returns the first of the [`problems`](Self::problems) as an error.
    ///
    /// # Errors
    /// The first key with an invalid value.
    pub fn check(&self) -> Result<(), StartError> {
        match self.problems().into_iter().next() {
            None => Ok(()),
            Some((key, reason)) => Err(StartError::configuration(
                format_args!("detector.{key}"),
                reason,
            )),
        }
    }
}
