//! Watches a service's tasks: one that dies ends the service in order, or, where that is declared, is restarted after a pause.

mod tally;
#[cfg(test)]
mod tests;

pub use tally::{TaskCounts, TaskTally};

use crate::panics::message;
use crate::readiness::{Effect, Fault, Part, Readiness};
use std::collections::HashMap;
use std::fmt::Display;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use tally::Count;
use tokio::task::{Id, JoinError, JoinSet};
use tokio::time::{Duration, sleep};
use tokio_util::sync::CancellationToken;
use tracing::{Instrument, Span};

/// The part of the readiness under which tasks are named.
pub const PART: &str = "tasks";

/// From the first failure to the next start. Doubles with each failure until the task was calm.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

/// The longest of these pauses.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// A task that has run so long since its restart counts as well again.
const CALM: Duration = Duration::from_secs(60);

/// How a task ended by itself.
#[derive(Debug, Default)]
pub struct TaskEnd(Option<String>);

impl From<()> for TaskEnd {
    fn from((): ()) -> Self {
        Self(None)
    }
}

impl<E: Display> From<Result<(), E>> for TaskEnd {
    fn from(ended: Result<(), E>) -> Self {
        Self(ended.err().map(|error| error.to_string()))
    }
}

/// A task the service cannot do without has failed, and is not restarted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the task `{task}` {reason}; the program ends, for a service manager to start it again")]
pub struct TaskFailed {
    /// Its name.
    pub task: String,
    /// How it failed.
    pub reason: String,
}

type Run = dyn Fn() -> Pin<Box<dyn Future<Output = TaskEnd> + Send>> + Send + Sync;

/// What is known about a task.
struct Task {
    name: String,
    span: Span,
    part: Part,
    count: Count,
    after: After,
    pause: Duration,
}

/// What happens when a task has failed.
#[derive(Clone)]
enum After {
    /// It is restarted; meanwhile the service is not ready, or degraded.
    Restart(Arc<Run>, Effect),
    /// The service ends.
    End,
}

/// How one run of a task ended by itself.
struct Ended {
    end: TaskEnd,
    /// It ran long enough for earlier failures to be forgotten.
    was_calm: bool,
}

/// The tasks of a service. Somebody must poll [`watch`](Self::watch) while the service runs, and
/// [`finish`](Self::finish) at its end. When it is dropped, so are the tasks.
pub struct Supervisor {
    running: JoinSet<Ended>,
    tasks: HashMap<Id, Task>,
    readiness: Readiness,
    tally: TaskTally,
    shutdown: CancellationToken,
}

impl Supervisor {
    /// A supervisor without tasks. After `shutdown` tasks are expected to end.
    pub fn new(readiness: Readiness, tally: TaskTally, shutdown: CancellationToken) -> Self {
        Self {
            running: JoinSet::new(),
            tasks: HashMap::new(),
            readiness,
            tally,
            shutdown,
        }
    }

