//! Measures policies on a machine, clip by clip, and joins the measurements of several machines and settings into
//! tables.
//!
//! ```text
//! (a run on the node) ─▶ ClipRun ─▶ runs file, one per setup ─┐
//! published rows of the paper ────────────────────────────────┴─▶ Setup with its runs ─▶ tables, figures, page
//! ```

mod across;
mod figures;
mod page;
mod published;
mod rows;
mod run;
mod runs_file;
mod summary;
mod table;

pub use run::{ClipRun, FRAMES, JUDGED_BY, Setup, SetupRuns, TRACED_CLIPS};
pub use runs_file::{RunsFile, files_of, read};
pub use table::render;

use crate::error::EvalError;
use crate::files;
use std::path::Path;

/// Writes the joined tables into `folder`, which is created if needed: `join.html` with everything, `join.txt` with the
/// printed text, `clips.csv` with a row per run, `policies.csv` with a row per setup and policy, `power.csv` with the
/// power traces, `settings.csv` with what each setup was measured under, and the figures as SVG.
///
/// # Errors
/// [`EvalError`] with the first figure that cannot be drawn, or the first file that cannot be written.
pub fn write(folder: &Path, setups: &[SetupRuns], text: &str) -> Result<(), EvalError> {
    let summaries = summary::summarise_all(setups);
    let figures = figures::figures(setups, &summaries).map_err(|error| {
        EvalError::content(folder, format!("a figure cannot be drawn: {error}"))
    })?;
    for figure in &figures {
        files::write(&folder.join(format!("{}.svg", figure.name)), &figure.svg)?;
    }
    let page = page::render(setups, &summaries, &figures);
    files::write(&folder.join("join.html"), page)?;
    files::write(&folder.join("join.txt"), text)?;
    files::write_csv(&folder.join("clips.csv"), &rows::rows_of_clips(setups))?;
    files::write_csv(&folder.join("power.csv"), &rows::rows_of_power(setups))?;
    files::write_csv(
        &folder.join("settings.csv"),
        &rows::rows_of_settings(setups),
    )?;
    files::write_csv(
        &folder.join("policies.csv"),
        &rows::rows_of_policies(&summaries),
    )
}

#[cfg(test)]
mod tests;
