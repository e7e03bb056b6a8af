//! One ONNX Runtime session: from a file to something that takes a tensor and gives tensors.

use super::head::TensorView;
use super::model::Interrupter;
use super::{ExecutionProvider, ModelError, Signature, StartError, TensorSpec};
use super::{onnxruntime, provider};
use crate::geometry::PictureSize;
use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::session::{RunOptions, Session};
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tracing::warn;

/// What a session is made from.
#[derive(Clone, Debug)]
pub(crate) struct SessionSettings {
    /// ONNX file.
    pub(crate) model: PathBuf,
    /// In order of preference.
    pub(crate) providers: Vec<ExecutionProvider>,
    /// Whether a later one may stand in for the first.
    pub(crate) may_fall_back: bool,
    /// Threads inside one run; 0 for one less than the machine has cores.
    pub(crate) threads: usize,
    /// The library, if it is named.
    pub(crate) onnxruntime: Option<PathBuf>,
}

/// A loaded model with what runs it.
pub(crate) struct OnnxSession {
    session: Session,
    options: Arc<RunOptions>,
    signature: Signature,
    provider: ExecutionProvider,
}

impl OnnxSession {
    /// Loads the model with the first execution provider that works.
    ///
    /// # Errors
    /// When there is no library, no readable model, or no provider as configured.
    pub(crate) fn open(settings: &SessionSettings) -> Result<Self, StartError> {
        // Told apart from what ONNX Runtime says of a damaged model.
        if let Err(error) = std::fs::File::open(&settings.model) {
            return Err(StartError::ModelUnreadable {
                path: settings.model.clone(),
                reason: error.to_string(),
            });
        }
        let environment = onnxruntime::environment(settings.onnxruntime.as_deref())?;
        provider::first_that_works(&settings.providers, settings.may_fall_back, |provider| {
            Self::open_with(&environment, settings, provider)
        })
    }

    fn open_with(
        environment: &Environment,
        settings: &SessionSettings,
        provider: ExecutionProvider,
    ) -> Result<Self, StartError> {
        let refused = |reason: String| refusal(&settings.model, provider, reason);
        let session = build(environment, settings, provider)
            .map_err(|error| refused(error.message().to_owned()))?;
        let options = RunOptions::new().map_err(|error| refused(error.message().to_owned()))?;
        let signature = Signature {
            inputs: session.inputs().iter().map(spec).collect(),
            outputs: session.outputs().iter().map(spec).collect(),
        };
        Ok(Self {
            session,
            options: Arc::new(options),
            signature,
            provider,
        })
    }

    /// Names, types and shapes of the model's inputs and outputs.
    pub(crate) fn signature(&self) -> &Signature {
        &self.signature
    }

    /// What runs it.
    pub(crate) fn provider(&self) -> ExecutionProvider {
        self.provider
    }

    /// Asks a run in progress to end at the next node of the graph.
    pub(crate) fn interrupter(&self) -> Interrupter {
        let options = self.options.clone();
        Arc::new(move || {
            if let Err(error) = options.terminate() {
                warn!(%error, "a run could not be asked to end");
            }
        })
    }

    /// Runs the model on one picture: `planes` are three planes of `size`. `read` gets the outputs in the
    /// order of the signature.
    ///
    /// # Errors
    /// When ONNX Runtime fails, or an output is not float32.
    pub(crate) fn run<R>(
        &mut self,
        size: PictureSize,
        planes: &[f32],
        read: impl FnOnce(&[TensorView<'_>]) -> R,
    ) -> Result<R, ModelError> {
        let shape = [1, 3, i64::from(size.height), i64::from(size.width)];
        let failed = |error: ort::Error| ModelError(error.message().to_owned());
        let input = TensorRef::from_array_view((shape, planes)).map_err(failed)?;
        let outputs = self
            .session
            .run_with_options(ort::inputs![input], &*self.options)
            .map_err(failed)?;
        let views = (0..outputs.len())
            .map(|index| {
                outputs[index]
                    .try_extract_tensor::<f32>()
                    .map(|(shape, values)| TensorView { shape, values })
            })
            .collect::<Result<Vec<_>, _>>()
            .map_err(failed)?;
        Ok(read(&views))
    }
}

fn build(
    environment: &Environment,
    settings: &SessionSettings,
    provider: ExecutionProvider,
) -> ort::Result<Session> {
    let threads = match settings.threads {
        0 => std::thread::available_parallelism().map_or(1, |cores| (cores.get() - 1).max(1)),
        threads => threads,
    };
    let mut builder = Session::builder(environment)?
        .with_log_level(LogLevel::Warning)?
        .with_intra_threads(threads)?
        .with_inter_threads(1)?
        // Threads that spin between runs take the core from the rest of the program.
        .with_intra_op_spinning(false)?;
    if let Some(registration) = provider::registration(provider) {
        builder = builder.with_execution_providers([registration])?;
    }
    builder.commit_from_file(&settings.model)
}

/// A device that is missing shows only when the session is made, so with any other provider than the CPU the
/// provider is named; on the CPU it can only be the model.
fn refusal(model: &Path, provider: ExecutionProvider, reason: String) -> StartError {
    match provider {
        ExecutionProvider::Cpu => StartError::ModelUnreadable {
            path: model.to_owned(),
            reason,
        },
        ExecutionProvider::Cuda | ExecutionProvider::TensorRt => StartError::ProviderUnavailable {
            provider: provider.as_str(),
            reason,
        },
    }
}

fn spec(outlet: &Outlet) -> TensorSpec {
    let (is_float32, element_type, shape) = match outlet.dtype() {
        ValueType::Tensor { ty, shape, .. } => (
            *ty == TensorElementType::Float32,
            if *ty == TensorElementType::Float32 {
                "float32".to_owned()
            } else {
                ty.to_string()
            },
            shape.to_vec(),
        ),
        other => (false, format!("not a tensor ({other})"), Vec::new()),
    };
    TensorSpec {
        name: outlet.name().to_owned(),
        is_float32,
        element_type,
        shape,
    }
}
