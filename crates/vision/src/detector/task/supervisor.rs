//! Watches the worker: gives a run up that takes too long, and builds a new model after a failure, each time
//! waiting longer.

use super::counters::Counters;
use super::state::TaskState;
use super::worker::{self, Event};
use super::{Factory, TaskSettings};
use crate::detector::StartError;
use crate::detector::fault;
use crate::detector::model::{Interrupter, Model};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{error, info, warn};

/// When it is first said that a model is still being built; then after twice that time, and so on. There is no
/// limit: TensorRT builds engines for minutes.
const STILL_BUILDING: Duration = Duration::from_secs(10);

pub(super) struct Supervisor<M: Model> {
    settings: TaskSettings,
    factory: Arc<Factory<M>>,
    shared: Arc<TaskState<M::Input, M::Output>>,
    stop: CancellationToken,
    events: mpsc::UnboundedReceiver<(u64, Event)>,
    tell: mpsc::UnboundedSender<(u64, Event)>,
    /// The worker whose events count.
    worker: u64,
    /// Whether that worker's thread still lives.
    alive: bool,
    interrupter: Option<Interrupter>,
    /// Workers that still hang in a run that was given up.
    abandoned: BTreeSet<u64>,
}

/// Why a period of the supervisor's life ended.
enum End {
    /// The task was stopped.
    Stopped,
    /// The model is gone or could not be built.
    Failed,
}

impl<M: Model> Supervisor<M> {
    pub(super) fn new(
        settings: TaskSettings,
        factory: Arc<Factory<M>>,
        shared: Arc<TaskState<M::Input, M::Output>>,
        stop: CancellationToken,
    ) -> Self {
        let (tell, events) = mpsc::unbounded_channel();
        Self {
            settings,
            factory,
            shared,
            stop,
            events,
            tell,
            worker: 0,
            alive: false,
            interrupter: None,
            abandoned: BTreeSet::new(),
        }
    }

    /// Builds the first model, answers `started` with how that went, and keeps the task going until it is
    /// stopped. `stopped` becomes true when the run in hand has ended.
    pub(super) async fn run(
        mut self,
        started: oneshot::Sender<Result<(), StartError>>,
        stopped: watch::Sender<bool>,
    ) {
        let first = match self.build().await {
            Some(Ok(())) => Ok(()),
            Some(Err(error)) => Err(error),
            None => {
                stopped.send_replace(true);
                return;
            }
        };
        let begun = first.is_ok();
        let _ = started.send(first);
        if begun {
            self.keep_going().await;
            self.finish().await;
        }
        stopped.send_replace(true);
    }

    async fn keep_going(&mut self) {
        let mut pause = self.settings.first_pause;
        loop {
            let completed = self.completed();
            if let End::Stopped = self.watch_runs().await {
                return;
            }
            if self.completed() > completed {
                pause = self.settings.first_pause;
            }
            // Until a new model stands.
            loop {
                if let End::Stopped = self.pause(pause).await {
                    return;
                }
                pause = (pause * 2).min(self.settings.longest_pause);
                Counters::add(&self.shared.counters.rebuilds);
                match self.build().await {
                    Some(Ok(())) => {
                        info!(task = self.settings.name, "the session has been rebuilt");
                        break;
                    }
                    Some(Err(reason)) => {
                        Counters::add(&self.shared.counters.rebuilds_failed);
                        error!(task = self.settings.name, %reason, "the session could not be rebuilt");
                        let reason = reason.to_string();
                        let lost = fault::device_is_lost(&reason);
                        self.shared.still_degraded(reason, lost);
                    }
                    None => return,
                }
            }
        }
    }

    fn completed(&self) -> u64 {
        self.shared.counters.completed.load(Ordering::Relaxed)
    }

    fn count_abandoned(&self) {
        let threads = self.abandoned.len() as u64;
        self.shared
            .counters
            .abandoned
            .store(threads, Ordering::Relaxed);
    }

    /// Starts a worker and waits for its model; `None` when the task was stopped meanwhile.
    async fn build(&mut self) -> Option<Result<(), StartError>> {
        self.worker = self.shared.next_generation();
        let spawned = worker::spawn(
            self.settings.name,
            self.worker,
            self.factory.clone(),
            self.shared.clone(),
            self.tell.clone(),
        );
        if let Err(error) = spawned {
            return Some(Err(StartError::Thread {
                task: self.settings.name,
                reason: error.to_string(),
            }));
        }
        self.alive = true;
        let stop = self.stop.clone();
        let begun = Instant::now();
        let mut patience = STILL_BUILDING;
        loop {
            let event = tokio::select! {
                biased;
                () = stop.cancelled() => return None,
                event = self.next_event() => event,
                () = sleep_until(begun + patience) => {
                    warn!(
                        task = self.settings.name,
                        seconds = patience.as_secs(),
                        "the model is still being loaded and run for the first time"
                    );
                    patience *= 2;
                    continue;
                }
            };
            match event {
                Some(Event::Built {
                    provider,
                    interrupter,
                }) => {
                    self.interrupter = interrupter;
                    self.shared.ready(provider);
                    return Some(Ok(()));
                }
                Some(Event::BuildFailed(error)) => return Some(Err(error)),
                Some(Event::RunFailed(_)) | None => {}
                Some(Event::Ended) => {
                    return Some(Err(StartError::Thread {
                        task: self.settings.name,
                        reason: "it ended without a word".to_owned(),
                    }));
                }
            }
        }
    }

