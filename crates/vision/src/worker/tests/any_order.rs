use super::*;
use proptest::prelude::*;

const SPARE: usize = 7;

#[derive(Clone, Debug)]
enum Happens {
    Ask(usize),
    AskSpare,
    /// The caller of one of the pictures so far gives up.
    GiveUp(prop::sample::Index),
    /// The run in progress, or the next one, ends.
    End(Step),
    PassMs(u64),
}

fn happens() -> impl Strategy<Value = Happens> {
    let ends = prop_oneof![
        4 => Just(Step::Answer),
        1 => Just(Step::AnswerTooFew),
        1 => Just(FAIL),
        1 => Just(Step::Implausible),
        1 => Just(Step::Panic),
    ];
    prop_oneof![
        6 => (0_usize..4).prop_map(Happens::Ask),
        1 => Just(Happens::AskSpare),
        1 => any::<prop::sample::Index>().prop_map(Happens::GiveUp),
        4 => ends.prop_map(Happens::End),
        3 => prop::sample::select(vec![1, 10, 100, 1999, 2000, 32_000]).prop_map(Happens::PassMs),
    ]
}

async fn play(script: Vec<Happens>) {
    let mut stage = stage(in_threes()).await;
    let steps = stage.steps.clone();
    let end = |step| {
        // A worker whose thread was stuck takes no more steps, and has no run to end.
        let _ = steps.send(step);
    };
    let mut asked: Vec<(usize, Asked)> = Vec::new();
    for happens in script {
        match happens {
            Happens::Ask(camera) => asked.push((camera, stage.ask(camera))),
            Happens::AskSpare => {
                let worker = stage.worker.clone();
                let picture = (Asker(SPARE), Arc::default());
                let spare = tokio::spawn(async move { worker.run(None, picture).await });
                asked.push((SPARE, spare));
            }
            Happens::GiveUp(which) if !asked.is_empty() => which.get(&asked).1.abort(),
            Happens::GiveUp(_) => {}
            Happens::End(step) => end(step),
            Happens::PassMs(ms) => pass(Duration::from_millis(ms)).await,
        }
        settle().await;
    }
    for _ in &asked {
        end(Step::Answer);
    }
    let is_over = |asked: &[(usize, Asked)]| asked.iter().all(|(_, answer)| answer.is_finished());
    // An abandoned picture is among the waiting until the worker looks at its queue again.
    while !is_over(&asked) || stage.counts().waiting > 0 {
        pass(Duration::from_millis(100)).await;
    }
    let mut well = 0;
    let mut spare = 0;
    let mut refused = 0;
    let mut stopped = 0;
    let mut gave_up = 0;
    for (camera, answer) in asked {
        match answer.await {
            Ok(Ok(answer)) => {
                assert_eq!(answer.output, Asker(camera), "another one's answer");
                if camera == SPARE {
                    spare += 1;
                } else {
                    well += 1;
                }
            }
            // A spare picture that is refused is not counted.
            Ok(Err(RunError::Unavailable(_))) if camera == SPARE => {}
            Ok(Err(RunError::Unavailable(_))) => refused += 1,
            // Refused; counted only while the worker's task runs.
            Ok(Err(RunError::Stopped)) => stopped += 1,
            Ok(Err(_)) => {}
            // One that did not get its picture back has panicked instead (`Stage::ask`).
            Err(aborted) => {
                assert!(aborted.is_cancelled());
                gave_up += 1;
            }
        }
    }
    while let Ok(run) = stage.started.try_recv() {
        let cameras: std::collections::BTreeSet<_> = run.iter().collect();
        assert!(run.len() <= 3, "{run:?}");
        assert_eq!(cameras.len(), run.len(), "{run:?}");
        if run.contains(&Asker(SPARE)) {
            assert_eq!(run.len(), 1, "{run:?}");
        }
    }
    // An abandoned picture may already have been answered or refused.
    let counts = stage.counts();
    for (counted, least, more) in [
        (counts.completed, well, gave_up),
        (counts.spare, spare, gave_up),
        (counts.refused, refused, stopped + gave_up),
        (counts.cancelled, 0, gave_up),
    ] {
        let is_right = (least..=least + more).contains(&counted);
        assert!(is_right, "{least} to {more} more: {counts:?}");
    }
    assert_eq!(counts.waiting, 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn in_any_order_each_caller_gets_one_answer_and_its_own_and_its_picture_back(
        script in prop::collection::vec(happens(), 1..60),
    ) {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .start_paused(true)
            .build()
            .unwrap();
        runtime.block_on(play(script));
    }
}
