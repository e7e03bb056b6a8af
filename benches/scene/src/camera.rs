//! A camera that gives its frames to a policy.

use crate::PICTURE;
use albireo_core::detection::Detection;
use albireo_core::policy::{FrameEvidence, FrameHead, Outcome, Policy, decide};

/// A policy and its state for one camera.
#[derive(Clone, Debug)]
pub struct Camera<P> {
    /// The policy.
    pub policy: P,
    /// The answer to the last frame.
    pub outcome: Outcome,
    index: u64,
}

impl<P: Policy> Camera<P> {
    /// A camera without a frame.
    pub fn new(policy: P) -> Self {
        Self {
            policy,
            outcome: Outcome::default(),
            index: 0,
        }
    }

    /// Decides the next frame, in which the detector would find `detections`, and in which the screen sees something.
    pub fn frame(&mut self, detections: &[Detection]) {
        self.index += 1;
        let head = FrameHead {
            // Never a multiple of the periodic cap.
            index: self.index % 29 + 1,
            step: 1,
            picture: PICTURE,
        };
        let mut known = FrameEvidence::in_view(detections);
        let Ok(()) = decide(&mut self.policy, head, &mut known, &mut self.outcome);
    }
}
