use super::served::{Served, answered, clip, frame};
use crate::support::assert_has;
use albireo_core::policy::FrameState;
use albireo_vision::detector::{ExecutionProvider, ModelStatus};
use reqwest::Response;
use rstest::rstest;
use serde_json::{Value, json};
use std::collections::VecDeque;

pub(crate) struct Events {
    response: Response,
    text: String,
}

impl Events {
    pub(crate) fn new(response: Response) -> Self {
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        let text = String::new();
        Self { response, text }
    }

    /// The next event's name and data; `None` at the end of the stream.
    async fn next(&mut self) -> Option<(String, Value)> {
        loop {
            while let Some((event, rest)) = self.text.split_once("\n\n") {
                let field = |name: &str| {
                    event.lines().find_map(|line| line.strip_prefix(name)).map(str::to_owned)
                };
                let name = field("event: ");
                let data = field("data: ");
                self.text = rest.to_owned();
                if let (Some(name), Some(data)) = (name, data) {
                    return Some((name, serde_json::from_str(&data).unwrap()));
                }
            }
            let chunk = self.response.chunk().await.unwrap()?;
            self.text.push_str(std::str::from_utf8(&chunk).unwrap());
        }
    }

    pub(crate) async fn expect(&mut self, name: &str) -> Value {
        let (found, data) = self.next().await.expect("the stream ended");
        assert_eq!(found, name, "{data}");
        data
    }
}

#[rstest]
#[tokio::test]
async fn a_threshold_change_is_sent_to_listeners() {
    let node = Served::start().await;
    let mut events = Events::new(node.get("/api/v1/events?types=threshold&camera=rear").await);
    assert_eq!(events.expect("threshold").await["threshold"]["value"], 3e-4);
    for path in ["/api/v1/cameras/front/threshold", "/api/v1/threshold"] {
        assert!(node.put(path, r#"{"u": 5e-4}"#).await.status().is_success());
    }
    // A change of the other camera alone is not sent.
    let event = events.expect("threshold").await;
    let threshold = json!({"name": "u", "value": 5e-4});
    assert_eq!(event, json!({"camera": "rear", "threshold": threshold}));
}

#[rstest]
#[tokio::test]
async fn the_current_state_comes_first_and_then_each_event_in_order_until_the_node_stops() {
    let node = Served::start().await;
    answered(node.front(), frame(0, FrameState::I));
    let mut events = Events::new(node.get("/api/v1/events").await);
    assert_eq!(events.expect("detector").await["status"], "starting");
    for camera in ["front", "rear"] {
        assert_eq!(events.expect("threshold").await["camera"], camera);
        assert_eq!(events.expect("counters").await["camera"], camera);
    }
    answered(node.front(), frame(1, FrameState::P));
    let event = events.expect("frame").await;
    let expected = json!({"seq": 1, "state": "P", "boxes": [{"class": "car"}]});
    assert_has(&event, &expected);
    node.board.record_clip(clip("front", 3));
    assert_eq!(events.expect("clip").await["count"], 3);
    node.board.publish_counters(5);
    assert_eq!(events.expect("counters").await["frames"], 2);
    assert_eq!(events.expect("counters").await["frames"], 0);
    node.board.set_detector_status(ModelStatus::Degraded {
        reason: "it took too long".to_owned(),
        provider: ExecutionProvider::Cpu,
    });
    let expected = json!({"status": "degraded", "provider": "cpu", "reason": "it took too long"});
    assert_eq!(events.expect("detector").await, expected);
    node.shutdown.cancel();
    assert!(events.next().await.is_none());
    node.task.await.unwrap().unwrap();
}

#[rstest]
#[tokio::test]
async fn a_slow_reader_learns_how_many_events_it_lost() {
    let node = Served::start().await;
    let mut events = Events::new(node.get("/api/v1/events?types=frame").await);
    let camera = node.front();
    // The test runs on one thread, so the stream cannot read in between.
    for seq in 0..3000 {
        answered(camera, frame(seq, FrameState::P));
    }
    let lost = events.expect("lagged").await["lost"].as_u64().unwrap();
    assert_eq!(events.expect("frame").await["seq"], lost);
}

#[rstest]
#[tokio::test]
async fn invalid_filters_are_rejected() {
    let node = Served::start().await;
    let refused = node.refused("/api/v1/events?types=frame,frames", 400).await;
    let allowed = refused["allowed"].as_array().unwrap();
    assert!(allowed.contains(&json!("counters")));
    node.refused("/api/v1/events?camera=roof", 404).await;
    node.refused("/api/v1/events?type=frame", 400).await;
}

#[rstest]
#[tokio::test]
async fn readers_that_hold_all_streams_keep_no_new_reader_out() {
    let node = Served::start().await;
    let mut held = VecDeque::new();
    for _ in 0..64 {
        held.push_back(Events::new(node.get("/api/v1/events?types=detector").await));
    }
    let mut newest = Events::new(node.get("/api/v1/events?types=detector").await);
    newest.expect("detector").await;
    let mut oldest = held.pop_front().unwrap();
    oldest.expect("detector").await;
    assert!(oldest.next().await.is_none(), "the oldest ends");
    let mut second = held.pop_front().unwrap();
    second.expect("detector").await;
    node.board.set_detector_status(ModelStatus::Starting);
    second.expect("detector").await;
}
