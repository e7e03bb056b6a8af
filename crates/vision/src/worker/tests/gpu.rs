//! A GPU that runs out of memory or is lost, with the errors of ONNX Runtime's CUDA provider.

use super::*;
use crate::detector::fault;

/// An error text of ONNX Runtime's CUDA provider.
const OUT_OF_MEMORY: &str =
    "CUDA failure 2: out of memory ; GPU=0 ; hostname=board ; expr=cudaMalloc((void**)&p, size); ";
const LOST: &str = "Status Message: CUDA failure 719: unspecified launch failure ; GPU=0 ; hostname=board ; \
                    expr=cudaStreamSynchronize(stream); ";

impl Stage {
    /// A run that fails with `reason`; returns the error that the caller gets.
    async fn fail_with(&mut self, reason: &'static str) -> String {
        self.fail(Step::FailWith(reason)).await.to_string()
    }

    async fn until_lost(&self) -> String {
        let lost = |status: &DetectorStatus| matches!(status, DetectorStatus::Lost { .. });
        self.until_fault(lost).await
    }
}

#[tokio::test(start_paused = true)]
async fn a_gpu_that_no_new_session_restores_is_reported_lost_and_still_retried() {
    let mut stage = stage(settings()).await;
    let words: &'static str = fault::in_words(LOST).leak();
    stage.script.next.lock().failure = words;
    stage.script.next.lock().failing = 2;
    let reason = stage.fail_with(words).await;
    let expected = "the GPU is lost to this process";
    assert!(reason.contains(expected), "{reason}");
    // One failed run proves nothing: a new session may work.
    let status = stage.worker.status.borrow().clone();
    assert!(matches!(status, DetectorStatus::Degraded { .. }));
    for (pause, failed) in [(100, 1), (200, 2)] {
        pass(Duration::from_millis(pause)).await;
        stage.until_rebuilds_failed(failed).await;
        let reason = stage.until_lost().await;
        let parts = [
            "scripted.onnx",
            "CUDA failure 719",
            "restarting the program",
        ];
        assert!(parts.iter().all(|part| reason.contains(part)), "{reason}");
        let refused = stage.ask(1).await.unwrap().unwrap_err();
        assert!(matches!(refused, InferenceError::Unavailable(_)));
    }
    // The GPU comes back after all.
    pass(Duration::from_millis(400)).await;
    stage.until_ready().await;
    assert_eq!(stage.counts().rebuilds, 3);
}

#[tokio::test(start_paused = true)]
async fn another_build_failure_is_not_mistaken_for_a_lost_gpu() {
    let mut stage = stage(settings()).await;
    stage.script.next.lock().failure = fault::in_words(OUT_OF_MEMORY).leak();
    stage.script.next.lock().failing = 1;
    stage.fail_with(LOST).await;
    pass(Duration::from_millis(100)).await;
    stage.until_rebuilds_failed(1).await;
    let reason = stage.until_degraded().await;
    assert!(reason.contains("CUDA failure 2"), "{reason}");
}

#[tokio::test(start_paused = true)]
async fn a_failure_is_reported_after_the_failed_session_has_freed_its_memory() {
    let mut stage = stage(settings()).await;
    let (go_on, until) = blocking::channel();
    stage.script.next.lock().end = Some(until);
    let failing = stage.begin(0).await;
    stage.end(Step::FailWith(OUT_OF_MEMORY));
    stage.ended.recv().await.unwrap();
    pass(TIMEOUT - Duration::from_millis(1)).await;
    assert!(!failing.is_finished());
    go_on.send(()).unwrap();
    let error = failing.await.unwrap().unwrap_err();
    assert!(matches!(error, InferenceError::Failed(_)), "{error}");
    pass(Duration::from_millis(100)).await;
    stage.until_ready().await;
    assert_eq!(stage.counts().rebuilds, 1);
}

#[tokio::test(start_paused = true)]
async fn a_failed_session_that_hangs_on_close_is_stuck() {
    let mut stage = stage(settings()).await;
    let (_go_on, until) = blocking::channel();
    stage.script.next.lock().end = Some(until);
    let failing = stage.begin(0).await;
    stage.end(Step::FailWith(LOST));
    stage.ended.recv().await.unwrap();
    pass(TIMEOUT).await;
    let error = failing.await.unwrap().unwrap_err();
    assert!(matches!(error, InferenceError::TimedOut { .. }), "{error}");
    pass(STUCK_AFTER).await;
    stage.worker.ended().await.unwrap_err();
}
