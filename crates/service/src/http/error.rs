//! Errors that keep the HTTP interface from being served.

use std::net::SocketAddr;

/// The reason the interface cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum HttpError {
    /// Other machines can reach it and nothing protects it.
    #[error(
        "http.listen: {address} can be reached from other machines, and no token is set; set \
         http.token_file (or http.token), or http.allow_unauthenticated = true if anybody may use it"
    )]
    Unprotected {
        /// The address it listens on.
        address: SocketAddr,
    },
    /// The token cannot be read.
    #[error("{0}")]
    Token(String),
    /// The listener failed.
    #[error("the HTTP listener failed: {0}")]
    Listener(std::io::Error),
}
