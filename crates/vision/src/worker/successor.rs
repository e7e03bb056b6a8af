//! A better model that is built on another thread, and what it tells of it.

use super::thread::{Command, ModelThread, Outcome};
use super::{Build, Model, STILL_BUILDING};
use crate::onnx::{ExecutionProvider, StartError};
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// A model that is built while another one answers.
pub(super) struct Successor<M: Model> {
    pub(super) thread: ModelThread<M>,
    pub(super) begun: Instant,
    /// The time after which the log next reports that it is still being built.
    pub(super) patience: Duration,
    /// What runs it, once it is ready.
    pub(super) provider: Option<ExecutionProvider>,
}

impl<M: Model> Successor<M> {
    /// Begins to build the model on a thread of its own.
    pub(super) fn build(name: &'static str, build: Build<M>) -> Result<Self, StartError> {
        let thread =
            ModelThread::spawn(name, build).map_err(|error| StartError::thread(name, error))?;
        // A thread that is gone is noticed by its outcomes.
        let _ = thread.commands.send(Command::Build);
        Ok(Self {
            thread,
            begun: Instant::now(),
            patience: STILL_BUILDING,
            provider: None,
        })
    }
}

/// What a successor tells.
pub(super) enum Told<M: Model> {
    /// Its thread has finished the build; `None` if the thread is gone.
    Outcome(Option<Outcome<M>>),
    /// It is still being built.
    Still,
}

/// What the `successor` tells next; never returns without one that is being built.
pub(super) async fn told_by<M: Model>(successor: &mut Option<Successor<M>>) -> Told<M> {
    match successor {
        Some(successor) if successor.provider.is_none() => {
            tokio::select! {
                outcome = successor.thread.outcomes.recv() => Told::Outcome(outcome),
                () = sleep_until(successor.begun + successor.patience) => Told::Still,
            }
        }
        _ => std::future::pending().await,
    }
}
