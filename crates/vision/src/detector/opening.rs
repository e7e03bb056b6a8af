//! Opens a detector's model: finds the head that reads it, and the sizes that its input may have.

use super::class_names;
use super::head::{self, Evidence, Head, LEAST_SCORE, Objection, Recognised, RecognisedHead};
use super::heads::Heads;
use super::inputs::STRIDE;
use super::open_outputs;
use super::{DetectorConfig, HeadName, HeadSetting, ModelInput, OpenSides, USUAL_PICTURE};
use crate::onnx::has_half_weights;
use crate::onnx::{EngineCache, ExecutionProvider, OnnxSession, PictureInput, SessionSettings};
use crate::onnx::{ShapeRange, Signature, StartError, StartErrorKind, TensorSpec, TensorView};
use crate::picture::{ColorOrder, Fit, InputFormat, InputTensor, ValueRange};
use albireo_core::geometry::PictureSize;
use tracing::{info, warn};

/// Which of the configured providers run a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Among {
    /// The first that works.
    All,
    /// The first that works, but not TensorRT, whose engine is being built.
    Meanwhile,
    /// TensorRT alone.
    TensorRt,
}

/// Opens the model and finds its head. TensorRT builds an engine for a range of shapes, which must be known before, and
/// only a run shows how the outputs are read: there the processor looks at the model first.
pub(super) fn open(
    config: &DetectorConfig,
    among: Among,
) -> Result<(OnnxSession, Heads), StartError> {
    let mut settings = config.session_settings();
    if among == Among::Meanwhile {
        settings.providers.retain(|provider| *provider != ExecutionProvider::TensorRt);
    }
    if !settings.providers.contains(&ExecutionProvider::TensorRt) {
        let mut session = OnnxSession::open(&settings)?;
        check_batch(config, session.signature())?;
        let heads = head_for(config, &mut session)?;
        take_pixels(config, &mut session, &heads)?;
        return Ok((session, heads));
    }
    let mut looked_at = OnnxSession::open(&SessionSettings {
        providers: vec![ExecutionProvider::Cpu],
        ..settings.clone()
    })?;
    check_batch(config, looked_at.signature())?;
    let heads = head_for(config, &mut looked_at)?;
    let signature = looked_at.signature();
    let input = model_input(config, signature, heads.largest());
    settings.shapes = shapes(config, signature, input);
    drop(looked_at);
    let model = std::fs::read(&config.model)
        .map_err(|error| StartError::unreadable(&config.model, &error).because(error))?;
    settings.gpu.fp16 |= has_half_weights(&model);
    settings.engines = EngineCache::open(&settings, &model)?;
    match &settings.engines {
        Some(engines) if engines.is_built() => {}
        Some(engines) => info!(
            last_build_s = engines.last_build().map(|took| took.as_secs()),
            "TensorRT builds an engine for this model, which takes minutes, and keeps it for the next start"
        ),
        None => warn!(
            "TensorRT builds an engine, which takes minutes, at this and every start: set node.state_dir or \
             detector.gpu.engine_cache to keep it"
        ),
    }
    let mut opened = if among == Among::TensorRt {
        OnnxSession::open_with_first(&settings)?
    } else {
        OnnxSession::open(&settings)?
    };
    take_pixels(config, &mut opened, &heads)?;
    Ok((opened, heads))
}

/// Has pictures converted where the model runs, if a GPU may run it.
fn take_pixels(
    config: &DetectorConfig,
    session: &mut OnnxSession,
    heads: &Heads,
) -> Result<(), StartError> {
    let format = heads.largest().input_format;
    if prepared_format(config, format) == format {
        return Ok(());
    }
    session.take_pixels(&config.session_settings(), format)
}

/// What pictures are prepared as for a model that takes `format`: pixels, if a GPU is among the providers. That holds for
/// the processor, too, if it runs the model because the GPU does not, so that a picture prepared for one session can be
/// given to the next.
fn prepared_format(config: &DetectorConfig, format: InputFormat) -> InputFormat {
    let on_gpu = config.providers.iter().any(|provider| *provider != ExecutionProvider::Cpu);
    if on_gpu && !config.gpu.processor_converts {
        format.as_pixels()
    } else {
        format
    }
}

