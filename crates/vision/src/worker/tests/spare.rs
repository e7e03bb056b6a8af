use super::*;

type SpareAsked = tokio::task::JoinHandle<Option<Result<Answer<Asker>, RunError>>>;

impl Stage {
    /// Requests a spare run of `camera`'s picture that begins within `wait`.
    pub(super) fn ask_spare(&self, camera: usize, wait: Duration) -> SpareAsked {
        let (worker, camera) = (self.worker.clone(), Asker(camera));
        tokio::spawn(async move {
            let answer = async {
                worker.idle().await?;
                Some(worker.run(None, (camera, Arc::default())).await)
            };
            tokio::time::timeout(wait, answer).await.ok()?
        })
    }
}

#[tokio::test(start_paused = true)]
async fn frames_precede_a_spare_picture_which_is_dropped_if_too_late_and_fails_alone() {
    let mut stage = stage(settings()).await;
    let first = stage.begin(0).await;
    let spare = stage.ask_spare(7, Duration::from_millis(1500));
    // The spare run waits for the run in progress and for the frame that arrives meanwhile.
    let second = stage.ask(1);
    stage.until_waiting(1).await;
    stage.answer(first).await;
    assert_eq!(stage.next_run().await, [1]);
    assert!(!spare.is_finished());
    pass(Duration::from_millis(1500)).await;
    assert!(spare.await.unwrap().is_none());
    stage.answer(second).await;

    let spare = stage.ask_spare(8, TIMEOUT);
    assert_eq!(stage.next_run().await, [8]);
    // A frame that arrives during the spare run is next.
    let third = stage.ask(2);
    stage.until_waiting(1).await;
    stage.end(Step::Answer);
    let answer = spare.await.unwrap().unwrap().unwrap();
    assert_eq!((answer.output, answer.pictures), (Asker(8), 1));
    assert_eq!(stage.next_run().await, [2]);
    stage.answer(third).await;
    let counts = stage.counts();
    assert_eq!((counts.completed, counts.batches, counts.spare), (3, 3, 1));

    // After a failed one the next uses the new session.
    let spare = stage.ask_spare(7, TIMEOUT);
    assert_eq!(stage.next_run().await, [7]);
    stage.end(FAIL);
    assert!(spare.await.unwrap().unwrap().is_err());
    let next = stage.ask_spare(8, 10 * TIMEOUT);
    pass(Duration::from_millis(100)).await;
    assert_eq!(stage.next_run().await, [8]);
    stage.end(Step::Answer);
    next.await.unwrap().unwrap().unwrap();
}
