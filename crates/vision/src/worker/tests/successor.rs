//! A better model that takes long to build, while another one answers.

use super::*;
use ExecutionProvider::{Cpu, TensorRt};

/// A stage whose successor waits, for each build, to be told its facts or why it fails.
async fn stage_with_successor() -> (Stage, blocking::Sender<Result<usize, &'static str>>) {
    let (go_on, told) = blocking::channel::<Result<usize, _>>();
    let told = Mutex::new(told);
    let stage = stage_with(settings(), |script| {
        let build = move || match told.lock().recv() {
            Ok(Ok(facts)) => {
                script.next.lock().facts = facts;
                Ok(Scripted {
                    script: Arc::clone(&script),
                    provider: TensorRt,
                })
            }
            Ok(Err(reason)) => Err(StartError::first_run("engine".as_ref(), reason)),
            Err(_) => Err(StartError::first_run("engine".as_ref(), "the test is over")),
        };
        Some(Box::new(build))
    });
    (stage.await, go_on)
}

async fn until_provider(stage: &Stage, provider: ExecutionProvider) {
    let ready = ModelStatus::Ready { provider };
    stage.worker.status.clone().wait_for(|status| *status == ready).await.unwrap();
}

/// Waits until the build of the successor has ended, well or not.
async fn until_built(stage: &Stage) {
    stage.worker.building.clone().wait_for(Option::is_none).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn the_first_model_answers_until_its_successor_is_built_and_takes_over_between_runs() {
    let (mut stage, build) = stage_with_successor().await;
    until_provider(&stage, Cpu).await;
    // However long it takes: an engine may need a quarter of an hour.
    let took = Duration::from_secs(1500);
    pass(took).await;
    let building = |stage: &Stage| stage.worker.building.borrow().map(|begun| begun.elapsed());
    assert_eq!(building(&stage), Some(took));
    stage.run(Step::Answer).await.unwrap();
    let running = stage.begin(0).await;
    build.send(Ok(0)).unwrap();
    settle().await;
    assert_eq!(stage.worker.status.borrow().provider(), Some(Cpu));
    stage.answer(running).await;
    until_provider(&stage, TensorRt).await;
    assert_eq!(building(&stage), None);
    // The first one has ended, and its memory is free.
    stage.ended.recv().await.unwrap();
    stage.run(Step::Answer).await.unwrap();
    let expected = WorkerCounts {
        completed: 3,
        batches: 3,
        ..WorkerCounts::default()
    };
    assert_eq!(stage.counts(), expected);
}

#[tokio::test(start_paused = true)]
async fn a_successor_that_has_taken_over_is_repaired_by_its_own_build() {
    let (mut stage, build) = stage_with_successor().await;
    build.send(Ok(0)).unwrap();
    until_provider(&stage, TensorRt).await;
    // The first model has ended.
    stage.ended.recv().await.unwrap();
    stage.fail(FAIL).await;
    build.send(Ok(0)).unwrap();
    pass(FIRST_PAUSE).await;
    until_provider(&stage, TensorRt).await;
}

#[tokio::test(start_paused = true)]
async fn a_successor_that_fails_or_reads_other_classes_leaves_the_first_model_at_work() {
    for outcome in [Err("no such library"), Ok(1)] {
        let (mut stage, build) = stage_with_successor().await;
        build.send(outcome).unwrap();
        until_built(&stage).await;
        stage.run(Step::Answer).await.unwrap();
        let status = stage.worker.status.borrow().clone();
        assert_eq!(status, ModelStatus::Ready { provider: Cpu });
    }
}

#[tokio::test(start_paused = true)]
async fn a_successor_that_is_ready_takes_the_place_of_a_model_that_is_lost() {
    let (mut stage, build) = stage_with_successor().await;
    stage.fail(FAIL).await;
    build.send(Ok(0)).unwrap();
    until_built(&stage).await;
    pass(FIRST_PAUSE).await;
    until_provider(&stage, TensorRt).await;
    assert_eq!(stage.counts().rebuilds, 0);
    stage.run(Step::Answer).await.unwrap();
}
