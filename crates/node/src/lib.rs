//! The edge node: frames in; decisions of the policy, detections and clip reports out. As a library, with its HTTP
//! routes; [`run`] is the service.

pub mod api;
pub mod camera;
pub mod config;
pub mod delivery;
mod error;
pub mod input;
pub mod online;
mod run;
mod start;
pub mod state;

pub use camera::FrameRecord;
pub use camera::evidence::LiveEvidence;
pub use error::NodeError;
pub use run::{run, run_prepared};
pub use start::{Node, PolicyMaker, PreparedNode};