    /// Runs what `task` makes, in `span`; when that ends before the shutdown, or panics, it is made again. Meanwhile the
    /// readiness has the fault with that effect.
    pub fn restarting<F>(
        &mut self,
        name: impl Into<String>,
        span: Span,
        effect: Effect,
        task: impl Fn() -> F + Send + Sync + 'static,
    ) where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let run: Arc<Run> = Arc::new(move || {
            let task = task();
            Box::pin(async move { task.await.into() })
        });
        let task = self.task(name.into(), span, After::Restart(run, effect));
        self.start(task, Duration::ZERO);
    }

    /// Runs `task` in `span`; when that ends before the shutdown, or panics, the service ends.
    pub fn essential<F>(&mut self, name: impl Into<String>, span: Span, task: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let known = self.task(name.into(), span, After::End);
        let run = async move {
            Ended {
                end: task.await.into(),
                was_calm: false,
            }
        };
        let id = self.running.spawn(run.instrument(known.span.clone())).id();
        self.tasks.insert(id, known);
    }

    /// As [`essential`](Self::essential), for a part that outlives the other tasks: from the shutdown on, `ended` is not
    /// waited for.
    pub fn until_shutdown<F>(&mut self, name: impl Into<String>, span: Span, ended: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let shutdown = self.shutdown.clone();
        self.essential(name, span, async move {
            let ended = shutdown.run_until_cancelled(ended).await;
            ended.map_or_else(TaskEnd::default, Into::into)
        });
    }

    fn task(&self, name: String, span: Span, after: After) -> Task {
        Task {
            part: self.readiness.part_of(PART, name.clone()),
            count: self.tally.of(&name),
            pause: FIRST_PAUSE,
            name,
            span,
            after,
        }
    }

    /// Starts a task that is restarted, after `pause`.
    fn start(&mut self, task: Task, pause: Duration) {
        let After::Restart(run, _) = task.after.clone() else {
            return;
        };
        let again = pause > Duration::ZERO;
        let (part, count, shutdown) =
            (task.part.clone(), task.count.clone(), self.shutdown.clone());
        let running = async move {
            if again {
                tokio::select! {
                    () = shutdown.cancelled() => return Ended { end: TaskEnd::default(), was_calm: false },
                    () = sleep(pause) => {}
                }
                count.restarted();
                tracing::info!("the task runs again");
                part.degraded("failed and was restarted; well again when it has run for a minute");
            }
            // Made here, so that a panic in the making counts as one of the task.
            let task = run();
            tokio::pin!(task);
            let early = tokio::select! {
                end = &mut task => Some(end),
                () = sleep(CALM) => None,
            };
            match early {
                Some(end) => Ended {
                    end,
                    was_calm: false,
                },
                None => {
                    if again {
                        part.works();
                    }
                    Ended {
                        end: task.await,
                        was_calm: true,
                    }
                }
            }
        };
        let id = self
            .running
            .spawn(running.instrument(task.span.clone()))
            .id();
        self.tasks.insert(id, task);
    }

    /// Watches the tasks until the shutdown.
    ///
    /// # Errors
    /// [`TaskFailed`] when one fails that is not restarted; the others still run.
    pub async fn watch(&mut self) -> Result<(), TaskFailed> {
        let shutdown = self.shutdown.clone();
        loop {
            tokio::select! {
                biased;
                () = shutdown.cancelled() => return Ok(()),
                Some(ended) = self.running.join_next_with_id() => self.ended(ended)?,
                // No task, or none left: nothing to watch until the shutdown.
                else => {
                    shutdown.cancelled().await;
                    return Ok(());
                }
            }
        }
    }

    fn ended(&mut self, ended: Result<(Id, Ended), JoinError>) -> Result<(), TaskFailed> {
        let (id, ended) = match ended {
            Ok((id, ended)) => (id, Ok(ended)),
            Err(error) => (error.id(), Err(error)),
        };
        let Some(mut task) = self.tasks.remove(&id) else {
            return Ok(());
        };
        let stopping = self.shutdown.is_cancelled();
        let (reason, was_calm) = match ended {
            Ok(Ended {
                end: TaskEnd(None), ..
            }) if stopping => return Ok(()),
            Ok(Ended { end, was_calm }) => {
                let reason = end.0.map_or_else(
                    || "ended before the shutdown".to_owned(),
                    |reason| format!("failed: {reason}"),
                );
                (reason, was_calm)
            }
            Err(error) => (panicked(error), false),
        };
        task.count.failed();
        tracing::error!(parent: &task.span, task = task.name, "the task {reason}");
        match &task.after {
            _ if stopping => Ok(()),
            After::Restart(_, effect) => {
                if was_calm {
                    task.pause = FIRST_PAUSE;
                }
                let (pause, effect) = (task.pause, *effect);
                task.pause = (pause * 2).min(LONGEST_PAUSE);
                let reason = format!("{reason}; it is restarted");
                task.part.fault(Fault { effect, reason });
                self.start(task, pause);
                Ok(())
            }
            After::End => {
                task.part.not_ready(reason.clone());
                Err(TaskFailed {
                    task: task.name,
                    reason,
                })
            }
        }
    }

    /// Waits until every task has ended. To be called after the shutdown.
    pub async fn finish(&mut self) {
        while let Some(ended) = self.running.join_next_with_id().await {
            // An error is of one that is not restarted, and has been logged.
            let _ = self.ended(ended);
        }
    }

    /// The tasks that still run, by name: who is being waited for.
    pub fn still_running(&self) -> Vec<&str> {
        let mut names: Vec<_> = self.tasks.values().map(|task| task.name.as_str()).collect();
        names.sort_unstable();
        names
    }
}

fn panicked(error: JoinError) -> String {
    match error.try_into_panic() {
        Ok(payload) => format!("panicked: {}", message(&*payload)),
        Err(error) => error.to_string(),
    }
}
