//! What a run leaves behind with `--out`: `summary.csv`, `report.json`, figures as SVG, and
//! `report.html`, which shows it all in one file that needs no other.

mod html;
mod plot;
mod summary_csv;
mod worst;

use crate::data::LoadReport;
use crate::error::EvalError;
use crate::files;
use crate::result::ClipResult;
use crate::summary::PolicySummary;
use serde::Serialize;
use std::path::Path;

/// A finished run.
#[derive(Debug, Serialize)]
pub struct Report {
    /// What was evaluated, for the heading.
    pub title: String,
    /// The settings, name and value, in the order to show them.
    pub settings: Vec<(String, String)>,
    /// What the data's reader left out.
    pub data: LoadReport,
    /// One entry per policy.
    pub policies: Vec<PolicySummary>,
    /// One entry per clip and policy.
    pub clips: Vec<ClipResult>,
}

impl Report {
    /// Writes all files into `folder`, making it if need be.
    ///
    /// # Errors
    /// [`EvalError`] naming the file.
    pub fn write(&self, folder: &Path) -> Result<(), EvalError> {
        files::write_csv(&folder.join("summary.csv"), &summary_csv::rows(&self.clips))?;
        files::write_json(&folder.join("report.json"), self)?;
        let figures = plot::figures(self).map_err(|error| {
            EvalError::content(folder, format!("a figure cannot be drawn: {error}"))
        })?;
        for figure in &figures {
            files::write(&folder.join(format!("{}.svg", figure.name)), &figure.svg)?;
        }
        files::write(&folder.join("report.html"), html::render(self, &figures))
    }
}
