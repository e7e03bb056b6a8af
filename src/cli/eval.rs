//! `albireo eval`: compares accuracy, skip rate, time and energy of policies on recordings.

mod advise;
mod board;
mod join;
mod settings;
mod video;

use self::settings::SettingsArguments;
use super::progress;
use super::terminal;
use super::values::parse_rate;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{PolicyConfig, Profile};
use albireo_eval::data::{DataSet, bdd100k, coco, kitti, mot_challenge, recorded};
use albireo_eval::energy_model::EnergyModel;
use albireo_eval::files;
use albireo_eval::report::{Report, conclusion, render};
use albireo_eval::result::ClipResult;
use albireo_eval::run::run as run_policies;
use albireo_eval::run::streams::{self, RunTimes, Stream, StreamResults};
use albireo_eval::settings::Settings;
use albireo_eval::spec::{PolicySpec, Sweep, resolve};
use albireo_eval::summary;
use albireo_eval::text::wrapped;
use anyhow::{Context, bail, ensure};
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};

/// Compare policies side by side: accuracy, skip rate, frame time, energy.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  albireo eval recorded DIR --policy albireo --sweep u=3e-4,5e-4,7e-4,1e-3
      what each threshold costs in accuracy and saves in detector calls
  albireo eval advise drive.mp4 --target recall=0.95
      which value of a threshold your road and your detector allow
  albireo eval recorded DIR --profile reference --screen detections \\
      --traces traces
      the published code's decisions, frame by frame")]
pub struct EvalArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Replay recorded detections: a folder with sequences.json, detections/ and groundtruth/.
    Recorded(FolderArguments),
    /// Replay the public detections of a MOTChallenge sequence (seqinfo.ini, gt/ and det/), or of a folder of
    /// sequences.
    #[command(name = "motchallenge")]
    MotChallenge(FolderArguments),
    /// Replay stored detections on KITTI tracking: a folder with label_02/ and det_02/.
    Kitti(FolderArguments),
    /// Replay stored detections on BDD100K MOT (box_track_20), or any labels in the Scalabel form.
    Bdd100k {
        /// Labels: a JSON file or a folder of them.
        ground_truth: PathBuf,
        /// Predictions with scores, in the same form.
        #[arg(long)]
        detections: PathBuf,
        /// Size of the pictures, which the files do not contain.
        #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x720", value_parser = crate::cli::values::parse_size)]
        size: PictureSize,
        #[command(flatten)]
        run: RunArguments,
    },
    /// Replay stored detections on a COCO data set.
    Coco {
        /// The data set: images, annotations and categories.
        dataset: PathBuf,
        /// Detections as a list of results.
        #[arg(long)]
        detections: PathBuf,
        #[command(flatten)]
        run: RunArguments,
    },
    /// Run a real detector once over videos or pictures, then every policy on its detections.
    #[command(alias = "pictures")]
    Video(video::VideoArguments),
    /// Measure policies on this machine, clip by clip: accuracy against ground truth, time and energy by its own meter.
    Board(Box<board::BoardArguments>),
    /// Join what `albireo eval board` measured, here or elsewhere, into the paper's tables and figures.
    Join(join::JoinArguments),
    /// Propose a value of a policy's threshold for a target, from a recording with your own detector.
    Advise(advise::AdviseArguments),
}

/// A data set in a folder.
#[derive(Debug, Args)]
struct FolderArguments {
    /// The folder.
    folder: PathBuf,
    #[command(flatten)]
    run: RunArguments,
}

/// Headings of the help.
const JUDGED: &str = "How it is judged";
const WRITTEN: &str = "What is written";
const LOOKED: &str = "What looks at the pictures";

