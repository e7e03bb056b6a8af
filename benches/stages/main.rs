//! Measures the time of a frame by stage and the cost of the queue in front of the detector. With `--python`, compares
//! it with the same path in Python. Run with `cargo bench --bench stages`; `-- --help` lists options.

mod arguments;
mod ours;
mod python;
mod samples;
mod table;
mod throughput;

use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::detector::{DetectorConfig, DetectorHandle};
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, InputFormat, Picture, PixelLayout, decode,
};
use albireo_vision::screen::decoding_target;
use anyhow::{Context, bail};
use arguments::{Arguments, file_name, load_average};
use clap::Parser;
use ours::{Line, OurPath};
use python::PythonPath;
use samples::Samples;
use std::path::Path;
use std::sync::Arc;
use throughput::{MadeReady, Throughput};

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let frames = frames(&arguments)?;
    // The Python path reads the same files.
    let folder = tempfile::tempdir().context("a folder for pictures")?;
    for (number, frame) in frames.iter().enumerate() {
        let file = folder.path().join(format!("{number:05}.jpg"));
        std::fs::write(&file, &frame.bytes).with_context(|| file.display().to_string())?;
    }
    let bytes: usize = frames.iter().map(|frame| frame.bytes.len()).sum();
    println!(
        "{} pictures of {}, {} kB each; {} rounds; {} cores{}.",
        frames.len(),
        frames[0].size,
        bytes / frames.len() / 1000,
        arguments.rounds,
        std::thread::available_parallelism().map_or(1, usize::from),
        match load_average() {
            Some(load) => format!(", load average {load} at the start"),
            None => String::new(),
        },
    );
    if cfg!(debug_assertions) {
        println!(
            "This is the development profile; `cargo bench` measures what a release build does."
        );
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let line = Line::open().await?;
        for model in &arguments.models {
            measure(&arguments, model, &frames, folder.path(), &line).await?;
        }
        Ok(())
    })
}

/// The pictures of one round, all in JPEG.
fn frames(arguments: &Arguments) -> anyhow::Result<Vec<EncodedPicture>> {
    let mut source: Box<dyn FrameSource> = match &arguments.pictures {
        Some(folder) => Box::new(Pictures::of_folder(folder, Pictures::DEFAULT_RATE)?),
        None => Box::new(Pictures::of_archive(
            Path::new("demo/road.tar"),
            Pictures::DEFAULT_RATE,
        )?),
    };
    let mut frames = Vec::new();
    while frames.len() < usize::from(arguments.frames)
        && let Some(frame) = source.next()?
    {
        frames.push(frame);
    }
    if frames.is_empty() {
        bail!("{} has no pictures", source.name());
    }
    Ok(frames)
}

/// Measures one model. The compared paths take turns, so that a busy moment of the machine affects all of them.
async fn measure(
    arguments: &Arguments,
    model: &Path,
    frames: &[EncodedPicture],
    folder: &Path,
    line: &Line,
) -> anyhow::Result<()> {
    let config = DetectorConfig {
        model: model.to_owned(),
        threads: arguments.threads(),
        ..DetectorConfig::default()
    };
    let mut path = OurPath::open(&config, line)?;
    let head = path.network.head().as_str();
    let mut python = match &arguments.python {
        Some(python) => Some(PythonPath::start(
            python,
            model,
            head,
            folder,
            config.threads,
        )?),
        None => None,
    };
    let detector = DetectorHandle::start(&config).await?;
    let pictures = decoded(frames, path.network.input_format())?;

    let mut ours = Samples::default();
    let mut theirs = Samples::default();
    let mut throughput = Throughput::default();
    for frame in frames {
        // Warms up: buffers grow here.
        path.frame(frame, &mut Samples::default()).await?;
    }
    for _ in 0..arguments.rounds {
        for frame in frames {
            path.frame(frame, &mut ours).await?;
        }
        if let Some(python) = &mut python {
            python.round(&mut theirs)?;
        }
        throughput.run_loop(&mut path.network, &pictures)?;
        throughput.run_queue(&detector, &pictures).await?;
        throughput.run_camera(&detector, frames, MadeReady::InTurn).await?;
        throughput.run_camera(&detector, frames, MadeReady::Ahead).await?;
    }
    detector.stop().await;

    println!(
        "\n{}: head {head}, input {}, {}, threads: {};\ndecoded to {}; {:.1} objects per frame",
        file_name(model)?,
        path.network.input_format().size,
        detector.provider().as_str(),
        config.threads,
        path.decoded_size(),
        ours.detections(),
    );
    table::print(&ours, python.as_ref().map(|_| &theirs));
    throughput.print();
    if let Some(python) = &python {
        println!("Python: {}.", python.versions);
    }
    Ok(())
}

fn decoded(frames: &[EncodedPicture], input: InputFormat) -> anyhow::Result<Vec<Arc<Picture>>> {
    let mut pictures = Vec::new();
    for frame in frames {
        let mut picture = Picture::default();
        decode_for(input, frame, &mut picture)?;
        pictures.push(Arc::new(picture));
    }
    Ok(pictures)
}

/// Decodes `frame` like the node for a detector with this input, without a screen.
fn decode_for(
    input: InputFormat,
    frame: &EncodedPicture,
    into: &mut Picture,
) -> anyhow::Result<()> {
    let limits = FrameLimits::default();
    let target = decoding_target(input, None, frame.size);
    Ok(decode(
        frame,
        &limits,
        PixelLayout::Rgb8,
        Some(target),
        into,
    )?)
}
