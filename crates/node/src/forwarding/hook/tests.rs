use super::*;
use crate::settings::tests::{config, prepared};
use axum::Router;
use axum::body::Bytes as Body;
use axum::http::{HeaderMap, Method, Uri};
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

/// The limit of a wait, which a busy machine does not reach.
const PATIENCE: Duration = Duration::from_secs(120);

/// A request that a receiver got.
struct Received {
    headers: HeaderMap,
    path: String,
    sighting: Value,
}

impl Received {
    fn seq(&self) -> u64 {
        self.sighting["seq"].as_u64().unwrap()
    }
}

/// A real HTTP server that answers with these statuses, and then with 204; shows the requests that it got.
struct Receiver {
    url: String,
    requests: UnboundedReceiver<Received>,
}

impl Receiver {
    async fn answering(statuses: &[u16]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let (got, requests) = unbounded_channel();
        let left = Arc::new(parking_lot::Mutex::new(VecDeque::from(statuses.to_vec())));
        let answer = async move |method: Method, uri: Uri, headers: HeaderMap, body: Body| {
            assert_eq!(method, Method::POST);
            let received = Received {
                headers,
                path: uri.to_string(),
                sighting: serde_json::from_slice(&body).unwrap(),
            };
            got.send(received).ok().unwrap();
            let status = left.lock().pop_front().unwrap_or(204);
            StatusCode::from_u16(status).unwrap()
        };
        let routes = Router::new().fallback(answer);
        tokio::spawn(async { axum::serve(listener, routes).await });
        Self { url, requests }
    }

    async fn next(&mut self) -> Received {
        let request = timeout(PATIENCE, self.requests.recv()).await;
        request.expect("in time").expect("the server runs")
    }
}

pub(crate) fn sighting(camera: &str, class: &str, seq: u64) -> Sighting {
    Sighting {
        v: 1,
        node: "node".to_owned(),
        camera: camera.to_owned(),
        class: class.to_owned(),
        event: albireo_wire::SightingEvent::Appeared,
        seq,
        t_ns: 7,
        since_ns: 5,
        count: 1,
        confidence: Some(0.9),
        seconds: None,
    }
}

fn hook(board: &Board, section: &str) -> Hook {
    let config = toml::from_str(section).unwrap();
    let mut hook = Hook::new(config, board, 1).unwrap();
    hook.backoff = Backoff::new(1, 20, 1);
    hook
}

/// What was done with the messages of the only hook.
#[derive(PartialEq)]
struct Counts {
    sent: u64,
    failed: u64,
    dropped: u64,
}

fn counts(board: &Board) -> Counts {
    let counts = board.forwarded().remove(0);
    Counts {
        sent: counts.sent,
        failed: counts.failed,
        dropped: counts.dropped,
    }
}

async fn until(condition: impl Fn() -> bool) {
    let waiting = async {
        while !condition() {
            sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, waiting).await.expect("in time");
}

#[tokio::test]
async fn a_receiver_that_fails_twice_gets_each_sighting_once_it_accepts_and_in_order() {
    let mut receiver = Receiver::answering(&[503, 500]).await;
    let board = prepared(&config(None, "albireo")).board;
    let url = receiver.url.replace("http://", "http://ann:s3cret@");
    let hook = hook(&board, &format!("url = \"{url}/k3y?t=t0ken\""));
    let stop = CancellationToken::new();
    let running = tokio::spawn(hook.run(stop.clone()));
    let mut seen = Vec::new();
    for seq in 1..=2 {
        board.tell(sighting("front", "car", seq));
    }
    for _ in 0..4 {
        let received = receiver.next().await;
        assert_eq!(received.path, "/k3y?t=t0ken");
        assert_eq!(received.headers[CONTENT_TYPE], "application/json");
        assert_eq!(received.headers[AUTHORIZATION], "Basic YW5uOnMzY3JldA==");
        seen.push(received.seq());
        if seen.len() == 2 {
            let reasons = board.readiness.health().status().reasons;
            let shown = format!("{reasons:?} {:?}", board.forwarded());
            assert!(
                shown.contains("answered 503 Service Unavailable"),
                "{shown}"
            );
            for secret in ["ann", "s3cret", "k3y", "t0ken"] {
                assert!(!shown.contains(secret), "{shown}");
            }
        }
    }
    assert_eq!(seen, [1, 1, 1, 2]);
    let expected = Counts {
        sent: 2,
        failed: 2,
        dropped: 0,
    };
    until(|| counts(&board) == expected).await;
    assert!(!board.readiness.health().status().reasons.contains_key("hooks"));
    stop.cancel();
    running.await.unwrap();
}

#[tokio::test]
async fn a_hook_is_told_of_its_cameras_and_classes_alone() {
    let mut receiver = Receiver::answering(&[]).await;
    let board = prepared(&config(None, "albireo")).board;
    let url = &receiver.url;
    let filter = "cameras = [\"front\"]\nclasses = [\"car\"]";
    let hook = hook(&board, &format!("url = \"{url}\"\n{filter}"));
    let stop = CancellationToken::new();
    tokio::spawn(hook.run(stop.clone()));
    board.tell(sighting("rear", "car", 1));
    board.tell(sighting("front", "bus", 2));
    board.tell(sighting("front", "car", 3));
    let received = receiver.next().await;
    assert_eq!(received.path, "/");
    assert_eq!(received.seq(), 3);
    stop.cancel();
}

#[tokio::test]
async fn a_post_that_is_refused_for_good_is_dropped_and_the_next_one_is_sent() {
    let mut receiver = Receiver::answering(&[404, 429]).await;
    let board = prepared(&config(None, "albireo")).board;
    let hook = hook(&board, &format!("url = \"{}\"", receiver.url));
    let stop = CancellationToken::new();
    tokio::spawn(hook.run(stop.clone()));
    board.tell(sighting("front", "car", 1));
    board.tell(sighting("front", "car", 2));
    let mut seen = Vec::new();
    for _ in 0..3 {
        seen.push(receiver.next().await.seq());
    }
    assert_eq!(seen, [1, 2, 2]);
    let expected = Counts {
        sent: 1,
        failed: 2,
        dropped: 1,
    };
    until(|| counts(&board) == expected).await;
    stop.cancel();
}

#[tokio::test]
async fn while_nobody_listens_the_oldest_are_dropped_and_counted() {
    let board = prepared(&config(None, "albireo")).board;
    // Nothing listens there.
    let mut hook = hook(&board, "url = \"http://127.0.0.1:1\"");
    for seq in 0..MOST_WAITING as u64 + 3 {
        hook.take(Arc::new(sighting("front", "car", seq)));
    }
    assert_eq!(hook.waiting.front().unwrap().seq, 3);
    let stop = CancellationToken::new();
    let running = tokio::spawn(hook.run(stop.clone()));
    until(|| counts(&board).failed > 0).await;
    let health = board.readiness.health();
    assert_eq!(
        health.state(),
        albireo_wire::HealthState::NotReady,
        "of other parts"
    );
    let reason = &health.status().reasons["hooks"];
    assert_eq!(
        reason,
        "http://127.0.0.1:1: refuses the connection: nothing listens there"
    );
    let fault = health.faults.iter().find(|fault| fault.part == readiness::HOOKS).unwrap();
    assert_eq!(fault.fault.effect, albireo_wire::HealthState::Degraded);
    stop.cancel();
    running.await.unwrap();
    let counts = counts(&board);
    assert_eq!(counts.sent, 0);
    let all = 3 + MOST_WAITING as u64;
    assert_eq!(counts.dropped, all, "those that waited, too");
}
