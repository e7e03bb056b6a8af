//! What the askers, the worker thread and the supervisor share: the pictures that wait, and the run in hand.

use super::counters::Counters;
use crate::detector::{CameraSlot, DetectorStatus, ExecutionProvider, InferenceError};
use crate::frame::Picture;
use std::collections::BTreeMap;
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, OwnedSemaphorePermit, oneshot, watch};
use tokio::time::Instant;

/// An answered picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Inference<T> {
    /// What the model found.
    pub output: T,
    /// From being asked to the start of the run.
    pub queued: Duration,
    /// From the start of the run to its end.
    pub took: Duration,
}

pub(super) type Answer<T> = Result<Inference<T>, InferenceError>;

/// A picture that waits for its run.
pub(super) struct Job<T> {
    pub(super) picture: Arc<Picture>,
    pub(super) asked: Instant,
    pub(super) reply: oneshot::Sender<Answer<T>>,
    /// The place it takes in the queue, given back when its run starts.
    pub(super) places: [OwnedSemaphorePermit; 2],
}

/// A picture handed to the worker.
pub(super) struct Assignment {
    pub(super) camera: CameraSlot,
    pub(super) picture: Arc<Picture>,
    pub(super) queued: Duration,
    pub(super) started: Instant,
}

struct Running<T> {
    started: Instant,
    reply: oneshot::Sender<Answer<T>>,
}

enum Phase {
    Working,
    Degraded(String),
    Stopped,
}

struct State<T> {
    phase: Phase,
    /// Which worker may take pictures. A worker that finds another number here has been given up.
    generation: u64,
    /// At most one picture a camera.
    waiting: BTreeMap<CameraSlot, Job<T>>,
    last_served: Option<CameraSlot>,
    running: Option<Running<T>>,
    provider: ExecutionProvider,
}

pub(super) struct Shared<T> {
    state: Mutex<State<T>>,
    /// Wakes the worker: a picture has come, or it must leave.
    work: Condvar,
    /// Wakes the supervisor: a run has started.
    pub(super) run_started: Notify,
    pub(super) counters: Arc<Counters>,
    pub(super) status: watch::Sender<DetectorStatus>,
}

impl<T> Shared<T> {
    pub(super) fn new() -> Self {
        Self {
            state: Mutex::new(State {
                phase: Phase::Degraded("it is starting".to_owned()),
                generation: 0,
                waiting: BTreeMap::new(),
                last_served: None,
                running: None,
                provider: ExecutionProvider::Cpu,
            }),
            work: Condvar::new(),
            run_started: Notify::new(),
            counters: Arc::default(),
            status: watch::Sender::new(DetectorStatus::Starting),
        }
    }

