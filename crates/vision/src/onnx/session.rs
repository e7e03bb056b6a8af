//! One ONNX Runtime session: loads a model file and runs it on tensors.

use super::{
    ElementType, EngineCache, ExecutionProvider, GpuConfig, Metadata, Signature, StartError,
};
use super::{StartErrorKind, TensorSpec, fault, file_kind, onnxruntime, provider};
use albireo_core::geometry::PictureSize;
use half::f16;
use half::slice::HalfFloatSliceExt;
use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, Outlet, Tensor, TensorElementType, TensorRef, ValueType};
use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Duration;

/// The shapes between which TensorRT must run a model, each for all inputs as `name:1x3x416x416,…`. ONNX Runtime runs only
/// the first optimisation profile of an engine, so there is one for all shapes, built for the usual one
/// (<https://github.com/microsoft/onnxruntime/pull/31624>).
#[derive(Clone, Debug)]
pub struct ShapeRange {
    /// The least of each dimension.
    pub least: String,
    /// The shapes for which the engine is made fast.
    pub usual: String,
    /// The most of each dimension.
    pub most: String,
}

/// The file of a model, and what runs it.
#[derive(Clone, Debug)]
pub struct SessionSettings {
    /// The ONNX file.
    pub model: PathBuf,
    /// Execution providers in order of preference.
    pub providers: Vec<ExecutionProvider>,
    /// Settings of the GPU providers.
    pub gpu: GpuConfig,
    /// Threads within a run; 0 for one fewer than the machine has cores.
    pub threads: usize,
    /// The ONNX Runtime library, if configured.
    pub onnxruntime: Option<PathBuf>,
    /// The shapes that TensorRT is told before it builds an engine; it would build another for each new one.
    pub shapes: Option<ShapeRange>,
    /// Where TensorRT keeps the engines of this model.
    pub(crate) engines: Option<EngineCache>,
}

/// An output tensor as borrowed float32 values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TensorView<'a> {
    /// Its dimensions.
    pub shape: &'a [i64],
    /// Its elements, the last dimension fastest.
    pub values: &'a [f32],
}

/// A loaded model with its execution provider.
pub struct OnnxSession {
    session: Session,
    signature: Signature,
    provider: ExecutionProvider,
    engines: Option<EngineCache>,
    buffers: RunBuffers,
}

/// The pictures of a batch, one after another, in the model's element type; reused from run to run.
#[derive(Default)]
struct RunBuffers {
    floats: Vec<f32>,
    halves: Vec<f16>,
    bytes: Vec<u8>,
}

impl OnnxSession {
    /// Loads the model that `settings` names with the first execution provider that works.
    ///
    /// # Errors
    /// If there is no library, no readable model, or no provider as configured.
    pub fn open(settings: &SessionSettings) -> Result<Self, StartError> {
        Self::open_among(settings, &settings.providers)
    }

    /// [`open`](Self::open) with the first provider of `settings` or none.
    ///
    /// # Errors
    /// As of [`open`](Self::open).
    pub(crate) fn open_with_first(settings: &SessionSettings) -> Result<Self, StartError> {
        Self::open_among(settings, settings.providers.get(..1).unwrap_or_default())
    }

    fn open_among(
        settings: &SessionSettings,
        providers: &[ExecutionProvider],
    ) -> Result<Self, StartError> {
        // Distinguishes an unreadable file and one of another kind from a model that ONNX Runtime finds damaged.
        if let Err(error) = std::fs::File::open(&settings.model) {
            return Err(StartError::unreadable(&settings.model, &error).because(error));
        }
        if let Some(kind) = file_kind::other_kind(&settings.model) {
            return Err(StartError::unreadable(&settings.model, kind));
        }
        let environment = onnxruntime::environment(settings.onnxruntime.as_deref())?;
        provider::first_that_works(providers, |provider| {
            Self::open_with(&environment, settings, provider)
        })
    }

    fn open_with(
        environment: &Environment,
        settings: &SessionSettings,
        provider: ExecutionProvider,
    ) -> Result<Self, StartError> {
        let session = build(environment, settings, provider)
            .map_err(|error| refusal(environment, settings, provider, &in_words(&error)))?;
        let signature = Signature {
            inputs: session.inputs().iter().map(spec).collect(),
            outputs: session.outputs().iter().map(spec).collect(),
            metadata: metadata(&session),
        };
        Ok(Self {
            session,
            signature,
            provider,
            engines: settings.engines.clone(),
            buffers: RunBuffers::default(),
        })
    }

