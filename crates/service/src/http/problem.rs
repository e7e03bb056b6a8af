//! Errors as problem documents (RFC 9457), including the framework's own errors.

use super::serve::BODY_LIMIT;
use albireo_wire::ThresholdSpec;
use axum::body::to_bytes;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::http::header::{ALLOW, CONTENT_LENGTH, CONTENT_TYPE};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Duration;
use utoipa::ToSchema;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, ResponseBuilder};

/// The media type of a problem document.
pub(super) const MEDIA_TYPE: &str = "application/problem+json";

/// An error of a request, and how to correct it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Problem {
    /// Always `about:blank`: the title is the text of the status.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The text of the status.
    title: &'static str,
    /// The HTTP status.
    status: u16,
    /// The error of this request.
    detail: String,
    /// The allowed methods, names or media types.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    allowed: Vec<String>,
    /// The range of the threshold, if the request was about one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<ThresholdSpec>)]
    threshold_spec: Option<Box<ThresholdSpec>>,
}

impl Problem {
    /// Creates a problem with that status.
    pub fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        Self {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Error"),
            status: status.as_u16(),
            detail: detail.into(),
            allowed: Vec::new(),
            threshold_spec: None,
        }
    }

    /// Adds the allowed values.
    pub fn allowing(mut self, allowed: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.allowed = allowed.into_iter().map(Into::into).collect();
        self
    }

    /// Adds the range of the threshold.
    pub fn with_threshold_spec(mut self, spec: ThresholdSpec) -> Self {
        self.threshold_spec = Some(Box::new(spec));
        self
    }
}

/// Checks the types of a selection of events, separated by commas: with an unknown one the stream would be silent for ever.
///
/// # Errors
/// The first type that is not among the `known`.
pub fn check_event_types(types: Option<&str>, known: &[&str]) -> Result<(), Problem> {
    let mut types = types.into_iter().flat_map(|types| types.split(','));
    let Some(unknown) = types.find(|name| !known.contains(name)) else {
        return Ok(());
    };
    let all = known.join(", ");
    let detail = format!("there is no event type `{unknown}`; there are: {all}");
    Err(Problem::new(StatusCode::BAD_REQUEST, detail).allowing(known.iter().copied()))
}

/// Adds to an OpenAPI document what the server adds to every operation: the bearer token, and problem documents as the
/// answers to requests that fail.
pub fn describe(openapi: &mut OpenApi) {
    let token = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).build();
    let components = openapi.components.get_or_insert_default();
    components.add_security_scheme("token", SecurityScheme::Http(token));
    let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem")));
    let problem = ResponseBuilder::new().content(MEDIA_TYPE, content.build()).build();
    for path in openapi.paths.paths.values_mut() {
        let operations = [
            &mut path.get,
            &mut path.put,
            &mut path.post,
            &mut path.delete,
        ];
        for operation in operations.into_iter().flatten() {
            for status in ["4XX", "5XX"] {
                let answers = &mut operation.responses.responses;
                answers.insert(status.to_owned(), problem.clone().into());
            }
        }
    }
}

/// The value of the parameter `name` of a query, if it is in the range.
///
/// # Errors
/// What it must be.
pub fn within<T: Copy + Display + PartialOrd>(
    name: &str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<T, Problem> {
    if range.contains(&value) {
        return Ok(value);
    }
    let (first, last) = range.into_inner();
    let detail = format!("`{name}` must be from {first} to {last}, not {value}");
    Err(Problem::new(StatusCode::BAD_REQUEST, detail))
}

/// Returns a response with a problem document as its body; `body` is a [`Problem`] or one with more members.
pub fn response(status: StatusCode, body: &impl Serialize) -> Response {
    let bytes = serde_json::to_vec(body).unwrap_or_default();
    (status, [(CONTENT_TYPE, MEDIA_TYPE)], bytes).into_response()
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        response(status, &self)
    }
}

/// Turns the framework's errors with a plain text body (wrong method, unreadable query) or without one (unknown path)
/// into problem documents.
pub(super) async fn translate(
    State(time_limit): State<Duration>,
    request: Request,
    next: Next,
) -> Response {
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let response = next.run(request).await;
    let status = response.status();
    let media_type = response.headers().get(CONTENT_TYPE);
    let is_problem = media_type.is_some_and(|value| value == MEDIA_TYPE);
    if is_problem || !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    // The framework's texts are one line. A longer body is not one of them, and the status alone is told.
    let bytes = to_bytes(body, 4096).await.unwrap_or_default();
    let allowed: Vec<_> = parts
        .headers
        .get_all(ALLOW)
        .iter()
        .filter_map(|methods| methods.to_str().ok())
        .flat_map(|methods| methods.split(','))
        .map(str::trim)
        .collect();
    let written = String::from_utf8_lossy(&bytes);
    let text = written.trim();
    let detail = match status {
        StatusCode::PAYLOAD_TOO_LARGE => {
            format!("the body must have at most {BODY_LIMIT} bytes")
        }
        _ if !text.is_empty() => text.to_owned(),
        StatusCode::METHOD_NOT_ALLOWED => {
            let allowed = allowed.join(", ");
            format!("{method} is not allowed here; allowed: {allowed}")
        }
        StatusCode::REQUEST_TIMEOUT => {
            format!("the request did not end within {time_limit:?}")
        }
        StatusCode::NOT_FOUND => {
            format!("there is nothing at {path}; /openapi.json lists all paths")
        }
        _ => status.canonical_reason().unwrap_or("an error").to_owned(),
    };
    let problem = Problem::new(status, detail).allowing(allowed);
    // The answer's other headers stay, such as the list of methods.
    parts.headers.remove(CONTENT_TYPE);
    parts.headers.remove(CONTENT_LENGTH);
    (parts.headers, problem).into_response()
}