    /// Until the task is stopped or a run has failed or taken too long.
    async fn watch_runs(&mut self) -> End {
        let stop = self.stop.clone();
        let shared = self.shared.clone();
        loop {
            let deadline = shared.deadline(self.settings.timeout);
            tokio::select! {
                biased;
                () = stop.cancelled() => return End::Stopped,
                event = self.next_event() => match event {
                    Some(Event::RunFailed(reason)) => {
                        warn!(task = self.settings.name, reason, "the session will be rebuilt");
                        return End::Failed;
                    }
                    Some(Event::Ended) => return End::Failed,
                    Some(Event::Built { .. } | Event::BuildFailed(_)) | None => {}
                },
                () = sleep_until(deadline.unwrap_or_else(Instant::now)),
                    if deadline.is_some() =>
                {
                    if shared.expire(self.settings.timeout) {
                        self.abandon();
                        return End::Failed;
                    }
                }
                () = shared.run_started.notified(), if deadline.is_none() => {}
            }
        }
    }

    /// Leaves the worker to its run that takes too long.
    fn abandon(&mut self) {
        if let Some(interrupt) = self.interrupter.take() {
            interrupt();
        }
        if self.alive {
            self.abandoned.insert(self.worker);
            self.count_abandoned();
        }
        warn!(
            task = self.settings.name,
            timeout_ms = self.settings.timeout.as_millis(),
            "a run took too long and was given up; the session will be rebuilt"
        );
    }

    /// Waits `pause`, on until the worker that failed is gone or has taken too long for that, and on until few enough
    /// threads hang.
    async fn pause(&mut self, pause: Duration) -> End {
        let stop = self.stop.clone();
        let over = Instant::now() + pause;
        // A session gives its memory back as it goes, and beside it the next might find none on a GPU. One that hangs in
        // that (CUDA may, once a device is lost) must not be waited for for ever.
        let patience = Instant::now() + pause.max(self.settings.timeout);
        loop {
            let now = Instant::now();
            let leaving = self.alive && !self.abandoned.contains(&self.worker);
            if leaving && now >= patience {
                self.abandoned.insert(self.worker);
                self.count_abandoned();
                warn!(
                    task = self.settings.name,
                    "a session that failed does not end and is left behind"
                );
                continue;
            }
            if now >= over && !leaving {
                if self.abandoned.len() < self.settings.most_abandoned {
                    return End::Failed;
                }
                self.shared.still_degraded(
                    format!(
                        "{} runs hang; the session is rebuilt when one of them ends",
                        self.abandoned.len()
                    ),
                    false,
                );
            }
            let next = [(now < over, over), (leaving, patience)];
            let next = next
                .into_iter()
                .find_map(|(waits, until)| waits.then_some(until));
            tokio::select! {
                biased;
                () = stop.cancelled() => return End::Stopped,
                _ = self.next_event() => {}
                () = sleep_until(next.unwrap_or(now)), if next.is_some() => {}
            }
        }
    }

    /// After the stop: until the worker has ended the run in hand and is gone, or that has taken too long.
    async fn finish(&mut self) {
        let limit = Instant::now() + self.settings.timeout;
        let shared = self.shared.clone();
        while self.alive {
            let deadline = shared.deadline(self.settings.timeout).unwrap_or(limit);
            tokio::select! {
                biased;
                _ = self.next_event() => {}
                () = sleep_until(deadline) => {
                    if shared.expire(self.settings.timeout) {
                        self.abandon();
                    }
                    return;
                }
            }
        }
    }

    /// Waits for one event and returns it if it is of the present worker. Earlier workers only tell that their
    /// thread is gone.
    async fn next_event(&mut self) -> Option<Event> {
        // Always some: `self.tell` keeps the channel open.
        let (worker, event) = self.events.recv().await?;
        let ended = matches!(event, Event::Ended);
        if ended && self.abandoned.remove(&worker) {
            self.count_abandoned();
        }
        if worker != self.worker {
            return None;
        }
        if ended {
            self.alive = false;
        }
        Some(event)
    }
}