/// The shapes that an engine is built for, if the model leaves some open: without them TensorRT would build another for
/// each size of a batch. It is made fast for full batches, as those come when there is much to do.
fn shapes(config: &DetectorConfig, signature: &Signature, input: ModelInput) -> Option<ShapeRange> {
    if input.open.is_none() && config.batch_size == 1 {
        return None;
    }
    let least = input.open.map_or(input.format.size, |open| open.least);
    let usual = match input.open {
        Some(_) => input.smallest_for(USUAL_PICTURE),
        None => input.format.size,
    };
    Some(ShapeRange {
        least: signature.shapes(least, 1),
        usual: signature.shapes(usual, config.batch_size),
        most: signature.shapes(input.format.size, config.batch_size),
    })
}

/// Half of each side, in whole strides: the least input that an engine of TensorRT is built for.
pub(super) fn half(size: PictureSize, stride: u32) -> PictureSize {
    let half_of = |side: u32| side.div_ceil(2).next_multiple_of(stride).min(side);
    PictureSize::new(half_of(size.width), half_of(size.height))
}

/// The input of a model, and the sizes below the largest that it may run at: none, if its sides are fixed or any picture
/// fills it.
pub(super) fn model_input(
    config: &DetectorConfig,
    signature: &Signature,
    head: &Head,
) -> ModelInput {
    let format = head.input_format;
    let is_padded = format.fit != Fit::Stretch;
    let stride = signature.metadata.stride().unwrap_or(STRIDE);
    let least = if config.providers.contains(&ExecutionProvider::TensorRt) {
        half(format.size, stride)
    } else {
        PictureSize::new(1, 1)
    };
    let open = if is_padded && signature.has_open_sides() {
        Some(OpenSides { stride, least })
    } else {
        None
    };
    ModelInput {
        format: prepared_format(config, format),
        open,
        head: Some(head.name),
    }
}

/// Checks that the model accepts and returns as many pictures at once as configured.
fn check_batch(config: &DetectorConfig, signature: &Signature) -> Result<(), StartError> {
    let is_open = |tensor: &TensorSpec| tensor.shape.first() == Some(&-1);
    // An output of rows has those of all pictures one after another.
    let is_split = |output: &TensorSpec| {
        output.shape.len() > 2 || output.name == "labels" || output.name == "scores"
    };
    let takes_several = signature.inputs.iter().all(is_open);
    let returns_several = signature.outputs.iter().all(is_split);
    if config.batch_size == 1 || (takes_several && returns_several) {
        return Ok(());
    }
    Err(StartError::configuration(
        "detector.batch_size",
        format_args!(
            "is {}, and {} takes one picture at a time ({signature}); export it with an open batch (Ultralytics: \
             dynamic=True), or leave batch_size at 1",
            config.batch_size,
            config.model.display()
        ),
    ))
}

/// What is said of a configured range if the model takes bytes and not that range.
fn ignored_range(config: &DetectorConfig, input: PictureInput) -> Option<String> {
    let range = config.range?;
    if !input.takes_bytes || range == ValueRange::To255 {
        return None;
    }
    Some(format!(
        "detector.range = \"{}\" is ignored, as the model takes bytes, from 0 to 255, and converts them itself: leave it \
         out",
        range.as_str()
    ))
}

