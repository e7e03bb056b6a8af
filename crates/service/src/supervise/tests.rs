use super::*;
use albireo_wire::HealthState;
use std::sync::atomic::{AtomicU32, Ordering};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::task::JoinHandle;
use tokio::time::Instant;

struct Bench {
    readiness: Readiness,
    failures: TaskFailures,
    shutdown: CancellationToken,
    /// The time of each start of the task.
    starts: UnboundedReceiver<Instant>,
    watching: JoinHandle<Result<(), TaskFailed>>,
}

fn supervisor() -> Supervisor {
    Supervisor::new(
        Readiness::default(),
        TaskFailures::default(),
        CancellationToken::new(),
    )
}

/// Supervises a task that runs `what` with the number of its start, counted from 0.
fn bench<F: Future<Output: Into<TaskEnd>> + Send + 'static>(
    what: impl Fn(u32, CancellationToken) -> F + Clone + Send + Sync + 'static,
) -> Bench {
    let mut supervisor = supervisor();
    let readiness = supervisor.readiness.clone();
    let failures = supervisor.failures.clone();
    let shutdown = supervisor.shutdown.clone();
    let (started, starts) = unbounded_channel();
    let number = AtomicU32::new(0);
    let stop = shutdown.clone();
    supervisor.restarting("camera/front", HealthState::NotReady, move || {
        let _ = started.send(Instant::now());
        what(number.fetch_add(1, Ordering::Relaxed), stop.clone())
    });
    let watching = tokio::spawn(async move {
        let ended = supervisor.watch().await;
        supervisor.finish().await;
        ended
    });
    Bench {
        readiness,
        failures,
        shutdown,
        starts,
        watching,
    }
}

impl Bench {
    fn failures(&self) -> u64 {
        self.failures.lock()["camera/front"]
    }
}

#[tokio::test(start_paused = true)]
async fn a_task_that_panics_or_ends_too_early_is_counted_reported_and_restarted() {
    let mut bench = bench(|number, stop| async move {
        match number {
            0 => panic!("index out of bounds"),
            1 => tokio::time::sleep(FIRST_PAUSE).await,
            _ => stop.cancelled().await,
        }
    });
    let mut changes = bench.readiness.subscribe();
    let first = bench.starts.recv().await.unwrap();
    changes.changed().await.unwrap();
    let status = changes.borrow_and_update().clone();
    assert_eq!(status.state, HealthState::NotReady);
    let reported = &status.reasons[PART];
    let expected = "camera/front: panicked: index out of bounds";
    assert!(reported.contains(expected), "{reported}");
    assert_eq!(bench.failures(), 1);

    let again = bench.starts.recv().await.unwrap();
    assert_eq!(again - first, FIRST_PAUSE);
    assert_eq!(bench.failures(), 1);
    assert_eq!(bench.readiness.health().state(), HealthState::Degraded);
    // It ends after a pause, and the next one is twice as long.
    assert_eq!(bench.starts.recv().await.unwrap() - again, 3 * FIRST_PAUSE);
    assert_eq!(bench.failures(), 2);
    tokio::time::sleep(CALM).await;
    tokio::task::yield_now().await;
    assert_eq!(bench.readiness.health().state(), HealthState::Ready);
    bench.shutdown.cancel();
    assert_eq!((&mut bench.watching).await.unwrap(), Ok(()));
    assert_eq!(bench.failures(), 2);
}

#[tokio::test(start_paused = true)]
async fn the_restart_pause_doubles_to_a_limit_and_resets_after_a_calm_run() {
    let mut bench = bench(|number, _| async move {
        if number == 3 {
            tokio::time::sleep(2 * CALM).await;
        }
        Err::<(), _>("no such device")
    });
    let mut last = bench.starts.recv().await.unwrap();
    for expected in [100, 200, 400, 120_000 + 100, 200] {
        let start = bench.starts.recv().await.unwrap();
        assert_eq!((start - last).as_millis(), expected);
        last = start;
    }
    for _ in 0..20 {
        last = bench.starts.recv().await.unwrap();
    }
    assert_eq!(bench.starts.recv().await.unwrap() - last, LONGEST_PAUSE);
    let reported = &bench.readiness.health().status().reasons[PART];
    assert!(reported.contains("camera/front: "), "{reported}");
    bench.shutdown.cancel();
    assert_eq!(bench.watching.await.unwrap(), Ok(()));
}

#[tokio::test]
async fn watch_returns_the_failure_of_an_essential_task() {
    let mut supervisor = supervisor();
    let stop = supervisor.shutdown.clone();
    supervisor.essential("http", async move { stop.cancelled().await });
    supervisor.essential("ingest", async { the_disk_is_gone() });
    let failed = supervisor.watch().await.unwrap_err();
    assert_eq!(failed.task, "ingest");
    assert_eq!(failed.reason, "panicked: the disk is gone");
    assert!(!supervisor.readiness.health().is_ready());
    assert_eq!(supervisor.still_running(), ["http"]);
    supervisor.shutdown.cancel();
    supervisor.finish().await;
    assert!(supervisor.still_running().is_empty());
}

#[tokio::test]
async fn an_until_shutdown_task_does_not_delay_shutdown_and_fails_if_it_ends_early() {
    let mut stopped = supervisor();
    stopped.until_shutdown("uplink", std::future::pending::<()>());
    stopped.shutdown.cancel();
    assert_eq!(stopped.watch().await, Ok(()));
    stopped.finish().await;
    let mut ended = supervisor();
    ended.until_shutdown("uplink", async {});
    let failed = ended.watch().await.unwrap_err();
    assert_eq!(failed.task, "uplink");
    assert_eq!(failed.reason, "ended before the shutdown");
}

fn the_disk_is_gone() {
    panic!("the disk is gone");
}
