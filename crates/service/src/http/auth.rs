//! Authenticates callers: by bearer token (RFC 6750), or without one only from this machine.

use super::Problem;
use crate::ServiceError;
use crate::config::{ANONYMOUS, HttpConfig, NamedToken, Role, SET_A_TOKEN, Token, first_line};
use crate::rate_limit::RateLimit;
use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderName, ORIGIN, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Version};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use parking_lot::RwLock;
use std::net::{Ipv4Addr, Ipv6Addr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use subtle::ConstantTimeEq;
use tokio::net::TcpListener;

/// Paths open to all: liveness and readiness, the page, which asks for the token itself, and the interface's
/// description with the page that shows it. They are the same wherever this version runs and reveal nothing about this
/// service.
const OPEN: [&str; 6] = [
    "/",
    "/healthz",
    "/readyz",
    "/openapi.json",
    "/docs",
    // Reports only whether the token sent with the request is valid.
    "/api/v1/caller",
];

/// True if a path is open to all.
fn is_open(path: &str) -> bool {
    OPEN.contains(&path) || path.starts_with("/docs/") || path.starts_with(super::page::ASSETS)
}

/// Decides which requests may pass.
#[derive(Clone)]
pub(super) struct Guard {
    rule: Arc<Rule>,
    /// Web origins whose pages may make changes without a token.
    origins: Arc<[String]>,
}

/// The sender of a request, as an extension of the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// Name of the token: `token` for the one in `[http]`, `anonymous` if none is needed.
    pub name: Arc<str>,
    /// The caller's permissions.
    pub role: Role,
}

/// The interval at which the token files are read again.
const READ_EVERY: Duration = Duration::from_secs(1);

static WRONG_TOKEN: RateLimit = RateLimit::new(Duration::from_secs(10));

/// Requests with a wrong token since the start.
static WRONG_TOKENS: AtomicU64 = AtomicU64::new(0);

/// The requests with a wrong token since the start, as `GET /metrics` shows them.
pub(crate) fn wrong_tokens() -> u64 {
    WRONG_TOKENS.load(Ordering::Relaxed)
}

/// Whether a request of a connection was admitted. Where tokens are set, only one with a valid token counts. Clones share it.
#[derive(Clone, Debug, Default)]
pub(super) struct Admitted(Arc<AtomicBool>);

impl Admitted {
    pub(super) fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A token with its holder.
#[derive(Clone, PartialEq)]
struct KnownToken {
    caller: Caller,
    token: Token,
}

enum Rule {
    /// Requests must carry one of the tokens.
    Tokens(RwLock<Vec<KnownToken>>),
    /// Only programs on this machine can reach the listener. A web page could still point its own host name to
    /// this machine (DNS rebinding) and so get past the browser; the `Host` header reveals it.
    ThisMachine,
    /// Anybody, as configured.
    Anybody,
}

impl Guard {
    /// The rule for this configuration and this listener.
    ///
    /// # Errors
    /// [`ServiceError`] if the token file cannot be used, or if other machines can reach the listener without a
    /// token.
    pub(crate) fn new(
        config: &HttpConfig,
        named: &[NamedToken],
        listener: &TcpListener,
    ) -> Result<Self, ServiceError> {
        let address = listener
            .local_addr()
            .map_err(|error| ServiceError(format!("the HTTP listener failed: {error}")))?;
        let tokens = read_tokens(config, named).map_err(ServiceError)?;
        let rule = if !tokens.is_empty() {
            Rule::Tokens(RwLock::new(tokens))
        } else if config.allow_unauthenticated {
            Rule::Anybody
        } else if address.ip().is_loopback() {
            Rule::ThisMachine
        } else {
            let reason = HttpConfig::unprotected(address, SET_A_TOKEN);
            return Err(ServiceError(format!("http.listen: {reason}")));
        };
        Ok(Self {
            rule: Arc::new(rule),
            origins: config.cors_origins.clone().into(),
        })
    }

    /// Applies changes in the token files, so a token is replaced without a restart. If a file becomes invalid, the
    /// last valid tokens stay.
    pub(crate) async fn follow_files(self, config: HttpConfig, named: Vec<NamedToken>) {
        let has_file =
            config.token_file.is_some() || named.iter().any(|token| token.token_file.is_some());
        let tokens = match &*self.rule {
            Rule::Tokens(tokens) if has_file => tokens,
            _ => return,
        };
        let mut fault = None;
        loop {
            tokio::time::sleep(READ_EVERY).await;
            let config = config.clone();
            let named = named.clone();
            let reading = tokio::task::spawn_blocking(move || read_tokens(&config, &named));
            let read = match reading.await {
                Ok(read) => read,
                Err(error) => Err(error.to_string()),
            };
            match read {
                Ok(found) => {
                    fault = None;
                    if *tokens.read() != found {
                        *tokens.write() = found;
                        tracing::info!("a token was replaced");
                    }
                }
                Err(error) if fault.as_ref() == Some(&error) => {}
                Err(error) => {
                    tracing::error!(
                        error,
                        "the token files cannot be used; the previous tokens stay in force"
                    );
                    fault = Some(error);
                }
            }
        }
    }

