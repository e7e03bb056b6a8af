//! What every service of albireo has in common, node and hub alike: its configuration, its Zenoh session, its
//! HTTP server, its log, and how it is stopped. It knows neither node nor hub.

pub mod archive;
pub mod clock;
pub mod config;
pub mod http;
pub mod logging;
pub mod metrics;
pub mod notify;
pub mod panics;
mod process;
pub mod rate_limit;
pub mod readiness;
pub mod session;
pub mod signals;
pub mod supervise;
