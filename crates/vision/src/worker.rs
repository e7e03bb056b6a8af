//! One model on its own thread, shared by all cameras: a queue, a thread, and a deadline per run.
//!
//! A task owns all mutable state: it receives requests from a channel, hands the thread one batch at a time, and waits
//! for the outcome or the deadline. A run that exceeds its deadline is answered with an error at that time; nothing
//! else is accepted until the run comes back, and then the session goes on. After a failed run the session is rebuilt,
//! with growing pauses. A thread that has not come back [`STUCK_AFTER`] its deadline cannot be repaired within the
//! process: [`Worker::ended`] reports it.

mod counters;
mod error;
mod queue;
mod status;
#[cfg(test)]
mod tests;
mod thread;

pub use counters::{WorkerCounts, WorkerMeter};
pub use error::RunError;
pub use status::ModelStatus;

use crate::onnx::{ExecutionProvider, StartError, fault};
use albireo_core::geometry::PictureSize;
pub(crate) use queue::batch_sizes;
use queue::{Queue, Request};
use std::sync::Arc;
use std::time::Duration;
use thread::{Command, ModelThread, Outcome};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::{CancellationToken, DropGuard};
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
    /// only for those that are likely to come, and no longer than a run takes.
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

/// A handle to a running worker, which stops when its last handle is dropped.
pub(crate) struct Worker<I, T> {
    requests: mpsc::UnboundedSender<Request<I, T>>,
    /// The worker's status, updated as it changes.
    pub(crate) status: watch::Receiver<ModelStatus>,
    idle: watch::Receiver<bool>,
    /// The start of the build of a successor, until it has ended.
    pub(crate) building: watch::Receiver<Option<Instant>>,
    ended: watch::Receiver<Option<Result<(), String>>>,
    /// Counters for metrics; does not keep the worker running.
    pub(crate) meter: WorkerMeter,
    stop: Arc<(CancellationToken, DropGuard)>,
}

impl<I, T> Clone for Worker<I, T> {
    fn clone(&self) -> Self {
        Self {
            requests: self.requests.clone(),
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
    /// failure. Counts with `meter`. Needs a tokio runtime with timers.
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
        let mut task = Task {
            settings,
            thread,
            successor: None,
            facts: None,
            requests: received,
            queue: Queue::new(settings.batch_size, settings.batch_wait),
            is_stopping: false,
            provider: ExecutionProvider::Cpu,
            status,
            idle,
            building,
            meter: meter.clone(),
            stop: stop.clone(),
        };
        let guard = stop.clone().drop_guard();
        let worker = Self {
            requests,
            status: watched,
            idle: is_idle,
            building: is_building,
            ended,
            meter,
            stop: Arc::new((stop, guard)),
        };
        let built = task.build().await.unwrap_or_else(|end| {
            let reason = match end {
                End::Stuck(reason) => reason,
                End::Stopped | End::StoppedLate => "it was stopped".to_owned(),
            };
            Err(StartError::thread(settings.name, reason))
        });
        let facts = built?;
        if let Some(build) = successor {
            let successor = Successor::build(settings.name, build)?;
            task.building.send_replace(Some(successor.begun));
            task.successor = Some(successor);
        }
        tokio::spawn(async move {
            let served = task.serve().await;
            end.send_replace(Some(task.finish(served).await));
        });
        Ok((worker, facts))
    }

    /// Checks that a picture would be accepted now; counts a refusal.
    ///
    /// # Errors
    /// The error that [`run`](Self::run) would return at once.
    pub(crate) fn accepts(&self) -> Result<(), RunError> {
        if self.stop.0.is_cancelled() {
            return Err(RunError::Stopped);
        }
        let Some(refusal) = self.status.borrow().refusal() else {
            return Ok(());
        };
        self.meter.update(|counts| counts.refused += 1);
        Err(refusal)
    }

    /// Runs the model on the `picture` of an asker, or, without one, on a picture when no asker waits. Waits for its turn
    /// and for the run. When this returns `Ok`, the worker no longer holds the picture. May be cancelled at any time.
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
        idle.wait_for(|idle| *idle).await.ok().map(|_| ())
    }

