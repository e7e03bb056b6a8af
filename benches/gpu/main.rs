//! Measures the node on one GPU, piece by piece: cameras with their energy, batches, stages, precision, ways into a
//! session, starts, and the messages on failure. Writes `benches/gpu.md` after each piece. Run by `make gpu`;
//! `--provider cpu` makes it a trial of this script.

mod arguments;
mod cameras;
mod card;
mod failures;
mod machine;
mod node;
mod page;
mod pieces;
mod precision;
mod report;
mod results;
mod stages;
mod starts;
mod ways;

use anyhow::{Context, bail};
use arguments::Arguments;
use clap::Parser;
use pieces::{Piece, Row};
use results::{Outcome, Results};
use std::process::{ExitCode, Stdio};
use std::time::{Duration, Instant};
use tokio::process::Command;

/// The time after its limit in which a piece may end by itself.
const GRACE: Duration = Duration::from_secs(5);

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
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        match &arguments.piece {
            Some(piece) => {
                let rows = serde_json::from_str::<Piece>(piece)?.measure(arguments).await?;
                println!("{}", serde_json::to_string(&rows)?);
                Ok(())
            }
            None => measure_all(arguments).await,
        }
    })
}

/// Measures what is missing, and writes the page after each piece.
async fn measure_all(arguments: &Arguments) -> anyhow::Result<()> {
    report::may_be_written(arguments)?;
    let pieces = Piece::all(arguments)?;
    let mut results = Results::load(arguments)?;
    let engines = tempfile::tempdir()?;
    for piece in &pieces {
        if results.has(piece) {
            eprintln!("{}: measured before", piece.name());
            continue;
        }
        eprintln!("{}", piece.name());
        let begun = Instant::now();
        let rows = in_a_process(arguments, piece, engines.path()).await;
        if let Err(error) = &rows {
            eprintln!("  {error:#}");
            // Without its provider nothing can be measured, and nothing is written.
            if matches!(piece, Piece::Machine) {
                bail!("{error:#}");
            }
        }
        let outcome = Outcome {
            rows: rows.map_err(|error| format!("{error:#}")),
            seconds: begun.elapsed().as_secs_f64(),
            date: arguments.date.clone(),
        };
        results.keep(piece, outcome)?;
        report::write(arguments, &pieces, &results)?;
    }
    report::write(arguments, &pieces, &results)?;
    if pieces.iter().all(|piece| results.has(piece)) {
        results.finish()?;
    }
    println!("{} is written", arguments.out.display());
    Ok(())
}

/// Measures a piece in a process of its own, which the system's `timeout` ends together with the node that it started: a
/// crash in a driver ends only that piece, and no piece finds the memory of another.
async fn in_a_process(
    arguments: &Arguments,
    piece: &Piece,
    engines: &std::path::Path,
) -> anyhow::Result<Vec<Row>> {
    let limit = arguments.limit() + GRACE;
    let output = Command::new("timeout")
        .arg("--kill-after=5")
        .arg(limit.as_secs().to_string())
        .arg(std::env::current_exe()?)
        .args(std::env::args_os().skip(1))
        .arg("--piece")
        .arg(serde_json::to_string(piece)?)
        .arg("--engines")
        .arg(engines)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .output()
        .await
        .context("the program `timeout`")?;
    let said = String::from_utf8_lossy(&output.stderr);
    if output.status.success() {
        eprint!("{said}");
        return serde_json::from_slice(&output.stdout).context("what was measured");
    }
    if matches!(output.status.code(), Some(124 | 137)) {
        bail!("not done within {} s", limit.as_secs());
    }
    bail!(
        "{}",
        said.lines().last().unwrap_or("it ended without a word")
    )
}
