//! Measures the node on one GPU: provider, stages, batches, ways into a session, cameras with their energy, starts, and
//! the messages on failure. Writes `benches/gpu.md`. Run by `make gpu`; `--provider cpu` makes it a trial of this
//! script.

mod arguments;
mod cameras;
mod card;
mod failures;
mod node;
mod page;
mod stages;
mod starts;
mod ways;

use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::detector::DetectorNetwork;
use albireo_vision::picture::EncodedPicture;
use anyhow::{Context, bail};
use arguments::{Arguments, library, name_of};
use card::Card;
use clap::Parser;
use page::Page;
use std::path::Path;
use std::process::ExitCode;

/// The number of pictures used from the demonstration's road.
const PICTURES: usize = 60;

/// The mark on a trial's page. A trial overwrites no page without it.
const TRIAL: &str = "**CPU provider: a trial of the script, not a GPU's figures.**";

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // On one line, because a parent process reads the last line.
            eprintln!("{error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(model) = &arguments.ways_of {
        return ways::run(arguments, model);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(measure(arguments))
}

async fn measure(arguments: &Arguments) -> anyhow::Result<()> {
    let there = std::fs::read_to_string(&arguments.out).unwrap_or_default();
    if !arguments.is_gpu() && !there.is_empty() && !there.contains(TRIAL) {
        bail!(
            "{} has a GPU's figures: name another page for a trial (OUT=…)",
            arguments.out.display()
        );
    }
    let engines = tempfile::tempdir()?;
    let first = arguments.models()?.swap_remove(0);
    // Fails with a message before anything is measured.
    let network = DetectorNetwork::open(&arguments.detector(&first, Some(engines.path())))?;
    let used = network.provider();
    drop(network);
    if used != arguments.provider {
        bail!(
            "`{}` was asked for and the session runs on `{}`",
            arguments.provider.as_str(),
            used.as_str()
        );
    }
    let card = match Card::open(arguments.device) {
        Ok(card) => Some(card),
        Err(error) if arguments.is_gpu() => return Err(error),
        Err(_) => None,
    };
    let frames = frames()?;
    let mut page = Page::default();
    beginning(&mut page, arguments, card.as_ref())?;
    stages::write(&mut page, arguments, &frames, engines.path()).await?;
    ways::write(&mut page, arguments).await?;
    cameras::write(&mut page, arguments, &frames, card.as_ref(), engines.path()).await?;
    starts::write(&mut page, arguments, &frames).await?;
    failures::write(&mut page, arguments).await?;
    std::fs::write(&arguments.out, page.into_text())
        .with_context(|| arguments.out.display().to_string())?;
    println!("{} is written", arguments.out.display());
    Ok(())
}

/// The pictures for the detectors.
fn frames() -> anyhow::Result<Vec<EncodedPicture>> {
    let mut source = Pictures::of_archive(Path::new("demo/road.tar"), node::RATE)?;
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

/// Writes the subject of the page and the command that makes it.
fn beginning(page: &mut Page, arguments: &Arguments, card: Option<&Card>) -> anyhow::Result<()> {
    page.lines("# What a GPU does for the node");
    if arguments.is_gpu() {
        page.text(format!(
            "Figures of one GPU, by `{}`.",
            arguments.provider.as_str()
        ));
    } else {
        page.text(format!(
            "{TRIAL} No GPU was available: no figure of CUDA or TensorRT has been measured. Each table below is what the \
             same script wrote with ONNX Runtime's CPU provider, so that script and tables are known to work; on a machine with a \
             GPU the same command fills these tables with the GPU's figures."
        ));
    }
    page.lines(format!(
        "<!-- by hand, {} -->\n```sh\nmake gpu                                      # with CUDA; PROVIDER=tensorrt for TensorRT\n\
         make gpu MODELS=\"yolo11n.onnx yolo26m.onnx\"   # your own detectors, of any size; made beside them: half precision, an open batch\n\
         make gpu PROVIDER=cpu                         # a trial of the script without a GPU\n```",
        arguments.date
    ));
    page.text(
        "It needs NVIDIA's driver, and ONNX Runtime's CUDA build with the CUDA and cuDNN libraries that it loads: the wheel \
         `onnxruntime-gpu` has the build, `ORT_DYLIB_PATH` names its `libonnxruntime.so`, `LD_LIBRARY_PATH` the rest. Without them \
         it stops with what ONNX Runtime said and writes nothing. `CAMERA_MODELS`, `SECONDS_EACH`, `MOST_CAMERAS`, `RUNS`, `DEVICE` and \
         `OUT` set the rest. For a machine without Rust the bench is built elsewhere (`cargo bench --no-run --bench gpu` says where it \
         lies) and named in `GPU_BENCH`, the program in `ALBIREO_BIN`. Speed is that of the architecture: models exported with random \
         weights do for everything but the cameras, where `CAMERA_MODELS` should know what it sees.",
    );
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let mut row = vec![
        card.map_or_else(|| Ok("none, or no driver".to_owned()), Card::description)?,
        format!("{cores} cores, {}", std::env::consts::ARCH),
        load.split_whitespace().next().unwrap_or(page::NONE).to_owned(),
        name_of(&library()?.canonicalize()?),
    ];
    row.push(if cfg!(debug_assertions) {
        "development".to_owned()
    } else {
        "optimised".to_owned()
    });
    page.table(
        &[
            "GPU",
            "processor",
            "load at the start",
            "ONNX Runtime",
            "build",
        ],
        &[row],
    );
    Ok(())
}
