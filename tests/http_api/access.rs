use super::served::{Served, THRESHOLD, prepared, problem};
use crate::support::{assert_contains, until, value_of};
use albireo_node::config::NodeConfig;
use albireo_service::config::HttpConfig;
use albireo_service::http;
use reqwest::Method;
use std::path::Path;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub(super) const TOKEN: &str = "a-long-random-secret";

fn http_config(settings: &str) -> HttpConfig {
    toml::from_str(settings).unwrap()
}

pub(super) fn with_token() -> HttpConfig {
    http_config(&format!("token = {TOKEN:?}"))
}

fn with_file(file: &Path) -> HttpConfig {
    http_config(&format!("token_file = {file:?}"))
}

/// The status of a request with one more header.
async fn status_with(node: &Served, header: &str, value: &str) -> u16 {
    let answer = node
        .request(Method::GET, "/api/v1/threshold")
        .header(header, value)
        .send()
        .await
        .unwrap();
    answer.status().as_u16()
}

#[tokio::test]
async fn only_the_exact_token_opens_everything_besides_health_and_the_page() {
    let node = Served::with(with_token()).await;
    node.ready();
    let open = "/ /healthz /readyz /openapi.json /docs/ /api/v1/caller";
    for path in open.split(' ') {
        assert_eq!(node.get(path).await.status(), 200, "{path}");
    }
    let closed =
        "/metrics /api/v1/threshold /api/v1/events /api/v1/cameras/front/frame.jpg /nothing";
    for path in closed.split(' ') {
        let response = node.get(path).await;
        assert_eq!(response.headers()["www-authenticate"], "Bearer", "{path}");
        problem(response, 401).await;
    }
    problem(node.put("/api/v1/threshold", r#"{"u": 5e-4}"#).await, 401).await;
    assert_eq!(node.front().threshold(), Some(THRESHOLD.default));
    for (value, status) in [
        ("Bearer a-long-random-secret", 200),
        ("bearer a-long-random-secret", 200),
        ("Bearer a-long-random-secre", 401),
        ("Bearer a-long-random-secret1", 401),
        ("Bearer A-long-random-secret", 401),
        ("Bearer ", 401),
        ("Bearer", 401),
        ("Basic a-long-random-secret", 401),
        ("a-long-random-secret", 401),
    ] {
        let found = status_with(&node, "authorization", value).await;
        assert_eq!(found, status, "{value}");
    }
    let metrics = node.request(Method::GET, "/metrics").bearer_auth(TOKEN);
    let metrics = metrics.send().await.unwrap().text().await.unwrap();
    // Other tests of this process count, too.
    assert!(value_of(&metrics, "albireo_http_wrong_tokens_total") >= 7.0);
}

#[tokio::test]
async fn browsers_may_not_guess_the_type_of_any_answer() {
    let node = Served::start().await;
    let paths = "/ /healthz /metrics /openapi.json /api/v1/threshold /api/v1/clips /nothing";
    for path in paths.split(' ') {
        let headers = node.get(path).await.headers().clone();
        assert_eq!(headers["x-content-type-options"], "nosniff", "{path}");
    }
}

#[tokio::test]
async fn a_token_file_is_reloaded_without_a_restart_and_an_invalid_one_keeps_the_old_token() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    let write = |text: &str| std::fs::write(&file, text).unwrap();
    write("the-first-token-of-all\nsecond line\n");
    let node = Served::with(with_file(&file)).await;
    let status = async |token: &str| {
        node.request(Method::GET, "/metrics")
            .bearer_auth(token)
            .send()
            .await
            .unwrap()
            .status()
            .as_u16()
    };
    assert_eq!(status("the-first-token-of-all").await, 200);
    node.refused("/metrics", 401).await;
    write("the-second-token-of-all\n");
    let until_accepted = async |token: &str| {
        until(token, async || status(token).await == 200).await;
    };
    until_accepted("the-second-token-of-all").await;
    assert_eq!(status("the-first-token-of-all").await, 401);
    // Fewer than 16 characters. The node reads the file about every second.
    write("short\n");
    tokio::time::sleep(std::time::Duration::from_millis(2500)).await;
    assert_eq!(status("the-second-token-of-all").await, 200);
    assert_eq!(status("short").await, 401);
    write("the-third-token-of-all\n");
    until_accepted("the-third-token-of-all").await;
}

#[tokio::test]
async fn a_node_open_to_others_needs_protection_or_permission_and_a_token_file_a_usable_token() {
    let folder = tempfile::tempdir().unwrap();
    let [empty, short] = [("empty", "\n"), ("short", "short\n")].map(|(name, content)| {
        std::fs::write(folder.path().join(name), content).unwrap();
        with_file(&folder.path().join(name))
    });
    let missing = with_file(&folder.path().join("missing"));
    let anybody = http_config("allow_unauthenticated = true");
    let open = "0.0.0.0:0";
    let local = "127.0.0.1:0";
    for (address, config, said) in [
        (open, HttpConfig::default(), "allow_unauthenticated"),
        (open, with_token(), ""),
        (open, anybody, ""),
        (local, HttpConfig::default(), ""),
        (local, missing, "/missing: No such file"),
        (local, empty, "/empty: the first line is empty"),
        (local, short, "/short: the first line has fewer than 16"),
    ] {
        let listener = TcpListener::bind(address).await.unwrap();
        let shutdown = CancellationToken::new();
        // Cancelled beforehand: a service that starts stops at once.
        shutdown.cancel();
        let node = prepared("albireo", None);
        let router = node.router(&NodeConfig::default(), shutdown.clone());
        let served = http::run(&config, &[], &[], router, listener, shutdown).await;
        let error = served.err().map(|error| error.to_string()).unwrap_or_default();
        assert_eq!(error.is_empty(), said.is_empty(), "{address}: {error}");
        assert_contains(&error, &[said]);
    }
}

#[tokio::test]
async fn dns_rebinding_and_other_web_origins_are_rejected_unless_configured() {
    const ALLOWED: &str = "access-control-allow-origin";
    let preflight = async |node: &Served, origin: &str| {
        let request = node
            .request(Method::OPTIONS, "/api/v1/threshold")
            .header("origin", origin)
            .header("access-control-request-method", "PUT")
            .header("access-control-request-headers", "content-type");
        request.send().await.unwrap().headers().clone()
    };
    let closed = Served::start().await;
    let headers = preflight(&closed, "https://fleet.example").await;
    assert!(!headers.contains_key(ALLOWED));
    for (host, status) in [("evil.example:8080", 421), ("localhost:8080", 200)] {
        assert_eq!(status_with(&closed, "host", host).await, status, "{host}");
    }
    let mut config = with_token();
    config.cors_origins = vec!["https://fleet.example".to_owned()];
    let open = Served::with(config).await;
    let headers = preflight(&open, "https://fleet.example").await;
    assert_eq!(headers[ALLOWED], "https://fleet.example");
    // Exactly the methods of the node.
    assert_eq!(headers["access-control-allow-methods"], "GET,PUT");
    let headers = preflight(&open, "https://evil.example").await;
    assert!(!headers.contains_key(ALLOWED));
}
