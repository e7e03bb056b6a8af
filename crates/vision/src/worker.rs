//! One model on its own thread, shared by all cameras: a queue, a thread, and a deadline for each run.
//!
//! A task owns everything that changes: it takes requests from a channel, hands the thread one batch at a time, and
//! waits for what comes back or for the deadline. A run that exceeds its deadline is answered with an error then; until
//! it comes back nothing else is accepted, and then the session goes on. After a run that failed the session is built
//! again, with growing pauses. A thread that is not back [`STUCK_AFTER`] its deadline cannot be repaired within the
//! process: [`Worker::ended`] says so.

mod counters;
mod queue;
#[cfg(test)]
mod tests;
mod thread;

pub use counters::{WorkerCounts, WorkerMeter};

use crate::detector::{
    CameraSlot, DetectorStatus, ExecutionProvider, InferenceError, StartError, fault,
};
use queue::{Queue, Request};
use std::sync::Arc;
use std::time::Duration;
use thread::{Command, ModelThread, Outcome};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::{CancellationToken, DropGuard};
use tracing::{error, info, warn};

/// From a failure to the first attempt to build a new session; doubles with each failure until a run ends well.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

/// The longest of these pauses.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// How long after its deadline a run is waited for before its thread counts as stuck.
const STUCK_AFTER: Duration = Duration::from_secs(30);

/// When the log first says that a model is still being built; then after twice that time, and so on. There is no limit:
/// TensorRT builds engines for minutes.
const STILL_BUILDING: Duration = Duration::from_secs(10);

/// Something that answers pictures, built and used on one thread.
pub(crate) trait Model: 'static {
    /// A picture as it takes it.
    type Input: Send + 'static;
    /// What it finds in a picture.
    type Output: Send + 'static;
    /// What its users rely on as long as the program runs: a model that is built again must have the same.
    type Facts: Clone + PartialEq + Send + 'static;

    /// What its users rely on.
    fn facts(&self) -> Self::Facts;

    /// Answers pictures, at least one and at most the batch size of its worker: one output for each, in their order.
    /// Blocks.
    ///
    /// # Errors
    /// When the run failed.
    fn run(&mut self, pictures: &[Self::Input]) -> Result<Vec<Self::Output>, InferenceError>;

    /// What runs it.
    fn provider(&self) -> ExecutionProvider;
}

/// How a worker behaves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WorkerSettings {
    /// What it is called in logs; also the name of its thread.
    pub(crate) name: &'static str,
    /// The longest a run may take.
    pub(crate) timeout: Duration,
    /// The most pictures of a run, each of another camera.
    pub(crate) batch_size: usize,
    /// How long a picture waits for those of other cameras to share its run, from being asked.
    pub(crate) batch_wait: Duration,
}

/// An answered picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Answer<T> {
    /// What the model found.
    pub(crate) output: T,
    /// From being asked to the start of the run.
    pub(crate) queued: Duration,
    /// From the start of the run to its end.
    pub(crate) took: Duration,
    /// How many pictures the run looked at: this one's part of it is `took` divided by their number.
    pub(crate) pictures: u32,
}

/// A handle to a running worker, which stops when its last handle is dropped.
pub(crate) struct Worker<I, T> {
    requests: mpsc::UnboundedSender<Request<I, T>>,
    /// How the worker is doing, now and from now on.
    pub(crate) status: watch::Receiver<DetectorStatus>,
    idle: watch::Receiver<bool>,
    ended: watch::Receiver<Option<Result<(), String>>>,
    /// Its counters for metrics: does not keep the worker running.
    pub(crate) meter: WorkerMeter,
    stop: Arc<(CancellationToken, DropGuard)>,
}

impl<I, T> Clone for Worker<I, T> {
    fn clone(&self) -> Self {
        Self {
            requests: self.requests.clone(),
            status: self.status.clone(),
            idle: self.idle.clone(),
            ended: self.ended.clone(),
            meter: self.meter.clone(),
            stop: Arc::clone(&self.stop),
        }
    }
}

