//! What the user may choose.

use albireo_vision::detector::{DetectorConfig, ExecutionProvider, GpuConfig};
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};

/// Measures what one GPU does for the node, and writes a page of it. `make gpu` calls it.
#[derive(clap::Parser)]
#[command(name = "cargo bench --bench gpu --")]
pub(crate) struct Arguments {
    /// What runs the models; `cpu` is a trial of this script and marked as such.
    #[arg(long, value_enum, default_value_t = ExecutionProvider::Cuda)]
    pub provider: ExecutionProvider,
    /// ONNX file of a detector; may be given several times. Without it YOLOX-Nano.
    #[arg(long = "model", value_name = "FILE")]
    models: Vec<PathBuf>,
    /// ONNX file of the detector that cameras are put on; may be given several times. It should have learned what is in the
    /// pictures, or nothing is tracked and nothing can be skipped. Without it YOLOX-Nano.
    #[arg(long = "camera-model", value_name = "FILE")]
    camera_models: Vec<PathBuf>,
    /// Which GPU, as CUDA and NVML number them.
    #[arg(long, default_value_t = 0)]
    pub device: u32,
    /// Runs of each kind in a table of times.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    pub runs: u16,
    /// Seconds for which cameras send in each trial, after one that does not count.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..))]
    pub seconds: u16,
    /// The most cameras that are tried.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u16).range(1..))]
    pub most_cameras: u16,
    /// The page that is written.
    #[arg(long, value_name = "FILE", default_value = "benches/gpu.md")]
    pub out: PathBuf,
    /// Today, for the page.
    #[arg(long, default_value = "undated")]
    pub date: String,
    /// `cargo bench` says so; changes nothing.
    #[arg(long, hide = true)]
    bench: bool,
    /// Makes this program the one that measures the ways into a session, which needs an ONNX Runtime of its own.
    #[arg(long, hide = true)]
    pub ways_of: Option<PathBuf>,
}

impl Arguments {
    /// The detectors to measure.
    pub(crate) fn models(&self) -> anyhow::Result<Vec<PathBuf>> {
        or_default(&self.models)
    }

    /// The detectors that cameras are put on.
    pub(crate) fn camera_models(&self) -> anyhow::Result<Vec<PathBuf>> {
        or_default(&self.camera_models)
    }

    /// A detector that runs as asked or not at all. What TensorRT cannot run of a model goes to CUDA.
    pub(crate) fn detector(&self, model: &Path, engines: Option<&Path>) -> DetectorConfig {
        let mut providers = vec![self.provider];
        if self.provider == ExecutionProvider::TensorRt {
            providers.push(ExecutionProvider::Cuda);
        }
        DetectorConfig {
            model: model.to_owned(),
            providers,
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

    /// Whether the figures are of a GPU.
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

/// A file's name for tables.
pub(crate) fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// What an error says of a model, with the file's name instead of its path on this machine.
pub(crate) fn without_folder(said: impl std::fmt::Display, model: &Path) -> String {
    said.to_string()
        .replace(&model.display().to_string(), &name_of(model))
}

/// The ONNX Runtime library: that of `ORT_DYLIB_PATH`, a file or a folder, else of `.cache/onnxruntime`.
pub(crate) fn library() -> anyhow::Result<PathBuf> {
    let named = std::env::var_os("ORT_DYLIB_PATH").filter(|name| !name.is_empty());
    let place = named.map_or_else(|| PathBuf::from(".cache/onnxruntime"), PathBuf::from);
    if place.is_file() {
        return Ok(place);
    }
    std::fs::read_dir(&place)
        .with_context(|| place.display().to_string())?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| name_of(path).starts_with("libonnxruntime.so"))
        .max()
        .with_context(|| format!("no libonnxruntime.so in {}", place.display()))
}
