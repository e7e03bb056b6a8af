//! What the cameras see reaches others: a receiver of hooks that fails at first, and an MQTT broker.

use crate::support::{Node, albireo, free_port, json_at, process};
use serde_json::Value;
use std::process::Stdio;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpListener;

/// Takes one request and answers it with this status; returns its body.
async fn answer(listener: &TcpListener, status: &str) -> Value {
    let (stream, _) = listener.accept().await.unwrap();
    let mut stream = BufReader::new(stream);
    let mut length = 0;
    loop {
        let mut line = String::new();
        stream.read_line(&mut line).await.unwrap();
        if let Some(rest) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = rest.trim().parse().unwrap();
        }
        if line.trim().is_empty() {
            break;
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).await.unwrap();
    let head = format!("HTTP/1.1 {status}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).await.unwrap();
    serde_json::from_slice(&body).unwrap()
}

#[rstest::rstest]
#[tokio::test]
#[ignore = "needs ONNX Runtime and Mosquitto"]
async fn a_car_on_the_recorded_road_is_told_to_a_hook_and_to_a_broker() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let hook = listener.local_addr().unwrap();
    let port = free_port().to_string();
    let mut broker = process("mosquitto");
    let _broker = broker.args(["-p", &port]).stderr(Stdio::null()).spawn().unwrap();
    let settings = format!(
        "node.name = \"house\"\nsightings = {{ appear_s = 0.0, leave_s = 0.0 }}\nmqtt.broker = \"mqtt://127.0.0.1:{port}\"\n\
         [[hook]]\nurl = \"http://ann:s3cret@{hook}/k3y\"\nclasses = [\"car\"]\n[[camera]]\nname = \"front\"\n"
    );
    let node = Node::start(&settings).await;
    let mut replay = albireo();
    replay.args([
        "replay",
        "demo",
        "--loop",
        "--node",
        "house",
        "--connect",
        &node.zenoh,
    ]);
    let _road = replay.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();

    let first = answer(&listener, "503 Service Unavailable").await;
    assert_eq!(first["class"], "car");
    assert_eq!(first["event"], "appeared");
    let second = answer(&listener, "500 Internal Server Error").await;
    assert_eq!(second, first);
    let third = answer(&listener, "204 No Content").await;
    assert_eq!(third, first);
    let next = answer(&listener, "204 No Content").await;
    assert_ne!(
        next["event"], first["event"],
        "a class that appeared leaves: {next}"
    );

    let mut client = process("mosquitto_sub");
    client
        .args(["-p", &port, "-v", "-t", "albireo/house/front/#"])
        .stdout(Stdio::piped());
    let mut client = client.spawn().unwrap();
    let mut lines = BufReader::new(client.stdout.take().unwrap()).lines();
    let mut wanted = vec![
        "/class/car ON",
        "/class/car/count 1",
        "/event {",
        "/availability online",
    ];
    while !wanted.is_empty() {
        let line = lines.next_line().await.unwrap().expect("the broker runs");
        wanted.retain(|part| !line.contains(part));
    }
    let overview = json_at(&format!("{}/api/v1/node", node.http)).await;
    let mqtt = &overview["forwarded"][0];
    let hook = &overview["forwarded"][1];
    assert!(mqtt["sent"].as_u64() > Some(0), "{overview}");
    assert_eq!(hook["failed"], 2, "{overview}");
    let log = node.stop_well().await.log;
    for secret in ["s3cret", "k3y"] {
        assert!(!overview.to_string().contains(secret), "{overview}");
        assert!(!log.contains(secret), "{log}");
    }
}
