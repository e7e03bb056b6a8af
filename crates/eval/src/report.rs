//! Writes the files of `--out`: `summary.csv`, `report.json`, figures as SVG, and `report.html`, which shows all
//! of it in one self-contained file.

mod conclusion;
mod html;
mod plot;
mod summary_csv;
mod table;
mod worst;

pub use conclusion::conclusion;
pub(crate) use html::{document, figures};
pub use table::render;

use crate::data::LoadReport;
use crate::error::EvalError;
use crate::files;
use crate::result::ClipResult;
use crate::summary::PolicySummary;
use serde::Serialize;
use std::path::Path;

/// The report of a finished run.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The heading, which names the evaluated recordings.
    pub title: String,
    /// Names and values of the settings, in the order in which they are shown.
    pub settings: Vec<(String, String)>,
    /// The rows and clips that the reader of the data left out.
    pub data: LoadReport,
    /// One entry per policy.
    pub policies: Vec<PolicySummary>,
    /// One entry per clip and policy.
    pub clips: Vec<ClipResult>,
}

impl Report {
    /// Writes all files into `folder`, which is created if needed.
    ///
    /// # Errors
    /// [`EvalError`] when a file cannot be written.
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
