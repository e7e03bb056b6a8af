//! The worker with models that wait, fail, panic and hang, under paused time that the tests advance.

mod any_order;
mod building;
mod gpu;
mod rhythm;
mod spare;
mod successor;

use super::*;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc as blocking;
use tokio::sync::mpsc;
use tokio::time::advance;

const TIMEOUT: Duration = Duration::from_secs(2);

#[derive(Clone, Copy, Debug)]
enum Step {
    Answer,
    AnswerTooFew,
    Fail(&'static str),
    Implausible,
    Panic,
}

const FAIL: Step = Step::Fail("scripted failure");

/// The picture of a scripted model: its camera, and shared data.
type Scene = (Asker, Arc<()>);

impl WorkerInput for Scene {
    /// Cameras from 10 on have pictures of another size.
    fn size(&self) -> PictureSize {
        let (Asker(camera), _) = *self;
        let height = if camera < 10 { 1 } else { 2 };
        PictureSize::new(1, height)
    }
}

struct Script {
    started: mpsc::UnboundedSender<Vec<Asker>>,
    steps: Mutex<blocking::Receiver<Step>>,
    ended: mpsc::UnboundedSender<()>,
    next: Mutex<Next>,
}

/// How the next models are built, and how the next one ends.
#[derive(Default)]
struct Next {
    failures: VecDeque<&'static str>,
    facts: usize,
    /// The signal that the next dropped model waits for.
    end: Option<blocking::Receiver<()>>,
}

/// A model that reports when a run starts and for which cameras, and then waits for the test to end it.
struct Scripted {
    script: Arc<Script>,
    provider: ExecutionProvider,
}

impl Model for Scripted {
    type Input = Scene;
    type Output = Asker;
    type Facts = usize;

    fn facts(&self) -> usize {
        self.script.next.lock().facts
    }

    fn run(&mut self, pictures: &[Scene]) -> Result<Vec<Asker>, RunError> {
        let cameras: Vec<_> = pictures.iter().map(|(camera, _)| *camera).collect();
        self.script.started.send(cameras.clone()).ok();
        let step = self.script.steps.lock().recv();
        let reason = match step {
            Ok(Step::Answer) => return Ok(cameras),
            Ok(Step::AnswerTooFew) => return Ok(cameras[1..].to_vec()),
            Ok(Step::Implausible) => {
                return Err(RunError::Implausible("scripted nonsense".to_owned()));
            }
            Ok(Step::Panic) => panic!("scripted panic"),
            Ok(Step::Fail(reason)) => reason,
            Err(_) => "the test is over",
        };
        Err(RunError::Failed(reason.to_owned()))
    }

