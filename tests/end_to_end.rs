//! A clip end to end through real processes: `albireo node`, `albireo replay`, and a client that shares no code with them.

use crate::support::{Client, Node, replay, shared, value_of};
use std::collections::BTreeSet;

#[rstest::rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ../shared and ONNX Runtime and Python and ffmpeg"]
async fn shared_every_frame_of_a_clip_is_answered_or_reported_as_dropped() {
    let model = shared("models/yolox_nano_416.onnx");
    let settings = format!(
        "node.name = \"bench\"\ndetector.model = {model:?}\ndetector.timeout_ms = 30000\n\
         policy.name = \"albireo\"\npolicy.u = 5e-4\nclip.silence_s = 6.0\n\
         [[camera]]\nname = \"front\"\ndelivery = \"every\"\n# development: ring=4\n"
    );
    let node = Node::start(&settings).await;
    let mut client = Client::listen(&node.zenoh, "albireo/bench/front/*").await;
    let video = shared("media/highway_two_cars.mp4");
    let clip = ["--node", "bench", "--clip", "two-cars"];
    replay(&node, video.to_str().unwrap(), &clip).await;
    let mut detections = Vec::new();
    let report = loop {
        let (key, message) = client.next().await.expect("the client goes on");
        match key.rsplit('/').next() {
            Some("detections") => detections.push(message),
            Some("clip") if message["clip"] == "two-cars" => break message,
            _ => {}
        }
    };

    let dropped = report["dropped"].as_object().unwrap().values();
    let dropped: u64 = dropped.map(|number| number.as_u64().unwrap()).sum();
    assert_eq!(report["frames"], detections.len(), "{report}");
    assert_eq!(detections.len() as u64 + dropped, 251, "{report}");
    let numbers: BTreeSet<_> = detections.iter().map(|d| d["seq"].as_u64()).collect();
    let answered = detections.len();
    assert_eq!(numbers.len(), answered, "every frame is answered once");

    for (state, count) in report["states"].as_object().expect("five counters") {
        let found = detections.iter().filter(|one| one["state"] == **state).count();
        assert_eq!(*count, found, "{state}");
        let may_be_missing = ["E", "E+I"].contains(&&**state);
        assert!(found > 0 || may_be_missing, "no {state} in {report}");
    }
    assert!(report["energy"]["joules"].as_f64().unwrap() > 0.0);

    // A client that comes late gets the report from the publisher's cache.
    let mut late = Client::listen_with_history(&node.zenoh, "albireo/bench/front/clip").await;
    let (_, kept) = late.next().await.expect("the cache answers");
    assert_eq!(kept, report);

    let metrics = node.text("/metrics").await;
    let asked = ["I", "E+I", "AI"].map(|state| report["states"][state].as_u64().unwrap());
    let completed = "albireo_detector_runs_total{outcome=\"completed\"}";
    let runs = value_of(&metrics, completed);
    assert_eq!(runs, asked.iter().sum::<u64>() as f64);

    let took = node.stop_well().await.took;
    assert!(took.as_secs_f64() < 5.0, "ended after {took:?}");
}
