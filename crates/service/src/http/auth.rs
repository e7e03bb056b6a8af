//! Who may use the interface: bearer tokens (RFC 6750), and without one only this machine.

use super::HttpError;
use super::Problem;
use crate::config::{HttpConfig, NamedToken, Role, Token};
use crate::rate_limit::SharedLimit;
use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderName, ORIGIN, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Version};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use parking_lot::RwLock;
use std::collections::{BTreeMap, BTreeSet};
use std::net::{Ipv4Addr, Ipv6Addr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use subtle::ConstantTimeEq;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Open to all: whether the service lives and works, the page, which asks for the token itself, and the description
/// of the interface with the page that reads it, which are the same wherever this version runs and reveal nothing of this
/// service.
const OPEN: [&str; 6] = [
    "/",
    "/healthz",
    "/readyz",
    "/openapi.json",
    "/docs",
    // Says no more than whether the token that came with it is good.
    "/api/v1/caller",
];

/// Whether a path is open to all.
fn is_open(path: &str) -> bool {
    OPEN.contains(&path) || path.starts_with("/docs/") || path.starts_with(super::page::ASSETS)
}

/// Why a token file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// It cannot be read.
    #[error("token_file {file}: {source}")]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Its first line is no token.
    #[error("token_file {file}: the first line {fault}")]
    Unusable {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        fault: &'static str,
    },
}

/// Decides who may pass.
#[derive(Clone)]
pub(super) struct Guard {
    rule: Arc<Rule>,
    /// Web origins whose pages may change something without a token.
    origins: Arc<[String]>,
}

/// Who a request comes from, as an extension of the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// Name of the token: `token` for that of the section `[http]`, `anonymous` where none is needed.
    pub name: Arc<str>,
    /// What the caller may do.
    pub role: Role,
}

impl Caller {
    /// Name of a caller without a token.
    pub(super) const ANONYMOUS: &str = "anonymous";
}

/// Interval at which the token files are read again.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A token, whose it is, and the file it comes from.
struct TokenEntry {
    caller: Caller,
    token: Token,
    file: Option<PathBuf>,
}

enum Rule {
    /// Requests must carry one of the tokens.
    Tokens(RwLock<Vec<TokenEntry>>),
    /// Only programs of this machine reach the listener. A web page could still have its own name point
    /// to this machine (DNS rebinding) and so be let in by the browser; the `Host` header shows
    /// that.
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
    pub(crate) fn new(
        config: &HttpConfig,
        named: &[NamedToken],
        listener: &TcpListener,
    ) -> Result<Self, HttpError> {
        let address = listener.local_addr().map_err(HttpError::Listener)?;
        let tokens = tokens(config, named)?;
        let rule = if !tokens.is_empty() {
            Rule::Tokens(RwLock::new(tokens))
        } else if config.allow_unauthenticated {
            Rule::Anybody
        } else if address.ip().is_loopback() {
            Rule::ThisMachine
        } else {
            return Err(HttpError::Unprotected { address });
        };
        Ok(Self {
            rule: Arc::new(rule),
            origins: config.cors_origins.clone().into(),
        })
    }

