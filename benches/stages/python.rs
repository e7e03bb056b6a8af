//! Runs the same path in Python, in a separate process that runs a round on request.

use super::samples::{Samples, Stage};
use anyhow::{Context, bail};
use serde::Deserialize;
use std::io::{BufRead, BufReader, Lines, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

const SCRIPT: &str = "benches/stages/python_path.py";

/// The results of one round of the script, in milliseconds per frame.
#[derive(Deserialize)]
struct Round {
    decode: Vec<f64>,
    letterbox: Vec<f64>,
    model: Vec<f64>,
    head: Vec<f64>,
}

/// A running script.
pub(crate) struct PythonPath {
    child: Child,
    orders: Option<ChildStdin>,
    answers: Lines<BufReader<ChildStdout>>,
    /// The versions of its libraries.
    pub versions: String,
}

impl PythonPath {
    /// Starts the script with the pictures in `folder`. Returns when its model is loaded and warm.
    pub(crate) fn start(
        python: &Path,
        model: &Path,
        head: &str,
        folder: &Path,
        threads: usize,
    ) -> anyhow::Result<Self> {
        let mut child = Command::new(python)
            .arg(SCRIPT)
            .args([model, folder])
            .args([head, &threads.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("{} {SCRIPT}", python.display()))?;
        let orders = child.stdin.take();
        let output = child.stdout.take().context("the script has no output")?;
        let mut answers = BufReader::new(output).lines();
        let versions = answers.next().transpose()?;
        let versions = versions.with_context(|| format!("{SCRIPT} ended before it began"))?;
        Ok(Self {
            child,
            orders,
            answers,
            versions,
        })
    }

    /// Runs all pictures once.
    pub(crate) fn round(&mut self, samples: &mut Samples) -> anyhow::Result<()> {
        let Some(orders) = &mut self.orders else {
            bail!("{SCRIPT} has ended");
        };
        orders.write_all(b"round\n")?;
        orders.flush()?;
        let line = self.answers.next().transpose()?;
        let line = line.with_context(|| format!("{SCRIPT} ended early"))?;
        let round: Round = serde_json::from_str(&line).context(SCRIPT)?;
        for (stage, times) in [
            (Stage::Decode, round.decode),
            (Stage::Letterbox, round.letterbox),
            (Stage::Model, round.model),
            (Stage::Head, round.head),
        ] {
            for time in times {
                samples.add_one(stage, time);
            }
        }
        Ok(())
    }
}

impl Drop for PythonPath {
    fn drop(&mut self) {
        // The script exits at the end of its input. An earlier exit does no harm.
        self.orders = None;
        let _ = self.child.wait();
    }
}
