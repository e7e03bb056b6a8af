//! The reasons why a model cannot be started.

use super::Signature;
use std::error::Error;
use std::fmt::Display;
use std::path::Path;

/// The reason why a model could not be started. Every message names a remedy.
#[derive(Debug, thiserror::Error)]
#[error("{text}")]
pub struct StartError {
    kind: StartErrorKind,
    text: String,
    source: Option<Box<dyn Error + Send + Sync>>,
}

/// What a [`StartError`] is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartErrorKind {
    /// A configuration key contradicts itself or the model.
    Configuration,
    /// The ONNX Runtime library is missing or cannot be used.
    Library,
    /// The execution provider does not work here.
    Provider,
    /// The file is missing, damaged, no ONNX file, or not supported by this ONNX Runtime.
    Unreadable,
    /// The model is sound, but nothing here reads its inputs or outputs as configured.
    DoesNotFit,
    /// The model was loaded, and its first run failed.
    FirstRun,
    /// The thread of the model could not be started, or panicked.
    Thread,
}

impl StartError {
    pub(crate) fn new(kind: StartErrorKind, text: impl Display) -> Self {
        Self {
            kind,
            text: text.to_string(),
            source: None,
        }
    }

    /// The value of a configuration key contradicts itself or the model.
    pub(crate) fn configuration(key: impl Display, reason: impl Display) -> Self {
        Self::new(
            StartErrorKind::Configuration,
            format_args!("{key}: {reason}"),
        )
    }

    /// The ONNX file is missing, damaged or not supported by this ONNX Runtime.
    pub(crate) fn unreadable(model: &Path, reason: impl Display) -> Self {
        let where_it_begins = if model.is_relative() && !model.exists() {
            let here = std::env::current_dir().unwrap_or_default();
            format!(
                " (a relative path begins in the folder where the program runs, {})",
                here.display()
            )
        } else {
            String::new()
        };
        let model = model.display();
        Self::new(
            StartErrorKind::Unreadable,
            format_args!("the model {model} cannot be loaded: {reason}{where_it_begins}"),
        )
    }

    /// The model is sound, but its inputs or outputs are not what `head` expects.
    pub(crate) fn does_not_fit(
        model: &Path,
        signature: &Signature,
        (head, expected): (&str, &str),
        reason: impl Display,
    ) -> Self {
        Self::new(
            StartErrorKind::DoesNotFit,
            format_args!(
                "the model {} does not fit the head `{head}`: {reason}.\n  The model has {signature}.\n  The head \
                 expects {expected}.\n  Choose the head that belongs to the model, or export the model as the head \
                 expects it",
                model.display()
            ),
        )
    }

    /// The model was loaded, but its first run failed.
    pub(crate) fn first_run(model: &Path, reason: impl Display) -> Self {
        let model = model.display();
        Self::new(
            StartErrorKind::FirstRun,
            format_args!("the first run of the model {model} failed: {reason}"),
        )
    }

    /// The thread that builds the session could not be started, or panicked.
    pub(crate) fn thread(task: &str, reason: impl Display) -> Self {
        Self::new(
            StartErrorKind::Thread,
            format_args!("the thread of the {task} failed while it was starting: {reason}"),
        )
    }

    /// With the error that caused it.
    pub(crate) fn because(self, source: impl Error + Send + Sync + 'static) -> Self {
        Self {
            source: Some(Box::new(source)),
            ..self
        }
    }

    /// What it is about.
    pub fn kind(&self) -> StartErrorKind {
        self.kind
    }
}
