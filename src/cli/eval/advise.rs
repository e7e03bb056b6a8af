//! `albireo eval advise`: which policy, knob and screen meet a target on a recording.

use super::video::{PassArguments, look_at};
use super::{JUDGED, WRITTEN};
use crate::cli::rate::parse_rate;
use albireo_eval::advise::{
    Costs, Recording, Settings, Target, advise, parse_target, render, target_in_words,
};
use albireo_eval::data::recorded;
use albireo_eval::energy_model::EnergyModel;
use albireo_eval::footage::SourceName;
use anyhow::{Context, bail, ensure};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};

/// The options.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  albireo eval advise drive.mp4 --detector detector.onnx --target recall=0.95
      what a video of your own road allows, by your own detector
  albireo eval video drive.mp4 --detector detector.onnx --save-detections drive
  albireo eval advise drive --target skip_rate=0.5
      the same detections again, for another target, without another look at the pictures")]
pub(super) struct AdviseArguments {
    /// Video files, folders of pictures, or folders of recorded detections (`albireo eval video … --save-detections`); an
    /// hour of the road the camera sees is a good recording.
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    /// What is to be met: recall (against the detector), skip_rate, detector_ms_per_s, watts or joules_per_day.
    #[arg(long, value_name = "NAME=VALUE", default_value = "recall=0.95", value_parser = parse_target)]
    target: Target,
    /// A policy to try; may be given several times [default: albireo, expected-loss, even-skip-in-tracker].
    #[arg(long, value_name = "NAME")]
    policy: Vec<String>,
    /// Detections below this confidence are not used, as `detector.confidence` of a node.
    #[arg(long, help_heading = JUDGED, default_value_t = 0.5, allow_negative_numbers = true)]
    confidence: f64,
    /// Frames a second: of folders of pictures, and of recordings that do not say.
    #[arg(long, help_heading = JUDGED, value_name = "FPS", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Milliseconds the detector takes for a frame on your board [default: as measured here on pictures, else the energy
    /// model's].
    #[arg(long, help_heading = JUDGED, value_name = "MS")]
    detector_ms: Option<f64>,
    /// Project energy with this model; `none` for no energy [default: a Jetson AGX Thor with YOLO26x].
    #[arg(long, help_heading = JUDGED, value_name = "FILE")]
    energy_model: Option<PathBuf>,
    /// Frames in a row that a screen may call empty before the detector looks anyway; 0 for any number.
    #[arg(long, help_heading = JUDGED, value_name = "COUNT", default_value_t = 100)]
    longest_empty_run: u32,
    /// Print the advice as JSON instead.
    #[arg(long, help_heading = WRITTEN)]
    json: bool,
    #[command(flatten)]
    pass: PassArguments,
}

/// Runs the command; the advice goes to standard output, everything else to standard error.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do; also when nothing meets the target.
pub(super) fn run(arguments: &AdviseArguments) -> anyhow::Result<()> {
    ensure!(
        (0.0..=1.0).contains(&arguments.confidence),
        "--confidence {} is not between 0 and 1",
        arguments.confidence
    );
    if let Some(value) = arguments.detector_ms {
        let usable = (1e-3..=1e6).contains(&value);
        ensure!(
            usable,
            "--detector-ms {value} is not between 0.001 and 1000000"
        );
    }
    let settings = Settings {
        confidence: arguments.confidence,
        longest_empty_run: arguments.longest_empty_run,
        costs: Costs {
            frame_rate: arguments.rate,
            detector_ms: arguments.detector_ms,
            model: match arguments.energy_model.as_deref() {
                Some(none) if none == Path::new("none") => None,
                Some(file) => Some(EnergyModel::load(file)?),
                None => Some(EnergyModel::built_in()?),
            },
        },
    };
    let recordings = read(arguments)?;
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} trials, {elapsed}, {eta} left")
        .context("the progress bar's template")?;
    let bar = ProgressBar::new(0).with_style(style);
    if bar.is_hidden() {
        eprintln!("Trying policies on {} clips", recordings.len());
    }
    let begun = |steps: usize| bar.set_length(steps as u64);
    let advice = advise(
        &recordings,
        arguments.target,
        &arguments.policy,
        &settings,
        &begun,
        &|| bar.inc(1),
    );
    bar.finish_and_clear();
    let advice = advice?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&advice)?);
    } else {
        print!("{}", render(&advice));
    }
    if advice.best().is_none() {
        bail!(
            "nothing meets {} on this recording",
            target_in_words(arguments.target)
        );
    }
    Ok(())
}

/// Detections that are recorded are read, everything else is looked at.
fn read(arguments: &AdviseArguments) -> anyhow::Result<Vec<Recording>> {
    let mut recordings = Vec::new();
    let mut footage = Vec::new();
    for path in &arguments.recordings {
        if path.join("sequences.json").is_file() {
            let clips = recorded::read(path)?.only_with_detections(path)?;
            recordings.extend(clips.clips.into_iter().map(Recording::from));
        } else {
            let name = path.to_string_lossy();
            footage.push(name.parse::<SourceName>().map_err(anyhow::Error::msg)?);
        }
    }
    if !footage.is_empty() {
        let looked = look_at(&footage, arguments.rate, &arguments.pass)?;
        recordings.extend(looked.into_iter().map(Recording::from));
    }
    Ok(recordings)
}
