//! One model on its own thread, shared by all cameras: a queue, a thread, and a deadline per run.
//!
//! A task owns all mutable state: it receives requests from a channel, hands the thread one batch at a time, and waits
//! for the outcome or the deadline. A run that exceeds its deadline is answered with an error at that time; nothing
//! else is accepted until the run comes back, and then the session goes on. After a failed run the session is rebuilt,
//! with growing pauses. A thread that has not come back [`STUCK_AFTER`] its deadline cannot be repaired within the
//! process: [`Worker::ended`] reports it.

mod coming;
mod counters;
mod error;
mod handle;
mod queue;
mod status;
mod successor;
#[cfg(test)]
mod tests;
mod thread;

pub use coming::Announcement;
pub(crate) use coming::Coming;
pub use counters::{WorkerCounts, WorkerMeter};
pub use error::RunError;
pub(crate) use handle::Worker;
pub use status::ModelStatus;

use crate::onnx::{ExecutionProvider, StartError, fault};
use albireo_core::geometry::PictureSize;
pub(crate) use queue::batch_sizes;
use queue::{Queue, Request};
use std::time::Duration;
use successor::{Successor, Told, told_by};
use thread::{Command, ModelThread, Outcome};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{error, info, warn};

/// The pause before the first attempt to rebuild a failed session; doubles with each failure until a run succeeds.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

/// The longest such pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// The time after a run's deadline at which its thread counts as stuck.
const STUCK_AFTER: Duration = Duration::from_secs(30);

/// The time after which the log first reports that a model is still being built; doubles with each report. There is no
/// limit: TensorRT builds engines for minutes.
const STILL_BUILDING: Duration = Duration::from_secs(10);

/// A caller whose pictures take turns with those of others, such as a camera by its place in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Asker(pub(crate) usize);

/// A picture in the form that a model accepts.
pub(crate) trait WorkerInput: Send + 'static {
    /// Its columns and rows: only pictures of one size share a run.
    fn size(&self) -> PictureSize;
}

/// A model that answers pictures, built and used on one thread.
pub(crate) trait Model: 'static {
    /// A picture in the form that the model accepts.
    type Input: WorkerInput;
    /// The result for one picture.
    type Output: Send + 'static;
    /// The facts that its users rely on as long as the program runs: a rebuilt model must have the same.
    type Facts: Clone + PartialEq + Send + 'static;

    /// The facts that its users rely on.
    fn facts(&self) -> Self::Facts;

    /// Runs on at least one picture and at most the worker's batch size, all of one size; returns one output per picture,
    /// in their order. Blocks.
    ///
    /// # Errors
    /// If the run failed.
    fn run(&mut self, pictures: &[Self::Input]) -> Result<Vec<Self::Output>, RunError>;

    /// The provider that runs the model.
    fn provider(&self) -> ExecutionProvider;
}

/// The settings of a worker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WorkerSettings {
    /// Its name in logs; also the name of its thread.
    pub(crate) name: &'static str,
    /// The longest time that a run may take.
    pub(crate) timeout: Duration,
    /// The maximum number of pictures in a run, each from another asker and all of one size.
    pub(crate) batch_size: usize,
    /// The longest time that a picture waits for pictures of other askers to share its run, from its request. It waits
    /// only for those that are announced or likely to come, and no longer than a run takes.
    pub(crate) batch_wait: Duration,
}

/// Builds a model on its thread.
pub(crate) type Build<M> = Box<dyn Fn() -> Result<M, StartError> + Send>;

/// An answered picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer<T> {
    /// The model's result.
    pub output: T,
    /// The time from the request to the start of the run.
    pub queued: Duration,
    /// The duration of the run.
    pub took: Duration,
    /// The number of pictures in the run: this picture's share of the run is `took` divided by it.
    pub pictures: u32,
}

/// The reason why a worker no longer serves.
enum End {
    Stopped,
    /// Stopped during a run that exceeded its deadline; the run is not awaited.
    StoppedLate,
    Stuck(String),
}

