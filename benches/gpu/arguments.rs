//! Defines the command line.

use albireo_vision::detector::{DetectorConfig, ExecutionProvider, GpuConfig};
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// Measures the node on one GPU, piece by piece, and writes the page after each. A further run goes on with the pieces
/// that are missing. `make gpu` calls it.
#[derive(clap::Parser)]
#[command(name = "cargo bench --bench gpu --")]
pub(crate) struct Arguments {
    /// Provider that runs the models; `cpu` is a trial of this script and marked as such.
    #[arg(long, value_enum, default_value_t = ExecutionProvider::Cuda)]
    pub provider: ExecutionProvider,
    /// ONNX file of a detector; repeatable. Default: YOLOX-Nano.
    #[arg(long = "model", value_name = "FILE")]
    models: Vec<PathBuf>,
    /// ONNX file of the detector for the trials with cameras; repeatable. It must detect the objects in the pictures,
    /// or nothing is tracked and nothing can be skipped. Default: YOLOX-Nano.
    #[arg(long = "camera-model", value_name = "FILE")]
    camera_models: Vec<PathBuf>,
    /// Number of the GPU in CUDA and NVML.
    #[arg(long, default_value_t = 0)]
    pub device: u32,
    /// Runs per entry in a table of times.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    pub runs: u16,
    /// Seconds for which cameras send in each trial, after one second of warm-up.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    pub seconds: u16,
    /// Largest number of cameras to try.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u16).range(1..))]
    pub most_cameras: u16,
    /// Policy for the trials with cameras, as `NAME` or `NAME=THRESHOLD`; repeatable.
    #[arg(long = "policy", default_values = ["vanilla", "albireo", "expected-loss"])]
    pub policies: Vec<Policy>,
    /// Longest time for one piece, seconds. TensorRT needs minutes for its engines.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(10..))]
    pub limit: u64,
    /// Output file of the page. Beside it, in a file that ends in .json, is what was measured until all pieces are.
    #[arg(long, value_name = "FILE", default_value = "benches/gpu.md")]
    pub out: PathBuf,
    /// Measures everything anew, also what an earlier run has left.
    #[arg(long)]
    pub again: bool,
    /// Date for the page.
    #[arg(long, default_value = "undated")]
    pub date: String,
    /// Passed by `cargo bench`; has no effect.
    #[arg(long, hide = true)]
    bench: bool,
    /// Measures one piece, in JSON, and prints the result; each piece has a process of its own.
    #[arg(long, hide = true)]
    pub piece: Option<String>,
    /// Folder of the caches of CUDA and TensorRT that the pieces share.
    #[arg(long, hide = true, default_value = ".")]
    pub engines: PathBuf,
}

/// A policy of a node, with a threshold other than its default if there is one.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Policy {
    pub name: String,
    pub threshold: Option<f64>,
}

impl FromStr for Policy {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (name, threshold) = match text.split_once('=') {
            None => (text, None),
            Some((name, value)) => {
                let threshold = value.parse();
                let threshold =
                    threshold.map_err(|_| format!("the threshold `{value}` is no number"))?;
                (name, Some(threshold))
            }
        };
        Ok(Self {
            name: name.to_owned(),
            threshold,
        })
    }
}

impl std::fmt::Display for Policy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.name)?;
        match self.threshold {
            Some(threshold) => write!(f, " {threshold}"),
            None => Ok(()),
        }
    }
}

impl Arguments {
    /// The detectors to measure.
    pub(crate) fn models(&self) -> anyhow::Result<Vec<PathBuf>> {
        or_default(&self.models)
    }

    /// The detectors for the trials with cameras.
    pub(crate) fn camera_models(&self) -> anyhow::Result<Vec<PathBuf>> {
        or_default(&self.camera_models)
    }

    /// The longest time for one piece.
    pub(crate) fn limit(&self) -> Duration {
        Duration::from_secs(self.limit)
    }

    /// A detector that fails if the provider is missing, with engines from the caches that all pieces share.
    pub(crate) fn detector(&self, model: &Path) -> DetectorConfig {
        self.detector_with(model, Some(&self.engines))
    }

    /// The same with other caches, or none. No other provider is listed: it would answer while TensorRT builds its engine.
    pub(crate) fn detector_with(&self, model: &Path, engines: Option<&Path>) -> DetectorConfig {
        DetectorConfig {
            model: model.to_owned(),
            providers: vec![self.provider],
            gpu: GpuConfig {
                device: self.device,
                engine_cache: engines.map(Path::to_owned),
                ..GpuConfig::default()
            },
            // The first runs of a large model may take seconds.
            timeout_ms: 60_000,
            ..DetectorConfig::default()
        }
    }

    /// Returns `true` if the figures are those of a GPU.
    pub(crate) fn is_gpu(&self) -> bool {
        self.provider != ExecutionProvider::Cpu
    }
}

fn or_default(models: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let models = match models {
        [] => vec![PathBuf::from("models/yolox_nano.onnx")],
        models => models.to_vec(),
    };
    if let Some(missing) = models.iter().find(|model| !model.is_file()) {
        bail!("the model {} is not here", missing.display());
    }
    Ok(models)
}

/// The name of a file, for tables.
pub(crate) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The text of an error with the model's file name instead of its path on this machine.
pub(crate) fn without_folder(said: impl std::fmt::Display, model: &Path) -> String {
    said.to_string().replace(&model.display().to_string(), &name_of(model))
}

/// The ONNX Runtime library from the file or folder in `ORT_DYLIB_PATH`, else from `.cache/onnxruntime`.
pub(crate) fn library() -> anyhow::Result<PathBuf> {
    let place = match std::env::var_os("ORT_DYLIB_PATH") {
        Some(named) if !named.is_empty() => PathBuf::from(named),
        _ => PathBuf::from(".cache/onnxruntime"),
    };
    if place.is_file() {
        return Ok(place);
    }
    let entries = std::fs::read_dir(&place).with_context(|| place.display().to_string())?;
    let libraries = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| name_of(path).starts_with("libonnxruntime.so"));
    // The last by name, which is the newest of several versions.
    let newest = libraries.max();
    newest.with_context(|| format!("no libonnxruntime.so in {}", place.display()))
}
