//! The HTTP server that services share: adds authentication, limits and problem documents to a router and
//! serves it.

mod auth;
mod caller;
mod index;
mod page;
mod problem;
mod query;
mod serve;

pub(crate) use auth::wrong_tokens;
pub use auth::{Caller, read_token};
pub use caller::*;
pub use index::{Route, routes};
pub use page::with_page;
pub use problem::{Problem, check_event_types, describe, response, within};
pub use query::refuse_unread_queries;
pub use serve::run;
