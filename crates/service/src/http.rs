//! The HTTP server that services share: it puts authentication, limits and problem documents around a router
//! and serves it.

mod auth;
mod error;
mod problem;
mod serve;

pub use auth::{Caller, TokenError};
pub use error::HttpError;
pub use problem::{Problem, response};
pub use serve::{BODY_LIMIT, run, run_with_tokens};
