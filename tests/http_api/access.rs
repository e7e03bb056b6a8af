use super::served::{KNOB, Served, board, problem};
use albireo_node::api::http::{NodeView, router};
use albireo_service::config::{HttpConfig, Token};
use albireo_service::http::{self, HttpError};
use albireo_vision::picture::FrameLimits;
use reqwest::{Method, StatusCode};
use rstest::rstest;
use std::path::PathBuf;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

fn with_token() -> HttpConfig {
    HttpConfig {
        token: Some(Token::new("a-long-random-secret")),
        ..HttpConfig::default()
    }
}

#[tokio::test]
async fn with_a_token_all_but_health_and_the_page_needs_it() {
    let node = Served::with(with_token(), Some(KNOB)).await;
    node.ready();
    for path in [
        "/",
        "/healthz",
        "/readyz",
        "/openapi.json",
        "/docs/",
        "/api/v1/caller",
    ] {
        assert_eq!(node.get(path).await.status(), StatusCode::OK, "{path}");
    }
    for path in [
        "/metrics",
        "/api/v1/threshold",
        "/api/v1/events",
        "/api/v1/cameras/front/frame.jpg",
        "/nothing",
    ] {
        let response = node.get(path).await;
        assert_eq!(response.headers()["www-authenticate"], "Bearer", "{path}");
        problem(response, 401).await;
    }
    problem(node.put("/api/v1/threshold", r#"{"u": 5e-4}"#).await, 401).await;
    assert_eq!(node.board.cameras()[0].threshold(), Some(KNOB.default));
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
async fn only_the_whole_token_passes(#[case] value: &str, #[case] status: u16) {
    let node = Served::with(with_token(), Some(KNOB)).await;
    let request = node.request(Method::GET, "/api/v1/threshold");
    let answer = request.header("authorization", value).send().await.unwrap();
    assert_eq!(answer.status(), status);
}

#[tokio::test]
async fn the_token_file_gives_the_token() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    std::fs::write(&file, "a-token-of-the-file\nsecond line\n").unwrap();
    let config = HttpConfig {
        token_file: Some(file),
        ..HttpConfig::default()
    };
    let node = Served::with(config, Some(KNOB)).await;
    let request = node.request(Method::GET, "/metrics");
    let response = request
        .bearer_auth("a-token-of-the-file")
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    problem(node.get("/metrics").await, 401).await;
}

#[tokio::test]
async fn a_token_is_exchanged_by_its_file_without_a_restart_and_a_bad_one_leaves_the_good() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    std::fs::write(&file, "the-first-token-of-all\n").unwrap();
    let config = HttpConfig {
        token_file: Some(file.clone()),
        ..HttpConfig::default()
    };
    let node = Served::with(config, Some(KNOB)).await;
    let status = async |token: &str| {
        let request = node.request(Method::GET, "/metrics").bearer_auth(token);
        request.send().await.unwrap().status()
    };
    let until = async |token: &str, wanted: StatusCode| {
        let until = tokio::time::Instant::now() + crate::support::PATIENCE;
        while status(token).await != wanted {
            assert!(
                tokio::time::Instant::now() < until,
                "{token}: never {wanted}"
            );
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    assert_eq!(status("the-first-token-of-all").await, StatusCode::OK);
    std::fs::write(&file, "the-second-token-of-all\n").unwrap();
    until("the-second-token-of-all", StatusCode::OK).await;
    assert_eq!(
        status("the-first-token-of-all").await,
        StatusCode::UNAUTHORIZED
    );
    // Fewer than 16 characters: refused, whether at the start or later.
    std::fs::write(&file, "short\n").unwrap();
    std::fs::write(directory.path().join("other"), "short\n").unwrap();
    let config = HttpConfig {
        token_file: Some(directory.path().join("other")),
        ..HttpConfig::default()
    };
    let error = refused("127.0.0.1:0", config).await.unwrap();
    assert!(error.to_string().contains("fewer than 16"), "{error}");
    tokio::time::sleep(std::time::Duration::from_millis(2500)).await;
    assert_eq!(status("the-second-token-of-all").await, StatusCode::OK);
    assert_eq!(status("short").await, StatusCode::UNAUTHORIZED);
    std::fs::write(&file, "the-third-token-of-all\n").unwrap();
    until("the-third-token-of-all", StatusCode::OK).await;
}

async fn refused(address: &str, config: HttpConfig) -> Option<HttpError> {
    let listener = TcpListener::bind(address).await.unwrap();
    let (board, _detector) = board(Some(KNOB), None);
    let view = NodeView {
        board,
        limits: FrameLimits::default(),
        config: std::sync::Arc::new(serde_json::Value::Null),
    };
    let shutdown = CancellationToken::new();
    // Already over: a service that is not refused ends at once.
    shutdown.cancel();
    http::run(&config, router(view, shutdown.clone()), listener, shutdown)
        .await
        .err()
}

#[tokio::test]
async fn an_address_that_others_reach_is_not_served_without_a_token_or_a_word() {
    let error = refused("0.0.0.0:0", HttpConfig::default()).await.unwrap();
    assert!(matches!(error, HttpError::Unprotected { .. }), "{error}");
    assert!(error.to_string().contains("allow_unauthenticated"));
    assert!(refused("0.0.0.0:0", with_token()).await.is_none());
    let anybody = HttpConfig {
        allow_unauthenticated: true,
        ..HttpConfig::default()
    };
    assert!(refused("0.0.0.0:0", anybody).await.is_none());
    assert!(
        refused("127.0.0.1:0", HttpConfig::default())
            .await
            .is_none()
    );
}

#[tokio::test]
async fn a_token_file_that_is_missing_or_empty_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let empty = directory.path().join("empty");
    std::fs::write(&empty, "\n").unwrap();
    for file in [PathBuf::from("/nowhere/token"), empty] {
        let config = HttpConfig {
            token_file: Some(file.clone()),
            ..HttpConfig::default()
        };
        let error = refused("127.0.0.1:0", config).await.unwrap();
        assert!(matches!(error, HttpError::Token(_)), "{error}");
        assert!(
            error.to_string().contains(file.to_str().unwrap()),
            "{error}"
        );
    }
}

#[tokio::test]
async fn without_a_token_a_page_that_points_its_own_name_here_is_not_let_in() {
    let node = Served::start().await;
    for (host, status) in [
        ("evil.example", 421),
        ("evil.example:8080", 421),
        ("localhost.evil.example:8080", 421),
        ("127.0.0.1.evil.example", 421),
        ("localhost:8080", 200),
        ("LOCALHOST", 200),
        ("127.0.0.1", 200),
        ("[::1]:8080", 200),
        ("[::1].evil.example", 421),
        ("localhost:80@evil", 421),
        ("192.168.1.7:8080", 200),
    ] {
        let response = node
            .request(Method::GET, "/api/v1/threshold")
            .header("host", host)
            .send()
            .await
            .unwrap();
        assert_eq!(response.status().as_u16(), status, "{host}");
    }
}

#[tokio::test]
async fn other_web_origins_are_let_in_only_when_named() {
    let preflight = |node: &Served, origin: &str| {
        node.request(Method::OPTIONS, "/api/v1/threshold")
            .header("origin", origin)
            .header("access-control-request-method", "PUT")
            .header("access-control-request-headers", "content-type")
            .send()
    };
    let closed = Served::start().await;
    let response = preflight(&closed, "https://fleet.example").await.unwrap();
    assert!(
        !response
            .headers()
            .contains_key("access-control-allow-origin")
    );
    let mut config = with_token();
    config.cors_origins = vec!["https://fleet.example".to_owned()];
    let open = Served::with(config, Some(KNOB)).await;
    let response = preflight(&open, "https://fleet.example").await.unwrap();
    assert_eq!(
        response.headers()["access-control-allow-origin"],
        "https://fleet.example"
    );
    // As the node has them, and no other.
    let methods = response.headers()["access-control-allow-methods"].to_str();
    assert_eq!(methods.unwrap(), "GET,PUT");
    let response = preflight(&open, "https://evil.example").await.unwrap();
    assert!(
        !response
            .headers()
            .contains_key("access-control-allow-origin")
    );
}
