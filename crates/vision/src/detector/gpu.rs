//! The `[detector.gpu]` section of the configuration: settings of CUDA and TensorRT.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of the `cuda` and `tensorrt` execution providers; without meaning for `cpu`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GpuConfig {
    /// Which GPU, as CUDA numbers them. No setting of a node: `CUDA_VISIBLE_DEVICES` chooses.
    #[serde(skip)]
    pub device: u32,
    /// The most GPU memory that CUDA's arena, and TensorRT's workspace while it builds an engine, may take, MiB;
    /// 0 for no limit. No setting of a node.
    #[serde(skip)]
    pub memory_limit_mib: u32,
    /// Whether TensorRT may compute in half precision: about twice as fast, and scores move in the third
    /// decimal place.
    pub fp16: bool,
    /// Folder where TensorRT keeps the engines and tactics it has built, minutes of work each, for the next
    /// start. Without it they are built at every start.
    pub engine_cache: Option<PathBuf>,
}

impl Default for GpuConfig {
    fn default() -> Self {
        Self {
            device: 0,
            memory_limit_mib: 0,
            fp16: true,
            engine_cache: None,
        }
    }
}

impl GpuConfig {
    /// The most memory in bytes, if there is a limit.
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
