//! Measures the milliseconds per frame by stage, and the frames per second with several cameras in one run.

use super::arguments::{Arguments, name_of, without_folder};
use super::node::{RATE, processor_seconds_of};
use super::page::{NONE, median, ms};
use super::pieces::{Row, Table, TableName};
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorHandle, DetectorNetwork, ExecutionProvider, Preparation,
    PreparedPicture,
};
use albireo_vision::onnx::OnnxSession;
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, InputFormat, Picture, PixelLayout, decode,
};
use albireo_vision::screen::decoding_target;
use anyhow::bail;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The numbers of pictures in one run of the model.
const BATCHES: [usize; 4] = [1, 2, 4, 8];

/// The number of pictures used from the demonstration's road.
const PICTURES: usize = 60;

pub(crate) fn stages_table() -> Table {
    Table {
        heading: "Milliseconds per frame, by stage",
        text: "One picture after the other on one thread, medians. *Model* is one run as the node does it: the input copied to the \
               device, the kernels, the output copied back; the share of copying is given below, under *Copies alone*. Decoding and \
               letterbox are always the processor's. *Converted by* says where pixels become the model's numbers: in the letterbox, or \
               on the GPU within *model*, by a graph in front of it. *Started* says whether the processor starts a run layer by \
               layer or replays what CUDA recorded (`detector.gpu.cuda_graph`; a model that it cannot record runs layer by layer). \
               *Processor waits* says whether it spins, as CUDA does by itself, or sleeps. The last row of a model is the node's way. *Loading* \
               includes the first runs."
            .to_owned(),
        columns: &[
            "model",
            "provider used",
            "input",
            "elements",
            "converted by",
            "started",
            "processor waits",
            "loading, s",
            "decode",
            "letterbox",
            "model",
            "head",
            "processor, all stages",
        ],
    }
}

pub(crate) fn batches_table() -> Table {
    Table {
        heading: "Several cameras in one run",
        text: "As many cameras as the batch is large, each asking for its next picture when it has its answer \
               (`detector.batch_size`), beside the bare session that runs full batches of the same pictures one after the other. \
               *Model* is the run's time by picture."
            .to_owned(),
        columns: &[
            "model",
            "pictures a run, at most",
            "shared",
            "model, ms a picture",
            "frames/s",
            "bare session, frames/s",
            "of the bare session's rate",
        ],
    }
}

/// A row for each batch that the model takes.
///
/// # Errors
/// If the model does not run with one picture.
pub(crate) async fn batches(arguments: &Arguments, model: &Path) -> anyhow::Result<Vec<Row>> {
    let until = Instant::now() + arguments.limit();
    let pictures = frames()?;
    let mut rows = Vec::new();
    let mut longest = Duration::ZERO;
    for (done, batch) in BATCHES.into_iter().enumerate() {
        let config = DetectorConfig {
            batch_size: batch,
            ..arguments.detector(model)
        };
        let begun = Instant::now();
        let left = until.saturating_duration_since(begun);
        // What is measured counts more than a batch for which the time is too short.
        if left < longest {
            break;
        }
        // The time that is left, in equal parts for this batch and those after it.
        let each = left / (BATCHES.len() - done) as u32 / 3;
        let mut cells = vec![name_of(model), batch.to_string()];
        match together(arguments, &config, &pictures, each).await {
            Ok(found) => cells.extend(found),
            Err(error) if batch == 1 => return Err(error),
            Err(error) => {
                cells.push(without_folder(format_args!("{error:#}"), model));
                cells.resize(7, NONE.to_owned());
            }
        }
        longest = longest.max(begun.elapsed());
        let refused = cells[3] == NONE;
        rows.push(Row {
            table: TableName::Batches,
            cells,
        });
        // Larger batches would be refused in the same words.
        if refused {
            break;
        }
    }
    Ok(rows)
}

