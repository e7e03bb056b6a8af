//! `albireo eval frontier` and `leave-one-out`: expected-loss at equal skip rates, and how its settings
//! generalise.

use albireo_eval::data::recorded;
use albireo_eval::frontier::{
    Judging, Study, Variation, View, ViewedClip, leave_one_out, render, render_leave_one_out,
    study, write,
};
use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;

/// The options.
#[derive(Debug, Args)]
pub(super) struct FrontierArguments {
    /// Recorded detections with ground truth: a folder with sequences.json, detections/ and groundtruth/.
    folder: PathBuf,
    /// Detections below this confidence are not shown to the policies; may be given several times.
    #[arg(long, default_values_t = [0.5, 0.1])]
    confidence: Vec<f64>,
    /// Write frontier.md, frontier.json, frontier.csv and the plots here.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// The options.
#[derive(Debug, Args)]
pub(super) struct LeaveOneOutArguments {
    /// Recorded detections with ground truth: a folder with sequences.json, detections/ and groundtruth/.
    folder: PathBuf,
    /// A setting of `[policy.expected_loss]` and the values to try, for instance
    /// `life.least_visible=0,0.2,0.5`; may be given several times.
    #[arg(long, required = true, value_name = "SETTING=VALUE,VALUE")]
    setting: Vec<Variation>,
    /// Detections below this confidence are not shown to the policy.
    #[arg(long, default_value_t = 0.5)]
    confidence: f64,
    /// Use every second frame only, as if the camera were half as fast.
    #[arg(long)]
    half_rate: bool,
}

/// Runs the command that tells whether settings were fitted to single clips.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do.
pub(super) fn run_leave_one_out(arguments: &LeaveOneOutArguments) -> anyhow::Result<()> {
    let clips = recorded::read(&arguments.folder)?.only_with_detections(&arguments.folder)?;
    let view = if arguments.half_rate {
        View::half_rate(arguments.confidence)
    } else {
        View::as_recorded(arguments.confidence)
    };
    let viewed: Vec<_> = (clips.clips.iter())
        .filter_map(|clip| view.look(clip))
        .collect();
    anyhow::ensure!(
        viewed.len() > 1,
        "{}: leaving one clip out takes at least two with ground truth",
        arguments.folder.display()
    );
    let judging = Judging::of_boxes();
    print_leave_one_out(&arguments.setting, &judging, &viewed, &view.name)
}

/// Tries every setting and prints its table.
pub(super) fn print_leave_one_out(
    settings: &[Variation],
    judging: &Judging,
    clips: &[ViewedClip],
    view: &str,
) -> anyhow::Result<()> {
    let steps = settings.iter().map(|setting| judging.steps(setting)).sum();
    let bar = progress(steps, "operating points")?;
    let mut names: Vec<_> = clips.iter().map(|clip| &clip.name).collect();
    names.dedup();
    println!("{judging}, {} clips, {view}", names.len());
    for variation in settings {
        let result = leave_one_out(variation, judging, clips, &|| bar.inc(1))?;
        bar.suspend(|| print!("{}", render_leave_one_out(&result)));
    }
    bar.finish_and_clear();
    Ok(())
}

pub(super) fn progress(steps: usize, what: &str) -> anyhow::Result<ProgressBar> {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {what}, {{elapsed}}, {{eta}} left");
    let style = ProgressStyle::with_template(&template).context("the progress bar's template")?;
    Ok(ProgressBar::new(steps as u64).with_style(style))
}

/// Runs the command; the tables go to standard output, everything else to standard error.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do.
pub(super) fn run(arguments: &FrontierArguments) -> anyhow::Result<()> {
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
    let bar = progress(Study::steps(views.len()), "comparisons")?;
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
