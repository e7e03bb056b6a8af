//! Reads the body of a change request, and makes the change outside the async workers.

use albireo_service::http::{BODY_LIMIT, Problem};
use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use serde::de::DeserializeOwned;

/// Reads the message in a request. `expected` describes it for the error text.
pub(super) fn message<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: Result<Bytes, BytesRejection>,
    expected: &str,
) -> Result<T, Problem> {
    let name = headers
        .get(CONTENT_TYPE)
        .map(|value| value.to_str().unwrap_or("unreadable"));
    let media_type = name
        .and_then(|name| name.split(';').next())
        .unwrap_or_default()
        .trim();
    // No content type and curl's default one are also accepted: a page of another origin cannot send a PUT without a
    // preflight, regardless of its content type.
    let accepted = ["", "application/json", "application/x-www-form-urlencoded"];
    if !accepted
        .iter()
        .any(|accepted| media_type.eq_ignore_ascii_case(accepted))
    {
        let sent = name.map_or_else(|| "none".to_owned(), |name| format!("`{name}`"));
        return Err(Problem::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            format!(
                "the content type must be `application/json`, and is {sent}; with curl: -H 'content-type: application/json'"
            ),
        )
        .allowing(["application/json"]));
    }
    let body = body.map_err(|rejection| {
        let status = rejection.status();
        let detail = if status == StatusCode::PAYLOAD_TOO_LARGE {
            format!("the body must have at most {BODY_LIMIT} bytes")
        } else {
            rejection.body_text()
        };
        Problem::new(status, detail)
    })?;
    let fault =
        |status, what: &str| Problem::new(status, format!("the body must be {expected}: {what}"));
    let message = Json::from_bytes(&body);
    let Json(message) = message.map_err(|error| fault(error.status(), &error.body_text()))?;
    // Serde also accepts a list of the fields' values.
    if !body.trim_ascii_start().starts_with(b"{") {
        let what = "it is not a JSON object";
        return Err(fault(StatusCode::UNPROCESSABLE_ENTITY, what));
    }
    Ok(message)
}

/// Runs a change on a blocking thread, because it writes a file, which can take a while on a slow SD card.
pub(super) async fn off_the_runtime<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work).await.map_err(|error| {
        Problem::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            format!("the change failed: {error}"),
        )
    })
}
