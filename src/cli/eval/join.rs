//! `albireo eval join`: joins measured runs into the paper's tables and figures.

use crate::cli::terminal;
use albireo_eval::board::{SetupRuns, files_of, read, render, write};
use anyhow::ensure;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `albireo eval join`.
#[derive(Debug, Args)]
#[command(after_help = "\
Each file is one setup: a detector in one precision, in one power mode, on one
machine. Setups are never averaged together. With two setups of one machine the
output says whether their savings multiply with those of skipping.

Examples:
  albireo eval join results --out tables
      everything measured here, with join.html, CSV and SVG files
  albireo eval join results/thor/albireo/yolo26x/summary.csv
      the rows that the paper's authors published, as its main table has them")]
pub(super) struct JoinArguments {
    /// Files of `albireo eval board` (.jsonl) or folders of them, or summary.csv files of the paper's published
    /// results.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Write join.html, join.txt, policies.csv, clips.csv, power.csv, settings.csv and the figures here.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Runs the command; the tables go to standard output, everything else to standard error.
///
/// # Errors
/// When a file cannot be read, two files are of the same setup, or a file cannot be written.
pub(super) fn run(arguments: &JoinArguments) -> anyhow::Result<()> {
    let mut setups: Vec<SetupRuns> = Vec::new();
    for file in &files_of(&arguments.files)? {
        let found = read(file)?;
        ensure!(
            setups.iter().all(|other| other.setup != found.setup),
            "{}: a file before it is of the same setup ({}): give each setup once",
            file.display(),
            found.setup.title()
        );
        setups.push(found);
    }
    // The files are written before anything is printed: whoever reads the output may close it, which ends the program.
    if let Some(folder) = &arguments.out {
        // In files the tables have one width, whatever the terminal.
        let text = render(&setups, terminal::WIDTH);
        write(folder, &setups, &text)?;
    }
    print!("{}", render(&setups, terminal::width()));
    if let Some(folder) = &arguments.out {
        eprintln!("Written to {}", folder.display());
    }
    Ok(())
}