/// An event that a task waits for.
enum Event<M: Model> {
    /// A request arrived and was queued or refused.
    Request,
    /// The thread has finished its command.
    Outcome(Outcome<M>),
    /// The successor is ready, cannot be built, or is still being built.
    Successor,
    /// A picture that was announced does not come.
    CalledOff,
    /// The time limit of the wait has come.
    Time,
}

/// All mutable state, owned by one task.
struct Task<M: Model> {
    settings: WorkerSettings,
    thread: ModelThread<M>,
    successor: Option<Successor<M>>,
    /// The facts of the first model that was built, which any other must have.
    facts: Option<M::Facts>,
    requests: mpsc::UnboundedReceiver<Request<M::Input, M::Output>>,
    queue: Queue<M::Input, M::Output>,
    /// True once the worker is stopped: every request is refused.
    is_stopping: bool,
    provider: ExecutionProvider,
    status: watch::Sender<ModelStatus>,
    idle: watch::Sender<bool>,
    building: watch::Sender<Option<Instant>>,
    meter: WorkerMeter,
    stop: CancellationToken,
}

impl<M: Model> Task<M> {
    /// Runs requests until the worker is stopped or its thread is stuck.
    async fn serve(&mut self) -> Result<(), End> {
        let mut pause = FIRST_PAUSE;
        loop {
            self.next_batch().await?;
            let must_rebuild = self.run_batch().await?;
            if must_rebuild {
                self.rebuild(&mut pause).await?;
            } else {
                pause = FIRST_PAUSE;
            }
        }
    }

    /// Waits after the last run until the thread has dropped its model, at most as long as a run may take.
    async fn finish(mut self, served: Result<(), End>) -> Result<(), String> {
        self.close();
        match served {
            Err(End::Stuck(reason)) => return Err(reason),
            Err(End::StoppedLate) => return Ok(()),
            Ok(()) | Err(End::Stopped) => {}
        }
        drop(self.thread.commands);
        let thread_ends = async { while self.thread.outcomes.recv().await.is_some() {} };
        // A thread that takes longer is not awaited.
        let _ = tokio::time::timeout(self.settings.timeout, thread_ends).await;
        Ok(())
    }

    /// Puts the successor in the place of the model; true if it was ready. Call it between two runs. The former model is
    /// dropped on its own thread.
    fn promote_successor(&mut self) -> bool {
        let ready = self.successor.take_if(|successor| successor.provider.is_some());
        let Some(Successor {
            thread,
            begun,
            provider: Some(provider),
            ..
        }) = ready
        else {
            return false;
        };
        let former = self.provider.as_str();
        self.thread = thread;
        self.provider = provider;
        info!(
            worker = self.settings.name,
            former,
            provider = provider.as_str(),
            took_s = begun.elapsed().as_secs(),
            "the model runs on the provider that was being built"
        );
        self.open(ModelStatus::Ready { provider });
        true
    }

    /// Takes note of what a successor told; gives it up if it cannot be used.
    fn hear_of_successor(&mut self, told: Told<M>) {
        let worker = self.settings.name;
        let provider = self.provider.as_str();
        let Some(successor) = &mut self.successor else {
            return;
        };
        let seconds = successor.begun.elapsed().as_secs();
        if let Told::Outcome(_) = told {
            self.building.send_replace(None);
        }
        let reason = match told {
            Told::Still => {
                successor.patience *= 2;
                info!(
                    worker,
                    seconds, provider, "still building, this provider answers meanwhile"
                );
                return;
            }
            Told::Outcome(Some(Outcome::Built(Ok((its_provider, facts))))) => {
                if self.facts.as_ref() == Some(&facts) {
                    successor.provider = Some(its_provider);
                    return;
                }
                "it has other classes or another input; restart the program to use the new file"
                    .to_owned()
            }
            Told::Outcome(Some(Outcome::Built(Err(error)))) => error.to_string(),
            Told::Outcome(Some(Outcome::Ran(_)) | None) => "its thread is gone".to_owned(),
        };
        self.successor = None;
        error!(
            worker,
            provider, reason, "the build failed, and this provider goes on"
        );
    }

