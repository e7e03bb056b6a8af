//! Execution providers: the configured list, in order, without a silent fallback.

use super::{GpuConfig, SessionSettings, StartError};
use ort::ep::{ArenaExtendStrategy, CUDA, ExecutionProviderDispatch, TensorRT};
use ort::memory::{AllocationDevice, Allocator, AllocatorType, MemoryInfo, MemoryType};
use ort::session::Session;
use serde::{Deserialize, Serialize};
use tracing::warn;

/// An execution provider of ONNX Runtime.
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
    /// Its name in configuration and reports.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::TensorRt => "tensorrt",
            Self::Cuda => "cuda",
            Self::Cpu => "cpu",
        }
    }
}

/// The providers that ONNX Runtime registers for `provider`; none for the CPU, which is always there. TensorRT leaves
/// to CUDA what it cannot run, and is nowhere without it. By default, ONNX Runtime would continue without a provider that
/// it cannot register.
pub(super) fn registrations(
    provider: ExecutionProvider,
    settings: &SessionSettings,
) -> Vec<ExecutionProviderDispatch> {
    let gpu = &settings.gpu;
    match provider {
        ExecutionProvider::Cpu => Vec::new(),
        ExecutionProvider::Cuda => {
            let options = cuda(gpu).with_cuda_graph(gpu.cuda_graph);
            vec![options.build().error_on_failure()]
        }
        ExecutionProvider::TensorRt => vec![
            tensorrt(settings).build().error_on_failure(),
            cuda(gpu).build().error_on_failure(),
        ],
    }
}

/// The memory in which `provider` runs a session.
pub(super) fn memory(
    provider: ExecutionProvider,
    gpu: &GpuConfig,
    session: &Session,
) -> ort::Result<Allocator> {
    if provider == ExecutionProvider::Cpu {
        return Ok(Allocator::default());
    }
    let on_device = MemoryInfo::new(
        AllocationDevice::CUDA,
        gpu.device.cast_signed(),
        AllocatorType::Device,
        MemoryType::Default,
    )?;
    Allocator::new(session, on_device)
}

fn cuda(gpu: &GpuConfig) -> CUDA {
    let cuda = CUDA::default().with_device_id(gpu.device.cast_signed());
    match gpu.memory_limit() {
        Some(limit) => cuda
            .with_memory_limit(limit)
            // By default the arena grows by doubling, beyond half the limit with the first large model.
            .with_arena_extend_strategy(ArenaExtendStrategy::SameAsRequested),
        None => cuda,
    }
}

fn tensorrt(settings: &SessionSettings) -> TensorRT {
    let gpu = &settings.gpu;
    let mut tensorrt =
        TensorRT::default().with_device_id(gpu.device.cast_signed()).with_fp16(gpu.fp16);
    if gpu.fp16 {
        // Their sums of squares exceed what half precision holds, and boxes of transformers are lost.
        tensorrt = tensorrt.with_layer_norm_fp32_fallback(true);
    }
    if let Some(limit) = gpu.memory_limit() {
        tensorrt = tensorrt.with_max_workspace_size(limit);
    }
    if let Some(shapes) = &settings.shapes {
        tensorrt = tensorrt
            .with_profile_min_shapes(&shapes.least)
            .with_profile_opt_shapes(&shapes.usual)
            .with_profile_max_shapes(&shapes.most);
    }
    if let Some(engines) = &settings.engines {
        // Timings are those of layers on this GPU, whatever model they are from.
        tensorrt = tensorrt
            .with_engine_cache(true)
            .with_engine_cache_path(engines.folder().display())
            .with_timing_cache(true)
            .with_timing_cache_path(engines.root().display());
    }
    tensorrt
}

/// Tries `attempt` with each of `providers` in order and returns what it makes of the first that works. Logs those that
/// do not.
///
/// # Errors
/// The error of `attempt` for the last provider, or that there is none.
pub(super) fn first_that_works<T>(
    providers: &[ExecutionProvider],
    mut attempt: impl FnMut(ExecutionProvider) -> Result<T, StartError>,
) -> Result<T, StartError> {
    let mut last_error = StartError::configuration(
        "detector.providers",
        "the list is empty; [\"cpu\"] works everywhere",
    );
    for (index, &provider) in providers.iter().enumerate() {
        match attempt(provider) {
            Ok(works) => {
                if index > 0 {
                    warn!(
                        first = providers[0].as_str(),
                        used = provider.as_str(),
                        "fell back to another execution provider of detector.providers"
                    );
                }
                return Ok(works);
            }
            Err(error) => {
                warn!(provider = provider.as_str(), %error, "execution provider not usable");
                last_error = error;
            }
        }
    }
    Err(last_error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::StartErrorKind;
    use ExecutionProvider::{Cpu, Cuda, TensorRt};

    /// An attempt that works with any provider but TensorRT.
    fn without_tensorrt(provider: ExecutionProvider) -> Result<ExecutionProvider, StartError> {
        match provider {
            TensorRt => Err(StartError::new(
                StartErrorKind::Provider,
                "`tensorrt` is not here",
            )),
            works => Ok(works),
        }
    }

    #[test]
    fn providers_are_tried_in_their_order_until_one_works() {
        let mut tried = Vec::new();
        let found = first_that_works(&[TensorRt, Cuda, Cpu], |provider| {
            tried.push(provider);
            without_tensorrt(provider)
        });
        assert_eq!(found.unwrap(), Cuda);
        assert_eq!(tried, [TensorRt, Cuda]);
    }

    #[test]
    fn if_no_provider_works_the_error_is_that_of_the_attempt() {
        let error = first_that_works(&[TensorRt], without_tensorrt).unwrap_err().to_string();
        assert!(error.contains("`tensorrt`"), "{error}");
    }

    #[test]
    fn an_empty_list_of_providers_is_an_error_that_names_its_key() {
        let error = first_that_works(&[], without_tensorrt).unwrap_err().to_string();
        assert!(error.contains("detector.providers"), "{error}");
    }
}
