use super::served::{Served, THRESHOLD, board, problem};
use crate::support::{assert_contains, until};
use albireo_node::api::http::router;
use albireo_node::config::NodeConfig;
use albireo_service::config::{HttpConfig, Token};
use albireo_service::http::{self, HttpError};
use reqwest::Method;
use rstest::rstest;
use std::path::PathBuf;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub(super) const TOKEN: &str = "a-long-random-secret";

pub(super) fn with_token() -> HttpConfig {
    HttpConfig {
        token: Some(Token::new(TOKEN)),
        ..HttpConfig::default()
    }
}

fn with_file(file: PathBuf) -> HttpConfig {
    HttpConfig {
        token_file: Some(file),
        ..HttpConfig::default()
    }
}

#[tokio::test]
async fn a_token_protects_everything_except_health_and_the_page() {
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
}

#[rstest]
#[case("Bearer a-long-random-secret", 200)]
#[case("bearer a-long-random-secret", 200)]
#[case("Bearer a-long-random-secre", 401)]
#[case("Bearer a-long-random-secret1", 401)]
#[case("Bearer A-long-random-secret", 401)]
#[case("Bearer ", 401)]
#[case("Bearer", 401)]
#[case("Basic a-long-random-secret", 401)]
#[case("a-long-random-secret", 401)]
#[tokio::test]
async fn only_the_exact_token_is_accepted(#[case] value: &str, #[case] status: u16) {
    let node = Served::with(with_token()).await;
    let request = node.request(Method::GET, "/api/v1/threshold");
    let answer = request.header("authorization", value).send().await.unwrap();
    assert_eq!(answer.status(), status);
}

#[tokio::test]
async fn a_token_file_is_reloaded_without_a_restart_and_an_invalid_one_keeps_the_old_token() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    let write = |text: &str| std::fs::write(&file, text).unwrap();
    write("the-first-token-of-all\nsecond line\n");
    let node = Served::with(with_file(file.clone())).await;
    let status = async |token: &str| {
        let request = node.request(Method::GET, "/metrics").bearer_auth(token);
        request.send().await.unwrap().status().as_u16()
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

async fn refused(address: &str, config: HttpConfig) -> Option<HttpError> {
    let listener = TcpListener::bind(address).await.unwrap();
    let board = board("albireo", None);
    let shutdown = CancellationToken::new();
    // Cancelled beforehand: a service that starts stops at once.
    shutdown.cancel();
    let router = router(board, &NodeConfig::default(), shutdown.clone());
    let served = http::run(&config, &[], &[], router, listener, shutdown);
    served.await.err()
}

#[tokio::test]
async fn an_address_open_to_others_needs_a_token_or_explicit_permission() {
    let error = refused("0.0.0.0:0", HttpConfig::default()).await.unwrap();
    assert!(matches!(error, HttpError::Unprotected { .. }), "{error}");
    assert!(error.to_string().contains("allow_unauthenticated"));
    assert!(refused("0.0.0.0:0", with_token()).await.is_none());
    let anybody = HttpConfig {
        allow_unauthenticated: true,
        ..HttpConfig::default()
    };
    assert!(refused("0.0.0.0:0", anybody).await.is_none());
    let local = refused("127.0.0.1:0", HttpConfig::default()).await;
    assert!(local.is_none());
}

#[rstest]
#[case::missing(None, "token")]
#[case::empty(Some("\n"), "token")]
#[case::short(Some("short\n"), "fewer than 16")]
#[tokio::test]
async fn an_unusable_token_file_is_rejected(#[case] content: Option<&str>, #[case] said: &str) {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    if let Some(content) = content {
        std::fs::write(&file, content).unwrap();
    }
    let error = refused("127.0.0.1:0", with_file(file.clone()))
        .await
        .unwrap();
    assert!(matches!(error, HttpError::Token(_)), "{error}");
    assert_contains(&error.to_string(), &[file.to_str().unwrap(), said]);
}

#[tokio::test]
async fn without_a_token_dns_rebinding_is_rejected() {
    let node = Served::start().await;
    for (host, status) in [
        ("evil.example:8080", 421),
        ("localhost.evil.example:8080", 421),
        ("localhost:8080", 200),
        ("192.168.1.7:8080", 200),
    ] {
        let request = node.request(Method::GET, "/api/v1/threshold");
        let answer = request.header("host", host).send().await.unwrap();
        assert_eq!(answer.status(), status, "{host}");
    }
}

#[tokio::test]
async fn other_web_origins_are_allowed_only_when_configured() {
    const ALLOWED: &str = "access-control-allow-origin";
    let preflight = async |node: &Served, origin: &str| {
        let request = node.request(Method::OPTIONS, "/api/v1/threshold");
        let request = request
            .header("origin", origin)
            .header("access-control-request-method", "PUT")
            .header("access-control-request-headers", "content-type");
        request.send().await.unwrap().headers().clone()
    };
    let closed = Served::start().await;
    let headers = preflight(&closed, "https://fleet.example").await;
    assert!(!headers.contains_key(ALLOWED));
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
