//! The task: one model on a thread of its own, shared by all cameras through a bounded queue that is fair
//! between them, one picture a run or several, and rebuilt when a run fails, panics or takes too long.

mod counters;
mod queue;
mod state;
mod supervisor;
#[cfg(test)]
mod tests;
mod worker;

pub use counters::TaskCounters;
pub use counters::TaskMeter;
pub use state::Inference;

use super::{CameraSlot, DetectorStatus, InferenceError, Model, StartError};
use parking_lot::Mutex;
use queue::{Batching, Job};
use state::TaskState;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use supervisor::Supervisor;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot, watch};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

/// Makes a model, on the thread it will live on; called again after each failure.
pub type Factory<M> = dyn Fn() -> Result<M, StartError> + Send + Sync;

/// How a task behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskSettings {
    /// What it is called in logs; also the name of its thread.
    pub name: &'static str,
    /// A run that takes this long is given up.
    pub timeout: Duration,
    /// Pictures that may wait, all cameras together; at least 1 is used. Each camera has at most one.
    pub queue: usize,
    /// The most pictures of a run, each of another camera; at least 1 is used.
    pub batch_size: usize,
    /// How long a picture waits for those of other cameras to share its run, from being asked.
    pub batch_wait: Duration,
    /// From the first failure to the first attempt to build a new model. Doubles with each failure until a
    /// run ends well.
    pub first_pause: Duration,
    /// The longest of these pauses.
    pub longest_pause: Duration,
    /// Threads that may hang in runs that were given up. While there are so many, no new model is built.
    pub most_abandoned: usize,
}

impl TaskSettings {
    /// A task of that name, limit and queue, one picture a run, with pauses from 0.1 s to 30 s and at most 4
    /// abandoned threads.
    pub const fn new(name: &'static str, timeout: Duration, queue: usize) -> Self {
        Self {
            name,
            timeout,
            queue,
            batch_size: 1,
            batch_wait: Duration::ZERO,
            first_pause: Duration::from_millis(100),
            longest_pause: Duration::from_secs(30),
            most_abandoned: 4,
        }
    }
}

/// The right to have one picture looked at while nobody else asks.
pub struct SpareTurn {
    _place: OwnedSemaphorePermit,
}

/// A handle to a running task. It stops when its last handle is dropped.
pub struct InferenceTask<I, T> {
    inner: Arc<Inner<I, T>>,
}

impl<I, T> Clone for InferenceTask<I, T> {
    fn clone(&self) -> Self {
        Self {
            inner: self.inner.clone(),
        }
    }
}

struct Inner<I, T> {
    shared: Arc<TaskState<I, T>>,
    /// One place a camera: a second picture of the same camera waits for it.
    cameras: Mutex<HashMap<CameraSlot, Arc<Semaphore>>>,
    /// The places of all.
    queue: Arc<Semaphore>,
    /// The one place of pictures that are looked at when nobody waits.
    spare: Arc<Semaphore>,
    stop: CancellationToken,
    stopped: watch::Receiver<bool>,
}

impl<I, T> Inner<I, T> {
    fn stop(&self) {
        self.shared.stop();
        self.stop.cancel();
    }
}

impl<I, T> Drop for Inner<I, T> {
    fn drop(&mut self) {
        self.stop();
    }
}

impl<I: Send + 'static, T: Send + 'static> InferenceTask<I, T> {
    /// Builds the first model on its thread and waits for it; also says what its users may rely on. Needs a tokio
    /// runtime with timers.
    ///
    /// # Errors
    /// When the first model cannot be built. Later failures are retried, counted and told by
    /// [`status`](Self::status).
    pub async fn start<M: Model<Input = I, Output = T>>(
        settings: TaskSettings,
        factory: impl Fn() -> Result<M, StartError> + Send + Sync + 'static,
    ) -> Result<(Self, M::Facts), StartError> {
        let shared = Arc::new(TaskState::new(Batching {
            size: settings.batch_size.max(1),
            wait: settings.batch_wait,
        }));
        let stop = CancellationToken::new();
        let (started, has_started) = oneshot::channel();
        let (tell_stopped, stopped) = watch::channel(false);
        let inner = Arc::new(Inner {
            shared: shared.clone(),
            cameras: Mutex::new(HashMap::new()),
            queue: Arc::new(Semaphore::new(
                settings.queue.clamp(1, Semaphore::MAX_PERMITS),
            )),
            spare: Arc::new(Semaphore::new(1)),
            stop: stop.clone(),
            stopped,
        });
        let first: Arc<OnceLock<M::Facts>> = Arc::default();
        let facts = first.clone();
        let factory: Arc<Factory<M>> = Arc::new(move || {
            let model = factory()?;
            if *facts.get_or_init(|| model.facts()) == model.facts() {
                Ok(model)
            } else {
                Err(StartError::ModelChanged {
                    task: settings.name,
                })
            }
        });
        let supervisor = Supervisor::new(settings, factory, shared, stop);
        tokio::spawn(supervisor.run(started, tell_stopped));
        let failed = || StartError::Thread {
            task: settings.name,
            reason: "its supervisor ended".to_owned(),
        };
        has_started.await.unwrap_or_else(|_| Err(failed()))?;
        let facts = first.get().cloned().ok_or_else(failed)?;
        Ok((Self { inner }, facts))
    }

