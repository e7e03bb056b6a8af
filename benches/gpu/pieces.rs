//! The pieces that are measured, in the order of their value, and the tables that they fill.

use super::arguments::{Arguments, Policy, name_of};
use super::{cameras, failures, machine, precision, stages, starts, ways};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// One measurement, with a process of its own.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) enum Piece {
    /// The card at rest. First, because every other process would warm it.
    Machine,
    Cameras {
        model: PathBuf,
        policy: Policy,
    },
    Batches {
        model: PathBuf,
    },
    Stages {
        model: PathBuf,
    },
    Precision {
        whole: PathBuf,
        half: PathBuf,
    },
    Ways {
        model: PathBuf,
    },
    Starts {
        model: PathBuf,
    },
    Failures,
}

/// A row of a table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Row {
    pub table: TableName,
    pub cells: Vec<String>,
}

/// The tables, in the order in which they stand on the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum TableName {
    Machine,
    Carried,
    Together,
    Batches,
    Stages,
    Precision,
    Ways,
    Copies,
    Starts,
    Failures,
}

impl TableName {
    pub(crate) const ALL: [Self; 10] = [
        Self::Machine,
        Self::Carried,
        Self::Together,
        Self::Batches,
        Self::Stages,
        Self::Precision,
        Self::Ways,
        Self::Copies,
        Self::Starts,
        Self::Failures,
    ];
}

/// The frame of a table.
pub(crate) struct Table {
    pub heading: &'static str,
    pub text: String,
    pub columns: &'static [&'static str],
}

impl Piece {
    /// All pieces of a run, the most valuable first: a run that is cut has measured what matters.
    pub(crate) fn all(arguments: &Arguments) -> anyhow::Result<Vec<Self>> {
        let models = arguments.models()?;
        let mut pieces = vec![Self::Machine];
        for model in arguments.camera_models()? {
            for policy in &arguments.policies {
                pieces.push(Self::Cameras {
                    model: model.clone(),
                    policy: policy.clone(),
                });
            }
        }
        let of_each = |piece: fn(PathBuf) -> Self| models.iter().cloned().map(piece);
        pieces.extend(of_each(|model| Self::Batches { model }));
        pieces.extend(of_each(|model| Self::Stages { model }));
        pieces.extend(precision::pairs(&models));
        pieces.extend(of_each(|model| Self::Ways { model }));
        pieces.extend(of_each(|model| Self::Starts { model }));
        pieces.push(Self::Failures);
        Ok(pieces)
    }

    /// Its name on the page and among the results.
    pub(crate) fn name(&self) -> String {
        let of = |what: &str, model: &Path| format!("{what} of {}", name_of(model));
        match self {
            Self::Machine => "the card at rest".to_owned(),
            Self::Cameras { model, policy } => of(&format!("cameras under {policy}"), model),
            Self::Batches { model } => of("batches", model),
            Self::Stages { model } => of("stages", model),
            Self::Precision { half, .. } => of("precision", half),
            Self::Ways { model } => of("ways into a session", model),
            Self::Starts { model } => of("starts", model),
            Self::Failures => "failures".to_owned(),
        }
    }

    /// The tables that it fills.
    pub(crate) fn tables(&self) -> &'static [TableName] {
        match self {
            Self::Machine => &[TableName::Machine],
            Self::Cameras { .. } => &[TableName::Carried, TableName::Together],
            Self::Batches { .. } => &[TableName::Batches],
            Self::Stages { .. } => &[TableName::Stages],
            Self::Precision { .. } => &[TableName::Precision],
            Self::Ways { .. } => &[TableName::Ways, TableName::Copies],
            Self::Starts { .. } => &[TableName::Starts],
            Self::Failures => &[TableName::Failures],
        }
    }

    /// Measures it in this process.
    pub(crate) async fn measure(&self, arguments: &Arguments) -> anyhow::Result<Vec<Row>> {
        match self {
            Self::Machine => machine::measure(arguments).await,
            Self::Cameras { model, policy } => cameras::measure(arguments, model, policy).await,
            Self::Batches { model } => stages::batches(arguments, model).await,
            Self::Stages { model } => stages::stages(arguments, model),
            Self::Precision { whole, half } => precision::measure(arguments, whole, half),
            Self::Ways { model } => ways::measure(arguments, model),
            Self::Starts { model } => starts::measure(arguments, model).await,
            Self::Failures => failures::measure(arguments).await,
        }
    }
}

/// The frame of each table, by the module that fills it.
pub(crate) fn table(name: TableName, arguments: &Arguments) -> Table {
    match name {
        TableName::Machine => machine::table(),
        TableName::Carried => cameras::carried_table(arguments),
        TableName::Together => cameras::together_table(),
        TableName::Batches => stages::batches_table(),
        TableName::Stages => stages::stages_table(),
        TableName::Precision => precision::table(),
        TableName::Ways => ways::ways_table(),
        TableName::Copies => ways::copies_table(),
        TableName::Starts => starts::table(),
        TableName::Failures => failures::table(),
    }
}
