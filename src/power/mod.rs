//! Power meters, one file each; sampling every 100 ms; exact integration over a span of time.

mod config;

pub use config::{PowerConfig, PowerSource};
