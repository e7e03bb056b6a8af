//! What the askers, the worker thread and the supervisor share: the pictures that wait, and the run in hand.

use super::counters::Counters;
use super::queue::{Batching, Job, Queue};
use crate::detector::{CameraSlot, DetectorStatus, ExecutionProvider, InferenceError};
use parking_lot::{Condvar, Mutex, MutexGuard};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{Notify, oneshot, watch};
use tokio::time::{Instant, sleep_until};

/// An answered picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Inference<T> {
    /// What the model found.
    pub output: T,
    /// From being asked to the start of the run.
    pub queued: Duration,
    /// From the start of the run to its end.
    pub took: Duration,
    /// How many pictures the run looked at: this one's part of it is `took` divided by their number.
    pub pictures: u32,
}

pub(super) type Answer<T> = Result<Inference<T>, InferenceError>;

/// What is handed to the worker for one run.
pub(super) struct Assignment<I> {
    pub(super) pictures: Vec<I>,
    pub(super) started: Instant,
}

struct Running<T> {
    started: Instant,
    /// Who asked, and how long each picture waited.
    replies: Vec<(oneshot::Sender<Answer<T>>, Duration)>,
    /// It is the spare picture's run.
    spare: bool,
}

enum Phase {
    Working,
    Degraded(String),
    Stopped,
}

struct State<I, T> {
    phase: Phase,
    /// Which worker may take pictures. A worker that finds another number here has been given up.
    generation: u64,
    queue: Queue<I, Answer<T>>,
    /// A picture that is looked at when nobody waits.
    spare: Option<Job<I, Answer<T>>>,
    running: Option<Running<T>>,
    provider: ExecutionProvider,
}

pub(super) struct TaskState<I, T> {
    state: Mutex<State<I, T>>,
    /// Wakes the worker: a picture has come, or it must leave.
    work: Condvar,
    /// The same for a worker that waits for a batch to fill.
    batch_grew: Notify,
    /// Wakes the supervisor: a run has started.
    pub(super) run_started: Notify,
    /// Wakes who waits for the model to have nothing to do.
    became_idle: Notify,
    pub(super) counters: Arc<Counters>,
    pub(super) status: watch::Sender<DetectorStatus>,
}

impl<I, T> TaskState<I, T> {
    pub(super) fn new(batching: Batching) -> Self {
        Self {
            state: Mutex::new(State {
                phase: Phase::Degraded("it is starting".to_owned()),
                generation: 0,
                queue: Queue::new(batching),
                spare: None,
                running: None,
                provider: ExecutionProvider::Cpu,
            }),
            work: Condvar::new(),
            batch_grew: Notify::new(),
            run_started: Notify::new(),
            became_idle: Notify::new(),
            counters: Arc::default(),
            status: watch::Sender::new(DetectorStatus::Starting),
        }
    }

    /// How many pictures wait.
    #[cfg(test)]
    pub(super) fn waiting(&self) -> usize {
        self.lock().queue.waiting()
    }

    /// Keeps the number that metrics show.
    fn count_waiting(&self, state: &State<I, T>) {
        let waiting = state.queue.waiting() as u64;
        self.counters.waiting.store(waiting, Ordering::Relaxed);
    }

