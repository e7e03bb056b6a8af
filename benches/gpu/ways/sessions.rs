//! Opens the sessions and runs them in turns.

use super::{Copy, INPUTS, Measured, PLAIN, WARM_UP, Way};
use crate::arguments::{Arguments, library};
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::ExecutionProvider;
use albireo_vision::onnx::Metadata;
use anyhow::bail;
use half::f16;
use ort::environment::Environment;
use ort::ep::{CUDA, TensorRT};
use ort::logging::LogLevel;
use ort::memory::{AllocationDevice, Allocator, AllocatorType, MemoryInfo, MemoryType};
use ort::session::{IoBinding, Session};
use ort::value::{
    DynTensor, PrimitiveTensorElementType, Tensor, TensorElementType, TensorRef,
    TensorValueTypeMarker, Value, ValueType,
};
use std::path::Path;
use std::time::Instant;

/// Measures the ways of `model`, with an ONNX Runtime of its own.
pub(crate) fn run(arguments: &Arguments, model: &Path) -> anyhow::Result<Measured> {
    let environment =
        ort::init_from(library()?)?.with_name("ways").with_telemetry(false).build()?;
    environment.set_log_level(LogLevel::Error);
    let sessions = Sessions {
        environment,
        arguments,
        model,
    };
    let session = sessions.open(Opened::AsTheNode)?;
    match session.inputs().first().map(|input| input.dtype()) {
        Some(ValueType::Tensor { ty, shape, .. }) => {
            let shape = closed(shape, image_size(&session))?;
            match ty {
                TensorElementType::Float32 => measure::<f32>(&sessions, session, shape),
                TensorElementType::Float16 => measure::<f16>(&sessions, session, shape),
                TensorElementType::Uint8 => measure::<u8>(&sessions, session, shape),
                other => bail!("its input has elements {other:?}"),
            }
        }
        _ => bail!("its input is no tensor"),
    }
}

/// The shape of an input of one picture; open sides are those of the largest input that the model names.
fn closed(shape: &[i64], largest: Option<PictureSize>) -> anyhow::Result<Vec<i64>> {
    let mut shape = shape.to_vec();
    if shape.first() == Some(&-1) {
        shape[0] = 1;
    }
    if let ([_, 3, rows @ -1, columns @ -1] | [_, rows @ -1, columns @ -1, 3], Some(size)) =
        (shape.as_mut_slice(), largest)
    {
        *rows = size.height.into();
        *columns = size.width.into();
    }
    if shape.iter().any(|side| *side < 1) {
        bail!("its input {shape:?} leaves its size open");
    }
    Ok(shape)
}

/// The size in the model's metadata.
fn image_size(session: &Session) -> Option<PictureSize> {
    let metadata = session.metadata().ok()?;
    let keys = metadata.custom_keys().ok()?;
    let entries = keys.into_iter().filter_map(|key| Some((key.clone(), metadata.custom(&key)?)));
    Metadata::new(entries).image_size()
}

struct Sessions<'a> {
    environment: Environment,
    arguments: &'a Arguments,
    model: &'a Path,
}

/// How a session is opened.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Opened {
    AsTheNode,
    /// Recorded as a CUDA graph.
    AsGraph,
    /// Fails unless the provider runs all nodes.
    WithoutFallback,
}

