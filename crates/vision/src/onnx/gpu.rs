//! The `[detector.gpu]` section of the configuration: settings of CUDA and TensorRT.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of the `cuda` and `tensorrt` execution providers; without effect on `cpu`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GpuConfig {
    /// The GPU's number, as CUDA counts. Not a node setting: `CUDA_VISIBLE_DEVICES` chooses.
    #[serde(skip)]
    pub device: u32,
    /// The maximum GPU memory for CUDA's arena, and for TensorRT's workspace while it builds an engine, in MiB; 0 for
    /// no limit. Not a node setting.
    #[serde(skip)]
    pub memory_limit_mib: u32,
    /// True if the processor converts pictures to the model's input for a GPU, too, to compare the two. Not a node setting.
    #[serde(skip)]
    pub processor_converts: bool,
    /// True if the processor may spin while it waits for the GPU, as CUDA chooses: an answer comes some hundredths of a
    /// millisecond sooner, and a core is busy as long as the model runs. Otherwise it sleeps, in the whole program, from
    /// the first session that does not spin.
    pub spin: bool,
    /// True if CUDA records what a run does, once for each input it is warmed up with, and replays it: the processor starts
    /// a recorded run in one call, and another one layer by layer, of which the log warns once for each shape. TensorRT, which
    /// merges layers, records nothing.
    pub cuda_graph: bool,
    /// True if TensorRT may compute in half precision, normalisation of layers excepted. It does so for a model whose own
    /// weights are in half precision, too.
    pub fp16: bool,
    /// The folder in which TensorRT keeps the engines and tactics it has built, minutes of work each, for the next
    /// start. Without it they are built at every start.
    pub engine_cache: Option<PathBuf>,
}

impl GpuConfig {
    /// The memory limit in bytes, if there is one.
    pub(crate) fn memory_limit(&self) -> Option<usize> {
        let bytes = usize::try_from(self.memory_limit_mib).ok()? << 20;
        (bytes > 0).then_some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_memory_limit_is_in_mebibytes_and_zero_is_none() {
        let mut gpu = GpuConfig::default();
        assert_eq!(gpu.memory_limit(), None);
        gpu.memory_limit_mib = 512;
        assert_eq!(gpu.memory_limit(), Some(512 * 1024 * 1024));
    }
}
