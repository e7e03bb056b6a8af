//! Connections that send or read nothing are closed, and never block other clients.

use super::access::{TOKEN, with_token};
use super::served::{Served, answered, frame};
use crate::support::{Node, limit, zenoh_session};
use albireo_core::policy::FrameState;
use albireo_service::config::HttpConfig;
use reqwest::{Method, StatusCode};
use rstest::rstest;
use std::io::ErrorKind;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};

async fn served(idle_timeout_ms: u64, max_connections: usize) -> Served {
    let config = HttpConfig {
        idle_timeout_ms,
        max_connections,
        ..HttpConfig::default()
    };
    Served::with(config).await
}

#[rstest]
#[tokio::test]
async fn a_connection_without_a_complete_request_is_closed() {
    let node = served(300, 256).await;
    let begun = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n";
    // A connection kept open after an answer is closed too.
    let sent = ["", &format!("{begun}X-Slow: "), &format!("{begun}\r\n")];
    for (sent, answered) in sent.into_iter().zip([false, false, true]) {
        let mut connection = TcpStream::connect(node.address).await.unwrap();
        connection.write_all(sent.as_bytes()).await.unwrap();
        let mut said = Vec::new();
        // It ends once the connection is closed.
        connection.read_to_end(&mut said).await.unwrap();
        assert_eq!(said.starts_with(b"HTTP/1.1 200"), answered);
    }
}

#[rstest]
#[tokio::test]
async fn at_the_connection_limit_the_oldest_connection_is_closed_for_a_new_one() {
    // A process may often have no more than 1024 descriptors.
    assert!(HttpConfig::default().max_connections < 400);
    let node = served(600_000, 2).await;
    let mut oldest = node.get("/api/v1/events?types=frame").await;
    let mut newer = node.get("/api/v1/events?types=frame").await;
    assert_eq!(node.get("/healthz").await.status(), StatusCode::OK);
    while let Ok(Some(_)) = oldest.chunk().await {}
    answered(node.front(), frame(7, FrameState::P));
    let heard = async {
        while let Ok(Some(event)) = newer.chunk().await {
            if event.windows(8).any(|bytes| bytes == b"\"seq\":7,") {
                return true;
            }
        }
        false
    };
    assert!(heard.await, "the newer is open");
}

#[rstest]
#[tokio::test]
async fn connections_without_a_valid_token_cut_off_nobody_who_has_one() {
    let config = HttpConfig {
        max_connections: 8,
        ..with_token()
    };
    let node = Served::with(config).await;
    let request = node.request(Method::GET, "/api/v1/events?types=frame");
    let mut stream = request.bearer_auth(TOKEN).send().await.unwrap();
    let mut strangers = Vec::new();
    for number in 0..40 {
        let mut stranger = TcpStream::connect(node.address).await.unwrap();
        // Every second one asks for what needs no token, the others for nothing.
        if number % 2 == 1 {
            let request = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
            stranger.write_all(request).await.unwrap();
        }
        strangers.push(stranger);
    }
    // The last of them is accepted before this request.
    assert_eq!(node.get("/healthz").await.status(), StatusCode::OK);
    answered(node.front(), frame(7, FrameState::P));
    let chunk = stream.chunk().await.unwrap().expect("the stream is open");
    assert!(chunk.starts_with(b"event: frame"), "{chunk:?}");
}

#[rstest]
#[tokio::test]
async fn an_event_stream_that_is_not_read_is_closed() {
    let node = served(300, 256).await;
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let mut deaf = socket.connect(node.address).await.unwrap();
    let request = b"GET /api/v1/events?types=frame HTTP/1.1\r\nHost: localhost\r\n\r\n";
    deaf.write_all(request).await.unwrap();
    let mut begun = [0; 15];
    deaf.read_exact(&mut begun).await.unwrap();
    assert_eq!(&begun, b"HTTP/1.1 200 OK");
    let camera = node.front();
    let mut seq = 0;
    // The server accepts nothing once it has closed the connection. Each packet from here postpones its limit, so one is
    // sent per second.
    let mut sent = Instant::now();
    loop {
        if sent.elapsed() > Duration::from_secs(1) {
            sent = Instant::now();
            match deaf.try_write(b" ") {
                Err(error) if error.kind() != ErrorKind::WouldBlock => break,
                _ => {}
            }
        }
        // Megabytes of events: more than the buffers in between hold.
        for _ in 0..500 {
            answered(camera, frame(seq, FrameState::P));
            seq += 1;
        }
        node.get("/healthz").await;
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn silent_connections_to_the_zenoh_port_keep_no_camera_out() {
    let node = Node::start("[detector]\nmodel = \"tests/fixtures/models/colours.onnx\"\n").await;
    let address = node.zenoh.trim_start_matches("tcp/").to_owned();
    let mut silent = Vec::new();
    for _ in 0..350 {
        silent.push(TcpStream::connect(&address).await.unwrap());
    }
    // One attempt.
    let settings = [
        ("mode", "client".into()),
        ("connect/endpoints", vec![node.zenoh.as_str()].into()),
        ("connect/timeout_ms", 0.into()),
    ];
    let session = zenoh_session(&settings).await.expect("a session");
    session.close().await.unwrap();
    // None of them is kept for long.
    let mut said = [0];
    let ended = silent.last_mut().unwrap().read(&mut said).await;
    assert!(ended.is_err() || ended.is_ok_and(|read| read == 0));
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_thousand_idle_connections_block_no_health_check_and_hold_few_descriptors() {
    let node = Node::start("[detector]\nmodel = \"tests/fixtures/models/colours.onnx\"\n").await;
    limit(node.id(), "--nofile=1024:1024");
    let address = node.http.trim_start_matches("http://").to_owned();
    let mut idle = Vec::new();
    for _ in 0..1100 {
        idle.push(TcpStream::connect(&address).await.unwrap());
    }
    let answer = reqwest::get(format!("{}/healthz", node.http)).await;
    assert_eq!(answer.unwrap().status(), StatusCode::OK);
    let descriptors = std::fs::read_dir(format!("/proc/{}/fd", node.id())).unwrap().count();
    assert!(descriptors < 500, "{descriptors} descriptors");
}