    /// The caller, or the reason the request may not pass.
    fn admit(&self, request: &Request) -> Result<Caller, Problem> {
        let headers = request.headers();
        let method = request.method();
        let anonymous = |role| Caller {
            name: ANONYMOUS.into(),
            role,
        };
        let only_reads = matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
        let refused = |status, detail: &str| Err(Problem::new(status, detail));
        if let Rule::Tokens(tokens) = &*self.rule {
            let tokens = tokens.read();
            let carried = tokens.iter().find(|known| carries(headers, &known.token));
            if let Some(known) = carried {
                if only_reads || known.caller.role == Role::Tune {
                    return Ok(known.caller.clone());
                }
                let name = &known.caller.name;
                let detail = format!(
                    "the token `{name}` may only read: this needs a token with the role `tune`"
                );
                return refused(StatusCode::FORBIDDEN, &detail);
            }
            if headers.contains_key(AUTHORIZATION) {
                WRONG_TOKENS.fetch_add(1, Ordering::Relaxed);
                WRONG_TOKEN.log(|held_back| {
                    tracing::warn!(held_back, "a request with a wrong token was rejected");
                });
            }
            if is_open(request.uri().path()) {
                return Ok(anonymous(Role::Read));
            }
            return refused(
                StatusCode::UNAUTHORIZED,
                "this needs the header `Authorization: Bearer TOKEN` with the node's token",
            );
        }
        if !only_reads && self.is_from_another_site(headers) {
            return refused(
                StatusCode::FORBIDDEN,
                "without a token a page of another site may not change anything: set a token, or name the page's \
                 origin in http.cors_origins",
            );
        }
        // The other content types are those that a browser sends to another site without a preflight.
        if *method == Method::POST && !is_json(headers) {
            let problem = Problem::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "without a token the content type of a POST must be `application/json`; \
                 with curl: -H 'content-type: application/json'",
            );
            return Err(problem.allowing(["application/json"]));
        }
        if matches!(*self.rule, Rule::ThisMachine) && !called_by_address(request) {
            return refused(
                StatusCode::MISDIRECTED_REQUEST,
                "without a token this interface answers only when called by address or as `localhost`; \
                 to reach it under another name set a token, or http.allow_unauthenticated = true",
            );
        }
        Ok(anonymous(Role::Tune))
    }

    /// True if a browser sent the request for a page of another site. Newer browsers report that in `Sec-Fetch-Site`,
    /// and all send the page's origin with requests that make changes; other clients send neither.
    fn is_from_another_site(&self, headers: &HeaderMap) -> bool {
        let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or(""));
        let origin = text(ORIGIN);
        if origin.is_some_and(|origin| self.origins.iter().any(|listed| listed == origin)) {
            return false;
        }
        match (text(HeaderName::from_static("sec-fetch-site")), origin) {
            (Some(site), _) => !matches!(site, "same-origin" | "none"),
            (None, Some(origin)) => {
                let host = origin.split_once("://").map(|(_, host)| host);
                host.is_none() || host != text(HOST)
            }
            (None, None) => false,
        }
    }
}

fn is_json(headers: &HeaderMap) -> bool {
    let media_type = headers
        .get(CONTENT_TYPE)
        .and_then(|value| value.to_str().ok()?.split(';').next())
        .unwrap_or_default();
    media_type.trim().eq_ignore_ascii_case("application/json")
}

fn read_tokens(config: &HttpConfig, named: &[NamedToken]) -> Result<Vec<KnownToken>, String> {
    let own = NamedToken {
        name: "token".to_owned(),
        role: Role::Tune,
        token: config.token.clone(),
        token_file: config.token_file.clone(),
    };
    let mut tokens = Vec::new();
    for one in std::iter::once(&own).chain(named) {
        let token = match &one.token_file {
            Some(file) => Some(read_token(file)?),
            None => one.token.clone(),
        };
        if let Some(token) = token {
            crate::logging::conceal(token.secret());
            let caller = Caller {
                name: one.name.as_str().into(),
                role: one.role,
            };
            tokens.push(KnownToken { caller, token });
        }
    }
    Ok(tokens)
}

/// Reads the token in the first line of a file.
///
/// # Errors
/// The file, and why its first line cannot be used.
pub fn read_token(file: &Path) -> Result<Token, String> {
    let wrong = |fault: &dyn std::fmt::Display| format!("token_file {}: {fault}", file.display());
    let token = Token::new(first_line(file).map_err(|error| wrong(&error))?);
    token.check().map_err(|fault| wrong(&format!("the first line {fault}")))?;
    Ok(token)
}