    fn provider(&self) -> ExecutionProvider {
        self.provider
    }
}

impl Drop for Scripted {
    fn drop(&mut self) {
        self.script.ended.send(()).ok();
        let hangs_until = self.script.next.lock().end.take();
        if let Some(until) = hangs_until {
            until.recv().ok();
        }
    }
}

struct Stage {
    worker: Worker<Scene, Asker>,
    started: mpsc::UnboundedReceiver<Vec<Asker>>,
    ended: mpsc::UnboundedReceiver<()>,
    steps: blocking::Sender<Step>,
    script: Arc<Script>,
    _held: blocking::Sender<()>,
}

/// A blocking task, which keeps tokio's paused clock from jumping to the next timer while only the model's thread is busy.
fn hold_time() -> blocking::Sender<()> {
    let (hold, held) = blocking::channel::<()>();
    tokio::task::spawn_blocking(move || held.recv().is_ok());
    hold
}

async fn stage(settings: WorkerSettings) -> Stage {
    stage_with(settings, |_| None).await
}

/// A stage whose model may get a successor, made of the same script.
async fn stage_with(
    settings: WorkerSettings,
    successor: impl FnOnce(Arc<Script>) -> Option<Build<Scripted>>,
) -> Stage {
    let held = hold_time();
    let (tell_started, started) = mpsc::unbounded_channel();
    let (tell_ended, ended) = mpsc::unbounded_channel();
    let (steps, next_steps) = blocking::channel();
    let script = Arc::new(Script {
        started: tell_started,
        steps: Mutex::new(next_steps),
        ended: tell_ended,
        next: Mutex::default(),
    });
    let followed = script.clone();
    let factory = move || match followed.next.lock().failures.pop_front() {
        Some(reason) => Err(StartError::first_run("scripted.onnx".as_ref(), reason)),
        None => Ok(Scripted {
            script: Arc::clone(&followed),
            provider: ExecutionProvider::Cpu,
        }),
    };
    let successor = successor(Arc::clone(&script));
    let (worker, _) = Worker::start(settings, WorkerMeter::default(), factory, successor)
        .await
        .unwrap();
    Stage {
        worker,
        started,
        ended,
        steps,
        script,
        _held: held,
    }
}

fn settings() -> WorkerSettings {
    WorkerSettings {
        name: "scripted",
        timeout: TIMEOUT,
        batch_size: 1,
        batch_wait: Duration::ZERO,
    }
}

type Asked = tokio::task::JoinHandle<Result<Answer<Asker>, RunError>>;

impl Stage {
    fn ask(&self, camera: usize) -> Asked {
        let worker = self.worker.clone();
        let camera = Asker(camera);
        tokio::spawn(async move {
            let shared = Arc::new(());
            let picture = (camera, Arc::clone(&shared));
            let answer = worker.run(Some(camera), picture).await;
            let is_mine_again = Arc::strong_count(&shared) == 1;
            assert!(answer.is_err() || is_mine_again, "the worker holds it");
            answer
        })
    }

    async fn next_run(&mut self) -> Vec<usize> {
        let cameras = self.started.recv().await.unwrap();
        cameras.into_iter().map(|Asker(camera)| camera).collect()
    }

    async fn begin(&mut self, camera: usize) -> Asked {
        let asked = self.ask(camera);
        assert_eq!(self.next_run().await, [camera]);
        asked
    }

    fn end(&self, step: Step) {
        self.steps.send(step).unwrap();
    }

    /// Ends the run well, and returns the answer to one of its callers.
    async fn answer(&self, asked: Asked) -> Answer<Asker> {
        self.end(Step::Answer);
        asked.await.unwrap().unwrap()
    }

    /// Asks for a picture of camera 0 and ends its run. Returns the caller's answer.
    async fn run(&mut self, step: Step) -> Result<Answer<Asker>, RunError> {
        let asked = self.begin(0).await;
        self.end(step);
        asked.await.unwrap()
    }

    /// Lets a run fail, and checks that the session is rebuilt after `pause_ms` and not before.
    async fn fail_and_be_rebuilt_after(&mut self, pause_ms: u64) {
        let rebuilds = self.counts().rebuilds;
        self.fail(FAIL).await;
        pass(Duration::from_millis(pause_ms - 1)).await;
        assert_eq!(self.counts().rebuilds, rebuilds, "pause {pause_ms}");
        pass(Duration::from_millis(1)).await;
        self.until(|counts| counts.rebuilds, rebuilds + 1).await;
        self.until_ready().await;
    }

    /// Like [`run`](Self::run), for a run that ends the model. Returns the caller's error.
    async fn fail(&mut self, step: Step) -> RunError {
        let error = self.run(step).await.unwrap_err();
        self.ended.recv().await.unwrap();
        error
    }

    fn stop(&self) -> tokio::task::JoinHandle<()> {
        let worker = self.worker.clone();
        tokio::spawn(async move { worker.stop().await })
    }

    fn counts(&self) -> WorkerCounts {
        self.worker.meter.read()
    }

    async fn until_waiting(&self, pictures: u64) {
        self.until(|counts| counts.waiting, pictures).await;
    }