    /// Accepts no more pictures, refuses those that wait, and returns when the run in progress has ended or exceeded
    /// its deadline. Safe to call more than once.
    pub(crate) async fn stop(&self) {
        self.stop.0.cancel();
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
    /// The time limit of the wait has come.
    Time,
}

/// A model that is built while another one answers.
struct Successor<M: Model> {
    thread: ModelThread<M>,
    begun: Instant,
    /// The time after which the log next reports that it is still being built.
    patience: Duration,
    /// What runs it, once it is ready.
    provider: Option<ExecutionProvider>,
}

impl<M: Model> Successor<M> {
    fn build(name: &'static str, build: Build<M>) -> Result<Self, StartError> {
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
enum Told<M: Model> {
    Outcome(Option<Outcome<M>>),
    /// It is still being built.
    Still,
}

/// What the `successor` tells next; never returns without one that is being built.
async fn told_by<M: Model>(successor: &mut Option<Successor<M>>) -> Told<M> {
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
            let has_failed = self.run_batch().await?;
            if has_failed {
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
        let limit = tokio::time::sleep(self.settings.timeout);
        tokio::select! {
            () = limit => {}
            () = async { while self.thread.outcomes.recv().await.is_some() {} } => {}
        }
        Ok(())
    }

    /// Puts the successor in the place of the model, if it is ready and no run is in progress. The former model is dropped
    /// on its own thread.
    fn succeed(&mut self) -> bool {
        let Some(ready) = self.successor.take_if(|successor| successor.provider.is_some()) else {
            return false;
        };
        let former = self.provider.as_str();
        self.thread = ready.thread;
        self.provider = ready.provider.unwrap_or(self.provider);
        let provider = self.provider;
        info!(
            worker = self.settings.name,
            former,
            provider = provider.as_str(),
            took_s = ready.begun.elapsed().as_secs(),
            "the model runs on the provider that was being built"
        );
        self.open(ModelStatus::Ready { provider });
        true
    }

    /// Takes note of what a successor told.
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
            Told::Outcome(Some(Outcome::Built(Ok((built, facts))))) => {
                if self.facts.as_ref() == Some(&facts) {
                    successor.provider = Some(built);
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

    /// Returns the next event, at `time` at the latest.
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

    /// Returns when the next run may begin.
    async fn next_batch(&mut self) -> Result<(), End> {
        loop {
            self.succeed();
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

    /// Runs the next pictures and answers them, at their deadline at the latest; returns true if the model is gone.
    async fn run_batch(&mut self) -> Result<bool, End> {
        let started = Instant::now();
        let batch = self.queue.take_batch();
        self.count_waiting();
        let is_spare = batch.iter().all(|request| request.asker.is_none());
        let (pictures, waiting): (Vec<_>, Vec<_>) = batch
            .into_iter()
            .map(|request| (request.picture, (request.reply, request.requested_at)))
            .unzip();
        // If the thread is gone, `event` reports it below.
        let _ = self.thread.commands.send(Command::Run(pictures));
        // None once the askers got the timeout error.
        let mut waiting = Some(waiting);
        let mut deadline = started + self.settings.timeout;
        let result = loop {
            match self.event(Some(deadline)).await {
                Ok(Event::Outcome(Outcome::Ran(result))) => break result,
                Ok(Event::Outcome(Outcome::Built(_)) | Event::Request | Event::Successor) => {}
                // The run in progress may still end in time.
                Err(End::Stopped) if waiting.is_some() => {}
                Err(End::Stopped) => return Err(End::StoppedLate),
                Ok(Event::Time) => {
                    let Some(waiting) = waiting.take() else {
                        let seconds = started.elapsed().as_secs();
                        return Err(self.stuck(format!("has not come back for {seconds} s")));
                    };
                    self.too_late(waiting);
                    if self.is_stopping {
                        return Err(End::StoppedLate);
                    }
                    deadline += STUCK_AFTER;
                }
                Err(stuck) => return Err(stuck),
            }
        };
        let took = started.elapsed();
        self.queue.ran(took);
        if waiting.is_none() {
            info!(
                worker = self.settings.name,
                took_ms = took.as_millis(),
                "the run that took too long has come back"
            );
        }
        let waiting = waiting.unwrap_or_default();
        let pictures = u32::try_from(waiting.len()).unwrap_or(u32::MAX);
        let has_failed = match &result {
            Ok(_) => {
                self.ran_well(pictures, is_spare);
                false
            }
            Err(error) => self.failed(error),
        };
        let mut outputs = result.map(Vec::into_iter);
        for (reply, requested_at) in waiting {
            let answer = match &mut outputs {
                // The thread ensures one output per picture.
                Ok(outputs) => outputs.next().ok_or(RunError::Stopped),
                Err(error) => Err(error.clone()),
            };
            // The asker may have given up.
            let _ = reply.send(answer.map(|output| Answer {
                output,
                queued: started.saturating_duration_since(requested_at),
                took,
                pictures,
            }));
        }
        if self.is_stopping {
            return Err(End::Stopped);
        }
        Ok(has_failed)
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
                counts.batches += u64::from(pictures > 0);
            }
        });
    }

    /// Answers the askers of a run that exceeds its deadline, and refuses others until the run has come back.
    fn too_late(&mut self, waiting: Vec<Reply<M::Output>>) {
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
        self.degraded(error.to_string(), false);
        for (reply, _) in waiting {
            let _ = reply.send(Err(error.clone()));
        }
    }

    /// Counts and reports a failed run; returns true if the model is lost.
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
        self.degraded(reason, false);
        true
    }

    /// Builds a new session after `pause`, and retries until one works.
    async fn rebuild(&mut self, pause: &mut Duration) -> Result<(), End> {
        loop {
            let over = Instant::now() + *pause;
            *pause = (*pause * 2).min(LONGEST_PAUSE);
            while Instant::now() < over {
                self.event(Some(over)).await?;
            }
            if self.succeed() {
                return Ok(());
            }
            self.meter.update(|counts| counts.rebuilds += 1);
            let Err(reason) = self.build().await? else {
                info!(worker = self.settings.name, "the session has been rebuilt");
                return Ok(());
            };
            error!(worker = self.settings.name, %reason, "the session could not be rebuilt");
            self.meter.update(|counts| counts.rebuilds_failed += 1);
            let reason = reason.to_string();
            let lost = fault::device_is_lost(&reason);
            self.degraded(reason, lost);
        }
    }

    /// Builds the model on the thread.
    async fn build(&mut self) -> Result<Result<M::Facts, StartError>, End> {
        // If the thread is gone, `event` reports it below.
        let _ = self.thread.commands.send(Command::Build);
        let begun = Instant::now();
        let mut patience = STILL_BUILDING;
        loop {
            match self.event(Some(begun + patience)).await? {
                Event::Outcome(Outcome::Built(built)) => {
                    return Ok(built.map(|(provider, facts)| {
                        self.provider = provider;
                        self.facts.get_or_insert_with(|| facts.clone());
                        self.open(ModelStatus::Ready { provider });
                        facts
                    }));
                }
                Event::Outcome(Outcome::Ran(_)) | Event::Request | Event::Successor => {}
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

    /// Refuses pictures from now on for this reason, unless the worker is stopping. Sets the status first, so that a
    /// caller that gets the error already sees it.
    fn degraded(&mut self, reason: String, lost: bool) {
        if self.is_stopping {
            return;
        }
        let provider = self.provider;
        self.status.send_replace(if lost {
            ModelStatus::Lost { reason, provider }
        } else {
            ModelStatus::Degraded { reason, provider }
        });
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
            self.meter.update(|counts| counts.refused += u64::from(request.asker.is_some()));
            let _ = request.reply.send(Err(error.clone()));
        }
    }

    fn count_waiting(&self) {
        let waiting = self.queue.waiting() as u64;
        self.meter.update(|counts| counts.waiting = waiting);
    }

    fn stuck(&mut self, how: String) -> End {
        let name = self.settings.name;
        let reason = format!("the thread of the {name} {how}; only restarting the program helps");
        error!(worker = name, "{reason}");
        self.degraded(reason.clone(), false);
        End::Stuck(reason)
    }
}

/// The channel for the answer to a request, and the time of the request.
type Reply<T> = (oneshot::Sender<Result<Answer<T>, RunError>>, Instant);