fn carries(headers: &HeaderMap, token: &Token) -> bool {
    const SCHEME: &[u8] = b"bearer ";
    let Some(header) = headers.get(AUTHORIZATION) else {
        return false;
    };
    let Some((scheme, secret)) = header.as_bytes().split_at_checked(SCHEME.len()) else {
        return false;
    };
    // In constant time, so that the delay does not reveal how many characters were right.
    let is_right = bool::from(secret.ct_eq(token.secret().as_bytes()));
    scheme.eq_ignore_ascii_case(SCHEME) && is_right
}

/// True if the request names this machine by address or as `localhost`, and nothing else. An unreadable name, or two
/// names, count as another name.
fn called_by_address(request: &Request) -> bool {
    let mut hosts = request.headers().get_all(HOST).iter();
    let host_is_right = match (hosts.next(), hosts.next()) {
        // HTTP/1.0 has no Host header; no browser sends HTTP/1.0.
        (None, _) => request.version() <= Version::HTTP_10,
        (Some(host), None) => host.to_str().is_ok_and(is_address),
        _ => false,
    };
    let authority = request.uri().authority();
    host_is_right && authority.is_none_or(|authority| is_address(authority.as_str()))
}

fn is_address(host: &str) -> bool {
    let is_port = |port: &str| port.bytes().all(|byte| byte.is_ascii_digit());
    let name = host
        .rsplit_once(':')
        .filter(|(_, port)| is_port(port))
        .map_or(host, |(name, _)| name);
    let in_brackets = name.strip_prefix('[').and_then(|name| name.strip_suffix(']'));
    match in_brackets {
        Some(name) => name.parse::<Ipv6Addr>().is_ok(),
        None => name.eq_ignore_ascii_case("localhost") || name.parse::<Ipv4Addr>().is_ok(),
    }
}

/// Passes a request on with its [`Caller`], or answers it.
pub(super) async fn guard(
    State(guard): State<Guard>,
    mut request: Request,
    next: Next,
) -> Response {
    match guard.admit(&request) {
        Ok(caller) => {
            // Without a token, a path that is open to all proves nothing.
            if (caller.role == Role::Tune || &*caller.name != ANONYMOUS)
                && let Some(admitted) = request.extensions().get::<Admitted>()
            {
                admitted.set();
            }
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(problem) => {
            let mut response = problem.into_response();
            if response.status() == StatusCode::UNAUTHORIZED {
                let scheme = HeaderValue::from_static("Bearer");
                response.headers_mut().insert(WWW_AUTHENTICATE, scheme);
            }
            response
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_requests_from_pages_of_other_sites_count_as_foreign() {
        let guard = Guard {
            rule: Arc::new(Rule::ThisMachine),
            origins: Arc::new(["https://fleet.example".to_owned()]),
        };
        let foreign = |sent: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, HeaderValue::from_static("127.0.0.1:8090"));
            for (name, value) in sent.split(", ").filter_map(|header| header.split_once(": ")) {
                headers.insert(name, HeaderValue::from_static(value));
            }
            guard.is_from_another_site(&headers)
        };
        for own in [
            "",
            "origin: http://127.0.0.1:8090",
            "sec-fetch-site: same-origin",
            "sec-fetch-site: none",
            "sec-fetch-site: same-origin, origin: https://proxy.example",
            "sec-fetch-site: cross-site, origin: https://fleet.example",
        ] {
            assert!(!foreign(own), "{own}");
        }
        for other in [
            "origin: http://evil.example",
            "origin: null",
            "origin: http://127.0.0.1:8000",
            "sec-fetch-site: cross-site",
            "sec-fetch-site: same-site",
            "sec-fetch-site: cross-site, origin: http://127.0.0.1:8090",
        ] {
            assert!(foreign(other), "{other}");
        }
    }

    #[test]
    fn only_ip_addresses_and_localhost_are_accepted_as_host() {
        for host in [
            "localhost",
            "localhost:8080",
            "LOCALHOST",
            "LOCALHOST:80",
            "127.0.0.1",
            "127.0.0.1:8080",
            "192.168.1.7:8080",
            "[::1]",
            "[::1]:8080",
        ] {
            assert!(is_address(host), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "evil.example:8080",
            "[::1].evil.example",
            "[::1]evil",
            "[::1",
            "localhost:80@evil",
            "localhost@evil",
            "localhost:evil",
            "localhost.evil.example:8080",
            "127.0.0.1.evil.example",
            "127.0.0.1:80:80",
        ] {
            assert!(!is_address(host), "{host}");
        }
    }
}
