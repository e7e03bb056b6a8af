//! The handle to a running worker: starts it, asks it for answers, stops it.

use super::queue::{Queue, Request};
use super::successor::Successor;
use super::thread::ModelThread;
use super::{Answer, Asker, Build, Coming, End, Model, ModelStatus, RunError, Task};
use super::{WorkerInput, WorkerMeter, WorkerSettings};
use crate::onnx::{ExecutionProvider, StartError};
use std::sync::Arc;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

/// A handle to a running worker, which stops when its last handle is dropped.
pub(crate) struct Worker<I, T> {
    requests: mpsc::UnboundedSender<Request<I, T>>,
    /// The pictures that are announced.
    pub(crate) coming: Coming,
    /// The worker's status, updated as it changes.
    pub(crate) status: watch::Receiver<ModelStatus>,
    idle: watch::Receiver<bool>,
    /// The start of the build of a successor, until it has ended.
    pub(crate) building: watch::Receiver<Option<Instant>>,
    ended: watch::Receiver<Option<Result<(), String>>>,
    /// Counters for metrics; does not keep the worker running.
    pub(crate) meter: WorkerMeter,
    stop: Arc<Stop>,
}

/// Stops the worker when it is dropped.
struct Stop {
    token: CancellationToken,
    _on_drop: DropGuard,
}

impl<I, T> Clone for Worker<I, T> {
    fn clone(&self) -> Self {
        Self {
            requests: self.requests.clone(),
            coming: self.coming.clone(),
            status: self.status.clone(),
            idle: self.idle.clone(),
            building: self.building.clone(),
            ended: self.ended.clone(),
            meter: self.meter.clone(),
            stop: Arc::clone(&self.stop),
        }
    }
}

impl<I: WorkerInput, T: Send + 'static> Worker<I, T> {
    /// Builds the model on its thread and waits for it; also returns the model's facts. Calls `build` again after each
    /// failure of a run. Counts with `meter`. Needs a tokio runtime with timers.
    ///
    /// `successor` builds a better model, which may take long: on another thread, while the first one answers, whose place
    /// it takes between two runs. If it cannot be built, the log says why and the first one stays.
    ///
    /// # Errors
    /// If the first model cannot be built.
    pub(crate) async fn start<M: Model<Input = I, Output = T>>(
        settings: WorkerSettings,
        meter: WorkerMeter,
        build: impl Fn() -> Result<M, StartError> + Send + 'static,
        successor: Option<Build<M>>,
    ) -> Result<(Self, M::Facts), StartError> {
        let thread = ModelThread::spawn(settings.name, build)
            .map_err(|error| StartError::thread(settings.name, error))?;
        let (requests, received) = mpsc::unbounded_channel();
        let (status, watched) = watch::channel(ModelStatus::Starting);
        let (idle, is_idle) = watch::channel(false);
        let (building, is_building) = watch::channel(None);
        let (end, ended) = watch::channel(None);
        let stop = CancellationToken::new();
        let coming = Coming::default();
        let mut task = Task {
            settings,
            thread,
            successor: None,
            facts: None,
            requests: received,
            queue: Queue::new(settings.batch_size, settings.batch_wait, coming.clone()),
            is_stopping: false,
            provider: ExecutionProvider::Cpu,
            status,
            idle,
            building,
            meter: meter.clone(),
            stop: stop.clone(),
        };
        let worker = Self {
            requests,
            coming,
            status: watched,
            idle: is_idle,
            building: is_building,
            ended,
            meter,
            stop: Arc::new(Stop {
                token: stop.clone(),
                _on_drop: stop.drop_guard(),
            }),
        };
        let facts = match task.build().await {
            Ok(built) => built?,
            Err(End::Stuck(reason)) => return Err(StartError::thread(settings.name, reason)),
            Err(End::Stopped | End::StoppedLate) => {
                let reason = "it was stopped".to_owned();
                return Err(StartError::thread(settings.name, reason));
            }
        };
        if let Some(build) = successor {
            let successor = Successor::build(settings.name, build)?;
            task.building.send_replace(Some(successor.begun));
            task.successor = Some(successor);
        }
        tokio::spawn(async move {
            let served = task.serve().await;
            let finished = task.finish(served).await;
            end.send_replace(Some(finished));
        });
        Ok((worker, facts))
    }

    /// Checks that a picture would be accepted now; counts a refusal, except by a worker that is stopped.
    ///
    /// # Errors
    /// The error that [`run`](Self::run) would return at once.
    pub(crate) fn accepts(&self) -> Result<(), RunError> {
        if self.stop.token.is_cancelled() {
            return Err(RunError::Stopped);
        }
        let Some(refusal) = self.status.borrow().refusal() else {
            return Ok(());
        };
        self.meter.update(|counts| counts.refused += 1);
        Err(refusal)
    }

    /// Runs the model on a picture of `asker`; without one, it runs when no asker waits. Waits for its turn and for the
    /// run. When this returns `Ok`, the worker no longer holds the picture. May be cancelled at any time.
    ///
    /// # Errors
    /// See [`RunError`]; a run that takes too long is answered at its deadline, not later.
    pub(crate) async fn run(
        &self,
        asker: Option<Asker>,
        picture: I,
    ) -> Result<Answer<T>, RunError> {
        let (reply, answer) = oneshot::channel();
        let request = Request {
            asker,
            size: picture.size(),
            picture,
            requested_at: Instant::now(),
            reply,
        };
        self.requests.send(request).map_err(|_| RunError::Stopped)?;
        answer.await.unwrap_or(Err(RunError::Stopped))
    }

    /// Waits until the model has nothing to do; returns `None` once the worker has been stopped.
    pub(crate) async fn idle(&self) -> Option<()> {
        let mut idle = self.idle.clone();
        let has_ended = idle.wait_for(|idle| *idle).await.is_err();
        // A worker that was stopped while it had nothing to do stays idle.
        if has_ended || self.stop.token.is_cancelled() {
            return None;
        }
        Some(())
    }

    /// Accepts no more pictures, refuses those that wait, and returns when the run in progress has ended or exceeded
    /// its deadline. Safe to call more than once.
    pub(crate) async fn stop(&self) {
        self.stop.token.cancel();
        // A stuck thread is handled by the supervisor.
        let _ = self.ended().await;
    }

    /// Returns when the worker has stopped.
    ///
    /// # Errors
    /// If its thread is stuck: only a new process helps.
    pub(crate) async fn ended(&self) -> Result<(), String> {
        let mut ended = self.ended.clone();
        match ended.wait_for(Option::is_some).await {
            Ok(end) => end.clone().unwrap_or(Ok(())),
            Err(_) => Err("its task is gone".to_owned()),
        }
    }
}
