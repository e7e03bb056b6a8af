//! Reads the body of a request that sets something, and sets it outside the async workers.

use albireo_service::http::Problem;
use axum::body::Bytes;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::fmt::Display;

/// Reads the message in a request. `expected` describes it for the error text.
pub(super) fn message<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: &Bytes,
    expected: &str,
) -> Result<T, Problem> {
    let sent = headers
        .get(CONTENT_TYPE)
        .map_or("", |value| value.to_str().unwrap_or("unreadable"));
    let media_type = sent.split(';').next().unwrap_or_default().trim();
    // No content type and curl's default one are also accepted: a page of another origin cannot send a PUT without a
    // preflight, regardless of its content type.
    let accepted = ["", "application/json", "application/x-www-form-urlencoded"];
    if !accepted.iter().any(|accepted| media_type.eq_ignore_ascii_case(accepted)) {
        let detail = format!(
            "the content type must be `application/json`, and is `{sent}`; with curl: -H 'content-type: application/json'"
        );
        let problem = Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, detail);
        return Err(problem.allowing(["application/json"]));
    }
    let fault = |status, what: &dyn Display| {
        Problem::new(status, format!("the body must be {expected}: {what}"))
    };
    let no_json = |error| fault(StatusCode::BAD_REQUEST, &error);
    serde_json::from_slice::<Value>(body).map_err(no_json)?;
    // From here on it is JSON, and only its content can be wrong.
    let not_this = |what: &dyn Display| fault(StatusCode::UNPROCESSABLE_ENTITY, what);
    // Serde would also accept a list of the fields' values.
    if !body.trim_ascii_start().starts_with(b"{") {
        return Err(not_this(&"it is not a JSON object"));
    }
    serde_json::from_slice(body).map_err(|error| not_this(&error))
}

/// Runs a change on a blocking thread, because it writes a file, which can take a while on a slow SD card.
pub(super) async fn off_the_runtime<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}