impl Sessions<'_> {
    fn open(&self, opened: Opened) -> ort::Result<Session> {
        let graph = opened == Opened::AsGraph;
        let threads =
            std::thread::available_parallelism().map_or(1, |cores| (cores.get() - 1).max(1));
        let mut builder = Session::builder(&self.environment)?
            .with_log_level(LogLevel::Error)?
            .with_intra_threads(threads)?
            .with_inter_threads(1)?
            .with_intra_op_spinning(false)?;
        if opened == Opened::WithoutFallback {
            builder = builder.with_disable_cpu_fallback()?;
        }
        let device = i32::try_from(self.arguments.device).unwrap_or(i32::MAX);
        let cuda = || CUDA::default().with_device_id(device);
        match self.arguments.provider {
            ExecutionProvider::Cpu => {}
            ExecutionProvider::Cuda => {
                let cuda = cuda().with_cuda_graph(graph).build().error_on_failure();
                builder = builder.with_execution_providers([cuda])?;
            }
            ExecutionProvider::TensorRt => {
                let tensorrt = TensorRT::default()
                    .with_device_id(device)
                    .with_fp16(true)
                    .with_cuda_graph(graph);
                builder = builder.with_execution_providers([
                    tensorrt.build().error_on_failure(),
                    cuda().build().error_on_failure(),
                ])?;
            }
        }
        builder.commit_from_file(self.model)
    }

    /// The allocators of device memory and of pinned memory; in a trial both are those of the processor.
    fn allocators(&self, session: &Session) -> ort::Result<[Allocator; 2]> {
        if !self.arguments.is_gpu() {
            return Ok([Allocator::default(), Allocator::default()]);
        }
        let device = i32::try_from(self.arguments.device).unwrap_or(i32::MAX);
        let on = |place, kind| {
            let info = MemoryInfo::new(place, device, AllocatorType::Device, kind)?;
            Allocator::new(session, info)
        };
        Ok([
            on(AllocationDevice::CUDA, MemoryType::Default)?,
            on(AllocationDevice::CUDA_PINNED, MemoryType::CPUOutput)?,
        ])
    }
}

/// An element of an input.
trait Element:
    PrimitiveTensorElementType + Clone + std::marker::Copy + std::fmt::Debug + 'static
{
    /// Converts a number from 0 to 1.
    fn of(value: f32) -> Self;
}

impl Element for f32 {
    fn of(value: f32) -> Self {
        value
    }
}

impl Element for f16 {
    fn of(value: f32) -> Self {
        Self::from_f32(value)
    }
}

impl Element for u8 {
    fn of(value: f32) -> Self {
        (value * 255.0) as Self
    }
}

/// A way to run a session. Returns the outputs and the time until they were in the processor's memory.
type Run<'a, T> = Box<dyn FnMut(&[T]) -> ort::Result<(Vec<Vec<f32>>, f64)> + 'a>;

#[expect(
    clippy::too_many_lines,
    reason = "all ways are opened before any is timed, so that they share one state of the card"
)]
fn measure<T: Element>(
    sessions: &Sessions<'_>,
    session: Session,
    shape: Vec<i64>,
) -> anyhow::Result<Measured> {
    let elements = usize::try_from(shape.iter().product::<i64>())?;
    let inputs = random_inputs::<T>(elements);
    let all_nodes = if sessions.arguments.is_gpu() {
        match sessions.open(Opened::WithoutFallback) {
            Ok(_) => "yes".to_owned(),
            Err(error) => format!("no: {error}"),
        }
    } else {
        "not asked on the CPU".to_owned()
    };
    let [device, pinned] = sessions.allocators(&session)?;
    let mut plain = plain(session, shape.clone());
    let (expected, _) = plain(&inputs[0])?;
    drop(expected);
    let graph = if sessions.arguments.is_gpu() {
        sessions
            .open(Opened::AsGraph)
            .and_then(|session| on_the_device(sessions, session, &shape, &inputs[0]))
    } else {
        Err(ort::Error::new("only on a GPU"))
    };
    let open = || sessions.open(Opened::AsTheNode);
    let mut ways: Vec<(&str, ort::Result<Run<'_, T>>)> = vec![
        (PLAIN, Ok(Box::new(plain))),
        ("bound", open().and_then(|session| bound(session, &shape))),
        (
            "on the device",
            open().and_then(|session| on_the_device(sessions, session, &shape, &inputs[0])),
        ),
        ("graph", graph),
    ];
    let mut measured = Measured {
        all_nodes,
        ways: ways
            .iter()
            .map(|(name, way)| Way {
                name: (*name).to_owned(),
                times: Vec::new(),
                difference: 0.0,
                why_not: way.as_ref().err().map(ToString::to_string),
            })
            .collect(),
        copies: Vec::new(),
    };
    let runs = usize::from(sessions.arguments.runs);
    let until = Instant::now() + sessions.arguments.limit() / 3;
    for number in 0..WARM_UP + runs {
        if number > WARM_UP && Instant::now() > until {
            break;
        }
        let input = &inputs[number % INPUTS];
        let mut expected: Option<Vec<Vec<f32>>> = None;
        for ((_, way), results) in ways.iter_mut().zip(&mut measured.ways) {
            let Ok(run) = way else { continue };
            match run(input) {
                Ok((outputs, took)) => {
                    if number >= WARM_UP {
                        results.times.push(took);
                    }
                    let expected = expected.get_or_insert_with(|| outputs.clone());
                    results.difference = results.difference.max(difference(expected, &outputs));
                }
                Err(error) => {
                    results.times.clear();
                    results.why_not = Some(error.to_string());
                    *way = Err(error);
                }
            }
        }
    }
    let outputs = output_shapes(sessions, &shape, &inputs[0])?;
    let outputs: usize = outputs
        .iter()
        .map(|(element, shape)| {
            let elements: i64 = shape.iter().product();
            usize::try_from(elements).unwrap_or(0) * element.byte_size(1).unwrap_or(0)
        })
        .sum();
    for (name, bytes, direction) in [
        ("one", 1, Direction::ToTheDevice),
        ("input", elements * size_of::<T>(), Direction::ToTheDevice),
        ("outputs", outputs, Direction::FromTheDevice),
    ] {
        for (name, host) in [(name, &Allocator::default()), ("", &pinned)] {
            measured.copies.push(Copy {
                name: name.to_owned(),
                bytes,
                times: copy(host, &device, bytes, direction, runs)?,
            });
        }
    }
    Ok(measured)
}

