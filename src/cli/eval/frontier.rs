//! `albireo eval frontier`: the comparison table and plots of expected-loss at equal skip rates.

use crate::eval::data::recorded;
use crate::eval::frontier::{Study, View, render, study, write};
use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;

/// The options.
#[derive(Debug, Args)]
pub struct FrontierArguments {
    /// Recorded detections with ground truth: a folder with sequences.json, detections/ and groundtruth/.
    folder: PathBuf,
    /// Detections below this confidence are not shown to the policies; may be given several times.
    #[arg(long, default_values_t = [0.5, 0.1])]
    confidence: Vec<f64>,
    /// Write frontier.md, frontier.json, frontier.csv and the plots here.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Runs the command; the tables go to standard output, everything else to standard error.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do.
pub fn run(arguments: &FrontierArguments) -> anyhow::Result<()> {
    for confidence in &arguments.confidence {
        anyhow::ensure!(
            (0.0..=1.0).contains(confidence),
            "--confidence {confidence} is not between 0 and 1"
        );
    }
    let clips = recorded::read(&arguments.folder)?.only_with_detections(&arguments.folder)?;
    for line in clips.report.lines() {
        eprintln!("{line}");
    }
    let views: Vec<View> = (arguments.confidence.iter())
        .flat_map(|&confidence| {
            [
                View::as_recorded(confidence),
                View::half_rate(confidence),
                View::lossy(confidence),
            ]
        })
        .collect();
    let bar = ProgressBar::new(Study::steps(views.len()) as u64).with_style(
        ProgressStyle::with_template("{bar:40} {pos}/{len} comparisons, {elapsed}, {eta} left")
            .context("the progress bar's template")?,
    );
    let title = format!("Equal skip rates on {}", arguments.folder.display());
    let study = study(&title, &clips.clips, &views, &|| bar.inc(1))?;
    bar.finish_and_clear();
    print!("{}", render(&study));
    if let Some(folder) = &arguments.out {
        write(&study, folder)?;
        eprintln!("Written to {}", folder.display());
    }
    Ok(())
}