    /// Keeps the time from the start of the build to the end of the first run, if TensorRT has built an engine in it.
    pub(crate) fn was_built_in(&self, took: Duration) {
        if self.provider == ExecutionProvider::TensorRt
            && let Some(engines) = &self.engines
            && !engines.is_built()
        {
            engines.built_in(took);
        }
    }

    /// Names, types and shapes of the model's inputs and outputs.
    pub fn signature(&self) -> &Signature {
        &self.signature
    }

    /// The execution provider that runs the model.
    pub fn provider(&self) -> ExecutionProvider {
        self.provider
    }

    /// Runs the model on `pictures`, each as float32; converts them if the model takes float16 or bytes. `shape` is that
    /// of one picture, and `size` its columns and rows. Further inputs of a model, such as the picture's size, are
    /// filled from `size`. `read` gets the outputs in the order of the signature.
    ///
    /// # Errors
    /// If ONNX Runtime fails: its words.
    pub fn run<R>(
        &mut self,
        mut shape: [i64; 4],
        size: PictureSize,
        pictures: &[&[f32]],
        read: impl FnOnce(&[TensorView<'_>]) -> R,
    ) -> Result<R, String> {
        let failed = |error: ort::Error| in_words(&error);
        let Self {
            session,
            signature,
            buffers,
            ..
        } = self;
        let batch = pictures.len();
        shape[0] = i64::try_from(batch).unwrap_or(i64::MAX);
        let element = signature.picture().map(|input| &input.element);
        let mut picture = Some(buffers.input(element, shape, pictures).map_err(failed)?);
        let mut inputs: Vec<SessionInputValue<'_>> = Vec::with_capacity(signature.inputs.len());
        for input in &signature.inputs {
            match beside(input, size, batch) {
                Some(numbers) => inputs.push(numbers.map_err(failed)?),
                // The signature has been checked: there is one picture.
                None => inputs.extend(picture.take()),
            }
        }
        let outputs = session.run(inputs.as_slice()).map_err(failed)?;
        let read_out: Vec<_> = (0..outputs.len()).map(|index| elements(&outputs[index])).collect();
        let views: Vec<_> =
            read_out.iter().map(|(shape, values)| TensorView { shape, values }).collect();
        Ok(read(&views))
    }
}

impl RunBuffers {
    /// The input of `pictures` in these elements. A single picture in float32 is not copied.
    fn input<'a>(
        &'a mut self,
        element: Option<&ElementType>,
        shape: [i64; 4],
        pictures: &[&'a [f32]],
    ) -> ort::Result<SessionInputValue<'a>> {
        match (element, pictures) {
            (Some(ElementType::Float16), _) => {
                let length = pictures.iter().map(|values| values.len()).sum();
                self.halves.resize(length, f16::ZERO);
                let mut place = 0;
                for values in pictures {
                    // Converts eight at a time if the processor can; a loop over single values does not.
                    self.halves[place..][..values.len()].convert_from_f32_slice(values);
                    place += values.len();
                }
                let input = TensorRef::from_array_view((shape, self.halves.as_slice()))?;
                Ok(SessionInputValue::from(input))
            }
            (Some(ElementType::Uint8), _) => {
                self.bytes.clear();
                let values = pictures.iter().copied().flatten();
                self.bytes.extend(values.map(|&value| value.round() as u8));
                let input = TensorRef::from_array_view((shape, self.bytes.as_slice()))?;
                Ok(SessionInputValue::from(input))
            }
            (_, [one]) => {
                let input = TensorRef::from_array_view((shape, *one))?;
                Ok(SessionInputValue::from(input))
            }
            (_, several) => {
                self.floats.clear();
                for values in several {
                    self.floats.extend_from_slice(values);
                }
                let input = TensorRef::from_array_view((shape, self.floats.as_slice()))?;
                Ok(SessionInputValue::from(input))
            }
        }
    }
}

/// The numbers of an input beside the picture, the same for each of `batch` pictures; `None` if it is the picture.
fn beside(
    input: &TensorSpec,
    size: PictureSize,
    batch: usize,
) -> Option<ort::Result<SessionInputValue<'static>>> {
    let numbers = input.beside_picture(size)?;
    let shape = [batch, numbers.len()];
    let all = numbers.repeat(batch);
    Some(if input.element == ElementType::Int64 {
        let whole: Vec<i64> = all.into_iter().map(|number| number as i64).collect();
        Tensor::from_array((shape, whole)).map(SessionInputValue::from)
    } else {
        Tensor::from_array((shape, all)).map(SessionInputValue::from)
    })
}