/// Inputs of noise.
fn random_inputs<T: Element>(elements: usize) -> Vec<Vec<T>> {
    let mut noise = 1_u32;
    let mut random = || {
        // The generator of Numerical Recipes, of which the upper 24 bits are from 0 to 1.
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        T::of((noise >> 8) as f32 / f32::from(u16::MAX) / 256.0)
    };
    let mut input = || -> Vec<T> { (0..elements).map(|_| random()).collect() };
    (0..INPUTS).map(|_| input()).collect()
}

/// Runs a session like the node.
fn plain<T: Element>(
    mut session: Session,
    shape: Vec<i64>,
) -> impl FnMut(&[T]) -> ort::Result<(Vec<Vec<f32>>, f64)> {
    move |input| {
        let start = Instant::now();
        let input = TensorRef::from_array_view((shape.clone(), input))?;
        let outputs = session.run(ort::inputs![input])?;
        let took = since(start);
        let values = (0..outputs.len())
            .map(|index| values(&outputs[index]))
            .collect::<ort::Result<_>>()?;
        Ok((values, took))
    }
}

/// Binds input and outputs in the processor's memory.
fn bound<'a, T: Element>(mut session: Session, shape: &[i64]) -> ort::Result<Run<'a, T>> {
    let mut binding = session.create_binding()?;
    let mut host = Tensor::<T>::new(&Allocator::default(), shape)?;
    let (input_name, output_names) = names(&session)?;
    for name in output_names {
        binding.bind_output_to_device(name, &MemoryInfo::default())?;
    }
    Ok(Box::new(move |input| {
        let start = Instant::now();
        host.try_extract_tensor_mut::<T>()?.1.copy_from_slice(input);
        binding.bind_input(input_name.as_str(), &host)?;
        let outputs = session.run_binding(&binding)?;
        let took = since(start);
        let values = (0..outputs.len())
            .map(|index| values(&outputs[index]))
            .collect::<ort::Result<_>>()?;
        Ok((values, took))
    }))
}

/// An output on the device and its copy in the processor's memory.
struct Output {
    device: DynTensor,
    host: DynTensor,
}

