//! The audit of a camera: a share of the frames that its policy answered without the detector is looked at by the
//! detector afterwards, when that has nothing else to do, and what was shown is compared with what it finds.
//!
//! It changes nothing: a frame is drawn by its number after its answer is out, and what the detector then finds reaches
//! neither the policy nor the screen.

mod config;
mod frames;
mod task;
#[cfg(test)]
mod tests;

pub use config::AuditConfig;
pub(crate) use frames::{AuditCount, CameraAudit, DrawnFrame};
pub(crate) use task::Auditor;
