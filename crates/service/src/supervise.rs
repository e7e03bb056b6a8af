//! Watches a service's tasks for as long as it runs: one that dies is counted, logged in its span, named in the
//! readiness, and started anew after a pause, or ends the service where nothing else is clean.

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

/// How a task that failed is started anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Restarts {
    /// What it means for the service while the task does not run.
    pub effect: Effect,
    /// From the first failure to the next start. Doubles with each failure until the task was calm.
    pub first_pause: Duration,
    /// The longest of these pauses.
    pub longest_pause: Duration,
    /// A task that has run so long since its restart counts as well again.
    pub calm: Duration,
}

impl Restarts {
    /// Pauses from 0.1 s to 30 s, calm after a minute.
    pub const fn new(effect: Effect) -> Self {
        Self {
            effect,
            first_pause: Duration::from_millis(100),
            longest_pause: Duration::from_secs(30),
            calm: Duration::from_secs(60),
        }
    }
}

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

/// A task the service cannot do without has failed, and cannot be started anew.
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
    /// It is started anew.
    Restart(Arc<Run>, Restarts),
    /// The service goes on without it.
    Without(Effect),
    /// The service ends.
    End,
}

/// How one run of a task ended by itself.
struct Ended {
    end: TaskEnd,
    /// It had run so long that what went wrong before is forgotten.
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

    /// Runs what `task` makes, in `span`; when that ends before the shutdown, or panics, it is made anew.
    pub fn restarting<F>(
        &mut self,
        name: impl Into<String>,
        span: Span,
        restarts: Restarts,
        task: impl Fn() -> F + Send + Sync + 'static,
    ) where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let run: Arc<Run> = Arc::new(move || {
            let task = task();
            Box::pin(async move { task.await.into() })
        });
        let task = self.task(name.into(), span, After::Restart(run, restarts));
        self.start(task, Duration::ZERO);
    }

    /// Runs `task` in `span`; when that ends before the shutdown, or panics, the service ends.
    pub fn essential<F>(&mut self, name: impl Into<String>, span: Span, task: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        self.once(name.into(), span, After::End, task);
    }

    /// Runs `task` in `span`; when that ends before the shutdown, or panics, the service goes on without it, and its
    /// readiness says so with that effect.
    pub fn dispensable<F>(&mut self, name: impl Into<String>, span: Span, effect: Effect, task: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        self.once(name.into(), span, After::Without(effect), task);
    }

    fn once<F>(&mut self, name: String, span: Span, after: After, task: F)
    where
        F: Future<Output: Into<TaskEnd>> + Send + 'static,
    {
        let known = self.task(name, span, after);
        let run = async move {
            Ended {
                end: task.await.into(),
                was_calm: false,
            }
        };
        let id = self.running.spawn(run.instrument(known.span.clone())).id();
        self.tasks.insert(id, known);
    }

    fn task(&self, name: String, span: Span, after: After) -> Task {
        Task {
            part: self.readiness.part_of(PART, name.clone()),
            count: self.tally.of(&name),
            pause: match &after {
                After::Restart(_, restarts) => restarts.first_pause,
                After::Without(_) | After::End => Duration::ZERO,
            },
            name,
            span,
            after,
        }
    }

    /// Starts a task that can be made anew, after `pause`.
    fn start(&mut self, task: Task, pause: Duration) {
        let After::Restart(run, restarts) = task.after.clone() else {
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
                part.degraded(
                    "failed and was started anew; well again when it has run for a while",
                );
            }
            // Made here, so that a panic in the making counts as one of the task.
            let task = run();
            tokio::pin!(task);
            let early = tokio::select! {
                end = &mut task => Some(end),
                () = sleep(restarts.calm) => None,
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
    /// [`TaskFailed`] when one fails that cannot be started anew; the others still run.
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
                    || "ended, though nobody had told it to".to_owned(),
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
            After::Restart(_, restarts) => {
                if was_calm {
                    task.pause = restarts.first_pause;
                }
                let pause = task.pause;
                task.pause = (pause * 2).min(restarts.longest_pause);
                task.part.fault(Fault {
                    effect: restarts.effect,
                    reason: format!("{reason}; it is started anew"),
                });
                self.start(task, pause);
                Ok(())
            }
            After::Without(effect) => {
                let effect = *effect;
                task.part.fault(Fault { effect, reason });
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
            // An error is of one that cannot be started anew, and has been logged.
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
