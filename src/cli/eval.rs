//! `albireo eval`: accuracy, skip rate, time and energy of policies on recordings.

mod advise;
mod video;

use albireo_core::geometry::PictureSize;
use albireo_core::policy::Profile;
use albireo_eval::average_precision::{Classes, Interpolation};
use albireo_eval::conclusion::conclusion;
use albireo_eval::data::{Clips, bdd100k, coco, kitti, mot_challenge, recorded};
use albireo_eval::energy_model::EnergyModel;
use albireo_eval::replay::Scoring;
use albireo_eval::report::Report;
use albireo_eval::run::{Settings, run_stored};
use albireo_eval::source::ScreenRule;
use albireo_eval::spec::{Common, PolicySpec, Sweep, resolve};
use albireo_eval::streams::{self, RunTimes, Stream, StreamResults};
use albireo_eval::text::wrapped;
use albireo_eval::{summary, table};
use anyhow::Context;
use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
Examples:
  albireo eval recorded DIR --policy albireo --sweep u=3e-4,5e-4,7e-4,1e-3
      what each threshold costs in accuracy and saves in detector calls
  albireo eval advise drive.mp4 --target recall=0.95
      which value of a threshold your road and your detector allow
  albireo eval recorded DIR --profile reference --screen detections \\
      --traces traces
      the published code's decisions, frame by frame";

/// Compare policies side by side: accuracy, skip rate, frame time, energy.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct EvalArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Replay recorded detections: a folder with sequences.json, detections/ and groundtruth/.
    Recorded {
        /// The folder.
        folder: PathBuf,
        #[command(flatten)]
        run: RunArguments,
    },
    /// Replay the public detections of a MOTChallenge sequence, or of a folder of sequences.
    #[command(name = "motchallenge")]
    MotChallenge {
        /// The folder, with seqinfo.ini, gt/ and det/, or with such folders.
        folder: PathBuf,
        #[command(flatten)]
        run: RunArguments,
    },
    /// Replay stored detections on KITTI tracking: a folder with label_02/ and det_02/.
    Kitti {
        /// The folder.
        folder: PathBuf,
        #[command(flatten)]
        run: RunArguments,
    },
    /// Replay stored detections on BDD100K MOT (box_track_20), or any labels in the Scalabel form.
    Bdd100k {
        /// Labels: a JSON file or a folder of them.
        ground_truth: PathBuf,
        /// Predictions with scores, in the same form.
        #[arg(long)]
        detections: PathBuf,
        /// Size of the pictures, which the files do not say.
        #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x720", value_parser = crate::cli::size::parse_size)]
        size: PictureSize,
        /// Frames per second.
        #[arg(long, default_value_t = bdd100k::BDD100K_FRAME_RATE)]
        frame_rate: f64,
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
    /// Run a real detector once over videos or pictures, then every policy on what it found.
    #[command(alias = "pictures")]
    Video(video::VideoArguments),
    /// Propose a value of a policy's threshold for a target, from a recording with your own detector.
    Advise(advise::AdviseArguments),
}

/// Headings of the help.
const JUDGED: &str = "How it is judged";
const WRITTEN: &str = "What is written";
const LOOKED: &str = "What looks at the pictures";