/// A row with the time of each stage; on a GPU others, in which the processor spins, or converts the pictures, or in which
/// CUDA replays its runs.
pub(crate) fn stages(arguments: &Arguments, model: &Path) -> anyhow::Result<Vec<Row>> {
    let as_the_node = arguments.detector(model);
    let mut spinning = as_the_node.clone();
    spinning.gpu.spin = true;
    let mut converting = as_the_node.clone();
    converting.gpu.processor_converts = true;
    let mut replaying = as_the_node.clone();
    replaying.gpu.cuda_graph = true;
    // Spinning first: once told to sleep, the threads of a process sleep.
    let ways = if arguments.is_gpu() {
        vec![spinning, converting, replaying, as_the_node]
    } else {
        vec![as_the_node]
    };
    let each = arguments.limit() / 2 / ways.len() as u32;
    ways.iter().map(|config| stages_of(arguments, model, config, each)).collect()
}

/// A row of what is measured in the time of `each`.
fn stages_of(
    arguments: &Arguments,
    model: &Path,
    config: &DetectorConfig,
    each: Duration,
) -> anyhow::Result<Row> {
    let start = Instant::now();
    let until = start + each;
    let mut network = DetectorNetwork::open(config)?;
    let loading = start.elapsed().as_secs_f64();
    let mut times: [Vec<f64>; 4] = Default::default();
    let mut picture = Picture::default();
    let before = processor_seconds_of(std::process::id())?;
    for encoded in frames()?.iter().cycle().take(arguments.runs.into()) {
        if Instant::now() > until {
            break;
        }
        let start = Instant::now();
        decode_for(&network, encoded, &mut picture)?;
        let decoding = start.elapsed();
        let prepared = network.preparation().prepare(&picture)?;
        let found = network.detect(&prepared)?;
        for (times, time) in
            times.iter_mut().zip([decoding, found.letterbox, found.model, found.head])
        {
            times.push(time.as_secs_f64() * 1e3);
        }
    }
    let processor =
        (processor_seconds_of(std::process::id())? - before) * 1e3 / times[0].len().max(1) as f64;
    let element = match network.signature().inputs.first() {
        Some(input) => input.element.to_string(),
        None => NONE.to_owned(),
    };
    let mut row = vec![
        name_of(model),
        // The provider that the session reports, which may differ from the requested one.
        network.provider().as_str().to_owned(),
        network.input_format().size.to_string(),
        element,
        converted_by(&network).to_owned(),
        started(&network).to_owned(),
        waits(arguments, config).to_owned(),
        format!("{loading:.2}"),
    ];
    row.extend(times.iter().map(|times| ms(median(times))));
    row.push(format!("{processor:.1}"));
    Ok(Row {
        table: TableName::Stages,
        cells: row,
    })
}

fn converted_by(network: &DetectorNetwork) -> &'static str {
    if network.preparation().format() == network.input_format() {
        "processor"
    } else {
        "GPU"
    }
}

/// How the processor starts a run.
fn started(network: &DetectorNetwork) -> &'static str {
    if network.replays() {
        "replayed"
    } else {
        "layer by layer"
    }
}

/// What the processor does while the GPU works.
fn waits(arguments: &Arguments, config: &DetectorConfig) -> &'static str {
    if !arguments.is_gpu() {
        NONE
    } else if config.gpu.spin {
        "spins"
    } else {
        "sleeps"
    }
}

/// Decodes like the node for this model, without a screen.
pub(crate) fn decode_for(
    network: &DetectorNetwork,
    encoded: &EncodedPicture,
    into: &mut Picture,
) -> anyhow::Result<()> {
    let target = decoding_target(network.input_format(), None, encoded.size);
    let limits = FrameLimits::default();
    Ok(decode(
        encoded,
        &limits,
        PixelLayout::Rgb8,
        Some(target),
        into,
    )?)
}

