//! The edge node: receives frames, decides by a policy when the detector runs, and publishes detections and clip
//! reports. [`run`] is the service with its HTTP interface.

pub mod api;
mod backoff;
pub mod camera;
pub mod config;
pub mod delivery;
mod error;
pub mod forwarding;
pub mod frame;
pub mod input;
pub mod online;
pub mod outbox;
mod percentiles;
pub mod position;
mod publishing;
pub mod recorder;
mod run;
mod settings;
mod start;
pub mod state;
mod state_files;

pub use camera::PolicyMaker;
pub use camera::evidence::LiveEvidence;
pub use error::NodeError;
pub use frame::FrameRecord;
pub use run::run;
pub use start::{Node, PreparedNode};