/// What every comparison of policies takes.
#[derive(Clone, Debug, Args)]
struct RunArguments {
    /// Whose definitions hold where the published code and the paper's text differ.
    #[arg(long, value_enum, default_value_t = Scoring::Paper)]
    profile: Scoring,
    /// A policy, as NAME or NAME:SETTING, or `all` for every one with the paper's settings; may be given
    /// several times. Vanilla always runs too.
    #[arg(long, value_name = "NAME[:SETTING]", default_value = "albireo")]
    policy: Vec<String>,
    /// Uncertainty threshold of the policies that have one.
    #[arg(long, default_value_t = 3e-4, allow_negative_numbers = true)]
    u: f64,
    /// Values of a setting to try one after the other, for instance u=3e-4,5e-4,7e-4,1e-3.
    #[arg(long, value_name = "NAME=VALUE,…")]
    sweep: Vec<Sweep>,
    /// What the empty-scene screen says: never "empty", or "empty" exactly when nothing is detected.
    #[arg(long, help_heading = JUDGED, value_enum, default_value_t = ScreenRule::Nonempty)]
    screen: ScreenRule,
    /// Frames in a row that the screen may call empty before the detector runs anyway; 0 for any number.
    #[arg(long, help_heading = JUDGED, value_name = "COUNT", default_value_t = 100)]
    longest_empty_run: u32,
    /// Detections below this confidence are not used.
    #[arg(long, help_heading = JUDGED, default_value_t = 0.5, allow_negative_numbers = true)]
    confidence: f64,
    /// Boxes below this confidence are not judged, as a node with this `report.confidence` does not publish them
    /// [default: --confidence for detected boxes, half of it for predicted ones].
    #[arg(long, help_heading = JUDGED)]
    report_confidence: Option<f64>,
    /// Judge every class by itself instead of all as one.
    #[arg(long, help_heading = JUDGED)]
    per_class: bool,
    /// Area under the precision-recall curve at COCO's 101 recall levels instead of all points.
    #[arg(long, help_heading = JUDGED)]
    coco_interpolation: bool,
    /// Judge boxes when frames arrive too, with a detector that takes this many milliseconds, or those of FILE in
    /// turn, one measured run on each line; at-arrival.txt in --out.
    #[arg(long, help_heading = JUDGED, value_name = "MILLISECONDS|FILE", value_parser = RunTimes::read)]
    detector_ms: Option<RunTimes>,
    /// Judge the boxes too that are drawn between two detector calls when the second is known; settled.txt in --out.
    #[arg(long, help_heading = JUDGED)]
    settled: bool,
    /// Project energy and frame time with this model where none is measured; `none` for no energy [default: a
    /// Jetson AGX Thor with YOLO26x].
    #[arg(long, help_heading = WRITTEN, value_name = "FILE")]
    energy_model: Option<PathBuf>,
    /// Write what each policy did, frame by frame, to DIR/POLICY/SEQUENCE.jsonl.gz.
    #[arg(long, help_heading = WRITTEN, value_name = "DIR")]
    traces: Option<PathBuf>,
    /// Write summary.csv, report.json, plots and report.html here.
    #[arg(long, help_heading = WRITTEN, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Threads; 0 for as many as the machine has.
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Runs the command; tables go to standard output, everything else to standard error.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do.
pub fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    match &arguments.what {
        What::Recorded { folder, run } => compare(recorded::read(folder)?, folder, run),
        What::MotChallenge { folder, run } => compare(mot_challenge::read(folder)?, folder, run),
        What::Kitti { folder, run } => compare(kitti::read(folder)?, folder, run),
        What::Bdd100k {
            ground_truth,
            detections,
            size,
            frame_rate,
            run,
        } => {
            let source = bdd100k::Source {
                truth: Some(ground_truth),
                detections: Some(detections),
                picture: *size,
                frame_rate: Some(*frame_rate).filter(|rate| rate.is_finite() && *rate > 0.0),
            };
            compare(bdd100k::read(&source)?, ground_truth, run)
        }
        What::Coco {
            dataset,
            detections,
            run,
        } => compare(coco::read(dataset, Some(detections))?, dataset, run),
        What::Video(arguments) => video::run(arguments),
        What::Advise(arguments) => advise::run(arguments),
    }
}

