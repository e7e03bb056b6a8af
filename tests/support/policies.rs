//! A policy that runs a test's code before it begins a frame.

use albireo_core::policy::{Evidence, FrameHead, Need, Outcome, Policy};

/// A wrapper that runs `before` ahead of each frame of `inner`, a policy without a threshold.
pub(crate) struct Before<F> {
    pub(crate) inner: Box<dyn Policy>,
    pub(crate) before: F,
}

impl<F: FnMut() + Send + Sync> Policy for Before<F> {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        (self.before)();
        self.inner.begin(frame)
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        self.inner.answer(evidence)
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.inner.finish(outcome);
    }

    fn reset(&mut self) {
        self.inner.reset();
    }
}
