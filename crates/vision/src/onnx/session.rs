//! One ONNX Runtime session: loads a model file and runs it on tensors.

use super::recorded::{self, RecordedRuns, TensorShape};
use super::{
    ElementType, EngineCache, ExecutionProvider, GpuConfig, Metadata, Signature, StartError,
};
use super::{StartErrorKind, TensorSpec, conversion::PixelConversion};
use super::{fault, file_kind, onnxruntime, provider, waiting};
use crate::picture::{InputFormat, InputTensor};
use albireo_core::geometry::PictureSize;
use half::f16;
use half::slice::HalfFloatSliceExt;
use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::memory::Allocator;
use ort::session::builder::SessionBuilder;
use ort::session::{RunOptions, Session, SessionInputValue};
use ort::value::{DynValue, Outlet, Tensor, TensorElementType, TensorRef, ValueType};
use ort::value::{PrimitiveTensorElementType, TensorValueTypeMarker, Value};
use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Duration;
use tracing::{info, warn};

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

impl SessionSettings {
    /// True if `provider` is to record the runs of a session.
    fn records(&self, provider: ExecutionProvider) -> bool {
        provider == ExecutionProvider::Cuda && self.gpu.cuda_graph
    }

    /// These, for a session whose runs are not recorded.
    fn without_graph(&self) -> Self {
        let mut settings = self.clone();
        settings.gpu.cuda_graph = false;
        settings
    }
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
    /// What turns pixels into the input.
    conversion: Option<PixelConversion>,
    /// Where runs are recorded, if CUDA is to record them.
    recorded: Option<RecordedRuns>,
    /// The options of a run that is not recorded.
    unrecorded: RunOptions,
    buffers: RunBuffers,
}

