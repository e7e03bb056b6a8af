//! The thread a model lives on.

use super::Factory;
use super::state::TaskState;
use crate::detector::model::{Interrupter, Model};
use crate::detector::{ExecutionProvider, InferenceError, RunError, StartError};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::runtime::Handle;
use tokio::sync::mpsc;

/// What a worker tells the supervisor.
pub(super) enum Event {
    /// The model stands and waits for pictures.
    Built {
        provider: ExecutionProvider,
        interrupter: Option<Interrupter>,
    },
    /// There is no model.
    BuildFailed(StartError),
    /// A run failed; the queue has been closed.
    RunFailed(String),
    /// The thread leaves; its model is gone.
    Ended,
}

/// Starts the thread of worker `generation`.
pub(super) fn spawn<M: Model>(
    task: &'static str,
    generation: u64,
    factory: Arc<Factory<M>>,
    shared: Arc<TaskState<M::Input, M::Output>>,
    events: mpsc::UnboundedSender<(u64, Event)>,
) -> std::io::Result<()> {
    let runtime = Handle::current();
    std::thread::Builder::new()
        .name(task.to_owned())
        .spawn(move || {
            // With the runtime entered, this thread reads the same clock as the supervisor, also in a test
            // that holds it.
            let _entered = runtime.enter();
            let events = WorkerEvents { generation, events };
            match build(task, &*factory) {
                Ok(mut model) => {
                    events.send(Event::Built {
                        provider: model.provider(),
                        interrupter: model.interrupter(),
                    });
                    if let Some(failure) = work(&mut model, generation, &shared, &runtime) {
                        events.send(Event::RunFailed(failure));
                    }
                }
                Err(error) => events.send(Event::BuildFailed(error)),
            }
        })
        .map(drop)
}

/// The worker's line to the supervisor; its end tells that the thread leaves, however it leaves.
struct WorkerEvents {
    generation: u64,
    events: mpsc::UnboundedSender<(u64, Event)>,
}

impl WorkerEvents {
    fn send(&self, event: Event) {
        // Without a supervisor nobody needs to know.
        let _ = self.events.send((self.generation, event));
    }
}

impl Drop for WorkerEvents {
    fn drop(&mut self) {
        self.send(Event::Ended);
    }
}

fn build<M: Model>(task: &'static str, factory: &Factory<M>) -> Result<M, StartError> {
    catch_unwind(AssertUnwindSafe(factory)).unwrap_or_else(|panic| {
        Err(StartError::Thread {
            task,
            reason: message(&*panic),
        })
    })
}

/// Runs pictures until told to leave, or until a run fails: then says why.
fn work<M: Model>(
    model: &mut M,
    generation: u64,
    shared: &TaskState<M::Input, M::Output>,
    runtime: &Handle,
) -> Option<String> {
    while let Some(assignment) = shared.next(generation, runtime) {
        let asked = assignment.pictures.len();
        let result = catch_unwind(AssertUnwindSafe(|| model.run(&assignment.pictures)));
        // Before the answer goes out, so that the asker can use the buffers again.
        drop(assignment.pictures);
        let error = match result {
            Ok(Ok(outputs)) if outputs.len() == asked => {
                if shared.complete(generation, outputs, assignment.started.elapsed()) {
                    continue;
                }
                return None;
            }
            Ok(Ok(outputs)) => InferenceError::Failed(format!(
                "the model answered {} of {asked} pictures",
                outputs.len()
            )),
            Ok(Err(RunError(reason))) => InferenceError::Failed(reason),
            Err(panic) => InferenceError::Panicked(message(&*panic)),
        };
        let reason = error.to_string();
        return shared.fail(generation, error).then_some(reason);
    }
    None
}

/// The text of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    panic
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}
