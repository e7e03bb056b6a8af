//! The `[http]` section of the configuration.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

/// A secret that is not shown when printed for debugging.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Token(String);

impl Token {
    /// A token of those characters.
    pub fn new(secret: impl Into<String>) -> Self {
        Self(secret.into())
    }

    /// The secret itself.
    pub fn secret(&self) -> &str {
        &self.0
    }

    /// Why it cannot be sent as a bearer token (RFC 6750, section 2.1), if it cannot.
    pub fn fault(&self) -> Option<&'static str> {
        if self.0.is_empty() {
            Some("is empty; leave it out for no authentication")
        } else if !self.0.bytes().all(|byte| byte.is_ascii_graphic()) {
            Some("must be printable ASCII without spaces")
        } else {
            None
        }
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// The HTTP interface: where it listens and who may use it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HttpConfig {
    /// Address and port; port 0 for any free one.
    pub listen: SocketAddr,
    /// Bearer token that requests must carry. Prefer `token_file` or the environment variable
    /// `ALBIREO_HTTP__TOKEN`, so that the secret is not in this file.
    pub token: Option<Token>,
    /// File whose first line is the token.
    pub token_file: Option<PathBuf>,
    /// Whether anybody may use an address that other machines reach without a token.
    pub allow_unauthenticated: bool,
    /// A request other than the event stream that takes longer is answered with an error.
    pub timeout_ms: u64,
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
            cors_origins: Vec::new(),
        }
    }
}