/// Binds input and outputs on the device at fixed addresses.
fn on_the_device<'a, T: Element>(
    sessions: &Sessions<'_>,
    session: Session,
    shape: &[i64],
    example: &[T],
) -> ort::Result<Run<'a, T>> {
    let shapes = output_shapes(sessions, shape, example)?;
    let [on_device, _] = sessions.allocators(&session)?;
    let mut device = Tensor::<T>::new(&on_device, shape)?;
    // Copies from memory that ONNX Runtime allocated: to copy a borrowed tensor, `ort` 2.0.0-rc.15 first makes a copy,
    // for which it waits on the lock that it holds.
    let mut near = Tensor::<T>::new(&Allocator::default(), shape)?;
    near.try_extract_tensor_mut::<T>()?.1.copy_from_slice(example);
    // A graph is recorded with this input.
    near.copy_into(&mut device)?;
    let mut binding: IoBinding = session.create_binding()?;
    let (input_name, output_names) = names(&session)?;
    binding.bind_input(input_name, &device)?;
    let mut outputs = Vec::new();
    for (name, (element, shape)) in output_names.into_iter().zip(shapes) {
        let shape = shape.as_slice();
        let mut output = Output {
            device: DynTensor::new(&on_device, element, shape)?,
            host: DynTensor::new(&Allocator::default(), element, shape)?,
        };
        binding.bind_output(name, &mut output.device)?;
        outputs.push(output);
    }
    let mut session = session;
    Ok(Box::new(move |input| {
        let start = Instant::now();
        near.try_extract_tensor_mut::<T>()?.1.copy_from_slice(input);
        near.copy_into(&mut device)?;
        session.run_binding(&binding)?;
        for output in &mut outputs {
            output.device.copy_into(&mut output.host)?;
        }
        let took = since(start);
        let values =
            outputs.iter().map(|output| values(&output.host)).collect::<ort::Result<_>>()?;
        Ok((values, took))
    }))
}

/// The elements and shapes of the outputs, found by a run.
fn output_shapes<T: Element>(
    sessions: &Sessions<'_>,
    shape: &[i64],
    example: &[T],
) -> ort::Result<Vec<(TensorElementType, Vec<i64>)>> {
    let mut session = sessions.open(Opened::AsTheNode)?;
    let input = TensorRef::from_array_view((shape, example))?;
    let outputs = session.run(ort::inputs![input])?;
    (0..outputs.len())
        .map(|index| match outputs[index].dtype() {
            ValueType::Tensor { ty, shape, .. } => Ok((*ty, shape.to_vec())),
            other => Err(ort::Error::new(format!("an output is {other}"))),
        })
        .collect()
}

fn names(session: &Session) -> ort::Result<(String, Vec<String>)> {
    let input = session.inputs().first();
    let input = input.ok_or_else(|| ort::Error::new("it has no input"))?;
    let outputs = session.outputs().iter().map(|output| output.name().to_owned()).collect();
    Ok((input.name().to_owned(), outputs))
}

fn values<V: TensorValueTypeMarker + ?Sized>(output: &Value<V>) -> ort::Result<Vec<f32>> {
    if let Ok((_, halves)) = output.try_extract_tensor::<f16>() {
        return Ok(halves.iter().map(|half| half.to_f32()).collect());
    }
    Ok(output.try_extract_tensor::<f32>()?.1.to_vec())
}

/// The largest difference between two lists of outputs, relative for numbers above 1.
fn difference(expected: &[Vec<f32>], found: &[Vec<f32>]) -> f64 {
    if expected.len() != found.len() {
        return f64::INFINITY;
    }
    let mut largest = 0.0_f64;
    for (expected, found) in expected.iter().zip(found) {
        if expected.len() != found.len() {
            return f64::INFINITY;
        }
        for (expected, found) in expected.iter().zip(found) {
            let scale = expected.abs().max(1.0);
            largest = largest.max(f64::from((expected - found).abs() / scale));
        }
    }
    largest
}

#[derive(Clone, Copy)]
enum Direction {
    ToTheDevice,
    FromTheDevice,
}

/// Measures the milliseconds to copy `bytes` bytes.
fn copy(
    host: &Allocator,
    device: &Allocator,
    bytes: usize,
    direction: Direction,
    runs: usize,
) -> ort::Result<Vec<f64>> {
    let mut near = Tensor::<u8>::new(host, [bytes])?;
    let mut far = Tensor::<u8>::new(device, [bytes])?;
    // The system may not have mapped memory that was never written.
    let mut written = Tensor::<u8>::new(&Allocator::default(), [bytes])?;
    written.try_extract_tensor_mut::<u8>()?.1.fill(1);
    written.copy_into(&mut near)?;
    near.copy_into(&mut far)?;
    let mut times = Vec::new();
    for number in 0..WARM_UP + runs {
        let start = Instant::now();
        match direction {
            Direction::ToTheDevice => near.copy_into(&mut far)?,
            Direction::FromTheDevice => far.copy_into(&mut near)?,
        }
        if number >= WARM_UP {
            times.push(since(start));
        }
    }
    Ok(times)
}

fn since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}
