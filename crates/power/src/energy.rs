//! The energy account: totals since the start, their division between cameras, the watts that a running detector adds.

pub(crate) mod account;
mod attribution;
mod detector_watts;
pub(crate) mod totals;
