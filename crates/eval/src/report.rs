//! What a run leaves behind with `--out`: `summary.csv`, `report.json`, figures as SVG, and
//! `report.html`, which shows it all in one file that needs no other.

mod html;
mod plot;
mod summary_csv;
mod worst;

use crate::data::LoadReport;
use crate::result::ClipResult;
use crate::summary::PolicySummary;
use serde::Serialize;
use std::path::{Path, PathBuf};

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

/// A report that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file system said no.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Something could not be put into its format.
    #[error("cannot make {}: {reason}", path.display())]
    Format {
        /// The file that could not be made.
        path: PathBuf,
        /// What its format refused.
        reason: String,
    },
}

/// The folder that the files of a report go to.
pub(super) struct ReportFolder<'a>(&'a Path);

impl<'a> ReportFolder<'a> {
    /// Makes the folder if need be.
    ///
    /// # Errors
    /// [`ReportError::Write`] when it cannot be made.
    pub(super) fn make(path: &'a Path) -> Result<Self, ReportError> {
        std::fs::create_dir_all(path).map_err(|source| ReportError::Write {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self(path))
    }

    /// Writes a file of that name.
    ///
    /// # Errors
    /// [`ReportError`] naming the file.
    pub(super) fn write(
        &self,
        name: &str,
        content: Result<Vec<u8>, String>,
    ) -> Result<(), ReportError> {
        let path = self.0.join(name);
        let content = content.map_err(|reason| ReportError::Format {
            path: path.clone(),
            reason,
        })?;
        std::fs::write(&path, content).map_err(|source| ReportError::Write { path, source })
    }

    /// Writes `value` as indented JSON.
    ///
    /// # Errors
    /// [`ReportError`] naming the file.
    pub(super) fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), ReportError> {
        let json = serde_json::to_vec_pretty(value).map_err(|error| error.to_string());
        self.write(name, json)
    }
}

impl Report {
    /// Writes all files into `folder`, making it if need be.
    ///
    /// # Errors
    /// [`ReportError`] naming the file.
    pub fn write(&self, folder: &Path) -> Result<(), ReportError> {
        let folder = ReportFolder::make(folder)?;
        folder.write("summary.csv", summary_csv::render(&self.clips))?;
        folder.write_json("report.json", self)?;
        let figures = plot::figures(self);
        for figure in &figures {
            let svg = figure.svg.clone().into_bytes();
            folder.write(&format!("{}.svg", figure.name), Ok(svg))?;
        }
        folder.write("report.html", Ok(html::render(self, &figures).into_bytes()))
    }
}