impl<I: Send + 'static, T: Send + 'static> Worker<I, T> {
    /// Builds the model on its thread and waits for it; also says what its users may rely on. `build` is called again
    /// after each failure. Needs a tokio runtime with timers.
    ///
    /// # Errors
    /// When the first model cannot be built.
    pub(crate) async fn start<M: Model<Input = I, Output = T>>(
        settings: WorkerSettings,
        build: impl Fn() -> Result<M, StartError> + Send + 'static,
    ) -> Result<(Self, M::Facts), StartError> {
        let thread =
            ModelThread::spawn(settings.name, build).map_err(|error| StartError::Thread {
                task: settings.name,
                reason: error.to_string(),
            })?;
        let (requests, received) = mpsc::unbounded_channel();
        let (status, watched) = watch::channel(DetectorStatus::Starting);
        let (idle, is_idle) = watch::channel(false);
        let (end, ended) = watch::channel(None);
        let meter = WorkerMeter::default();
        let stop = CancellationToken::new();
        let mut task = Task {
            settings,
            thread,
            requests: received,
            queue: Queue::new(settings.batch_size, settings.batch_wait),
            is_stopping: false,
            provider: ExecutionProvider::Cpu,
            status,
            idle,
            meter: meter.clone(),
            stop: stop.clone(),
        };
        let guard = stop.clone().drop_guard();
        let worker = Self {
            requests,
            status: watched,
            idle: is_idle,
            ended,
            meter,
            stop: Arc::new((stop, guard)),
        };
        let built = task.build().await.unwrap_or_else(|end| {
            Err(StartError::Thread {
                task: settings.name,
                reason: match end {
                    End::Stuck(reason) => reason,
                    End::Stopped | End::StoppedLate => "it was stopped".to_owned(),
                },
            })
        });
        let facts = built?;
        tokio::spawn(async move {
            let served = task.serve().await;
            end.send_replace(Some(task.finish(served).await));
        });
        Ok((worker, facts))
    }

    /// Whether a picture would be taken now; a refusal is counted.
    ///
    /// # Errors
    /// What [`run`](Self::run) would answer at once.
    pub(crate) fn accepts(&self) -> Result<(), InferenceError> {
        if self.stop.0.is_cancelled() {
            return Err(InferenceError::Stopped);
        }
        let Some(refusal) = self.status.borrow().refusal() else {
            return Ok(());
        };
        self.meter.update(|counts| counts.refused += 1);
        Err(refusal)
    }

    /// Has a camera's `picture` answered. Waits for its turn and for the run. When this returns `Ok`, the worker no
    /// longer holds the picture.
    ///
    /// # Errors
    /// See [`InferenceError`]; a run that takes too long is answered at its deadline, not later.
    pub(crate) async fn run(
        &self,
        camera: CameraSlot,
        picture: I,
    ) -> Result<Answer<T>, InferenceError> {
        self.ask(Some(camera), picture).await
    }

    /// Has `picture` answered when no camera waits. May be given up at any time.
    ///
    /// # Errors
    /// As of [`run`](Self::run).
    pub(crate) async fn run_spare(&self, picture: I) -> Result<Answer<T>, InferenceError> {
        self.ask(None, picture).await
    }

    async fn ask(
        &self,
        camera: Option<CameraSlot>,
        picture: I,
    ) -> Result<Answer<T>, InferenceError> {
        let (reply, answer) = oneshot::channel();
        let request = Request {
            camera,
            picture,
            requested_at: Instant::now(),
            reply,
        };
        let sent = self.requests.send(request);
        sent.map_err(|_| InferenceError::Stopped)?;
        answer.await.unwrap_or(Err(InferenceError::Stopped))
    }

    /// Returns when the model has nothing to do; `None` once the worker has been stopped.
    pub(crate) async fn idle(&self) -> Option<()> {
        let mut idle = self.idle.clone();
        idle.wait_for(|idle| *idle).await.ok().map(|_| ())
    }