/// Runs all policies asked for over `clips` and reports.
fn compare(clips: Clips, path: &Path, arguments: &RunArguments) -> anyhow::Result<()> {
    anyhow::ensure!(
        (0.0..=1.0).contains(&arguments.confidence),
        "--confidence {} is not between 0 and 1",
        arguments.confidence
    );
    let clips = clips.only_with_detections(path)?;
    let policies = policies(arguments, false)?;
    let settings = settings(arguments)?;
    for line in clips.report.lines() {
        eprintln!("{line}");
    }
    let bar = ProgressBar::new((clips.clips.len() * policies.len()) as u64).with_style(
        ProgressStyle::with_template(
            "{bar:40} {pos}/{len} clips x policies, {elapsed}, {eta} left",
        )
        .context("the progress bar's template")?,
    );
    let results = run_stored(&clips.clips, &policies, &settings, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let streams = (streams_asked(arguments).into_iter())
        .map(|stream| streams::run(&clips.clips, &policies, &settings, stream))
        .collect::<Result<Vec<_>, _>>()?;
    let report = Report {
        title: format!("Stored detections of {}", path.display()),
        settings: listed(arguments),
        data: clips.report,
        policies: summary::summarise(&results),
        clips: results,
    };
    print!("{}", table::render(&report.policies));
    print_conclusion(&report.policies);
    print_streams(&streams);
    if let Some(folder) = &arguments.out {
        report.write(folder)?;
        write_streams(&streams, folder)?;
        eprintln!("Written to {}", folder.display());
    }
    Ok(())
}

/// Which boxes are judged beside those of a detector that takes no time.
fn streams_asked(arguments: &RunArguments) -> Vec<Stream> {
    let at_arrival = (arguments.detector_ms.clone()).map(|detector| Stream::AtArrival { detector });
    let settled = arguments.settled.then_some(Stream::Settled);
    at_arrival.into_iter().chain(settled).collect()
}

fn print_streams(streams: &[StreamResults]) {
    for stream in streams {
        print!("\n{}", stream.table());
    }
}

fn write_streams(streams: &[StreamResults], folder: &Path) -> anyhow::Result<()> {
    for stream in streams {
        let file = folder.join(stream.file_name());
        std::fs::write(&file, stream.table())
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(())
}

/// What the table comes to, below it.
fn print_conclusion(policies: &[summary::PolicySummary]) {
    println!();
    for sentence in conclusion(policies) {
        println!("{}", wrapped(&sentence, 100));
    }
}

fn policies(arguments: &RunArguments, pixels: bool) -> anyhow::Result<Vec<PolicySpec>> {
    let common = Common {
        profile: match arguments.profile {
            Scoring::Reference => Profile::Reference,
            Scoring::Paper => Profile::Paper,
        },
        u: arguments.u,
        screen: Some(arguments.screen),
        pixels,
    };
    Ok(resolve(&arguments.policy, &arguments.sweep, &common)?)
}

/// How the run judges. Makes the folders it will write to, so that a place where nothing can be written is
/// known before the work and not after it.
fn settings(arguments: &RunArguments) -> anyhow::Result<Settings> {
    for folder in [&arguments.out, &arguments.traces].into_iter().flatten() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot write to {}", folder.display()))?;
    }
    let energy_model = match arguments.energy_model.as_deref() {
        Some(none) if none == Path::new("none") => None,
        Some(file) => Some(EnergyModel::load(file)?),
        None => Some(EnergyModel::built_in()?),
    };
    Ok(Settings {
        scoring: arguments.profile,
        confidence: arguments.confidence,
        report_confidence: arguments.report_confidence,
        screen: arguments.screen,
        longest_empty_run: arguments.longest_empty_run,
        classes: if arguments.per_class {
            Classes::Separate
        } else {
            Classes::Pooled
        },
        interpolation: if arguments.coco_interpolation {
            Interpolation::Coco101
        } else {
            Interpolation::AllPoints
        },
        traces: arguments.traces.clone(),
        keep_worst: arguments.out.is_some(),
        energy_model,
        threads: arguments.threads,
    })
}

/// The settings that decide what the figures mean.
fn listed(arguments: &RunArguments) -> Vec<(String, String)> {
    let profile = match arguments.profile {
        Scoring::Reference => "reference (the published code)",
        Scoring::Paper => "paper (the paper's text)",
    };
    let classes = if arguments.per_class {
        "each by itself, then their mean"
    } else {
        "pooled, as the published evaluator"
    };
    let area = if arguments.coco_interpolation {
        "at COCO's 101 recall levels"
    } else {
        "at all points"
    };
    let mut listed = vec![
        ("Profile", profile.to_owned()),
        (
            "Detector confidence",
            format!("at least {}", arguments.confidence),
        ),
        (
            "Boxes judged",
            match (arguments.profile, arguments.report_confidence) {
                (Scoring::Reference, _) => "all".to_owned(),
                (Scoring::Paper, Some(least)) => format!("of confidence {least} and above"),
                (Scoring::Paper, None) => format!(
                    "as a node publishes them: detected ones of confidence {} and above, others from {}",
                    arguments.confidence,
                    arguments.confidence / 2.0
                ),
            },
        ),
        ("Empty-scene screen", arguments.screen.as_str().to_owned()),
        ("Classes", classes.to_owned()),
        ("Average precision", area.to_owned()),
    ];
    listed.push((
        "Energy",
        match &arguments.energy_model {
            Some(none) if none == Path::new("none") => "none".to_owned(),
            Some(model) => format!("projected with {}", model.display()),
            None => "estimated: projected with the built-in model of another board, a Jetson AGX Thor with YOLO26x, \
                     for --energy-model names none"
                .to_owned(),
        },
    ));
    listed
        .into_iter()
        .map(|(name, value)| (name.to_owned(), value))
        .collect()
}