/// The human-readable message of ONNX Runtime.
fn in_words(error: &ort::Error) -> String {
    fault::in_words(error.message())
}

/// The shape and the elements of an output; float16 and whole numbers are widened. Outputs of other elements, which no
/// head reads, are empty.
fn elements(output: &DynValue) -> (&[i64], Cow<'_, [f32]>) {
    if let Ok((shape, values)) = output.try_extract_tensor::<f32>() {
        return (shape, Cow::Borrowed(values));
    }
    if let Ok((shape, halves)) = output.try_extract_tensor::<f16>() {
        let mut values = vec![0.0; halves.len()];
        halves.convert_to_f32_slice(&mut values);
        return (shape, Cow::Owned(values));
    }
    if let Ok((shape, numbers)) = output.try_extract_tensor::<i64>() {
        return (shape, numbers.iter().map(|&number| number as f32).collect());
    }
    match output.try_extract_tensor::<i32>() {
        Ok((shape, numbers)) => (shape, numbers.iter().map(|&number| number as f32).collect()),
        Err(_) => (&[], Cow::Borrowed(&[])),
    }
}

/// The text in the model's file beside the graph; empty if it cannot be read.
fn metadata(session: &Session) -> Metadata {
    let Ok(metadata) = session.metadata() else {
        return Metadata::default();
    };
    let keys = metadata.custom_keys().unwrap_or_default();
    Metadata::new(
        keys.into_iter()
            .filter_map(|key| metadata.custom(&key).map(|value| (key, value))),
    )
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
        // Threads that spin between runs take processor time from the rest of the program.
        .with_intra_op_spinning(false)?;
    let registrations = provider::registrations(provider, settings);
    if !registrations.is_empty() {
        builder = builder.with_execution_providers(registrations)?;
    }
    builder.commit_from_file(&settings.model)
}

/// Returns why the model does not load. A missing device shows only when the session is created, in words of many kinds,
/// so the model is tried on the CPU, which is always there: what does not load there either is the model's fault, and no
/// provider needs to be installed.
fn refusal(
    environment: &Environment,
    settings: &SessionSettings,
    provider: ExecutionProvider,
    reason: &str,
) -> StartError {
    let model = &settings.model;
    if provider == ExecutionProvider::Cpu {
        return StartError::unreadable(model, file_kind::in_words(model, reason));
    }
    if let Err(error) = build(environment, settings, ExecutionProvider::Cpu) {
        return StartError::unreadable(model, file_kind::in_words(model, &in_words(&error)));
    }
    StartError::new(
        StartErrorKind::Provider,
        format_args!(
            "the execution provider `{}` does not work here: {reason}. Install what it needs, or list another in \
             detector.providers",
            provider.as_str()
        ),
    )
}

fn spec(outlet: &Outlet) -> TensorSpec {
    let (element, shape) = match outlet.dtype() {
        ValueType::Tensor { ty, shape, .. } => {
            let element = match ty {
                TensorElementType::Float32 => ElementType::Float32,
                TensorElementType::Float16 => ElementType::Float16,
                TensorElementType::Uint8 => ElementType::Uint8,
                TensorElementType::Int32 => ElementType::Int32,
                TensorElementType::Int64 => ElementType::Int64,
                // Named as in ONNX: int8, bool.
                other => ElementType::Other(format!("{other:?}").to_lowercase()),
            };
            (element, shape.to_vec())
        }
        other => (
            ElementType::Other(format!("not a tensor ({other})")),
            Vec::new(),
        ),
    };
    TensorSpec {
        name: outlet.name().to_owned(),
        element,
        shape,
    }
}