/// The cells of a batch: with cameras for at most `each`, then the bare session for as long.
async fn together(
    arguments: &Arguments,
    config: &DetectorConfig,
    frames: &[EncodedPicture],
    each: Duration,
) -> anyhow::Result<Vec<String>> {
    let detector = DetectorHandle::start(config).await?;
    let preparation = detector.preparation().clone();
    // Decodes in advance, because only the detector is measured.
    let mut pictures = Vec::new();
    for frame in frames {
        let mut picture = Picture::default();
        let target = decoding_target(preparation.format(), None, frame.size);
        let limits = FrameLimits::default();
        decode(
            frame,
            &limits,
            PixelLayout::Rgb8,
            Some(target),
            &mut picture,
        )?;
        pictures.push(Arc::new(picture));
    }
    let asked = usize::from(arguments.runs).div_ceil(config.batch_size);
    let start = Instant::now();
    let mut cameras = Vec::new();
    for camera in 0..config.batch_size {
        let detector = detector.clone();
        let mut own = pictures.clone();
        own.rotate_left(camera % pictures.len());
        cameras.push(tokio::spawn(async move {
            let mut answers = Vec::new();
            for number in 0..asked {
                if start.elapsed() > each {
                    break;
                }
                let picture = Arc::clone(&own[number % own.len()]);
                let answer = detector.detect(CameraSlot(camera), picture).await?;
                let model = answer.output.model.as_secs_f64() * 1e3;
                answers.push((model, f64::from(answer.pictures)));
            }
            anyhow::Ok(answers)
        }));
    }
    let mut answers = Vec::new();
    for camera in cameras {
        answers.extend(camera.await??);
    }
    let rate = answers.len() as f64 / start.elapsed().as_secs_f64();
    detector.stop().await;
    let a_picture: Vec<_> = answers.iter().map(|(model, pictures)| model / pictures).collect();
    let shared = answers.iter().map(|(_, pictures)| pictures).sum::<f64>();
    let bare = bare(config, &preparation, &pictures, asked, each)?;
    Ok(vec![
        format!("{:.2}", shared / answers.len() as f64),
        ms(median(&a_picture)),
        format!("{rate:.1}"),
        format!("{bare:.1}"),
        format!("{:.3}", rate / bare),
    ])
}

/// The frames per second of ONNX Runtime's session alone, with full batches that are prepared in advance and outputs
/// that nobody reads.
fn bare(
    config: &DetectorConfig,
    preparation: &Preparation,
    pictures: &[Arc<Picture>],
    runs: usize,
    longest: Duration,
) -> anyhow::Result<f64> {
    let mut session = OnnxSession::open(&config.session_settings())?;
    let format = model_format(config)?;
    let mut prepared = Vec::new();
    for picture in pictures.iter().cycle().take(config.batch_size) {
        prepared.push(preparation.prepare(picture)?.converted(format)?);
    }
    let inputs: Vec<_> = prepared.iter().map(PreparedPicture::tensor).collect();
    // A model with open sides runs at the size that the pictures need.
    let size = prepared.first().map_or(format.size, PreparedPicture::size);
    let shape = InputFormat { size, ..format }.shape();
    // The first runs lay out memory.
    for _ in 0..3 {
        session.run(shape, size, &inputs, |_| ()).map_err(anyhow::Error::msg)?;
    }
    let start = Instant::now();
    let mut done = 0;
    while done < runs && start.elapsed() < longest {
        session.run(shape, size, &inputs, |_| ()).map_err(anyhow::Error::msg)?;
        done += 1;
    }
    Ok((done * config.batch_size) as f64 / start.elapsed().as_secs_f64())
}

/// The model's own input, which a session takes that nothing stands before.
fn model_format(config: &DetectorConfig) -> anyhow::Result<InputFormat> {
    let on_processor = DetectorConfig {
        providers: vec![ExecutionProvider::Cpu],
        batch_size: 1,
        ..config.clone()
    };
    Ok(DetectorNetwork::open(&on_processor)?.input_format())
}

/// The pictures for the detectors.
pub(crate) fn frames() -> anyhow::Result<Vec<EncodedPicture>> {
    let mut source = Pictures::of_archive(Path::new("demo/road.tar"), RATE)?;
    let mut frames = Vec::new();
    while frames.len() < PICTURES
        && let Some(frame) = source.next()?
    {
        frames.push(frame);
    }
    if frames.is_empty() {
        bail!("there are no pictures");
    }
    Ok(frames)
}
