//! A GPU that runs out of memory or is lost, with the errors of ONNX Runtime's CUDA provider.

use super::*;
use crate::onnx::fault;

const OUT_OF_MEMORY: &str =
    "CUDA failure 2: out of memory ; GPU=0 ; hostname=board ; expr=cudaMalloc((void**)&p, size); ";
const LOST: &str = "Status Message: CUDA failure 719: unspecified launch failure ; GPU=0 ; hostname=board ; \
                    expr=cudaStreamSynchronize(stream); ";

#[tokio::test(start_paused = true)]
async fn a_gpu_that_no_new_session_restores_is_reported_lost_and_still_retried() {
    let mut stage = stage(settings()).await;
    let lost: &str = fault::in_words(LOST).leak();
    let full: &str = fault::in_words(OUT_OF_MEMORY).leak();
    stage.script.next.lock().failures = [full, lost, lost].into();
    let error = stage.fail(Step::Fail(lost)).await.to_string();
    let expected = "the GPU is lost to this process";
    assert!(error.contains(expected), "{error}");
    // One failed run proves nothing: a new session may work.
    assert!(stage.until_degraded().await.contains(expected));
    pass(FIRST_PAUSE).await;
    stage.until(|counts| counts.rebuilds_failed, 1).await;
    // Nor does a build that fails for another reason.
    let reason = stage.until_degraded().await;
    assert!(reason.contains("CUDA failure 2"), "{reason}");
    for (pause, failed) in [(2 * FIRST_PAUSE, 2), (4 * FIRST_PAUSE, 3)] {
        pass(pause).await;
        stage.until(|counts| counts.rebuilds_failed, failed).await;
        let is_lost = |status: &ModelStatus| matches!(status, ModelStatus::Lost { .. });
        let reason = stage.until_fault(is_lost).await;
        for part in ["scripted.onnx", lost, "restarting the program"] {
            assert!(reason.contains(part), "{reason}");
        }
        let refused = stage.ask(1).await.unwrap().unwrap_err();
        assert!(matches!(refused, RunError::Unavailable(_)));
    }
    // The GPU comes back after all.
    pass(8 * FIRST_PAUSE).await;
    stage.until_ready().await;
    assert_eq!(stage.counts().rebuilds, 4);
}

#[tokio::test(start_paused = true)]
async fn a_failure_is_reported_after_the_failed_session_has_freed_its_memory() {
    let mut stage = stage(settings()).await;
    let (go_on, until) = blocking::channel();
    stage.script.next.lock().end = Some(until);
    let failing = stage.begin(0).await;
    stage.end(Step::Fail(OUT_OF_MEMORY));
    stage.ended.recv().await.unwrap();
    pass(TIMEOUT - Duration::from_millis(1)).await;
    assert!(!failing.is_finished());
    go_on.send(()).unwrap();
    let error = failing.await.unwrap().unwrap_err();
    assert!(matches!(error, RunError::Failed(_)), "{error}");
    pass(FIRST_PAUSE).await;
    stage.until_ready().await;
    assert_eq!(stage.counts().rebuilds, 1);
}
