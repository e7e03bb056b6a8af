//! The policy of a running program is switched while frames come.

use crate::node_frames::{ask_frame, attachment, pictures, refused};
use crate::support::{Node, json_at, next, subscribe, until, until_read, zenoh_client};
use albireo_wire::{DetectionsMessage, read};
use rstest::rstest;
use serde_json::{Value, json};

const SETTINGS: &str = "power.source = \"none\"\ndetector.timeout_ms = 60000\n\
                        [[camera]]\nname = \"front\"\ndelivery = \"every\"\n";

async fn put(http: &str, body: &Value) -> Value {
    let request = reqwest::Client::new().put(format!("{http}/api/v1/policy"));
    request.body(body.to_string()).send().await.unwrap().json().await.unwrap()
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn one_request_switches_the_policy_while_frames_come_and_it_survives_a_kill() {
    const FRAMES: u64 = 80;
    let model = crate::support::project("tests/fixtures/models/boxes.onnx");
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let settings = format!("detector.model = {model:?}\nnode.state_dir = {state:?}\n{SETTINGS}");
    let node = Node::start_in(folder, &settings).await;
    let session = zenoh_client(&node.zenoh).await;
    let key = "albireo/node/front/detections";
    let mut answers = subscribe(&session, key, |sample| {
        read::<DetectionsMessage>(&sample.payload().to_bytes()).unwrap()
    })
    .await;
    until_read(&session, "node", "front").await;
    let pictures = pictures(8);
    let sending = tokio::spawn(async move {
        for (seq, picture) in (0..FRAMES).zip(pictures.iter().cycle()) {
            let sent = attachment(seq, None, Some("drive"));
            let reply = ask_frame(&session, "front", picture.clone(), "image/jpeg", sent).await;
            assert_eq!(refused(reply), None);
        }
        session
    });
    let mut names = Vec::new();
    for seq in 0..FRAMES {
        let answer = next(&mut answers).await;
        assert_eq!(answer.seq, seq, "each once and in order");
        names.push(answer.threshold.unwrap().name.to_string());
        if seq == FRAMES / 2 {
            let now = put(&node.http, &json!({"name": "expected-loss"})).await;
            assert_eq!(now["name"], "expected-loss");
        }
    }
    let session = sending.await.unwrap();
    let of_albireo = names.iter().take_while(|name| *name == "u").count();
    assert!(of_albireo > 40 && of_albireo < 80, "{of_albireo}");
    assert!(names[of_albireo..].iter().all(|name| name == "lambda"));

    // Another clip ends the one with the switch.
    let sent = attachment(FRAMES, None, Some("next"));
    let picture = self::pictures(1).remove(0);
    ask_frame(&session, "front", picture, "image/jpeg", sent).await;
    let clips = format!("{}/api/v1/clips", node.http);
    let reports = async || json_at(&clips).await["clips"].as_array().unwrap().clone();
    until("both reports", async || reports().await.len() == 2).await;
    let mut told = Vec::new();
    for report in reports().await.iter().rev() {
        let part = report["part"].as_u64().unwrap_or(0);
        told.push(json!([report["policy"], part, report["frames"]]));
    }
    let after = FRAMES - of_albireo as u64;
    assert_eq!(
        told,
        [
            json!(["albireo", 0, of_albireo]),
            json!(["expected-loss", 1, after])
        ]
    );

    let folder = node.kill().await;
    let node = Node::start_in(folder, &settings).await;
    let kept = json_at(&format!("{}/api/v1/policy", node.http)).await;
    assert_eq!(kept["name"], "expected-loss");
    assert_eq!(kept["configured"], "albireo");
    node.kill().await;
}
