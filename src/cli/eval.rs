//! `albireo eval`: accuracy, skip rate, time and energy of policies on recordings.

use crate::eval::average_precision::{Classes, Interpolation};
use crate::eval::data::{Clips, recorded};
use crate::eval::energy_model::EnergyModel;
use crate::eval::replay::Scoring;
use crate::eval::report::Report;
use crate::eval::run::{Settings, run_stored};
use crate::eval::source::ScreenRule;
use crate::eval::spec::{Common, PolicySpec, Sweep, resolve};
use crate::eval::{summary, table};
use crate::policy::Profile;
use anyhow::Context;
use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  albireo eval recorded DIR --policy albireo --sweep u=3e-4,5e-4,7e-4,1e-3
      what each threshold costs in accuracy and saves in detector calls
  albireo eval recorded DIR --profile reference --screen detections --traces traces
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
}

/// What every comparison of policies takes.
#[derive(Debug, Args)]
struct RunArguments {
    /// Whose definitions hold where the published code and the paper's text differ.
    #[arg(long, value_enum, default_value_t = Scoring::Paper)]
    profile: Scoring,
    /// A policy, as NAME or NAME:SETTING; may be given several times. Vanilla always runs too.
    #[arg(long, value_name = "NAME[:SETTING]", default_value = "albireo")]
    policy: Vec<String>,
    /// Uncertainty threshold of the policies that have one.
    #[arg(long, default_value_t = 3e-4)]
    u: f64,
    /// Values of a setting to try one after the other, for instance u=3e-4,5e-4,7e-4,1e-3.
    #[arg(long, value_name = "NAME=VALUE,…")]
    sweep: Vec<Sweep>,
    /// What the empty-scene screen says: never "empty", or "empty" exactly when nothing is detected.
    #[arg(long, value_enum, default_value_t = ScreenRule::Nonempty)]
    screen: ScreenRule,
    /// Detections below this confidence are not used.
    #[arg(long, default_value_t = 0.5)]
    confidence: f64,
    /// Judge every class by itself instead of all as one.
    #[arg(long)]
    per_class: bool,
    /// Area under the precision-recall curve at COCO's 101 recall levels instead of all points.
    #[arg(long)]
    coco_interpolation: bool,
    /// Project energy and frame time with this model where none is measured.
    #[arg(long, value_name = "FILE")]
    energy_model: Option<PathBuf>,
    /// Write what each policy did, frame by frame, to DIR/POLICY/SEQUENCE.jsonl.gz.
    #[arg(long, value_name = "DIR")]
    traces: Option<PathBuf>,
    /// Write summary.csv, report.json, plots and report.html here.
    #[arg(long, value_name = "DIR")]
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
        What::Recorded { folder, run } => {
            let clips = recorded::read(folder)?;
            compare(
                clips,
                run,
                &format!("Recorded detections: {}", folder.display()),
            )
        }
    }
}

/// Runs all policies asked for over `clips` and reports.
fn compare(clips: Clips, arguments: &RunArguments, title: &str) -> anyhow::Result<()> {
    anyhow::ensure!(
        (0.0..=1.0).contains(&arguments.confidence),
        "--confidence {} is not between 0 and 1",
        arguments.confidence
    );
    let policies = policies(arguments)?;
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
    let report = Report {
        title: title.to_owned(),
        settings: listed(arguments),
        data: clips.report,
        policies: summary::summarise(&results),
        clips: results,
    };
    print!("{}", table::render(&report.policies));
    if let Some(folder) = &arguments.out {
        report.write(folder)?;
        eprintln!("Written to {}", folder.display());
    }
    Ok(())
}

fn policies(arguments: &RunArguments) -> anyhow::Result<Vec<PolicySpec>> {
    let common = Common {
        profile: match arguments.profile {
            Scoring::Reference => Profile::Reference,
            Scoring::Paper => Profile::Paper,
        },
        u: arguments.u,
        screen: Some(arguments.screen),
    };
    Ok(resolve(&arguments.policy, &arguments.sweep, &common)?)
}

fn settings(arguments: &RunArguments) -> anyhow::Result<Settings> {
    let energy_model = arguments
        .energy_model
        .as_deref()
        .map(EnergyModel::load)
        .transpose()?;
    Ok(Settings {
        scoring: arguments.profile,
        confidence: arguments.confidence,
        screen: arguments.screen,
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
        ("Empty-scene screen", arguments.screen.as_str().to_owned()),
        ("Classes", classes.to_owned()),
        ("Average precision", area.to_owned()),
    ];
    if let Some(model) = &arguments.energy_model {
        listed.push(("Energy", format!("projected with {}", model.display())));
    }
    listed
        .into_iter()
        .map(|(name, value)| (name.to_owned(), value))
        .collect()
}
