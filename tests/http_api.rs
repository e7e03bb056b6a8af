//! The HTTP interface of a node over real connections: every answer a client can get.

mod access;
mod connections;
mod documented;
mod events;
mod history;
mod metrics;
mod resources;
pub(crate) mod served;
mod target;
mod threshold;

/// A detections message as a node sends it.
pub(crate) fn sample_detections() -> albireo_wire::DetectionsMessage {
    served::frame(7, albireo_core::policy::FrameState::I)
}