    fn lock(&self) -> MutexGuard<'_, State<I, T>> {
        self.state.lock()
    }

    /// Whether a picture would be taken now.
    pub(super) fn accepts(&self) -> Result<(), InferenceError> {
        self.lock().phase.accepts().inspect_err(|_| {
            Counters::add(&self.counters.refused);
        })
    }

    /// Puts a picture into its camera's place, which the caller has made sure is free.
    pub(super) fn push(
        &self,
        camera: CameraSlot,
        job: Job<I, Answer<T>>,
    ) -> Result<(), InferenceError> {
        let mut state = self.lock();
        if let Err(refusal) = state.phase.accepts() {
            Counters::add(&self.counters.refused);
            return Err(refusal);
        }
        state.queue.push(camera, job);
        self.count_waiting(&state);
        drop(state);
        self.wake_worker();
        Ok(())
    }

    /// Returns when the model has nothing to do: no run, and nobody waits.
    pub(super) async fn idle(&self) {
        let became_idle = self.became_idle.notified();
        tokio::pin!(became_idle);
        loop {
            // Enabled before the look, so that what happens in between is not missed.
            became_idle.as_mut().enable();
            if self.lock().is_idle() {
                return;
            }
            became_idle.as_mut().await;
            became_idle.set(self.became_idle.notified());
        }
    }

    /// Puts a picture where it is looked at when nobody waits. There is one such place; the caller has made sure that it
    /// is free.
    pub(super) fn push_spare(&self, job: Job<I, Answer<T>>) -> Result<(), InferenceError> {
        let mut state = self.lock();
        state.phase.accepts()?;
        state.spare = Some(job);
        drop(state);
        self.wake_worker();
        Ok(())
    }

    /// Takes the spare picture back; `false` when its run has begun.
    pub(super) fn withdraw_spare(&self) -> bool {
        self.lock().spare.take().is_some()
    }

    fn wake_worker(&self) {
        self.work.notify_all();
        self.batch_grew.notify_one();
    }

    /// Blocks until worker `generation` has pictures to run; `None` when it is to leave. `runtime` keeps the
    /// time that a batch may take to fill.
    pub(super) fn next(&self, generation: u64, runtime: &Handle) -> Option<Assignment<I>> {
        let mut state = self.lock();
        loop {
            if state.generation != generation || matches!(state.phase, Phase::Stopped) {
                return None;
            }
            let gone = state.queue.forget_the_gone();
            Counters::add_many(&self.counters.cancelled, gone);
            self.count_waiting(&state);
            let now = Instant::now();
            match state.queue.batch_complete_at() {
                None => {
                    let Some(job) = state.take_spare() else {
                        self.became_idle.notify_waiters();
                        self.work.wait(&mut state);
                        continue;
                    };
                    state.running = Some(Running {
                        started: now,
                        replies: vec![(job.reply, now.saturating_duration_since(job.asked))],
                        spare: true,
                    });
                    drop(state);
                    self.run_started.notify_one();
                    return Some(Assignment {
                        pictures: vec![job.picture],
                        started: now,
                    });
                }
                Some(time) if time > now => {
                    drop(state);
                    runtime.block_on(async {
                        tokio::select! {
                            () = self.batch_grew.notified() => {}
                            () = sleep_until(time) => {}
                        }
                    });
                    state = self.lock();
                }
                Some(_) => {
                    let (mut pictures, mut replies, mut places) =
                        (Vec::new(), Vec::new(), Vec::new());
                    for job in state.queue.take_batch() {
                        pictures.push(job.picture);
                        replies.push((job.reply, now.saturating_duration_since(job.asked)));
                        places.push(job.places);
                    }
                    self.count_waiting(&state);
                    state.running = Some(Running {
                        started: now,
                        replies,
                        spare: false,
                    });
                    drop(state);
                    drop(places);
                    self.run_started.notify_one();
                    return Some(Assignment {
                        pictures,
                        started: now,
                    });
                }
            }
        }
    }

    /// Answers the run of worker `generation` with success, picture by picture; `false` when the run had been
    /// given up.
    pub(super) fn complete(&self, generation: u64, outputs: Vec<T>, took: Duration) -> bool {
        let mut state = self.lock();
        if state.generation != generation {
            return false;
        }
        let running = state.running.take();
        drop(state);
        if running.as_ref().is_some_and(|running| running.spare) {
            Counters::add(&self.counters.spare);
        } else {
            Counters::add_many(&self.counters.completed, outputs.len());
            Counters::add(&self.counters.batches);
        }
        let replies = running.map_or_else(Vec::new, |running| running.replies);
        let pictures = u32::try_from(replies.len()).unwrap_or(u32::MAX);
        for ((reply, queued), output) in replies.into_iter().zip(outputs) {
            // The asker may have gone; that is its right.
            let _ = reply.send(Ok(Inference {
                output,
                queued,
                took,
                pictures,
            }));
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

    fn give_up(
        &self,
        mut state: MutexGuard<'_, State<I, T>>,
        error: InferenceError,
        reason: String,
    ) {
        state.generation += 1;
        let stopped = matches!(state.phase, Phase::Stopped);
        if !stopped {
            state.phase = Phase::Degraded(reason.clone());
        }
        let provider = state.provider;
        let running = state.running.take();
        let waiting = state.queue.take_all();
        let spare = state.spare.take();
        self.count_waiting(&state);
        drop(state);
        // Readiness tells first, so that whoever gets the error finds it there.
        if !stopped {
            self.status.send_replace(DetectorStatus::Degraded {
                reason: reason.clone(),
                provider,
            });
        }
        self.wake_worker();
        for (reply, _) in running.map_or_else(Vec::new, |running| running.replies) {
            let _ = reply.send(Err(error.clone()));
        }
        let unavailable = InferenceError::Unavailable(reason);
        if let Some(spare) = spare {
            let _ = spare.reply.send(Err(unavailable.clone()));
        }
        self.turn_away(waiting, &unavailable);
    }

    fn turn_away(&self, waiting: Vec<Job<I, Answer<T>>>, error: &InferenceError) {
        for job in waiting {
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
        self.became_idle.notify_waiters();
        self.status.send_replace(DetectorStatus::Ready { provider });
    }

    /// Says in the status why there is no session yet, and whether what ran it is `lost` to this process.
    pub(super) fn still_degraded(&self, reason: String, lost: bool) {
        let mut state = self.lock();
        if matches!(state.phase, Phase::Stopped) {
            return;
        }
        state.phase = Phase::Degraded(reason.clone());
        let provider = state.provider;
        drop(state);
        self.status.send_replace(match lost {
            true => DetectorStatus::Lost { reason, provider },
            false => DetectorStatus::Degraded { reason, provider },
        });
    }

    /// Closes the queue for good. The run in hand goes on; what waits is turned away.
    pub(super) fn stop(&self) {
        let mut state = self.lock();
        state.phase = Phase::Stopped;
        let waiting = state.queue.take_all();
        let spare = state.spare.take();
        self.count_waiting(&state);
        drop(state);
        self.wake_worker();
        if let Some(spare) = spare {
            let _ = spare.reply.send(Err(InferenceError::Stopped));
        }
        self.turn_away(waiting, &InferenceError::Stopped);
    }
}

impl<I, T> State<I, T> {
    fn is_idle(&self) -> bool {
        let free = (self.spare.as_ref()).is_none_or(|spare| spare.reply.is_closed());
        matches!(self.phase, Phase::Working)
            && self.running.is_none()
            && self.queue.waiting() == 0
            && free
    }

    /// The spare picture, if its asker still waits for it.
    fn take_spare(&mut self) -> Option<Job<I, Answer<T>>> {
        self.spare.take().filter(|spare| !spare.reply.is_closed())
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