/// Arguments of every comparison of policies.
#[derive(Clone, Debug, Args)]
struct RunArguments {
    #[command(flatten)]
    settings: SettingsArguments,
    /// A policy by its name in the configuration, as NAME or NAME:SETTING; may be given several times. `all` stands for
    /// the paper's policies with its settings and expected-loss at 0.1, 0.3 and 0.5. `,pause_s=SECONDS` behind it adds
    /// a pause on an empty road (`[screen]`), `,after_s=SECONDS` says after how long without a detection. Vanilla
    /// always runs as well.
    #[arg(long, value_name = "NAME[:SETTING]", default_value = "albireo")]
    policy: Vec<String>,
    /// Uncertainty threshold of the policies that have one.
    #[arg(long, default_value_t = 3e-4, allow_negative_numbers = true)]
    u: f64,
    /// Values of a setting to try one after the other, for instance u=3e-4,5e-4,7e-4,1e-3.
    #[arg(long, value_name = "NAME=VALUE,…")]
    sweep: Vec<Sweep>,
    /// Frames per second, in place of the rate that the data has: BDD100K 5, KITTI 10, MOTChallenge that of
    /// seqinfo.ini, a video its own.
    #[arg(long, help_heading = JUDGED, value_name = "FPS", alias = "frame-rate", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Take this many frames per second, as if the camera were slower.
    #[arg(long, help_heading = JUDGED, value_name = "FPS", value_parser = parse_rate)]
    fps: Option<f64>,
    /// Also judge boxes when frames arrive, with a detector that takes this many milliseconds, or the times in FILE in
    /// turn, one measured run per line; at-arrival.txt in --out.
    #[arg(long, help_heading = JUDGED, value_name = "MILLISECONDS|FILE", value_parser = RunTimes::read)]
    detector_ms: Option<RunTimes>,
    /// Also judge the boxes that are interpolated between two detector calls once the second is known; settled.txt in
    /// --out.
    #[arg(long, help_heading = JUDGED)]
    settled: bool,
    /// Project energy and frame time with the model of a board with this detector (config/energy); without one,
    /// energy is not reported.
    #[arg(long, help_heading = WRITTEN, value_name = "FILE")]
    energy_model: Option<PathBuf>,
    /// Write summary.csv, report.json, plots and report.html here.
    #[arg(long, help_heading = WRITTEN, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Names of settings in a report.
const CROWDS: &str = "Boxes on crowds, distractors and ignored regions";
const FRAME_RATE: &str = "Frame rate";
const FRAMES_JUDGED: &str = "Frames judged";

/// Runs the command; results go to standard output, notes, progress and places of files to standard error.
///
/// # Errors
/// When data cannot be read, an argument is invalid, or a file cannot be written.
pub fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    match &arguments.what {
        What::Recorded(FolderArguments { folder, run }) => {
            compare(recorded::read(folder)?, folder, run)
        }
        What::MotChallenge(FolderArguments { folder, run }) => {
            compare(mot_challenge::read(folder)?, folder, run)
        }
        What::Kitti(FolderArguments { folder, run }) => compare(kitti::read(folder)?, folder, run),
        What::Bdd100k {
            ground_truth,
            detections,
            size,
            run,
        } => {
            let source = bdd100k::Source {
                truth: Some(ground_truth),
                detections: Some(detections),
                picture: *size,
                frame_rate: Some(bdd100k::BDD100K_FRAME_RATE),
                rules: run.settings.rules()?,
            };
            compare(bdd100k::read(&source)?, ground_truth, run)
        }
        What::Coco {
            dataset,
            detections,
            run,
        } => compare(coco::read(dataset, Some(detections))?, dataset, run),
        What::Video(arguments) => video::run(arguments),
        What::Board(arguments) => super::block_on(board::run(arguments)),
        What::Join(arguments) => join::run(arguments),
        What::Advise(arguments) => advise::run(arguments),
    }
}

/// Runs all selected policies over the clips of `data`, and reports the results.
fn compare(data: DataSet, path: &Path, arguments: &RunArguments) -> anyhow::Result<()> {
    let confidence = arguments.settings.confidence;
    ensure!(
        (0.0..=1.0).contains(&confidence),
        "--confidence {confidence} is not between 0 and 1"
    );
    let rules = arguments.settings.rules()?;
    let mut data = data.only_with_detections(path)?.judged_by(rules, arguments.rate);
    if let Some(rate) = arguments.fps {
        if let Some(clip) = data.clips.iter().find(|clip| clip.frame_rate.is_none()) {
            bail!(
                "--fps {rate}: the data does not say how many frames per second {} has: add --rate",
                clip.name
            );
        }
        data.clips = data.clips.into_iter().map(|clip| clip.thinned(rate)).collect();
    }
    let has_pixels = false;
    let policies = policies(arguments, has_pixels)?;
    let settings = settings(arguments)?;
    for line in data.report.lines() {
        eprintln!("{line}");
    }
    let steps = data.clips.len() * policies.len();
    let bar = progress::bar(Some(steps as u64), "clips x policies");
    let results = run_policies(&data.clips, &policies, &settings, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let mut streams = Vec::new();
    for stream in streams_asked(arguments) {
        streams.push(streams::run(&data.clips, &policies, &settings, stream)?);
    }
    let report = Report {
        title: format!("Stored detections of {}", path.display()),
        settings: listed(arguments, &results)?,
        data: data.report,
        policies: summary::summarise(&results),
        clips: results,
    };
    keep(&report, &streams, arguments)?;
    print(&report, &streams, arguments);
    Ok(())
}

/// Writes the results to `--out`. Comes before [`print()`]: whoever reads the output may close it, which ends the
/// program.
fn keep(
    report: &Report,
    streams: &[StreamResults],
    arguments: &RunArguments,
) -> anyhow::Result<()> {
    if let Some(folder) = &arguments.out {
        report.write(folder)?;
        for stream in streams {
            files::write(&folder.join(stream.file_name()), stream.table())?;
        }
    }
    Ok(())
}

/// Prints the results.
fn print(report: &Report, streams: &[StreamResults], arguments: &RunArguments) {
    let width = terminal::width();
    print!("{}", render(&report.policies, width));
    println!();
    for sentence in conclusion(&report.policies) {
        println!("{}", wrapped(&sentence, width));
    }
    // The tables do not show these settings, and their figures depend on them.
    for (name, value) in &report.settings {
        let is_printed = match name.as_str() {
            CROWDS | FRAME_RATE => true,
            FRAMES_JUDGED => value != ALL,
            _ => false,
        };
        if is_printed {
            println!("{}", wrapped(&format!("{name}: {value}."), width));
        }
    }
    for stream in streams {
        print!("\n{}", stream.table());
    }
    if let Some(folder) = &arguments.out {
        eprintln!("Written to {}", folder.display());
    }
}

/// Returns the streams that are judged besides the boxes of a detector that takes no time.
fn streams_asked(arguments: &RunArguments) -> Vec<Stream> {
    let mut streams = Vec::new();
    if let Some(detector) = arguments.detector_ms.clone() {
        streams.push(Stream::AtArrival { detector });
    }
    if arguments.settled {
        streams.push(Stream::Settled);
    }
    streams
}

fn policies(arguments: &RunArguments, has_pixels: bool) -> anyhow::Result<Vec<PolicySpec>> {
    let base = PolicyConfig {
        profile: arguments.settings.profile,
        u: arguments.u,
        ..PolicyConfig::default()
    };
    Ok(resolve(
        &arguments.policy,
        &arguments.sweep,
        &base,
        arguments.settings.screen,
        has_pixels,
    )?)
}

/// Returns the settings of the run. Creates the folders to write to, so that an error of a folder comes before the work
/// and not after it.
fn settings(arguments: &RunArguments) -> anyhow::Result<Settings> {
    let mut settings = arguments.settings.settings();
    if let Some(confidence) = settings.report_confidence {
        ensure!(
            (0.0..=1.0).contains(&confidence),
            "--report-confidence {confidence} is not between 0 and 1"
        );
    }
    for folder in [&arguments.out, &settings.traces].into_iter().flatten() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot write to {}", folder.display()))?;
    }
    settings.keep_worst = arguments.out.is_some();
    if let Some(model) = &arguments.energy_model {
        settings.energy_model = Some(EnergyModel::load(model)?);
    }
    Ok(settings)
}