    /// Waits for the next event, at `time` at the latest. Queues or refuses a request that arrives, and takes note of
    /// what a successor tells.
    ///
    /// # Errors
    /// If the worker should stop, which is reported once, or if its thread has ended.
    async fn event(&mut self, time: Option<Instant>) -> Result<Event<M>, End> {
        tokio::select! {
            biased;
            () = self.stop.cancelled(), if !self.is_stopping => {
                self.close();
                Err(End::Stopped)
            }
            outcome = self.thread.outcomes.recv() => match outcome {
                Some(outcome) => Ok(Event::Outcome(outcome)),
                None => Err(self.stuck("is gone".to_owned())),
            },
            Some(request) = self.requests.recv() => {
                self.take(request);
                Ok(Event::Request)
            }
            () = self.queue.coming.called_off() => Ok(Event::CalledOff),
            told = told_by(&mut self.successor) => {
                self.hear_of_successor(told);
                Ok(Event::Successor)
            }
            () = sleep_until(time.unwrap_or_else(Instant::now)), if time.is_some() => Ok(Event::Time),
        }
    }

    /// Queues or refuses a request.
    fn take(&mut self, request: Request<M::Input, M::Output>) {
        match self.refusal() {
            None => self.queue.push(request),
            Some(refusal) => self.refuse([request], &refusal),
        }
        self.count_waiting();
    }

    /// The immediate answer to every request while no session can accept pictures.
    fn refusal(&self) -> Option<RunError> {
        if self.is_stopping {
            return Some(RunError::Stopped);
        }
        self.status.borrow().refusal()
    }

    /// Waits until the next run may begin.
    async fn next_batch(&mut self) -> Result<(), End> {
        loop {
            self.promote_successor();
            // What has come together runs together.
            while let Ok(request) = self.requests.try_recv() {
                self.take(request);
            }
            let cancelled = self.queue.drop_cancelled() as u64;
            self.meter.update(|counts| counts.cancelled += cancelled);
            self.count_waiting();
            let begins_at = self.queue.begins_at();
            self.idle.send_replace(begins_at.is_none());
            if begins_at.is_some_and(|time| time <= Instant::now()) {
                return Ok(());
            }
            self.event(begins_at).await?;
        }
    }

    /// Runs the next pictures and answers them, at their deadline at the latest; returns true if the session must be
    /// rebuilt.
    async fn run_batch(&mut self) -> Result<bool, End> {
        let started = Instant::now();
        let batch = self.queue.take_batch();
        self.count_waiting();
        let is_spare = batch.iter().all(|request| request.asker.is_none());
        let mut inputs = Vec::with_capacity(batch.len());
        let mut waiting = Vec::with_capacity(batch.len());
        for request in batch {
            inputs.push(request.picture);
            waiting.push(Waiting {
                reply: request.reply,
                requested_at: request.requested_at,
            });
        }
        // If the thread is gone, `event` reports it below.
        let _ = self.thread.commands.send(Command::Run(inputs));
        let result = self.result_of_run(started, &mut waiting).await?;
        let took = started.elapsed();
        self.queue.ran(took);
        let pictures = u32::try_from(waiting.len()).unwrap_or(u32::MAX);
        let must_rebuild = match &result {
            Ok(_) => {
                self.ran_well(pictures, is_spare);
                false
            }
            Err(error) => self.failed(error),
        };
        let mut outputs = result.map(Vec::into_iter);
        for caller in waiting {
            let output = match &mut outputs {
                // The thread ensures one output per picture.
                Ok(outputs) => outputs.next().ok_or(RunError::Stopped),
                Err(error) => Err(error.clone()),
            };
            let answer = output.map(|output| Answer {
                output,
                queued: started.saturating_duration_since(caller.requested_at),
                took,
                pictures,
            });
            // The caller may have given up.
            let _ = caller.reply.send(answer);
        }
        if self.is_stopping {
            return Err(End::Stopped);
        }
        Ok(must_rebuild)
    }

