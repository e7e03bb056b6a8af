//! Clip reports: kept until a hub has them, and sent.

pub mod outbox;
pub(crate) mod report;
pub(crate) mod uplink;
