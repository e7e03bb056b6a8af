//! `albireo export`: recorded frames as COCO or MOTChallenge.

use super::progress;
use super::values::counted;
use albireo_eval::export::{ExportFormat, ExportedFrames, export, recordings};
use clap::Args;
use std::path::PathBuf;

/// Arguments of `albireo export`.
#[derive(Args, Clone, Debug)]
#[command(
    about = "Export recorded frames as COCO or MOTChallenge, for training and labelling",
    after_help = "A node with [record] folder and when = [\"audit\"] keeps the frames on which the
audit found a difference between the boxes shown and those of the detector:
the frames from which a model or a threshold learns most.

Examples:
  albireo export /var/lib/albireo/recordings --to coco --out hard
      their pictures and the detector's boxes, in hard/annotations.json
  albireo export recordings --to mot --frames shown --out drives
      every recorded frame with the boxes shown and their track ids, a folder
      in MOTChallenge's layout for each recording, as `eval board` and other
      programs read

The boxes are a detector's, not the truth: correct them in a labelling tool
before training on them. Each has its confidence (`score`)."
)]
pub(super) struct ExportArguments {
    /// A folder of recordings, or one MCAP file of a node
    #[arg(value_name = "DIR")]
    recordings: PathBuf,
    /// The layout to write
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: ExportFormat,
    /// A new or empty folder for the export
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Which frames, with which boxes
    #[arg(long, value_enum, default_value_t, value_name = "FRAMES")]
    frames: ExportedFrames,
}

/// Exports, and prints what was written, what was left out, and what a user of the frames must know.
///
/// # Errors
/// When there is nothing to export, or the folder cannot be written.
pub(super) fn run(arguments: &ExportArguments) -> anyhow::Result<()> {
    let files = recordings(&arguments.recordings)?;
    let bar = progress::bar(Some(files.len() as u64), "recordings  {msg}");
    let out = &arguments.out;
    let exported = export(&files, out, arguments.to, arguments.frames, |so_far| {
        bar.inc(1);
        bar.set_message(counted(so_far.pictures, "picture", "pictures"));
    });
    bar.finish_and_clear();
    let done = exported?;
    println!(
        "{} with {} of {} in {}",
        counted(done.pictures, "picture", "pictures"),
        counted(done.boxes, "box", "boxes"),
        counted(done.recordings, "recording", "recordings"),
        out.display()
    );
    for what in &done.left_out {
        println!("left out: {what}");
    }
    for what in &done.notes {
        println!("note: {what}");
    }
    Ok(())
}