/// The head for a model: the configured one, or the recognised one.
fn head_for(config: &DetectorConfig, session: &mut OnnxSession) -> Result<Heads, StartError> {
    let names = class_names::count(config.class_names.as_ref(), &session.signature().metadata);
    let signature = known_signature(config, session, names);
    let name = config.head.name();
    let not_recognised = |reason: String| {
        StartError::new(
            StartErrorKind::DoesNotFit,
            format_args!(
                "the model {} is not recognised: {reason}\n  The model has {signature}.\n  If you know how to read it, \
                 set detector.head",
                config.model.display()
            ),
        )
    };
    let does_not_fit = |reason: String| match name {
        HeadName::Auto => not_recognised(reason),
        name => {
            let head = (name.as_str(), name.looks_for());
            StartError::does_not_fit(&config.model, &signature, head, reason)
        }
    };
    let first_run = |reason: String| StartError::first_run(&config.model, reason);
    if signature.lacks_size(config.input_size()) {
        // A model that no head reads is not asked for its size first.
        let any = signature.picture_input(Some(ANY_SIZE)).map_err(&does_not_fit)?;
        if name == HeadName::Auto {
            head::recognise(&signature, any, names).map_err(|reason| {
                not_recognised(format!(
                    "{reason}\n  Its input size is open as well: set detector.input_size, for example [640, 640]"
                ))
            })?;
        }
        return Err(size_is_open(config));
    }
    let input = signature.picture_input(config.input_size()).map_err(&does_not_fit)?;
    let mut assumed = None;
    let setting = match name {
        HeadName::Auto => {
            let found = head::recognise(&signature, input, names).map_err(&not_recognised)?;
            let told = told(session, &signature, input, names, found).map_err(first_run)?;
            let recognised = told.map_err(&not_recognised)?;
            assumed = recognised.assumed;
            HeadSetting::Named(recognised.name)
        }
        _ => config.head.clone(),
    };
    let mut bound = Heads::bind(
        setting.clone(),
        signature.clone(),
        input,
        config.overrides(),
    )
    .map_err(&does_not_fit)?;
    bound.assume(assumed);
    bound.assume(ignored_range(config, input));
    let is_recognised = name == HeadName::Auto;
    let against = run_on_black(session, input, |outputs| {
        if is_recognised {
            let assumed = head::assumed_of_nothing(setting.name(), &signature, outputs);
            bound.assume(assumed);
        }
        let mut objection = objection(bound.largest(), is_recognised, &signature, input, outputs)?;
        let way_out = || head::way_out(&signature, input, names, outputs);
        objection.remedy.get_or_insert_with(way_out);
        Some(objection)
    });
    match against.map_err(first_run)? {
        Some(objection) => Err(does_not_fit(format!(
            "its shapes are those of the head `{}`, but {objection}",
            setting.name().as_str()
        ))),
        None => Ok(bound),
    }
}

fn size_is_open(config: &DetectorConfig) -> StartError {
    StartError::configuration(
        "detector.input_size",
        format_args!(
            "the input size of {} is open: set it to the columns and rows that the model was trained with, for example \
             [640, 640]",
            config.model.display()
        ),
    )
}

/// What a run says against a head. One that was recognised must also fit the sizes of the run; whoever names a head may know
/// better.
fn objection(
    head: &Head,
    is_recognised: bool,
    signature: &Signature,
    input: PictureInput,
    outputs: &[TensorView<'_>],
) -> Option<Objection> {
    if is_recognised && let Some(reason) = head::misfit(head.name, signature, input, outputs) {
        return Some(Objection {
            reason,
            remedy: None,
        });
    }
    match head.evidence(outputs, LEAST_SCORE) {
        Evidence::Against(objection) => Some(objection),
        Evidence::For | Evidence::None => None,
    }
}

/// The head among `found` that the signature tells, or else a run; within, the reason if neither does.
///
/// # Errors
/// If the model does not run.
fn told(
    session: &mut OnnxSession,
    signature: &Signature,
    input: PictureInput,
    names: Option<usize>,
    found: Recognised,
) -> Result<Result<RecognisedHead, String>, String> {
    match found.only(signature) {
        Some(recognised) => Ok(Ok(recognised)),
        None => run_on_black(session, input, |outputs| {
            found.by_values(signature, input, names, outputs)
        }),
    }
}

/// What is known of the model with this number of class names, with what a run shows of outputs that it leaves open.
fn known_signature(
    config: &DetectorConfig,
    session: &mut OnnxSession,
    names: Option<usize>,
) -> Signature {
    let declared = session.signature();
    let stride = declared.metadata.stride().unwrap_or(STRIDE);
    let input = declared
        .picture_input(config.input_size())
        .or_else(|_| declared.picture_input(Some(ANY_SIZE)));
    match input {
        Ok(input) => open_outputs::measured(session, input, stride, names),
        Err(_) => declared.clone(),
    }
}

/// A size to try heads with while that of the input is open.
const ANY_SIZE: PictureSize = PictureSize::new(640, 640);

/// Runs the model on zeros, which are black in most ranges, and shows the outputs.
pub(super) fn run_on_black<R>(
    session: &mut OnnxSession,
    input: PictureInput,
    read: impl FnOnce(&[TensorView<'_>]) -> R,
) -> Result<R, String> {
    let format = input.format(Fit::Stretch, ColorOrder::Rgb, ValueRange::To255);
    let zeros = InputTensor::zeros(format.element, format.size);
    session.run(format.shape(), format.size, &[&zeros], read)
}
