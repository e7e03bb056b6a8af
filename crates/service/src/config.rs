//! Configuration: one TOML file, overridden by environment variables and checked as a whole before anything
//! starts; and the sections that all services share.

mod endpoint;
mod environment;
mod findings;
mod http;
mod load;
mod log;
mod secret_file;
mod secrets;
mod tokens;
mod unreadable;
mod uplink;
mod zenoh;

pub use endpoint::{EndpointUse, check_endpoint, shown_endpoints};
pub(crate) use endpoint::{HostPort, shown_endpoint, with_shown_endpoints};
pub use findings::{ConfigError, DAY_S, Finding, Findings};
pub(crate) use http::SET_A_TOKEN;
pub use http::{HttpConfig, Token};
pub use load::{Configuration, examine, examine_text, load};
pub(crate) use log::check_level;
pub use log::{LogConfig, LogFormat};
pub use secret_file::first_line;
pub use secrets::{MASK, without_secrets};
pub(crate) use tokens::ANONYMOUS;
pub use tokens::{NamedToken, Role};
pub use uplink::UplinkConfig;
pub use zenoh::{ZenohConfig, ZenohMode};