    /// How many pictures wait.
    #[cfg(test)]
    pub(super) fn waiting(&self) -> usize {
        self.lock().waiting.len()
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        // Nothing that runs under this lock can leave the state half changed.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a picture would be taken now.
    pub(super) fn accepts(&self) -> Result<(), InferenceError> {
        self.lock().phase.accepts().inspect_err(|_| {
            Counters::add(&self.counters.refused);
        })
    }

    /// Puts a picture into its camera's place, which the caller has made sure is free.
    pub(super) fn push(&self, camera: CameraSlot, job: Job<T>) -> Result<(), InferenceError> {
        let mut state = self.lock();
        if let Err(refusal) = state.phase.accepts() {
            Counters::add(&self.counters.refused);
            return Err(refusal);
        }
        state.waiting.insert(camera, job);
        drop(state);
        self.work.notify_all();
        Ok(())
    }

    /// Blocks until worker `generation` has a picture to run; `None` when it is to leave.
    pub(super) fn next(&self, generation: u64) -> Option<Assignment> {
        let mut state = self.lock();
        loop {
            if state.generation != generation || matches!(state.phase, Phase::Stopped) {
                return None;
            }
            match state.take_next() {
                Some((_, job)) if job.reply.is_closed() => {
                    Counters::add(&self.counters.cancelled);
                }
                Some((camera, job)) => {
                    let started = Instant::now();
                    let Job {
                        picture,
                        asked,
                        reply,
                        places,
                    } = job;
                    state.running = Some(Running { started, reply });
                    drop(state);
                    drop(places);
                    self.run_started.notify_one();
                    return Some(Assignment {
                        camera,
                        picture,
                        queued: started.saturating_duration_since(asked),
                        started,
                    });
                }
                None => {
                    state = self
                        .work
                        .wait(state)
                        .unwrap_or_else(PoisonError::into_inner);
                }
            }
        }
    }

    /// Answers the run of worker `generation` with success; `false` when the run had been given up.
    pub(super) fn complete(&self, generation: u64, inference: Inference<T>) -> bool {
        self.answer(generation, Ok(inference), &self.counters.completed)
    }

    /// Answers the run of worker `generation` with an error that is the picture's own; `false` when the run
    /// had been given up.
    pub(super) fn reject(&self, generation: u64, error: InferenceError) -> bool {
        self.answer(generation, Err(error), &self.counters.bad_pictures)
    }

    fn answer(&self, generation: u64, answer: Answer<T>, counter: &AtomicU64) -> bool {
        let mut state = self.lock();
        if state.generation != generation {
            return false;
        }
        let running = state.running.take();
        drop(state);
        Counters::add(counter);
        if let Some(running) = running {
            // The asker may have gone; that is its right.
            let _ = running.reply.send(answer);
        }
        true
    }

    /// Answers the run of worker `generation` with `error`, turns away what waits, and gives the worker up;
    /// `false` when it had been given up before.
    pub(super) fn fail(&self, generation: u64, error: InferenceError) -> bool {
        let state = self.lock();
        if state.generation != generation {
            return false;
        }
        Counters::add(match error {
            InferenceError::Panicked(_) => &self.counters.panicked,
            _ => &self.counters.failed,
        });
        let reason = error.to_string();
        self.give_up(state, error, reason);
        true
    }

    /// When the run in hand will have taken `timeout`.
    pub(super) fn deadline(&self, timeout: Duration) -> Option<Instant> {
        self.lock()
            .running
            .as_ref()
            .map(|running| running.started + timeout)
    }

    /// Gives the run in hand up if it has taken `timeout`; says whether it did.
    pub(super) fn expire(&self, timeout: Duration) -> bool {
        let state = self.lock();
        let late = state
            .running
            .as_ref()
            .is_some_and(|running| running.started + timeout <= Instant::now());
        if late {
            let timeout_ms = u64::try_from(timeout.as_millis()).unwrap_or(u64::MAX);
            let error = InferenceError::TimedOut { timeout_ms };
            let reason = error.to_string();
            Counters::add(&self.counters.timed_out);
            self.give_up(state, error, reason);
        }
        late
    }

    fn give_up(&self, mut state: MutexGuard<'_, State<T>>, error: InferenceError, reason: String) {
        state.generation += 1;
        let stopped = matches!(state.phase, Phase::Stopped);
        if !stopped {
            state.phase = Phase::Degraded(reason.clone());
        }
        let provider = state.provider;
        let running = state.running.take();
        let waiting = std::mem::take(&mut state.waiting);
        drop(state);
        // Readiness tells first, so that whoever gets the error finds it there.
        if !stopped {
            self.status.send_replace(DetectorStatus::Degraded {
                reason: reason.clone(),
                provider,
            });
        }
        self.work.notify_all();
        if let Some(running) = running {
            let _ = running.reply.send(Err(error));
        }
        self.turn_away(waiting, &InferenceError::Unavailable(reason));
    }

    fn turn_away(&self, waiting: BTreeMap<CameraSlot, Job<T>>, error: &InferenceError) {
        for (_, job) in waiting {
            Counters::add(&self.counters.refused);
            let _ = job.reply.send(Err(error.clone()));
        }
    }

    /// The number of a new worker, the only one from now on that may take pictures.
    pub(super) fn next_generation(&self) -> u64 {
        let mut state = self.lock();
        state.generation += 1;
        state.generation
    }

    /// Opens the queue for a freshly built worker.
    pub(super) fn ready(&self, provider: ExecutionProvider) {
        let mut state = self.lock();
        if matches!(state.phase, Phase::Stopped) {
            return;
        }
        state.phase = Phase::Working;
        state.provider = provider;
        drop(state);
        self.status.send_replace(DetectorStatus::Ready { provider });
    }

    /// Says in the status why there is no session yet.
    pub(super) fn still_degraded(&self, reason: String) {
        let mut state = self.lock();
        if matches!(state.phase, Phase::Stopped) {
            return;
        }
        state.phase = Phase::Degraded(reason.clone());
        let provider = state.provider;
        drop(state);
        self.status
            .send_replace(DetectorStatus::Degraded { reason, provider });
    }

    /// Closes the queue for good. The run in hand goes on; what waits is turned away.
    pub(super) fn stop(&self) {
        let mut state = self.lock();
        state.phase = Phase::Stopped;
        let waiting = std::mem::take(&mut state.waiting);
        drop(state);
        self.work.notify_all();
        self.turn_away(waiting, &InferenceError::Stopped);
    }
}

impl Phase {
    fn accepts(&self) -> Result<(), InferenceError> {
        match self {
            Self::Working => Ok(()),
            Self::Degraded(reason) => Err(InferenceError::Unavailable(reason.clone())),
            Self::Stopped => Err(InferenceError::Stopped),
        }
    }
}

impl<T> State<T> {
    /// The picture of the next camera round the circle.
    fn take_next(&mut self) -> Option<(CameraSlot, Job<T>)> {
        let camera = self
            .last_served
            .and_then(|last| self.waiting.range((Excluded(last), Unbounded)).next())
            .or_else(|| self.waiting.iter().next())
            .map(|(&camera, _)| camera)?;
        self.last_served = Some(camera);
        self.waiting.remove(&camera).map(|job| (camera, job))
    }
}