    /// Waits for the run in progress, which began at `started`. If it exceeds its deadline, those who are waiting get the
    /// error, and nobody is waiting any more when it comes back.
    async fn result_of_run(
        &mut self,
        started: Instant,
        waiting: &mut Vec<Waiting<M::Output>>,
    ) -> Result<Result<Vec<M::Output>, RunError>, End> {
        let mut is_late = false;
        let mut limit = started + self.settings.timeout;
        loop {
            match self.event(Some(limit)).await {
                Ok(Event::Outcome(Outcome::Ran(result))) => {
                    if is_late {
                        info!(
                            worker = self.settings.name,
                            took_ms = started.elapsed().as_millis(),
                            "the run that took too long has come back"
                        );
                    }
                    return Ok(result);
                }
                Ok(
                    Event::Outcome(Outcome::Built(_))
                    | Event::Request
                    | Event::CalledOff
                    | Event::Successor,
                ) => {}
                Ok(Event::Time) if is_late => {
                    let seconds = started.elapsed().as_secs();
                    return Err(self.stuck(format!("has not come back for {seconds} s")));
                }
                Ok(Event::Time) => {
                    is_late = true;
                    self.too_late(std::mem::take(waiting));
                    if self.is_stopping {
                        return Err(End::StoppedLate);
                    }
                    limit += STUCK_AFTER;
                }
                Err(End::Stopped) if is_late => return Err(End::StoppedLate),
                // The run in progress may still end in time.
                Err(End::Stopped) => {}
                Err(stuck) => return Err(stuck),
            }
        }
    }

    /// Counts and reports a successful run. The pictures of a run that returned too late do not count.
    fn ran_well(&mut self, pictures: u32, is_spare: bool) {
        self.open(ModelStatus::Ready {
            provider: self.provider,
        });
        self.meter.update(|counts| {
            if is_spare {
                counts.spare += u64::from(pictures);
            } else {
                counts.completed += u64::from(pictures);
                if pictures > 0 {
                    counts.batches += 1;
                }
            }
        });
    }

    /// Answers the callers of a run that exceeds its deadline, and refuses others until the run has come back.
    fn too_late(&mut self, waiting: Vec<Waiting<M::Output>>) {
        let timeout = self.settings.timeout.as_millis();
        warn!(
            worker = self.settings.name,
            timeout_ms = timeout,
            "a run takes too long"
        );
        self.meter.update(|counts| counts.timed_out += 1);
        let error = RunError::TimedOut {
            timeout_ms: u64::try_from(timeout).unwrap_or(u64::MAX),
        };
        self.degraded(error.to_string());
        for caller in waiting {
            let _ = caller.reply.send(Err(error.clone()));
        }
    }

    /// Counts and reports a failed run; returns true if the session must be rebuilt.
    fn failed(&mut self, error: &RunError) -> bool {
        let reason = error.to_string();
        self.meter.update(|counts| match error {
            RunError::Panicked(_) => counts.panicked += 1,
            _ => counts.failed += 1,
        });
        if let RunError::Implausible(_) = error {
            self.open(ModelStatus::Implausible {
                reason,
                provider: self.provider,
            });
            return false;
        }
        warn!(
            worker = self.settings.name,
            reason, "the session will be rebuilt"
        );
        self.degraded(reason);
        true
    }

