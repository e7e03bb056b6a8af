//! The HTTP server that services share: it puts authentication, limits and problem documents around a router
//! and serves it.

mod auth;
mod connections;
mod error;
mod problem;
mod serve;
mod stalled;

pub use auth::{Caller, TokenError};
pub use error::HttpError;
pub use problem::{Problem, response};
pub use serve::{BODY_LIMIT, run, run_with_tokens};