    /// Takes over what is written to the token files, until `shutdown`: a token is exchanged without a restart. A file
    /// that cannot be used leaves the token that was good.
    pub(crate) async fn follow_files(self, shutdown: CancellationToken) {
        let Rule::Tokens(tokens) = &*self.rule else {
            return;
        };
        let files: BTreeSet<PathBuf> =
            (tokens.read().iter().filter_map(|entry| entry.file.clone())).collect();
        if files.is_empty() {
            return;
        }
        let mut faults: BTreeMap<PathBuf, String> = BTreeMap::new();
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return,
                () = tokio::time::sleep(LOOK_EVERY) => {}
            }
            for file in &files {
                let place = file.clone();
                let Ok(found) = tokio::task::spawn_blocking(move || read(&place)).await else {
                    continue;
                };
                match found {
                    Ok(token) => {
                        faults.remove(file);
                        let mut tokens = tokens.write();
                        let others = tokens.iter_mut().filter(|entry| {
                            entry.file.as_ref() == Some(file) && entry.token != token
                        });
                        for entry in others {
                            crate::logging::conceal(token.secret());
                            entry.token = token.clone();
                            tracing::info!(token = &*entry.caller.name, "the token was exchanged");
                        }
                    }
                    Err(error) => {
                        let error = error.to_string();
                        if faults.insert(file.clone(), error.clone()).as_ref() != Some(&error) {
                            tracing::error!(error, "the token that was good stays in force");
                        }
                    }
                }
            }
        }
    }

    /// Who may pass, or the answer to a request that may not.
    fn admit(&self, request: &Request) -> Result<Caller, Box<Response>> {
        let headers = request.headers();
        let anonymous = |role| Caller {
            name: Caller::ANONYMOUS.into(),
            role,
        };
        let looks = matches!(
            *request.method(),
            Method::GET | Method::HEAD | Method::OPTIONS
        );
        match &*self.rule {
            Rule::Anybody | Rule::ThisMachine
                if !looks && self.is_from_another_site(headers) =>
            {
                Err(Box::new(Problem::new(
                    StatusCode::FORBIDDEN,
                    "without a token a page of another site may not change anything: set a token, or name the page's \
                     origin in http.cors_origins",
                )
                .into_response()))
            }
            // The other content types are those that a browser sends to another site without asking it.
            Rule::Anybody | Rule::ThisMachine
                if *request.method() == Method::POST && !is_json(headers) =>
            {
                Err(Box::new(Problem::new(
                    StatusCode::UNSUPPORTED_MEDIA_TYPE,
                    "without a token the content type of a POST must be `application/json`; \
                     with curl: -H 'content-type: application/json'",
                )
                .allowing(["application/json"])
                .into_response()))
            }
            Rule::Anybody => Ok(anonymous(Role::Tune)),
            Rule::ThisMachine if called_by_address(request) => Ok(anonymous(Role::Tune)),
            Rule::ThisMachine => Err(Box::new(Problem::new(
                StatusCode::MISDIRECTED_REQUEST,
                "without a token this interface answers only when called by address or as `localhost`; \
                 to reach it under another name set a token, or http.allow_unauthenticated = true",
            )
            .into_response())),
            Rule::Tokens(tokens) => {
                let holder = tokens
                    .read()
                    .iter()
                    .find(|entry| carries(headers, &entry.token))
                    .map(|entry| entry.caller.clone());
                if holder.is_none() && headers.contains_key(AUTHORIZATION) {
                    log_wrong_token();
                }
                match holder {
                    Some(caller) if looks || caller.role == Role::Tune => Ok(caller),
                    Some(caller) => {
                        let detail = format!(
                            "the token `{}` may look and not change: this needs one with the role `tune`",
                            caller.name
                        );
                        Err(Box::new(Problem::new(StatusCode::FORBIDDEN, detail).into_response()))
                    }
                    None if is_open(request.uri().path()) => Ok(anonymous(Role::Read)),
                    None => Err(Box::new(unauthorized())),
                }
            }
        }
    }
}

impl Guard {
    /// Whether a browser sent the request for a page of another site. Newer browsers say so in `Sec-Fetch-Site`, and all name
    /// the page's origin with what changes something; other clients send neither.
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
    let media_type = (headers.get(CONTENT_TYPE))
        .and_then(|value| value.to_str().ok()?.split(';').next())
        .unwrap_or_default();
    media_type.trim().eq_ignore_ascii_case("application/json")
}

fn log_wrong_token() {
    static LOG: SharedLimit = SharedLimit::new();
    LOG.log(|held_back| tracing::warn!(held_back, "a request with a wrong token was refused"));
}

fn unauthorized() -> Response {
    let detail = "this needs the header `Authorization: Bearer TOKEN` with the node's token";
    let mut response = Problem::new(StatusCode::UNAUTHORIZED, detail).into_response();
    response
        .headers_mut()
        .insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    response
}

fn tokens(config: &HttpConfig, named: &[NamedToken]) -> Result<Vec<TokenEntry>, TokenError> {
    let own = (
        Arc::from("token"),
        Role::Tune,
        &config.token,
        &config.token_file,
    );
    let named = named.iter().map(|one| {
        (
            one.name.as_str().into(),
            one.role,
            &one.token,
            &one.token_file,
        )
    });
    let mut tokens = Vec::new();
    for (name, role, token, file) in std::iter::once(own).chain(named) {
        let token = match file {
            Some(file) => Some(read(file)?),
            None => token.clone(),
        };
        if let Some(token) = &token {
            crate::logging::conceal(token.secret());
        }
        tokens.extend(token.map(|token| TokenEntry {
            caller: Caller { name, role },
            token,
            file: file.clone(),
        }));
    }
    Ok(tokens)
}

