//! Who may use the interface: bearer tokens (RFC 6750), and without one only this machine.

use super::HttpError;
use super::Problem;
use crate::config::{HttpConfig, Token};
use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, HOST, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use subtle::ConstantTimeEq;
use tokio::net::TcpListener;

/// Open to all: whether the node lives and works, and the page, which asks for the token itself.
const OPEN: [&str; 3] = ["/", "/healthz", "/readyz"];

/// Why a token file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// It cannot be read.
    #[error("http.token_file {file}: {source}")]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Its first line is no token.
    #[error("http.token_file {file}: the first line {fault}")]
    Unusable {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        fault: &'static str,
    },
}

/// Decides who may pass.
#[derive(Clone)]
pub(super) struct Guard(Arc<Rule>);

enum Rule {
    /// Requests must carry the token.
    Token(Token),
    /// Only programs of this machine reach the listener. A web page could still have its own name point
    /// to this machine (DNS rebinding) and so be let in by the browser; the `Host` it was called by
    /// tells.
    ThisMachine,
    /// Anybody, as the configuration says.
    Anybody,
}

impl Guard {
    /// The rule for that configuration on that listener.
    ///
    /// # Errors
    /// [`HttpError`] when the token file cannot be used, or other machines reach the listener without a
    /// token.
    pub(crate) fn new(config: &HttpConfig, listener: &TcpListener) -> Result<Self, HttpError> {
        let address = listener.local_addr().map_err(HttpError::Listener)?;
        let rule = if let Some(token) = token(config)? {
            Rule::Token(token)
        } else if config.allow_unauthenticated {
            Rule::Anybody
        } else if address.ip().is_loopback() {
            Rule::ThisMachine
        } else {
            return Err(HttpError::Unprotected { address });
        };
        Ok(Self(Arc::new(rule)))
    }

    /// The answer to a request that may not pass.
    fn refuse(&self, uri: &Uri, headers: &HeaderMap) -> Option<Response> {
        match &*self.0 {
            Rule::Anybody => None,
            Rule::ThisMachine if called_by_address(uri, headers) => None,
            Rule::ThisMachine => Some(Problem::new(
                StatusCode::MISDIRECTED_REQUEST,
                "without a token this interface answers only when called by address or as `localhost`; \
                 to reach it under another name set a token, or http.allow_unauthenticated = true",
            )
            .into_response()),
            Rule::Token(_) if OPEN.contains(&uri.path()) => None,
            Rule::Token(token) if carries(headers, token) => None,
            Rule::Token(_) => {
                let detail = "this needs the header `Authorization: Bearer TOKEN` with the node's token";
                let mut response = Problem::new(StatusCode::UNAUTHORIZED, detail).into_response();
                response
                    .headers_mut()
                    .insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
                Some(response)
            }
        }
    }
}

fn token(config: &HttpConfig) -> Result<Option<Token>, TokenError> {
    let Some(file) = &config.token_file else {
        return Ok(config.token.clone());
    };
    let text = std::fs::read_to_string(file).map_err(|source| TokenError::Unreadable {
        file: file.clone(),
        source,
    })?;
    let token = Token::new(text.lines().next().unwrap_or_default().trim());
    match token.fault() {
        None => Ok(Some(token)),
        Some(fault) => Err(TokenError::Unusable {
            file: file.clone(),
            fault,
        }),
    }
}

fn carries(headers: &HeaderMap, token: &Token) -> bool {
    let Some(sent) = headers
        .get(AUTHORIZATION)
        .and_then(|value| value.as_bytes().split_at_checked(7))
        .and_then(|(scheme, rest)| scheme.eq_ignore_ascii_case(b"bearer ").then_some(rest))
    else {
        return false;
    };
    // In constant time, so that the answer's delay does not tell how many characters were right.
    sent.ct_eq(token.secret().as_bytes()).into()
}

fn called_by_address(uri: &Uri, headers: &HeaderMap) -> bool {
    let host = uri
        .authority()
        .map(|authority| authority.as_str())
        .or_else(|| headers.get(HOST).and_then(|value| value.to_str().ok()));
    // HTTP/1.0 has no Host; no browser sends that.
    let Some(host) = host else { return true };
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok()
}

/// Lets a request pass or answers it.
pub(super) async fn guard(State(guard): State<Guard>, request: Request, next: Next) -> Response {
    match guard.refuse(request.uri(), request.headers()) {
        None => next.run(request).await,
        Some(response) => response,
    }
}