    async fn until_ready(&self) {
        let ready = |status: &ModelStatus| matches!(status, ModelStatus::Ready { .. });
        self.worker.status.clone().wait_for(ready).await.unwrap();
    }

    async fn until_degraded(&self) -> String {
        let degraded = |status: &ModelStatus| matches!(status, ModelStatus::Degraded { .. });
        self.until_fault(degraded).await
    }

    async fn until_fault(&self, fits: fn(&ModelStatus) -> bool) -> String {
        let mut watched = self.worker.status.clone();
        let status = watched.wait_for(fits).await.unwrap();
        status.fault().unwrap().to_owned()
    }

    async fn until(&self, count: fn(WorkerCounts) -> u64, value: u64) {
        while count(self.counts()) != value {
            tokio::task::yield_now().await;
        }
    }
}

async fn pass(time: Duration) {
    settle().await;
    advance(time).await;
    settle().await;
}

async fn settle() {
    for _ in 0..20 {
        tokio::task::yield_now().await;
    }
}

#[tokio::test(start_paused = true)]
async fn cameras_take_turns_however_often_one_asks() {
    let mut stage = stage(settings()).await;
    let mut asked = vec![stage.begin(0).await];
    // Camera 0 asks often before the others ask at all.
    asked.extend((0..6).map(|_| stage.ask(0)));
    stage.until_waiting(6).await;
    asked.extend([1, 2, 1, 2].map(|camera| stage.ask(camera)));
    let mut order = Vec::new();
    for waiting in (1..=10).rev() {
        stage.until_waiting(waiting).await;
        stage.end(Step::Answer);
        order.extend(stage.next_run().await);
    }
    stage.end(Step::Answer);
    assert_eq!(order, [1, 2, 0, 1, 2, 0, 0, 0, 0, 0]);
    for answer in asked {
        answer.await.unwrap().unwrap();
    }
    assert_eq!(stage.counts().completed, 11);
}

#[tokio::test(start_paused = true)]
async fn a_slow_run_is_answered_at_the_limit_with_an_error() {
    let mut stage = stage(settings()).await;
    let begun = Instant::now();
    let late = stage.begin(0).await;
    pass(TIMEOUT - Duration::from_millis(1)).await;
    assert!(!late.is_finished());
    pass(Duration::from_millis(1)).await;
    let error = late.await.unwrap().unwrap_err();
    assert_eq!(error, RunError::TimedOut { timeout_ms: 2000 });
    assert_eq!(begun.elapsed(), TIMEOUT);
    let reason = stage.until_degraded().await;
    assert!(reason.contains("2000 ms"), "{reason}");
}

#[tokio::test(start_paused = true)]
async fn pictures_are_refused_from_the_limit_of_a_slow_run_until_it_comes_back() {
    let mut stage = stage(settings()).await;
    let late = stage.begin(0).await;
    let waiting = stage.ask(1);
    stage.until_waiting(1).await;
    pass(TIMEOUT).await;
    late.await.unwrap().unwrap_err();
    let refused = waiting.await.unwrap().unwrap_err();
    assert!(matches!(refused, RunError::Unavailable(_)));
    assert!(stage.worker.accepts().is_err());
    let refused_at_once = stage.ask(2).await.unwrap().unwrap_err();
    assert!(matches!(refused_at_once, RunError::Unavailable(_)));
    assert_eq!(stage.counts().refused, 3);
    stage.end(Step::Answer);
    stage.until_ready().await;
    assert!(stage.worker.accepts().is_ok());
}

#[tokio::test(start_paused = true)]
async fn a_slow_run_that_comes_back_before_its_thread_counts_as_stuck_keeps_its_session() {
    let mut stage = stage(settings()).await;
    let late = stage.begin(0).await;
    pass(TIMEOUT).await;
    late.await.unwrap().unwrap_err();
    pass(STUCK_AFTER - Duration::from_millis(1)).await;
    stage.end(Step::Answer);
    stage.until_ready().await;
    let after = stage.begin(3).await;
    assert_eq!(stage.answer(after).await.output, Asker(3));
    let expected = WorkerCounts {
        completed: 1,
        batches: 1,
        timed_out: 1,
        ..WorkerCounts::default()
    };
    assert_eq!(stage.counts(), expected);
    assert!(stage.ended.try_recv().is_err());
}

#[tokio::test(start_paused = true)]
async fn a_thread_that_never_returns_ends_the_worker_with_an_error() {
    // It hangs in a run, or while it closes the session of a failed one.
    for hangs_while_closing in [false, true] {
        let mut stage = stage(settings()).await;
        let (_go_on, until) = blocking::channel();
        stage.script.next.lock().end = Some(until);
        let hanging = stage.begin(0).await;
        if hangs_while_closing {
            stage.end(FAIL);
            stage.ended.recv().await.unwrap();
        }
        pass(TIMEOUT).await;
        let error = hanging.await.unwrap().unwrap_err();
        assert_eq!(error, RunError::TimedOut { timeout_ms: 2000 });
        let worker = stage.worker.clone();
        let ended = tokio::spawn(async move { worker.ended().await });
        pass(STUCK_AFTER - Duration::from_millis(1)).await;
        assert!(!ended.is_finished());
        pass(Duration::from_millis(1)).await;
        let reason = ended.await.unwrap().unwrap_err();
        let said = "thread of the scripted has not come back for 32 s";
        assert!(reason.contains(said), "{reason}");
        assert_eq!(stage.until_degraded().await, reason);
        let error = stage.ask(1).await.unwrap().unwrap_err();
        assert_eq!(error, RunError::Stopped);
        assert_eq!(stage.counts().rebuilds, 0);
    }
}

#[tokio::test(start_paused = true)]
async fn a_run_that_fails_or_panics_is_counted_and_the_session_rebuilt() {
    let mut stage = stage(settings()).await;
    let failed = |reason: &str| RunError::Failed(reason.to_owned());
    let panicked = RunError::Panicked("scripted panic".to_owned());
    let too_few = failed("the model answered 0 of 1 pictures");
    for (pause, step, expected) in [
        (FIRST_PAUSE, FAIL, failed("scripted failure")),
        (2 * FIRST_PAUSE, Step::Panic, panicked),
        (4 * FIRST_PAUSE, Step::AnswerTooFew, too_few),
    ] {
        let error = stage.fail(step).await;
        assert_eq!(error, expected);
        // The status is set before the answer is sent.
        let degraded = ModelStatus::Degraded {
            reason: error.to_string(),
            provider: ExecutionProvider::Cpu,
        };
        assert_eq!(*stage.worker.status.borrow(), degraded);
        pass(pause).await;
        stage.until_ready().await;
    }
    stage.run(Step::Answer).await.unwrap();
    let expected = WorkerCounts {
        completed: 1,
        batches: 1,
        failed: 2,
        panicked: 1,
        rebuilds: 3,
        ..WorkerCounts::default()
    };
    assert_eq!(stage.counts(), expected);
}

fn in_threes() -> WorkerSettings {
    WorkerSettings {
        batch_size: 3,
        batch_wait: Duration::from_millis(10),
        ..settings()
    }
}

#[tokio::test(start_paused = true)]
async fn a_picture_runs_as_soon_as_the_one_that_it_waits_for_is_called_off() {
    let mut stage = stage(in_threes()).await;
    // A run, so that it is known how long one takes.
    let asked = stage.begin(0).await;
    pass(Duration::from_millis(20)).await;
    stage.answer(asked).await;
    let called_off = stage.worker.coming.announce(Asker(1), PictureSize::new(1, 1));
    let asked = stage.ask(0);
    stage.until_waiting(1).await;
    let before = Instant::now();
    drop(called_off);
    assert_eq!(stage.next_run().await, [0]);
    assert_eq!(before.elapsed(), Duration::ZERO);
    stage.end(Step::Answer);
    assert!(asked.await.unwrap().is_ok());
}

#[tokio::test(start_paused = true)]
async fn waiting_pictures_share_a_run_and_each_gets_its_own_answer_and_times() {
    const WAITED: Duration = Duration::from_millis(500);
    const RUN: Duration = Duration::from_millis(20);
    let mut stage = stage(in_threes()).await;
    // No other camera has asked before, so the run does not wait.
    let asked_first = stage.begin(0).await;
    let asked: Vec<_> = (1..5).map(|camera| stage.ask(camera)).collect();
    stage.until_waiting(4).await;
    pass(WAITED).await;
    let first = stage.answer(asked_first).await;
    assert_eq!(first.took, WAITED);
    assert_eq!(first.pictures, 1);
    assert_eq!(stage.next_run().await, [1, 2, 3]);
    pass(RUN).await;
    stage.end(Step::Answer);
    // The fourth has waited long enough for others.
    assert_eq!(stage.next_run().await, [4]);
    stage.end(Step::Answer);
    for (camera, asked) in (1..).zip(asked) {
        let answer = asked.await.unwrap().unwrap();
        let expected = if camera == 4 {
            Answer {
                output: Asker(camera),
                queued: WAITED + RUN,
                took: Duration::ZERO,
                pictures: 1,
            }
        } else {
            Answer {
                output: Asker(camera),
                queued: WAITED,
                took: RUN,
                pictures: 3,
            }
        };
        assert_eq!(answer, expected);
    }
    let counts = stage.counts();
    assert_eq!(counts.completed, 5);
    assert_eq!(counts.batches, 3);
}

/// Cameras from 10 on have pictures of another size.
#[tokio::test(start_paused = true)]
async fn pictures_of_one_size_share_a_run_and_those_of_another_wait_neither_for_them_nor_for_ever()
{
    let mut stage = stage(in_threes()).await;
    let mut running = stage.begin(0).await;
    // No time passes: the third camera is the only one of its size, so it waits for no other.
    for shared in [vec![1, 0], vec![0, 1]] {
        let mut asked: Vec<_> = [0, 1, 10].map(|camera| stage.ask(camera)).into();
        stage.until_waiting(3).await;
        stage.answer(running).await;
        assert_eq!(stage.next_run().await, shared);
        stage.end(Step::Answer);
        assert_eq!(stage.next_run().await, [10]);
        running = asked.pop().unwrap();
        for asked in asked {
            asked.await.unwrap().unwrap();
        }
    }
    stage.answer(running).await;
}

#[tokio::test(start_paused = true)]
async fn a_late_batch_is_answered_for_all_its_pictures_and_if_it_then_fails_the_session_rebuilt() {
    let mut stage = stage(in_threes()).await;
    let first = stage.begin(0).await;
    let asked = [1, 2, 3].map(|camera| stage.ask(camera));
    stage.until_waiting(3).await;
    stage.answer(first).await;
    assert_eq!(stage.next_run().await, [1, 2, 3]);
    pass(TIMEOUT).await;
    for answer in asked {
        let error = answer.await.unwrap().unwrap_err();
        assert_eq!(error, RunError::TimedOut { timeout_ms: 2000 });
    }
    stage.end(FAIL);
    // The task knows of the failure, and its backoff has begun.
    stage.until(|counts| counts.failed, 1).await;
    pass(FIRST_PAUSE).await;
    stage.until_ready().await;
    let counts = stage.counts();
    assert_eq!(counts.timed_out, 1);
    assert_eq!(counts.rebuilds, 1);
    assert_eq!(stage.ended.recv().await, Some(()));
}

#[tokio::test(start_paused = true)]
async fn backoffs_double_up_to_a_maximum_and_reset_after_a_good_run() {
    let mut stage = stage(settings()).await;
    for pause_ms in [
        100, 200, 400, 800, 1600, 3200, 6400, 12_800, 25_600, 30_000, 30_000,
    ] {
        stage.fail_and_be_rebuilt_after(pause_ms).await;
    }
    stage.run(Step::Answer).await.unwrap();
    for pause_ms in [100, 200] {
        stage.fail_and_be_rebuilt_after(pause_ms).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_model_rebuilt_with_another_signature_is_rejected_until_the_old_one_returns() {
    let mut stage = stage(settings()).await;
    stage.script.next.lock().facts = 1;
    stage.fail(FAIL).await;
    pass(FIRST_PAUSE).await;
    stage.until(|counts| counts.rebuilds_failed, 1).await;
    let reason = stage.until_degraded().await;
    assert!(reason.contains("than when the program started"), "{reason}");
    stage.script.next.lock().facts = 0;
    pass(2 * FIRST_PAUSE).await;
    stage.until_ready().await;
    assert_eq!(stage.counts().rebuilds, 2);
}

#[tokio::test(start_paused = true)]
async fn stopping_finishes_the_current_run_and_rejects_the_rest_and_spare_pictures() {
    let mut stage = stage(settings()).await;
    let current = stage.begin(0).await;
    let spare = stage.ask_spare(7, TIMEOUT);
    let waiting = stage.ask(1);
    stage.until_waiting(1).await;
    let stopping = stage.stop();
    assert_eq!(waiting.await.unwrap().unwrap_err(), RunError::Stopped);
    let refused = stage.ask(2).await.unwrap().unwrap_err();
    assert_eq!(refused, RunError::Stopped);
    assert!(!stopping.is_finished());
    stage.answer(current).await;
    stopping.await.unwrap();
    assert!(stage.ended.try_recv().is_ok(), "the model is dropped");
    stage.worker.stop().await;
    pass(TIMEOUT).await;
    assert!(spare.await.unwrap().is_none_or(|answer| answer.is_err()));
    assert_eq!(stage.counts().spare, 0);
}

#[tokio::test(start_paused = true)]
async fn a_worker_that_was_stopped_while_idle_is_not_idle_any_more() {
    let stage = stage(settings()).await;
    assert_eq!(stage.worker.idle().await, Some(()));
    stage.worker.stop().await;
    assert_eq!(stage.worker.idle().await, None);
}

#[tokio::test(start_paused = true)]
async fn stopping_waits_for_a_hanging_run_only_up_to_its_limit() {
    for stopped_after in [Duration::ZERO, TIMEOUT] {
        let mut stage = stage(settings()).await;
        let hanging = stage.begin(0).await;
        pass(stopped_after).await;
        let stopping = stage.stop();
        pass(TIMEOUT - stopped_after).await;
        stopping.await.unwrap();
        let error = hanging.await.unwrap().unwrap_err();
        assert!(matches!(error, RunError::TimedOut { .. }));
    }
}

#[tokio::test(start_paused = true)]
async fn the_worker_ends_with_its_last_handle() {
    let mut stage = stage(settings()).await;
    drop(stage.worker);
    assert_eq!(stage.ended.recv().await, Some(()));
}

#[tokio::test(start_paused = true)]
async fn a_picture_whose_caller_is_gone_is_not_run() {
    let mut stage = stage(settings()).await;
    let first = stage.begin(0).await;
    let gone = stage.ask(1);
    stage.until_waiting(1).await;
    gone.abort();
    assert!(gone.await.unwrap_err().is_cancelled());
    let last = stage.ask(2);
    stage.until_waiting(2).await;
    stage.answer(first).await;
    assert_eq!(stage.answer(last).await.output, Asker(2));
    let counts = stage.counts();
    assert_eq!(counts.completed, 2);
    assert_eq!(counts.cancelled, 1);
}

#[tokio::test(start_paused = true)]
async fn a_panic_while_the_first_model_is_built_is_an_error() {
    let _held = hold_time();
    let panics = || -> Result<Scripted, _> { panic!("scripted panic") };
    let error = Worker::start(settings(), WorkerMeter::default(), panics, None)
        .await
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("scripted panic"), "{error}");
}
