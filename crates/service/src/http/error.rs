//! Errors that keep the HTTP interface from being served.

use std::net::SocketAddr;

/// Why the interface cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum HttpError {
    /// Other machines reach it and nothing protects it.
    #[error(
        "http.listen: {address} can be reached from other machines, and no token is set; set \
         http.token_file (or http.token), or http.allow_unauthenticated = true if anybody may use it"
    )]
    Unprotected {
        /// Where it listens.
        address: SocketAddr,
    },
    /// The token cannot be read.
    #[error("{0}")]
    Token(String),
    /// The listener does not work.
    #[error("the HTTP listener failed: {0}")]
    Listener(std::io::Error),
}
