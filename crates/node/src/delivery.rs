//! Clip reports: kept until a hub has them, and sent.

pub mod outbox;
pub(crate) mod report;
#[cfg(test)]
mod tests;
pub(crate) mod uplink;
