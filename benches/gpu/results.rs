//! Keeps what was measured, piece by piece, so that a run that is cut leaves its figures and the next one goes on.

use super::arguments::{Arguments, name_of};
use super::pieces::{Piece, Row};
use anyhow::Context;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The results of one machine and one set of arguments.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Results {
    /// The conditions that all figures share; figures under others are not mixed with them.
    conditions: String,
    pieces: BTreeMap<String, Outcome>,
    #[serde(skip)]
    file: PathBuf,
}

/// The outcome of one piece.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Outcome {
    /// Its rows, or the reason for which there are none.
    pub rows: Result<Vec<Row>, String>,
    pub seconds: f64,
    pub date: String,
}

impl Results {
    /// Loads what an earlier run under the same conditions has left.
    pub(crate) fn load(arguments: &Arguments) -> anyhow::Result<Self> {
        let file = arguments.out.with_extension("json");
        let conditions = conditions(arguments)?;
        let empty = Self {
            conditions: conditions.clone(),
            pieces: BTreeMap::new(),
            file: file.clone(),
        };
        if arguments.again {
            return Ok(empty);
        }
        let Ok(text) = std::fs::read_to_string(&file) else {
            return Ok(empty);
        };
        let left: Self = match serde_json::from_str(&text) {
            Ok(left) => left,
            Err(error) => {
                eprintln!(
                    "{} is not read, everything is measured anew: {error}",
                    file.display()
                );
                return Ok(empty);
            }
        };
        if left.conditions != conditions {
            eprintln!(
                "{} was measured under other conditions, everything is measured anew: {} there, {conditions} here",
                file.display(),
                left.conditions
            );
            return Ok(empty);
        }
        Ok(Self { file, ..left })
    }

    pub(crate) fn get(&self, piece: &Piece) -> Option<&Outcome> {
        self.pieces.get(&piece.name())
    }

    /// Whether there are figures of it. A piece that failed is measured again by the next run.
    pub(crate) fn has(&self, piece: &Piece) -> bool {
        self.get(piece).is_some_and(|outcome| outcome.rows.is_ok())
    }

    pub(crate) fn keep(&mut self, piece: &Piece, outcome: Outcome) -> anyhow::Result<()> {
        self.pieces.insert(piece.name(), outcome);
        replace(&self.file, &serde_json::to_string_pretty(self)?)
    }

    /// Removes the file: the page has everything.
    pub(crate) fn finish(&self) -> anyhow::Result<()> {
        std::fs::remove_file(&self.file).with_context(|| self.file.display().to_string())
    }
}

/// What all figures of a page have in common: the card, the provider, the library, the models and the lengths.
fn conditions(arguments: &Arguments) -> anyhow::Result<String> {
    let card = super::card::Card::open(arguments.device).and_then(|card| card.description());
    let mut models = arguments.models()?;
    models.extend(arguments.camera_models()?);
    let models: Vec<_> = models
        .iter()
        .map(|model| {
            let bytes = std::fs::metadata(model).map_or(0, |metadata| metadata.len());
            format!("{} {bytes} B", name_of(model))
        })
        .collect();
    Ok(format!(
        "{}, {}, {}, {} runs, {} s, {}",
        card.unwrap_or_else(|_| "no card".to_owned()),
        arguments.provider.as_str(),
        name_of(&super::arguments::library()?.canonicalize()?),
        arguments.runs,
        arguments.seconds,
        models.join(", ")
    ))
}

/// Writes a file whole or not at all: a run may be cut at any time.
pub(crate) fn replace(file: &Path, text: &str) -> anyhow::Result<()> {
    let new = file.with_extension("new");
    std::fs::write(&new, text).with_context(|| new.display().to_string())?;
    std::fs::rename(&new, file).with_context(|| file.display().to_string())
}