    /// Builds a new session after `pause`, which doubles with each attempt, and retries until one works. A successor
    /// that is ready takes its place.
    async fn rebuild(&mut self, pause: &mut Duration) -> Result<(), End> {
        loop {
            let over = Instant::now() + *pause;
            *pause = (*pause * 2).min(LONGEST_PAUSE);
            while Instant::now() < over {
                self.event(Some(over)).await?;
            }
            if self.promote_successor() {
                return Ok(());
            }
            self.meter.update(|counts| counts.rebuilds += 1);
            let Err(error) = self.build().await? else {
                info!(worker = self.settings.name, "the session has been rebuilt");
                return Ok(());
            };
            let reason = error.to_string();
            error!(
                worker = self.settings.name,
                reason, "the session could not be rebuilt"
            );
            self.meter.update(|counts| counts.rebuilds_failed += 1);
            if fault::device_is_lost(&reason) {
                let provider = self.provider;
                self.refuse_with(ModelStatus::Lost { reason, provider });
            } else {
                self.degraded(reason);
            }
        }
    }

    /// Builds the model on the thread, and accepts pictures if that succeeds.
    async fn build(&mut self) -> Result<Result<M::Facts, StartError>, End> {
        // If the thread is gone, `event` reports it below.
        let _ = self.thread.commands.send(Command::Build);
        let begun = Instant::now();
        let mut patience = STILL_BUILDING;
        loop {
            match self.event(Some(begun + patience)).await? {
                Event::Outcome(Outcome::Built(Ok((provider, facts)))) => {
                    self.provider = provider;
                    if self.facts.is_none() {
                        self.facts = Some(facts.clone());
                    }
                    self.open(ModelStatus::Ready { provider });
                    return Ok(Ok(facts));
                }
                Event::Outcome(Outcome::Built(Err(error))) => return Ok(Err(error)),
                Event::Outcome(Outcome::Ran(_))
                | Event::Request
                | Event::CalledOff
                | Event::Successor => {}
                Event::Time => {
                    warn!(
                        worker = self.settings.name,
                        seconds = patience.as_secs(),
                        "the model is still being loaded and run for the first time"
                    );
                    patience *= 2;
                }
            }
        }
    }

    /// Accepts pictures from now on, unless the worker is stopping.
    fn open(&mut self, status: ModelStatus) {
        if !self.is_stopping {
            self.status.send_if_modified(|now| {
                let changed = *now != status;
                *now = status;
                changed
            });
        }
    }

    /// Refuses pictures from now on for this reason, until a run succeeds or the model is rebuilt.
    fn degraded(&mut self, reason: String) {
        let provider = self.provider;
        self.refuse_with(ModelStatus::Degraded { reason, provider });
    }

    /// Refuses pictures from now on with this status, unless the worker is stopping. Sets the status first, so that a
    /// caller that gets the error already sees it.
    fn refuse_with(&mut self, status: ModelStatus) {
        if self.is_stopping {
            return;
        }
        self.status.send_replace(status);
        self.refuse_waiting();
    }

    /// Refuses all waiting and all later requests: the worker stops.
    fn close(&mut self) {
        self.is_stopping = true;
        self.refuse_waiting();
    }

    fn refuse_waiting(&mut self) {
        let waiting = self.queue.take_all();
        if let Some(refusal) = self.refusal() {
            self.refuse(waiting, &refusal);
        }
        self.count_waiting();
    }

    fn refuse(
        &self,
        requests: impl IntoIterator<Item = Request<M::Input, M::Output>>,
        error: &RunError,
    ) {
        for request in requests {
            if request.asker.is_some() {
                self.meter.update(|counts| counts.refused += 1);
            }
            let _ = request.reply.send(Err(error.clone()));
        }
    }

    fn count_waiting(&self) {
        let waiting = self.queue.waiting() as u64;
        self.meter.update(|counts| counts.waiting = waiting);
    }

    /// Reports a thread that cannot be repaired, in the log and in the status; returns the end of the worker.
    fn stuck(&mut self, how: String) -> End {
        let name = self.settings.name;
        let reason = format!("the thread of the {name} {how}; only restarting the program helps");
        error!(worker = name, "{reason}");
        self.degraded(reason.clone());
        End::Stuck(reason)
    }
}

/// Who waits for the answer to a picture of the run in progress.
struct Waiting<T> {
    reply: oneshot::Sender<Result<Answer<T>, RunError>>,
    requested_at: Instant,
}