/// Describes the frame rates of all clips.
fn rates(results: &[ClipResult]) -> String {
    let mut rates: Vec<f64> = results.iter().filter_map(|result| result.frame_rate).collect();
    rates.sort_by(f64::total_cmp);
    let known = match rates[..] {
        [] => return "not known: no figure is in milliseconds; --rate gives it".to_owned(),
        [lowest, .., highest] if lowest < highest => format!("{lowest} to {highest} frames/s"),
        [rate, ..] => format!("{rate} frames/s"),
    };
    if rates.len() < results.len() {
        format!("{known}, and not known for some clips")
    } else {
        known
    }
}

/// How many frames are judged, usually.
const ALL: &str = "all";

/// Describes how many of all frames are judged.
fn frames_judged(results: &[ClipResult]) -> String {
    let mut frames = 0;
    let mut unlabelled = 0;
    for result in results {
        // Every policy has the same clips.
        if result.policy == results[0].policy {
            frames += result.frames;
            unlabelled += result.unlabelled_frames;
        }
    }
    if unlabelled == 0 {
        return ALL.to_owned();
    }
    format!(
        "{} of {frames}; nobody labelled the others, which count for calls, time and energy",
        frames - unlabelled
    )
}

/// Lists the settings that decide what the figures mean.
fn listed(
    arguments: &RunArguments,
    results: &[ClipResult],
) -> anyhow::Result<Vec<(String, String)>> {
    let settings = &arguments.settings;
    let confidence = settings.confidence;
    let profile = match settings.profile {
        Profile::Reference => "reference (the published code)",
        Profile::Paper => "paper (the paper's text)",
    };
    let judged = match (settings.profile, settings.report_confidence) {
        (Profile::Reference, _) => "all".to_owned(),
        (Profile::Paper, Some(least)) => format!("of confidence {least} and above"),
        (Profile::Paper, None) => format!(
            "as a node publishes them: detected ones of confidence {confidence} and above, others from {}",
            confidence / 2.0
        ),
    };
    let classes = if settings.per_class {
        "each by itself, then their mean"
    } else {
        "pooled, as the published evaluator"
    };
    let area = if settings.coco_interpolation {
        "at COCO's 101 recall levels"
    } else {
        "at all points"
    };
    let energy = match &arguments.energy_model {
        Some(model) => format!("projected with {}", model.display()),
        None => "not known: no --energy-model was given".to_owned(),
    };
    let rules = settings.rules()?.as_str().to_owned();
    let listed = [
        ("Profile", profile.to_owned()),
        ("Detector confidence", format!("at least {confidence}")),
        ("Boxes judged", judged),
        (CROWDS, rules),
        (FRAME_RATE, rates(results)),
        (FRAMES_JUDGED, frames_judged(results)),
        ("Empty-scene screen", settings.screen.as_str().to_owned()),
        ("Classes", classes.to_owned()),
        ("Average precision", area.to_owned()),
        ("Energy", energy),
    ];
    Ok(listed.map(|(name, value)| (name.to_owned(), value)).to_vec())
}