/// What is said of a model that cannot be recorded.
pub(crate) const NOT_RECORDED: &str =
    "CUDA cannot record the runs of this model as graphs; it runs without";

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

    /// [`open`](Self::open) with no other provider than the first of `settings`.
    ///
    /// # Errors
    /// As of [`open`](Self::open).
    pub(crate) fn open_with_first(settings: &SessionSettings) -> Result<Self, StartError> {
        let first = settings.providers.get(..1).unwrap_or_default();
        Self::open_among(settings, first)
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
        match Self::open_as(environment, settings, provider) {
            Err(error) if settings.records(provider) => {
                // If it opens without, recording is what failed.
                let opened = Self::open_as(environment, &settings.without_graph(), provider)?;
                warn!(%error, "{NOT_RECORDED}");
                Ok(opened)
            }
            opened => opened,
        }
    }

    fn open_as(
        environment: &Environment,
        settings: &SessionSettings,
        provider: ExecutionProvider,
    ) -> Result<Self, StartError> {
        let failed =
            |error: ort::Error| refusal(environment, settings, provider, &in_words(&error));
        let session = build(environment, settings, provider).map_err(failed)?;
        if provider != ExecutionProvider::Cpu && !settings.gpu.spin {
            let asked = waiting::let_threads_sleep(settings.gpu.device);
            if let Err(reason) = asked {
                info!(
                    reason,
                    "the processor keeps a core busy while it waits for the GPU"
                );
            }
        }
        let signature = Signature {
            inputs: session.inputs().iter().map(spec).collect(),
            outputs: session.outputs().iter().map(output_spec).collect(),
            metadata: metadata(&session),
        };
        let mut opened = Self {
            session,
            signature,
            provider,
            engines: settings.engines.clone(),
            conversion: None,
            recorded: None,
            unrecorded: recorded::unrecorded().map_err(failed)?,
            buffers: RunBuffers::default(),
        };
        if settings.records(provider) {
            let memory = provider::memory(provider, &settings.gpu, &opened.session);
            opened.record_in(memory.map_err(failed)?);
        }
        Ok(opened)
    }

    /// Has runs recorded, with tensors in `memory`, where the model runs.
    pub(crate) fn record_in(&mut self, memory: Allocator) {
        self.recorded = Some(RecordedRuns::new(memory));
    }

    /// Keeps the time from the start of the build to the end of the first run, if TensorRT has built an engine in it.
    pub(crate) fn keep_build_time(&self, took: Duration) {
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

    /// Has pictures of `format.as_pixels()` converted to `format`, the model's own, where the model runs; from then on
    /// [`run`](Self::run) takes pixels.
    ///
    /// # Errors
    /// If ONNX Runtime does not take the graph, not even on the processor.
    pub(crate) fn take_pixels(
        &mut self,
        settings: &SessionSettings,
        format: InputFormat,
    ) -> Result<(), StartError> {
        let element = self.signature.picture().map_or(&ElementType::Float32, |it| &it.element);
        let environment = onnxruntime::environment(settings.onnxruntime.as_deref())?;
        let without_graph = settings.without_graph();
        let open = |provider| {
            let options = builder(&environment, &without_graph, provider)?;
            let memory_for = |session: &Session| provider::memory(provider, &settings.gpu, session);
            PixelConversion::open(format, element, &options, memory_for)
        };
        // TensorRT would build an engine for a few sums.
        let here = match self.provider {
            ExecutionProvider::TensorRt => ExecutionProvider::Cuda,
            provider => provider,
        };
        let opened = match open(here) {
            Err(error) if here != ExecutionProvider::Cpu => {
                warn!(
                    provider = here.as_str(),
                    error = in_words(&error),
                    "pictures are converted by the processor"
                );
                open(ExecutionProvider::Cpu)
            }
            opened => opened,
        };
        let failed = |error: ort::Error| {
            StartError::first_run(
                &settings.model,
                format_args!("the graph in front of it: {}", in_words(&error)),
            )
        };
        self.conversion = Some(opened.map_err(failed)?);
        Ok(())
    }

    /// Runs the model on `pictures`, each in the model's elements, or as float32 for float16, or as pixels if the session
    /// takes these. `shape` is that of one picture, and `size` its columns and rows. Further inputs of a model, such as the
    /// picture's size, are filled from `size`. `read` gets the outputs in the order of the signature.
    ///
    /// # Errors
    /// If ONNX Runtime fails: its words.
    pub fn run<R>(
        &mut self,
        shape: [i64; 4],
        size: PictureSize,
        pictures: &[&InputTensor],
        read: impl FnOnce(&[TensorView<'_>]) -> R,
    ) -> Result<R, String> {
        let shape = of_batch(shape, pictures.len());
        self.run_on(shape, size, pictures, read).map_err(|error| in_words(&error))
    }

    fn run_on<R>(
        &mut self,
        shape: [i64; 4],
        size: PictureSize,
        pictures: &[&InputTensor],
        read: impl FnOnce(&[TensorView<'_>]) -> R,
    ) -> ort::Result<R> {
        if let (Some(conversion), Some(recorded)) = (&mut self.conversion, &mut self.recorded) {
            match recorded.of(shape) {
                Some(run) => {
                    let converted = conversion.run(shape, self.buffers.bytes(pictures))?;
                    run.replay(&mut self.session, &converted)?;
                    return Ok(read_outputs(run.outputs().map(elements), read));
                }
                None => recorded.warn_of(shape),
            }
        }
        self.run_unrecorded(shape, size, pictures, read)
    }

    fn run_unrecorded<R>(
        &mut self,
        shape: [i64; 4],
        size: PictureSize,
        pictures: &[&InputTensor],
        read: impl FnOnce(&[TensorView<'_>]) -> R,
    ) -> ort::Result<R> {
        let Self {
            session,
            signature,
            conversion,
            unrecorded,
            buffers,
            ..
        } = self;
        let element = signature.picture().map(|input| &input.element);
        let input = match conversion {
            Some(conversion) => conversion.run(shape, buffers.bytes(pictures))?.into(),
            None => buffers.input(element, shape, pictures)?,
        };
        let mut picture = Some(input);
        let mut inputs: Vec<SessionInputValue<'_>> = Vec::with_capacity(signature.inputs.len());
        for input in &signature.inputs {
            match beside(input, size, pictures.len()) {
                Some(numbers) => inputs.push(numbers?.into()),
                None => {
                    // The signature has been checked: there is one picture.
                    if let Some(picture) = picture.take() {
                        inputs.push(picture);
                    }
                }
            }
        }
        let returned = session.run_with_options(inputs.as_slice(), unrecorded)?;
        let outputs = (0..returned.len()).map(|index| elements(&returned[index]));
        Ok(read_outputs(outputs, read))
    }

    /// True if runs are to be recorded.
    pub(crate) fn records(&self) -> bool {
        self.recorded.is_some()
    }

    /// Records the run on `pictures`, pixels as of [`run`](Self::run), for all later ones of the same number and shape.
    ///
    /// # Errors
    /// If the model cannot be recorded: its outputs depend on what is in a picture, or not every part of it runs on the GPU.
    pub(crate) fn record(
        &mut self,
        shape: [i64; 4],
        size: PictureSize,
        pictures: &[&InputTensor],
    ) -> Result<(), String> {
        let shape = of_batch(shape, pictures.len());
        self.record_on(shape, size, pictures).map_err(|error| in_words(&error))
    }

    fn record_on(
        &mut self,
        shape: [i64; 4],
        size: PictureSize,
        pictures: &[&InputTensor],
    ) -> ort::Result<()> {
        let output_shapes: Vec<Vec<i64>> =
            self.run_unrecorded(shape, size, pictures, |outputs| {
                outputs.iter().map(|output| output.shape.to_vec()).collect()
            })?;
        let (Some(conversion), Some(recorded)) = (&mut self.conversion, &mut self.recorded) else {
            return Err(ort::Error::new("the model takes pixels itself"));
        };
        let converted = conversion.run(shape, self.buffers.bytes(pictures))?;
        let mut numbers = Vec::new();
        let mut picture = None;
        for input in &self.signature.inputs {
            match beside(input, size, pictures.len()) {
                Some(number) => numbers.push((input.name.clone(), number?)),
                None => {
                    picture = Some(TensorShape {
                        name: input.name.clone(),
                        element: *converted.data_type(),
                        shape: converted.shape().to_vec(),
                    });
                }
            }
        }
        let picture = picture.ok_or_else(|| ort::Error::new("the model takes no picture"))?;
        let mut outputs = Vec::new();
        for (output, output_shape) in self.session.outputs().iter().zip(output_shapes) {
            if output_shape.contains(&0) {
                return Err(ort::Error::new("what it returns depends on the picture"));
            }
            let Some(element) = output.dtype().tensor_type() else {
                return Err(ort::Error::new("an output is no tensor"));
            };
            outputs.push(TensorShape {
                name: output.name().to_owned(),
                element,
                shape: output_shape,
            });
        }
        let run = recorded.add(&self.session, shape, &picture, &numbers, outputs)?;
        run.replay(&mut self.session, &converted)
    }
}

/// The shape of `batch` pictures, where `shape` is that of one.
fn of_batch(mut shape: [i64; 4], batch: usize) -> [i64; 4] {
    shape[0] = i64::try_from(batch).unwrap_or(i64::MAX);
    shape
}

/// Shows `outputs` to `read`.
fn read_outputs<'a, R>(
    outputs: impl Iterator<Item = (&'a [i64], Cow<'a, [f32]>)>,
    read: impl FnOnce(&[TensorView<'_>]) -> R,
) -> R {
    let read_out: Vec<_> = outputs.collect();
    let views: Vec<_> =
        read_out.iter().map(|(shape, values)| TensorView { shape, values }).collect();
    read(&views)
}

impl RunBuffers {
    /// The input of `pictures` in these elements. A single picture in the model's own is not copied.
    fn input<'a>(
        &'a mut self,
        element: Option<&ElementType>,
        shape: [i64; 4],
        pictures: &[&'a InputTensor],
    ) -> ort::Result<SessionInputValue<'a>> {
        match element {
            Some(ElementType::Uint8) => {
                let input = TensorRef::from_array_view((shape, self.bytes(pictures)))?;
                Ok(SessionInputValue::from(input))
            }
            Some(ElementType::Float16) => {
                let input = TensorRef::from_array_view((shape, self.halves(pictures)))?;
                Ok(SessionInputValue::from(input))
            }
            _ => {
                let input = TensorRef::from_array_view((shape, self.floats(pictures)))?;
                Ok(SessionInputValue::from(input))
            }
        }
    }

    fn bytes<'a>(&'a mut self, pictures: &[&'a InputTensor]) -> &'a [u8] {
        if let [InputTensor::Bytes(one)] = pictures {
            return one;
        }
        self.bytes.clear();
        for picture in pictures {
            match picture {
                InputTensor::Bytes(values) => self.bytes.extend_from_slice(values),
                InputTensor::Floats(values) => {
                    self.bytes.extend(values.iter().map(|&value| value.round() as u8));
                }
            }
        }
        &self.bytes
    }

    fn floats<'a>(&'a mut self, pictures: &[&'a InputTensor]) -> &'a [f32] {
        if let [InputTensor::Floats(one)] = pictures {
            return one;
        }
        self.floats.clear();
        for picture in pictures {
            self.floats.extend_from_slice(&picture.to_floats());
        }
        &self.floats
    }

    fn halves(&mut self, pictures: &[&InputTensor]) -> &[f16] {
        self.halves.clear();
        for picture in pictures {
            let values = picture.to_floats();
            let start = self.halves.len();
            self.halves.resize(start + values.len(), f16::ZERO);
            // Converts eight at a time if the processor can; a loop over single values does not.
            self.halves[start..].convert_from_f32_slice(&values);
        }
        &self.halves
    }
}

/// The numbers of an input beside the picture, the same for each of `batch` pictures; `None` if it is the picture.
fn beside(input: &TensorSpec, size: PictureSize, batch: usize) -> Option<ort::Result<DynValue>> {
    let numbers = input.beside_picture(size)?;
    let mut shape = vec![numbers.len()];
    let mut all = numbers.to_vec();
    // Without a dimension for the batch they are there once.
    if input.shape.len() > 1 {
        shape.insert(0, batch);
        all = numbers.repeat(batch);
    }
    let tensor = match input.element {
        ElementType::Int64 => {
            let whole: Vec<i64> = all.into_iter().map(|number| number as i64).collect();
            Tensor::from_array((shape, whole)).map(Tensor::into_dyn)
        }
        ElementType::Int32 => {
            let whole: Vec<i32> = all.into_iter().map(|number| number as i32).collect();
            Tensor::from_array((shape, whole)).map(Tensor::into_dyn)
        }
        _ => Tensor::from_array((shape, all)).map(Tensor::into_dyn),
    };
    Some(tensor)
}

/// The human-readable message of ONNX Runtime.
fn in_words(error: &ort::Error) -> String {
    fault::in_words(error.message())
}

/// The shape and the elements of an output; float16 and whole numbers are widened. Outputs of other elements, which no
/// head reads, are empty.
fn elements<V: TensorValueTypeMarker + ?Sized>(output: &Value<V>) -> (&[i64], Cow<'_, [f32]>) {
    if let Ok((shape, values)) = output.try_extract_tensor::<f32>() {
        return (shape, Cow::Borrowed(values));
    }
    if let Ok((shape, halves)) = output.try_extract_tensor::<f16>() {
        let mut values = vec![0.0; halves.len()];
        halves.convert_to_f32_slice(&mut values);
        return (shape, Cow::Owned(values));
    }
    let whole = match output.dtype().tensor_type() {
        Some(TensorElementType::Int64) => widened(output, |number: i64| number as f32),
        Some(TensorElementType::Int32) => widened(output, |number: i32| number as f32),
        Some(TensorElementType::Int16) => widened(output, |number: i16| f32::from(number)),
        Some(TensorElementType::Int8) => widened(output, |number: i8| f32::from(number)),
        Some(TensorElementType::Uint64) => widened(output, |number: u64| number as f32),
        Some(TensorElementType::Uint32) => widened(output, |number: u32| number as f32),
        Some(TensorElementType::Uint16) => widened(output, |number: u16| f32::from(number)),
        Some(TensorElementType::Uint8) => widened(output, |number: u8| f32::from(number)),
        _ => None,
    };
    whole.unwrap_or((&[], Cow::Borrowed(&[])))
}

/// The shape and the elements of an output of whole numbers of this type.
fn widened<T, V>(output: &Value<V>, as_float: impl Fn(T) -> f32) -> Option<(&[i64], Cow<'_, [f32]>)>
where
    T: PrimitiveTensorElementType + Copy + 'static,
    V: TensorValueTypeMarker + ?Sized,
{
    let (shape, numbers) = output.try_extract_tensor::<T>().ok()?;
    let floats = numbers.iter().map(|&number| as_float(number)).collect();
    Some((shape, floats))
}

/// The text in the model's file beside the graph; empty if it cannot be read.
fn metadata(session: &Session) -> Metadata {
    let Ok(metadata) = session.metadata() else {
        return Metadata::default();
    };
    let keys = metadata.custom_keys().unwrap_or_default();
    let entries = keys
        .into_iter()
        .filter_map(|key| metadata.custom(&key).map(|value| (key, value)));
    Metadata::new(entries)
}

fn build(
    environment: &Environment,
    settings: &SessionSettings,
    provider: ExecutionProvider,
) -> ort::Result<Session> {
    builder(environment, settings, provider)?.commit_from_file(&settings.model)
}

/// The options of a session.
fn builder(
    environment: &Environment,
    settings: &SessionSettings,
    provider: ExecutionProvider,
) -> ort::Result<SessionBuilder> {
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
    Ok(builder)
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
    let name = outlet.name().to_owned();
    match outlet.dtype() {
        ValueType::Tensor { ty, shape, .. } => TensorSpec {
            name,
            element: element_type(*ty),
            shape: shape.to_vec(),
        },
        other => TensorSpec {
            name,
            element: ElementType::Other(format!("not a tensor ({other})")),
            shape: Vec::new(),
        },
    }
}

/// That of an output, where bytes are numbers and not pixels.
fn output_spec(outlet: &Outlet) -> TensorSpec {
    let mut output = spec(outlet);
    if output.element == ElementType::Uint8 {
        output.element = ElementType::Whole("uint8");
    }
    output
}

fn element_type(ty: TensorElementType) -> ElementType {
    match ty {
        TensorElementType::Float32 => ElementType::Float32,
        TensorElementType::Float16 => ElementType::Float16,
        TensorElementType::Uint8 => ElementType::Uint8,
        TensorElementType::Int32 => ElementType::Int32,
        TensorElementType::Int64 => ElementType::Int64,
        TensorElementType::Int8 => ElementType::Whole("int8"),
        TensorElementType::Int16 => ElementType::Whole("int16"),
        TensorElementType::Uint16 => ElementType::Whole("uint16"),
        TensorElementType::Uint32 => ElementType::Whole("uint32"),
        TensorElementType::Uint64 => ElementType::Whole("uint64"),
        // Named as in ONNX: float64, bool.
        other => ElementType::Other(format!("{other:?}").to_lowercase()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::{ColorOrder, Fit, ValueRange};
    use std::path::Path;

    const SIZE: PictureSize = PictureSize::new(64, 32);

    struct Opened {
        session: OnnxSession,
        /// That of one picture.
        shape: [i64; 4],
    }

    impl Opened {
        /// A session on the processor that takes pixels, as one on a GPU does.
        fn new(model: &str) -> Self {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/models");
            let settings = SessionSettings {
                model: folder.join(model),
                providers: vec![ExecutionProvider::Cpu],
                gpu: GpuConfig::default(),
                threads: 1,
                onnxruntime: None,
                shapes: None,
                engines: None,
            };
            let mut session = OnnxSession::open(&settings).unwrap();
            let input = session.signature().picture_input(Some(SIZE)).unwrap();
            let format = input.format(Fit::Stretch, ColorOrder::Rgb, ValueRange::ToOne);
            session.take_pixels(&settings, format).unwrap();
            let shape = format.as_pixels().shape_of(SIZE);
            Self { session, shape }
        }

        /// One whose runs of these numbers of black pictures have been recorded.
        fn recorded(model: &str, counts: &[usize]) -> Self {
            let mut opened = Self::new(model);
            opened.session.record_in(Allocator::default());
            let black = one_colour([0, 0, 0]);
            for &count in counts {
                let pictures = vec![&black; count];
                opened.session.record(opened.shape, SIZE, &pictures).unwrap();
            }
            opened
        }

        fn run(&mut self, pictures: &[InputTensor]) -> Result<Vec<Output>, String> {
            let pictures: Vec<_> = pictures.iter().collect();
            self.session.run(self.shape, SIZE, &pictures, |outputs| {
                let copied = outputs.iter().map(|output| Output {
                    shape: output.shape.to_vec(),
                    values: output.values.to_vec(),
                });
                copied.collect()
            })
        }
    }

    #[derive(Debug, PartialEq)]
    struct Output {
        shape: Vec<i64>,
        values: Vec<f32>,
    }

    fn one_colour(rgb: [u8; 3]) -> InputTensor {
        InputTensor::Bytes(rgb.repeat((SIZE.width * SIZE.height) as usize))
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn a_recorded_run_returns_what_another_returns() {
        for (model, counts) in [
            ("yolo_open.onnx", &[1, 2][..]),
            ("yolo_float16.onnx", &[1]),
            ("colours.onnx", &[1]),
        ] {
            let mut plain = Opened::new(model);
            let mut recorded = Opened::recorded(model, counts);
            for rgb in [[200, 10, 0], [0, 90, 255], [30, 30, 30]] {
                for &count in counts {
                    let mut pictures = vec![one_colour(rgb); count];
                    pictures[0] = one_colour([7, 100, 60]);
                    let found = recorded.run(&pictures).unwrap();
                    assert_eq!(found, plain.run(&pictures).unwrap(), "{model} {rgb:?}");
                }
            }
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn pictures_of_a_number_that_was_not_recorded_are_run_all_the_same() {
        let mut plain = Opened::new("yolo_open.onnx");
        let mut recorded = Opened::recorded("yolo_open.onnx", &[2]);
        for count in [1, 3] {
            let pictures = vec![one_colour([200, 10, 0]); count];
            let found = recorded.run(&pictures).unwrap();
            assert_eq!(found[0].shape[0], count as i64);
            assert_eq!(found, plain.run(&pictures).unwrap());
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn each_number_of_pictures_that_was_not_recorded_is_warned_of_once() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let subscriber = tracing_subscriber::fmt().with_writer(file.reopen().unwrap()).finish();
        let _logging = tracing::subscriber::set_default(subscriber);
        let mut recorded = Opened::recorded("yolo_open.onnx", &[2, 4]);
        for count in [2, 1, 3, 4, 1, 3] {
            recorded.run(&vec![one_colour([0, 0, 0]); count]).unwrap();
        }
        let log = std::fs::read_to_string(&file).unwrap();
        let warnings = log.lines().filter(|line| line.contains("layer by layer"));
        assert_eq!(warnings.count(), 2, "{log}");
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn outputs_that_depend_on_the_picture_are_an_error_and_not_those_of_another_picture() {
        let mut recorded = Opened::recorded("changing.onnx", &[1]);
        recorded.run(&[one_colour([0, 200, 0])]).unwrap();
        let red = one_colour([200, 0, 0]);
        let error = recorded.run(std::slice::from_ref(&red)).unwrap_err();
        assert!(error.contains("shape"), "{error}");
        Opened::new("changing.onnx").run(&[red]).unwrap();
    }
}
