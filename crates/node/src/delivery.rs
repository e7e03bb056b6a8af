//! Keeps clip reports until a hub has them, and sends them.

pub(crate) mod report;
#[cfg(test)]
mod tests;
pub(crate) mod uplink;
