//! Defines the command line.

use anyhow::Context;
use std::path::{Path, PathBuf};

/// Time of each stage between a JPEG picture and published detections, on this machine.
#[derive(clap::Parser)]
#[command(name = "cargo bench --bench stages --")]
pub(crate) struct Arguments {
    /// ONNX file of a detector; repeatable.
    #[arg(
        long = "model",
        value_name = "FILE",
        default_value = "models/yolox_nano.onnx"
    )]
    pub models: Vec<PathBuf>,
    /// Folder of JPEG files; without it the demonstration's road, 640x360.
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
    /// Pictures per round.
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..))]
    pub frames: u16,
    /// Rounds. In each, albireo, Python and the loops take turns.
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u16).range(1..))]
    pub rounds: u16,
    /// Threads of ONNX Runtime; 0 for one less than the number of cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// A Python with numpy, opencv-python and onnxruntime, which runs the same path.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
    /// Passed by `cargo bench`; has no effect.
    #[arg(long, hide = true)]
    bench: bool,
}

impl Arguments {
    /// The number of threads of ONNX Runtime, at least 1.
    pub(crate) fn threads(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, |cores| (cores.get() - 1).max(1)),
            threads => threads,
        }
    }
}

/// The load average of the last minute, if the machine reports it.
pub(crate) fn load_average() -> Option<String> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next().map(ToOwned::to_owned)
}

/// The name of a file, for headings.
pub(crate) fn file_name(path: &Path) -> anyhow::Result<String> {
    let name = path.file_name().context("the model has no file name")?;
    Ok(name.to_string_lossy().into_owned())
}
