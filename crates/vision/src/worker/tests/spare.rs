use super::*;

type SpareAsked = tokio::task::JoinHandle<Option<Result<Answer<Asker>, RunError>>>;

impl Stage {
    /// Requests a spare run of `camera`'s picture that begins within `wait`.
    pub(super) fn ask_spare(&self, camera: usize, wait: Duration) -> SpareAsked {
        let worker = self.worker.clone();
        let camera = Asker(camera);
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
async fn frames_precede_a_spare_picture_which_is_dropped_if_its_time_is_over() {
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
}

#[tokio::test(start_paused = true)]
async fn a_spare_picture_runs_alone_and_is_counted_apart() {
    let mut stage = stage(settings()).await;
    let spare = stage.ask_spare(8, TIMEOUT);
    assert_eq!(stage.next_run().await, [8]);
    // A frame that arrives during the spare run is next.
    let frame = stage.ask(2);
    stage.until_waiting(1).await;
    stage.end(Step::Answer);
    let answer = spare.await.unwrap().unwrap().unwrap();
    assert_eq!(answer.output, Asker(8));
    assert_eq!(answer.pictures, 1);
    assert_eq!(stage.next_run().await, [2]);
    stage.answer(frame).await;
    let expected = WorkerCounts {
        completed: 1,
        batches: 1,
        spare: 1,
        ..WorkerCounts::default()
    };
    assert_eq!(stage.counts(), expected);
}

#[tokio::test(start_paused = true)]
async fn after_a_spare_picture_that_fails_the_next_one_uses_a_new_session() {
    let mut stage = stage(settings()).await;
    let spare = stage.ask_spare(7, TIMEOUT);
    assert_eq!(stage.next_run().await, [7]);
    stage.end(FAIL);
    assert!(spare.await.unwrap().unwrap().is_err());
    let next = stage.ask_spare(8, 10 * TIMEOUT);
    pass(FIRST_PAUSE).await;
    assert_eq!(stage.next_run().await, [8]);
    stage.end(Step::Answer);
    next.await.unwrap().unwrap().unwrap();
}
