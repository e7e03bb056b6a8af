//! Watches a service's tasks: if one ends, it is restarted after a pause if declared so, otherwise the service stops.

#[cfg(test)]
mod tests;

use crate::panics::message;
use crate::readiness::{Fault, Readiness};
use albireo_wire::HealthState;
use futures_util::FutureExt;
use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use tokio::task::JoinSet;
use tokio::time::{Duration, sleep};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

/// The readiness part that lists the tasks.
pub const PART: &str = "tasks";

/// The first pause before a restart. Doubles with each failure until the task has run calmly.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

/// The longest pause before a restart.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// A task that has run this long since its restart counts as working again.
const CALM: Duration = Duration::from_secs(60);

/// The end of a task, with the reason if it failed.
#[derive(Debug, Default)]
pub struct TaskEnd(Option<String>);

impl From<()> for TaskEnd {
    fn from((): ()) -> Self {
        Self(None)
    }
}

impl<E: Display> From<Result<(), E>> for TaskEnd {
    fn from(ended: Result<(), E>) -> Self {
        Self(ended.err().map(|error| format!("failed: {error}")))
    }
}

/// An essential task failed and is not restarted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the task `{task}` {reason}; the program exits so that a service manager can restart it")]
pub struct TaskFailed {
    /// Its name.
    pub task: String,
    /// The failure.
    pub reason: String,
}

/// Every task ever started, and the number of times it panicked, failed, or ended unexpectedly. Clones share them.
pub type TaskFailures = Arc<Mutex<BTreeMap<String, u64>>>;

/// The tasks of a service. The owner must poll [`watch`](Self::watch) while the service runs, and
/// [`finish`](Self::finish) at its end. Dropping it drops the tasks.
pub struct Supervisor {
    running: JoinSet<(String, TaskEnd)>,
    names: BTreeSet<String>,
    readiness: Readiness,
    failures: TaskFailures,
    shutdown: CancellationToken,
}

impl Supervisor {
    /// Creates a supervisor without tasks. After `shutdown`, tasks are expected to end.
    pub fn new(readiness: Readiness, failures: TaskFailures, shutdown: CancellationToken) -> Self {
        Self {
            running: JoinSet::new(),
            names: BTreeSet::new(),
            readiness,
            failures,
            shutdown,
        }
    }

    /// Runs the future that `task` creates, and creates it again if it ends before the shutdown or panics. Until it
    /// is restarted, the readiness has a fault with this effect; then it is degraded until the task has run for a minute.
    pub fn restarting<F>(
        &mut self,
        name: impl Into<String>,
        effect: HealthState,
        task: impl Fn() -> F + Send + Sync + 'static,
    ) where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let name = name.into();
        let part = self.readiness.part_of(PART, name.clone());
        let failures = self.failures.clone();
        let shutdown = self.shutdown.clone();
        self.essential(name.clone(), async move {
            let mut pause = FIRST_PAUSE;
            loop {
                // Created inside, so that a panic in `task` counts as a panic of the task.
                let run = end_of(async { task().await });
                tokio::pin!(run);
                let end = tokio::select! {
                    end = &mut run => end,
                    () = sleep(CALM) => {
                        part.works();
                        pause = FIRST_PAUSE;
                        run.await
                    }
                };
                if shutdown.is_cancelled() {
                    return end;
                }
                let reason = failed(&failures, &name, end);
                part.fault(Fault::new(
                    effect,
                    format!("{reason}; it will be restarted"),
                ));
                let waited = shutdown.run_until_cancelled(sleep(pause)).await;
                if waited.is_none() {
                    return TaskEnd::default();
                }
                pause = (pause * 2).min(LONGEST_PAUSE);
                tracing::info!("the task was restarted");
                part.degraded(
                    "failed and was restarted; counts as working once it has run for a minute",
                );
            }
        });
    }

    /// Runs `task`, in a span with its name; if it ends before the shutdown or panics, the service ends.
    pub fn essential<F>(&mut self, name: impl Into<String>, task: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let name = name.into();
        self.failures.lock().entry(name.clone()).or_default();
        self.names.insert(name.clone());
        let span = tracing::info_span!("task", name);
        let run = async move { (name, end_of(task).await) };
        self.running.spawn(run.instrument(span));
    }

    /// Like [`essential`](Self::essential), for a part that outlives the other tasks: after the shutdown, `part` is
    /// not awaited.
    pub fn until_shutdown<F>(&mut self, name: impl Into<String>, part: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let shutdown = self.shutdown.clone();
        self.essential(name, async move {
            match shutdown.run_until_cancelled(part).await {
                Some(end) => end.into(),
                None => TaskEnd::default(),
            }
        });
    }

    /// Watches the tasks until the shutdown. Joining never fails: panics are caught inside, and no task is aborted.
    ///
    /// # Errors
    /// [`TaskFailed`] if a task fails that is not restarted; the others still run.
    pub async fn watch(&mut self) -> Result<(), TaskFailed> {
        let shutdown = self.shutdown.clone();
        loop {
            tokio::select! {
                biased;
                () = shutdown.cancelled() => return Ok(()),
                Some(Ok((name, end))) = self.running.join_next() => self.ended(name, end)?,
            }
        }
    }

    fn ended(&mut self, task: String, end: TaskEnd) -> Result<(), TaskFailed> {
        self.names.remove(&task);
        let stopping = self.shutdown.is_cancelled();
        if stopping && end.0.is_none() {
            return Ok(());
        }
        let reason = failed(&self.failures, &task, end);
        if stopping {
            return Ok(());
        }
        self.readiness.part_of(PART, task.clone()).not_ready(reason.clone());
        Err(TaskFailed { task, reason })
    }

    /// Waits until every task has ended; as in [`watch`](Self::watch), joining never fails. Call it after the shutdown.
    pub async fn finish(&mut self) {
        while let Some(Ok((name, end))) = self.running.join_next().await {
            // `ended` has logged the error.
            let _ = self.ended(name, end);
        }
    }

    /// The names of the tasks that still run.
    pub fn still_running(&self) -> Vec<&str> {
        self.names.iter().map(String::as_str).collect()
    }
}

/// Counts and logs a failure, and returns its reason.
fn failed(failures: &TaskFailures, task: &str, end: TaskEnd) -> String {
    let ended_early = || "ended before the shutdown".to_owned();
    let reason = end.0.unwrap_or_else(ended_early);
    *failures.lock().entry(task.to_owned()).or_default() += 1;
    tracing::error!(task, "the task {reason}");
    reason
}

/// Runs a task to its end or its panic.
async fn end_of(task: impl Future<Output: Into<TaskEnd>>) -> TaskEnd {
    match AssertUnwindSafe(task).catch_unwind().await {
        Ok(end) => end.into(),
        Err(payload) => TaskEnd(Some(format!("panicked: {}", message(&*payload)))),
    }
}
