//! The `[http]` section of the configuration.

use super::{Findings, NamedToken};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

/// The minimum number of characters of a token.
const LEAST_TOKEN: usize = 16;

/// What protects an interface that is configured by keys.
pub(crate) const SET_A_TOKEN: &str = "set http.token_file (or http.token), or http.allow_unauthenticated = true if \
                                      anybody may use it";

/// A secret that debug output does not show.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Token(String);

impl Token {
    /// Creates a token with these characters.
    pub fn new(secret: impl Into<String>) -> Self {
        Self(secret.into())
    }

    /// The secret itself.
    pub fn secret(&self) -> &str {
        &self.0
    }

    /// Checks that it can be used as a bearer token (RFC 6750, section 2.1).
    pub(crate) fn check(&self) -> Result<(), &'static str> {
        if self.0.is_empty() {
            return Err("is empty; leave it out for no authentication");
        }
        if !self.0.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err("must be printable ASCII without spaces");
        }
        if self.0.len() < LEAST_TOKEN {
            return Err(
                "has fewer than 16 characters, which can be guessed; `openssl rand -hex 16` makes one",
            );
        }
        Ok(())
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// The HTTP interface: the address it listens on, and who may use it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HttpConfig {
    /// Address and port; port 0 selects any free one.
    pub listen: SocketAddr,
    /// The bearer token that requests must carry. Prefer `token_file` or the environment variable
    /// `ALBIREO_HTTP__TOKEN`, so that this file does not contain the secret.
    pub token: Option<Token>,
    /// A file whose first line is the token.
    pub token_file: Option<PathBuf>,
    /// Allows an address that other machines can reach without a token.
    pub allow_unauthenticated: bool,
    /// Requests that take longer, except the event stream, are answered with an error. Not a setting.
    #[serde(skip)]
    pub timeout_ms: u64,
    /// A connection that sends or reads nothing for this long is closed. Not a setting.
    #[serde(skip)]
    pub idle_timeout_ms: u64,
    /// The maximum number of connections. At the limit, the oldest is closed for a new one. Not a setting:
    /// 256 connections use some 10 MB.
    #[serde(skip)]
    pub max_connections: usize,
    /// Web origins whose pages may call the interface (`https://fleet.example`); none by default.
    pub cors_origins: Vec<String>,
}

impl Default for HttpConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8080)),
            token: None,
            token_file: None,
            allow_unauthenticated: false,
            timeout_ms: 10_000,
            idle_timeout_ms: 30_000,
            max_connections: 256,
            cors_origins: Vec::new(),
        }
    }
}

impl HttpConfig {
    /// The error of an interface at `address` that nothing protects, with the way out.
    pub fn unprotected(address: SocketAddr, way_out: &str) -> String {
        format!("{address} can be reached from other machines, and no token is set; {way_out}")
    }

    /// True if other machines can reach it and nothing protects it.
    pub fn is_unprotected(&self, tokens: &[NamedToken]) -> bool {
        !self.listen.ip().is_loopback()
            && self.token.is_none()
            && self.token_file.is_none()
            && tokens.is_empty()
            && !self.allow_unauthenticated
    }

    /// Adds the errors in the section, checked together with the named tokens.
    pub fn check(&self, tokens: &[NamedToken], findings: &mut Findings) {
        NamedToken::check(tokens, findings);
        if let Some(token) = &self.token {
            findings.check("http.token", token.check());
        }
        findings.path("http.token_file", self.token_file.as_deref());
        if self.token.is_some() && self.token_file.is_some() {
            findings.add(
                "http.token_file",
                "is set together with http.token; keep one",
            );
        }
        if self.is_unprotected(tokens) {
            let reason = Self::unprotected(self.listen, SET_A_TOKEN);
            findings.add("http.listen", reason);
        }
        for origin in &self.cors_origins {
            let host = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
            if host.is_none_or(|host| host.is_empty() || host.contains('/')) {
                findings.add(
                    "http.cors_origins",
                    format!("`{origin}` is not an origin such as `https://fleet.example`"),
                );
            }
        }
    }
}