/// Why no token can be read from a file, if none can.
pub fn token_file_fault(file: &Path) -> Option<String> {
    read(file).err().map(|error| error.to_string())
}

fn read(file: &Path) -> Result<Token, TokenError> {
    let text = std::fs::read_to_string(file).map_err(|source| TokenError::Unreadable {
        file: file.to_owned(),
        source,
    })?;
    let token = Token::new(text.lines().next().unwrap_or_default().trim());
    match token.fault() {
        None => Ok(token),
        Some(fault) => Err(TokenError::Unusable {
            file: file.to_owned(),
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
    // In constant time, so that the answer's delay does not reveal how many characters were right.
    sent.ct_eq(token.secret().as_bytes()).into()
}

/// Whether the request names this machine by address or as `localhost`, and nothing else. A name that cannot be read,
/// or two of them, is another name.
fn called_by_address(request: &Request) -> bool {
    let hosts: Vec<_> = request.headers().get_all(HOST).iter().collect();
    let host_is_right = match hosts[..] {
        // HTTP/1.0 has no Host; no browser sends that.
        [] => request.version() <= Version::HTTP_10,
        [host] => host.to_str().is_ok_and(is_address),
        _ => false,
    };
    let authority = request.uri().authority();
    host_is_right && authority.is_none_or(|authority| is_address(authority.as_str()))
}

fn is_address(host: &str) -> bool {
    let is_port = |port: &str| port.bytes().all(|byte| byte.is_ascii_digit());
    if let Some(rest) = host.strip_prefix('[') {
        let Some((name, port)) = rest.split_once(']') else {
            return false;
        };
        let port_is_right = port.is_empty() || port.strip_prefix(':').is_some_and(is_port);
        return port_is_right && name.parse::<Ipv6Addr>().is_ok();
    }
    let (name, port) = host.split_once(':').unwrap_or((host, ""));
    is_port(port) && (name.eq_ignore_ascii_case("localhost") || name.parse::<Ipv4Addr>().is_ok())
}

/// Lets a request pass, with its [`Caller`], or answers it.
pub(super) async fn guard(
    State(guard): State<Guard>,
    mut request: Request,
    next: Next,
) -> Response {
    match guard.admit(&request) {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(response) => *response,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_of_another_site_is_told_from_own_pages_and_from_clients_that_are_no_browser() {
        let guard = Guard {
            rule: Arc::new(Rule::ThisMachine),
            origins: Arc::new(["https://fleet.example".to_owned()]),
        };
        let foreign = |sent: &[(&'static str, &'static str)]| {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, HeaderValue::from_static("127.0.0.1:8090"));
            for (name, value) in sent {
                headers.insert(*name, HeaderValue::from_static(value));
            }
            guard.is_from_another_site(&headers)
        };
        for own in [
            &[][..],
            &[("origin", "http://127.0.0.1:8090")],
            &[("sec-fetch-site", "same-origin")],
            &[("sec-fetch-site", "none")],
            &[
                ("sec-fetch-site", "same-origin"),
                ("origin", "https://proxy.example"),
            ],
            &[
                ("sec-fetch-site", "cross-site"),
                ("origin", "https://fleet.example"),
            ],
        ] {
            assert!(!foreign(own), "{own:?}");
        }
        for other in [
            &[("origin", "http://evil.example")][..],
            &[("origin", "null")],
            &[("origin", "http://127.0.0.1:8000")],
            &[("sec-fetch-site", "cross-site")],
            &[("sec-fetch-site", "same-site")],
            &[
                ("sec-fetch-site", "cross-site"),
                ("origin", "http://127.0.0.1:8090"),
            ],
        ] {
            assert!(foreign(other), "{other:?}");
        }
    }

    #[test]
    fn only_addresses_and_localhost_are_this_machine() {
        for host in [
            "localhost",
            "LOCALHOST:80",
            "127.0.0.1:8080",
            "[::1]",
            "[::1]:8080",
        ] {
            assert!(is_address(host), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "[::1].evil.example",
            "[::1]evil",
            "[::1",
            "localhost:80@evil",
            "localhost@evil",
            "localhost:evil",
            "127.0.0.1.evil.example",
            "127.0.0.1:80:80",
        ] {
            assert!(!is_address(host), "{host}");
        }
    }
}