    /// Takes no more pictures, turns away those that wait, and returns when the run in progress has ended or has taken
    /// too long. Safe to call more than once.
    pub(crate) async fn stop(&self) {
        self.stop.0.cancel();
        // A stuck thread is handled by the supervisor.
        let _ = self.ended().await;
    }

    /// Returns when it has been stopped.
    ///
    /// # Errors
    /// When its thread is stuck: only a new process helps.
    pub(crate) async fn ended(&self) -> Result<(), String> {
        let mut ended = self.ended.clone();
        match ended.wait_for(Option::is_some).await {
            Ok(end) => end.clone().unwrap_or(Ok(())),
            Err(_) => Err("its task is gone".to_owned()),
        }
    }
}

/// Why a worker serves no longer.
enum End {
    Stopped,
    /// Stopped during a run that exceeds its deadline and is not waited for.
    StoppedLate,
    Stuck(String),
}

/// What a task waits for.
enum Event<M: Model> {
    /// A request came and was queued or refused.
    Request,
    /// The thread has finished its job.
    Outcome(Outcome<M>),
    /// The time has come.
    Time,
}

/// Everything that changes, owned by one task.
struct Task<M: Model> {
    settings: WorkerSettings,
    thread: ModelThread<M>,
    requests: mpsc::UnboundedReceiver<Request<M::Input, M::Output>>,
    queue: Queue<M::Input, M::Output>,
    /// Whether every request is refused, since the worker was stopped.
    is_stopping: bool,
    provider: ExecutionProvider,
    status: watch::Sender<DetectorStatus>,
    idle: watch::Sender<bool>,
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

    /// After the last run: waits until the thread has dropped its model, at most as long as a run may take.
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

