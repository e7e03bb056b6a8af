//! What the task runs: ONNX Runtime behind a trait, so that a misbehaving model can take its place in tests.

use super::{ExecutionProvider, RunError};
use std::sync::Arc;

/// A camera among those that share a task, by its place in the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraSlot(pub usize);

/// Asks a run in progress to end early. Called from another thread, at most once a run.
pub type Interrupter = Arc<dyn Fn() + Send + Sync>;

/// Something that answers pictures, built and used on one thread of its own.
pub trait Model: 'static {
    /// A picture as it takes it.
    type Input: Send + 'static;
    /// What it finds in a picture.
    type Output: Send + 'static;
    /// What its users rely on as long as the program runs: a model built anew must have the same.
    type Facts: Clone + PartialEq + Send + Sync + 'static;

    /// What its users rely on.
    fn facts(&self) -> Self::Facts;

    /// Answers pictures, at least one and at most the batch size of its task: one output for each, in their
    /// order. Blocks.
    ///
    /// # Errors
    /// When the run failed. The model is dropped then and built anew.
    fn run(&mut self, pictures: &[Self::Input]) -> Result<Vec<Self::Output>, RunError>;

    /// What runs it.
    fn provider(&self) -> ExecutionProvider;

    /// How a run that takes too long can be asked to end; `None` if it cannot.
    fn interrupter(&self) -> Option<Interrupter> {
        None
    }
}
