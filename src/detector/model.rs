//! What the task runs: ONNX Runtime behind a trait, so that a recorded or a misbehaving detector can take
//! its place.

use super::{ExecutionProvider, ModelError};
use crate::frame::Picture;
use std::sync::Arc;

/// A camera among those that share a task, by its place in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraSlot(pub usize);

/// Asks a run in progress to end early. Called from another thread, at most once a run.
pub type Interrupter = Arc<dyn Fn() + Send + Sync>;

/// Something that answers pictures, built and used on one thread of its own.
pub trait Model: 'static {
    /// What it finds in a picture.
    type Output: Send + 'static;

    /// Answers one picture. Blocks.
    ///
    /// # Errors
    /// When the run failed. The model is dropped then and built anew.
    fn run(&mut self, camera: CameraSlot, picture: &Picture) -> Result<Self::Output, ModelError>;

    /// What runs it.
    fn provider(&self) -> ExecutionProvider;

    /// How a run that takes too long can be asked to end; `None` if it cannot.
    fn interrupter(&self) -> Option<Interrupter> {
        None
    }
}
