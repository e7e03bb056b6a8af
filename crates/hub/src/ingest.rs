//! Stores the nodes' reports, each exactly once.
//!
//! Zenoh's thread only puts a query into a bounded queue, and answers "busy" when it is full or when the node has sent
//! more than its share. One thread parses the batches, another commits them, at most every `ingest.commit_ms`, and the answer
//! is sent after the commit: a slow or absent database delays acknowledgements but never fills the memory.

mod clip;
mod counters;
mod decode;
mod fate;
mod group;
mod inbox;
mod limits;
mod outcomes;
mod plan;
mod recorder;
mod retention;
mod tables;
#[cfg(test)]
mod tests;
mod travel;
mod writer;

pub use counters::{IngestCounters, IngestCounts};
pub use decode::{Batch, decode};
pub(crate) use inbox::{Inbox, Refusal};
pub use recorder::{Recorded, Recorder};
pub use tables::ReportCounts;
pub(crate) use writer::start;