    /// Whether a picture would be taken now; a refusal is counted.
    ///
    /// # Errors
    /// What [`run`](Self::run) would answer at once.
    pub fn accepts(&self) -> Result<(), InferenceError> {
        self.inner.shared.accepts()
    }

    /// Has `picture` answered. Waits for its turn and for the run.
    ///
    /// When this returns `Ok` or [`InferenceError::Failed`] the task no longer holds it; after a time-out a
    /// hanging run may still hold it.
    ///
    /// # Errors
    /// See [`InferenceError`]; a run that takes too long is answered at the limit, not later.
    pub async fn run(
        &self,
        camera: CameraSlot,
        picture: I,
    ) -> Result<Inference<T>, InferenceError> {
        let asked = Instant::now();
        let shared = &self.inner.shared;
        shared.accepts()?;
        let place = self.place_of(camera);
        let places = [
            place
                .acquire_owned()
                .await
                .map_err(|_| InferenceError::Stopped)?,
            self.inner
                .queue
                .clone()
                .acquire_owned()
                .await
                .map_err(|_| InferenceError::Stopped)?,
        ];
        let (reply, answer) = oneshot::channel();
        shared.push(
            camera,
            Job {
                picture,
                asked,
                reply,
                places: Some(places),
            },
        )?;
        answer.await.unwrap_or(Err(InferenceError::Stopped))
    }

    /// The right to ask [`run_spare`](Self::run_spare), one at a time: comes when the model has nothing to do. `None` once
    /// the task has been stopped.
    pub async fn spare_turn(&self) -> Option<SpareTurn> {
        let place = self.inner.spare.clone().acquire_owned().await.ok()?;
        self.inner.shared.idle().await;
        Some(SpareTurn { _place: place })
    }

    /// Has `picture` answered when nobody else waits: every picture of [`run`](Self::run) that comes meanwhile goes before
    /// it. `None` when its run could not begin before `until`.
    ///
    /// # Errors
    /// As of [`run`](Self::run).
    pub async fn run_spare(
        &self,
        turn: SpareTurn,
        picture: I,
        until: Instant,
    ) -> Result<Option<Inference<T>>, InferenceError> {
        let (reply, answer) = oneshot::channel();
        self.inner.shared.push_spare(Job {
            picture,
            asked: Instant::now(),
            reply,
            places: None,
        })?;
        tokio::pin!(answer);
        let answer = tokio::select! {
            biased;
            answer = &mut answer => answer,
            () = sleep_until(until) => {
                if self.inner.shared.withdraw_spare() {
                    return Ok(None);
                }
                answer.await
            }
        };
        drop(turn);
        answer.unwrap_or(Err(InferenceError::Stopped)).map(Some)
    }

    fn place_of(&self, camera: CameraSlot) -> Arc<Semaphore> {
        self.inner
            .cameras
            .lock()
            .entry(camera)
            .or_insert_with(|| Arc::new(Semaphore::new(1)))
            .clone()
    }

    /// How the task is doing, now and from now on.
    pub fn status(&self) -> watch::Receiver<DetectorStatus> {
        self.inner.shared.status.subscribe()
    }

    /// What it has counted since it started.
    pub fn counters(&self) -> TaskCounters {
        self.meter().read()
    }

    /// Its counters for whoever shows them: does not keep the task running.
    pub fn meter(&self) -> TaskMeter {
        TaskMeter(self.inner.shared.counters.clone())
    }

    /// Takes no more pictures, turns away those that wait, and returns when the run in hand has ended or
    /// has taken too long. Safe to call more than once.
    pub async fn stop(&self) {
        self.inner.stop();
        self.ended().await;
    }

    /// Returns when the task has been stopped, or its supervisor is gone.
    pub async fn ended(&self) {
        let mut stopped = self.inner.stopped.clone();
        // An error means that the supervisor is gone, which is what is waited for.
        let _ = stopped.wait_for(|stopped| *stopped).await;
    }
}