    /// The next thing that happens, at the latest at `time`.
    ///
    /// # Errors
    /// When the worker should stop, which is reported once, or its thread has ended.
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
                match self.refusal() {
                    None => self.queue.push(request),
                    Some(refusal) => self.refuse([request], &refusal),
                }
                self.count_waiting();
                Ok(Event::Request)
            }
            () = sleep_until(time.unwrap_or_else(Instant::now)), if time.is_some() => Ok(Event::Time),
        }
    }

    /// The immediate answer to every request while no session can take pictures.
    fn refusal(&self) -> Option<InferenceError> {
        match self.is_stopping {
            true => Some(InferenceError::Stopped),
            false => self.status.borrow().refusal(),
        }
    }

    /// Returns when the next run may begin.
    async fn next_batch(&mut self) -> Result<(), End> {
        loop {
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

    /// Runs the next pictures and answers them, at their deadline at the latest; says whether the model is gone.
    async fn run_batch(&mut self) -> Result<bool, End> {
        let started = Instant::now();
        let batch = self.queue.take_batch();
        self.count_waiting();
        let is_spare = batch.iter().all(|request| request.camera.is_none());
        let (pictures, waiting): (Vec<_>, Vec<_>) = batch
            .into_iter()
            .map(|request| (request.picture, (request.reply, request.requested_at)))
            .unzip();
        // A thread that is gone is found out below.
        let _ = self.thread.commands.send(Command::Run(pictures));
        // None once they have been answered that the run takes too long.
        let mut waiting = Some(waiting);
        let mut deadline = started + self.settings.timeout;
        let result = loop {
            match self.event(Some(deadline)).await {
                Ok(Event::Outcome(Outcome::Ran(result))) => break result,
                Ok(Event::Outcome(Outcome::Built(_)) | Event::Request) => {}
                // The run in progress is waited for.
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
                // The thread has seen to it that there is an output for each.
                Ok(outputs) => outputs.next().ok_or(InferenceError::Stopped),
                Err(error) => Err(error.clone()),
            };
            // The asker may have gone; that is its right.
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

    /// Counts and reports a run that ended well. The pictures of a run that returned too late do not count.
    fn ran_well(&mut self, pictures: u32, is_spare: bool) {
        self.open(DetectorStatus::Ready {
            provider: self.provider,
        });
        self.meter.update(|counts| match is_spare {
            true => counts.spare += u64::from(pictures),
            false => {
                counts.completed += u64::from(pictures);
                counts.batches += u64::from(pictures > 0);
            }
        });
    }

    /// Answers those who wait for a run that exceeds its deadline, and refuses others until it has come back.
    fn too_late(&mut self, waiting: Vec<Asker<M::Output>>) {
        let timeout = self.settings.timeout.as_millis();
        warn!(
            worker = self.settings.name,
            timeout_ms = timeout,
            "a run takes too long"
        );
        self.meter.update(|counts| counts.timed_out += 1);
        let error = InferenceError::TimedOut {
            timeout_ms: u64::try_from(timeout).unwrap_or(u64::MAX),
        };
        self.degraded(error.to_string(), false);
        for (reply, _) in waiting {
            let _ = reply.send(Err(error.clone()));
        }
    }

    /// Counts and reports a run that failed; returns whether the model is lost.
    fn failed(&mut self, error: &InferenceError) -> bool {
        let reason = error.to_string();
        self.meter.update(|counts| match error {
            InferenceError::Panicked(_) => counts.panicked += 1,
            _ => counts.failed += 1,
        });
        if let InferenceError::Implausible(_) = error {
            self.open(DetectorStatus::Implausible {
                reason,
                provider: self.provider,
            });
            return false;
        }
        warn!(
            worker = self.settings.name,
            reason, "the session will be built again"
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
            self.meter.update(|counts| counts.rebuilds += 1);
            let Err(reason) = self.build().await? else {
                info!(
                    worker = self.settings.name,
                    "the session has been built again"
                );
                return Ok(());
            };
            error!(worker = self.settings.name, %reason, "the session could not be built again");
            self.meter.update(|counts| counts.rebuilds_failed += 1);
            let reason = reason.to_string();
            let lost = fault::device_is_lost(&reason);
            self.degraded(reason, lost);
        }
    }

    /// Has the thread build the model.
    async fn build(&mut self) -> Result<Result<M::Facts, StartError>, End> {
        // A thread that is gone is found out below.
        let _ = self.thread.commands.send(Command::Build);
        let (begun, mut patience) = (Instant::now(), STILL_BUILDING);
        loop {
            match self.event(Some(begun + patience)).await? {
                Event::Outcome(Outcome::Built(built)) => {
                    return Ok(built.map(|(provider, facts)| {
                        self.provider = provider;
                        self.open(DetectorStatus::Ready { provider });
                        facts
                    }));
                }
                Event::Outcome(Outcome::Ran(_)) | Event::Request => {}
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

    /// From now on pictures are taken, unless the worker is stopping.
    fn open(&mut self, status: DetectorStatus) {
        if !self.is_stopping {
            self.status.send_if_modified(|now| {
                let changed = *now != status;
                *now = status;
                changed
            });
        }
    }

    /// From now on pictures are refused for this reason, unless the worker is stopping. The status says so first, so
    /// that it is set when a caller gets the error.
    fn degraded(&mut self, reason: String, lost: bool) {
        if self.is_stopping {
            return;
        }
        let provider = self.provider;
        self.status.send_replace(match lost {
            true => DetectorStatus::Lost { reason, provider },
            false => DetectorStatus::Degraded { reason, provider },
        });
        self.refuse_waiting();
    }

    /// Refuses all waiting requests and all later ones: the worker stops.
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
        error: &InferenceError,
    ) {
        for request in requests {
            self.meter
                .update(|counts| counts.refused += u64::from(request.camera.is_some()));
            let _ = request.reply.send(Err(error.clone()));
        }
    }

    fn count_waiting(&self) {
        let waiting = self.queue.waiting() as u64;
        self.meter.update(|counts| counts.waiting = waiting);
    }

    fn stuck(&mut self, how: String) -> End {
        let name = self.settings.name;
        let reason =
            format!("the thread of the {name} {how}; only a new start of the program helps");
        error!(worker = name, "{reason}");
        self.degraded(reason.clone(), false);
        End::Stuck(reason)
    }
}

/// A request that waits for an answer, and since when.
type Asker<T> = (oneshot::Sender<Result<Answer<T>, InferenceError>>, Instant);
