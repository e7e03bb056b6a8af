use super::*;
use serde_json::Value;

#[tokio::test(start_paused = true)]
async fn a_slow_build_is_logged_periodically_and_waited_for_and_its_failure_is_an_error() {
    let _held = hold_time();
    let file = tempfile::NamedTempFile::new().unwrap();
    let subscriber = tracing_subscriber::fmt()
        .json()
        .flatten_event(true)
        .with_writer(file.reopen().unwrap())
        .finish();
    let _logging = tracing::subscriber::set_default(subscriber);
    let (building, mut is_building) = mpsc::unbounded_channel();
    let (go_on, may_go_on) = blocking::channel::<()>();
    let may_go_on = Mutex::new(may_go_on);
    let build = move || -> Result<Scripted, _> {
        building.send(()).unwrap();
        may_go_on.lock().recv().unwrap();
        Err(StartError::first_run(
            "scripted.onnx".as_ref(),
            "scripted end",
        ))
    };
    let meter = WorkerMeter::default();
    let starting = tokio::spawn(Worker::start(settings(), meter, build, None));
    is_building.recv().await.unwrap();
    settle().await;
    for (seconds, expected) in [
        (9, &[][..]),
        (1, &[10]),
        (9, &[10]),
        (1, &[10, 20]),
        (20, &[10, 20, 40]),
        (39, &[10, 20, 40]),
        (1, &[10, 20, 40, 80]),
    ] {
        pass(Duration::from_secs(seconds)).await;
        let log = std::fs::read_to_string(&file).unwrap();
        let entries = log.lines().map(|line| serde_json::from_str(line).unwrap());
        let is_report = |it: &Value| it["message"].to_string().contains("still being loaded");
        let reports: Vec<Value> = entries.filter(is_report).collect();
        let reported_after = |report: &Value| report["seconds"].as_u64().unwrap();
        let reported: Vec<_> = reports.iter().map(reported_after).collect();
        assert_eq!(reported, expected);
        for report in reports {
            assert_eq!(report["worker"], "scripted");
            assert_eq!(report["level"], "WARN");
        }
    }
    assert!(!starting.is_finished());
    go_on.send(()).unwrap();
    let error = starting.await.unwrap().err().unwrap();
    assert!(error.to_string().contains("scripted end"), "{error}");
}
