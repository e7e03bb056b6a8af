//! Answers every frame immediately by prediction, and applies the detections when they arrive.
//!
//! ```text
//! frame k    the policy asks for detections: its state is saved, k is pending ─▶ predicted boxes
//! frame k+1  no evidence is requested while k is pending                      ─▶ predicted boxes
//! …
//! frame m                                                                     ─▶ predicted boxes
//! deliver k  back to the saved state, take the detections ─▶ final state and boxes of k;
//!            then predict k+1 … m again, from where the objects really were
//! ```
//!
//! The final state and boxes of frame k are the same as if the frame had waited for its detections.

use super::{
    Evidence, FrameHead, InvalidThreshold, Need, Outcome, PassCause, PauseFrames, Policy, WithPause,
};

/// Frames after the pending one that are predicted again one by one; further ones are predicted as lost frames.
const MOST_STEPS: usize = 256;

/// A frame, and the threshold in force when it began.
#[derive(Clone, Copy, Debug)]
struct Step {
    head: FrameHead,
    threshold: Option<f64>,
}

/// The error for a policy that cannot predict, so that a frame cannot be answered before its detections.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "policy `{policy}` cannot answer at once: it does not predict boxes; use `albireo`, `expected-loss` or one of \
     these with `+flow`, or let frames wait for the detector (`answer = \"when_known\"`)"
)]
pub struct CannotRewind {
    /// The policy's name.
    pub policy: &'static str,
}

/// The error for evidence about a frame that is not waiting for any.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("frame {frame} is not waiting for evidence")]
pub struct NotPending {
    /// The frame.
    pub frame: u64,
}

/// A policy whose frames are answered before their evidence arrives, or, if they [wait](Self::waiting), afterwards. At
/// most one frame is pending at a time.
pub struct LatePolicy {
    policy: WithPause,
    /// True if frames wait for their evidence.
    waits: bool,
    pending: Option<Step>,
    /// The frames since the pending one.
    steps: Vec<Step>,
    /// Discarded answers of frames that are predicted again.
    unused: Outcome,
}

impl LatePolicy {
    /// Answers frames of `policy` immediately.
    ///
    /// # Errors
    /// [`CannotRewind`] for a policy that does not predict.
    pub fn new(policy: Box<dyn Policy>) -> Result<Self, CannotRewind> {
        if !policy.can_rewind() {
            let policy = policy.name();
            return Err(CannotRewind { policy });
        }
        Ok(Self {
            waits: false,
            ..Self::waiting(policy)
        })
    }

    /// Lets frames wait for the evidence that `policy` requests. A frame whose evidence never arrives is abandoned when
    /// the next one begins.
    pub fn waiting(policy: Box<dyn Policy>) -> Self {
        Self {
            policy: WithPause::new(policy, PauseFrames::OFF),
            waits: true,
            pending: None,
            steps: Vec::new(),
            unused: Outcome::default(),
        }
    }

    /// True if frames wait for their evidence.
    pub const fn waits(&self) -> bool {
        self.waits
    }

    /// The policy, in its state after the last frame.
    pub fn policy(&self) -> &dyn Policy {
        &self.policy
    }

    /// Returns the index of the frame that is waiting for evidence.
    pub fn pending(&self) -> Option<u64> {
        self.pending.map(|pending| pending.head.index)
    }

    /// Sets the policy's threshold; takes effect with the next frame and is kept when a pending frame receives its
    /// evidence.
    ///
    /// # Errors
    /// Those of [`Policy::set_threshold`].
    pub fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        self.policy.set_threshold(value)
    }

    /// Sets what [`Policy::set_join`] does, for the frames that follow.
    pub fn set_join(&mut self, share: f64) {
        self.policy.set_join(share);
    }

    /// Why the newest compared picture has no news, and the number of frames since it last had some.
    pub fn no_news(&self) -> Option<(PassCause, u32)> {
        self.policy.no_news()
    }

    /// Sets the pauses for the frames that follow.
    pub fn set_pause(&mut self, pause: PauseFrames) {
        self.policy.set_pause(pause);
    }

    /// Answers a frame immediately: overwrites `outcome` with state `P`, or `E` in a pause on an empty road (not
    /// `degraded`, without a cause), and predicted boxes. Returns what the frame needs: with [`Need::Nothing`] this is
    /// its final answer, otherwise it is pending until [`deliver`](Self::deliver) completes it. A frame needs nothing
    /// while another one is pending. If frames wait, a frame that needs something has no answer yet.
    pub fn frame(&mut self, head: FrameHead, outcome: &mut Outcome) -> Need {
        let step = Step {
            head,
            threshold: self.policy.threshold(),
        };
        let need = self.policy.begin(head);
        if self.waits {
            self.pending = Some(step);
            return self.finish_unless(need, outcome);
        }
        if self.pending.is_some() {
            self.remember(step);
            predict(&mut self.policy, need, outcome);
            return Need::Nothing;
        }
        if need != Need::Nothing {
            self.pending = Some(step);
            self.policy.save();
        }
        predict(&mut self.policy, need, outcome);
        need
    }

    /// Delivers evidence to the pending frame `frame`. Returns what it needs next; with [`Need::Nothing`], `outcome`
    /// has its final state and boxes, and the next frame may ask again. [`Evidence::Unavailable`] means that the
    /// evidence failed or arrived too late: the frame is `degraded` if it needed the detector.
    ///
    /// # Errors
    /// [`NotPending`] if another frame or none is pending; nothing changes then.
    pub fn deliver(
        &mut self,
        frame: u64,
        evidence: Evidence<'_>,
        outcome: &mut Outcome,
    ) -> Result<Need, NotPending> {
        let Some(pending) = self.pending.filter(|step| step.head.index == frame) else {
            return Err(NotPending { frame });
        };
        if self.waits {
            let need = self.policy.answer(evidence);
            return Ok(self.finish_unless(need, outcome));
        }
        let threshold = self.policy.threshold();
        self.policy.rewind();
        restore(&mut self.policy, pending.threshold);
        let need = self.policy.answer(evidence);
        if self.finish_unless(need, outcome) != Need::Nothing {
            // It waits for its next evidence from here on.
            self.policy.save();
            predict(&mut self.policy, need, &mut self.unused);
        }
        for step in &self.steps {
            restore(&mut self.policy, step.threshold);
            let need = self.policy.begin(step.head);
            predict(&mut self.policy, need, &mut self.unused);
        }
        if self.pending.is_none() {
            self.steps.clear();
        }
        restore(&mut self.policy, threshold);
        Ok(need)
    }

    /// Forgets the objects and the pending frame, as at the start of a stream.
    pub fn reset(&mut self) {
        self.pending = None;
        self.steps.clear();
        self.policy.reset();
    }

    /// Finishes the pending frame unless it needs something.
    fn finish_unless(&mut self, need: Need, outcome: &mut Outcome) -> Need {
        if need == Need::Nothing {
            self.policy.finish(outcome);
            self.pending = None;
        }
        need
    }

    /// Stores a frame to predict it again; joins it to the last one if there are too many.
    fn remember(&mut self, step: Step) {
        let full = self.steps.len() == MOST_STEPS;
        if full && let Some(last) = self.steps.last_mut() {
            let frames = last.head.step.saturating_add(step.head.step.max(1));
            *last = step;
            last.head.step = frames;
        } else {
            self.steps.push(step);
        }
    }
}

/// Finishes the current frame by prediction alone.
fn predict(policy: &mut dyn Policy, mut need: Need, outcome: &mut Outcome) {
    while need != Need::Nothing {
        need = policy.answer(Evidence::Unavailable);
    }
    policy.finish(outcome);
    outcome.degraded = false;
    outcome.cause = None;
}

/// Restores a threshold that was in force before, which no policy rejects.
fn restore(policy: &mut dyn Policy, threshold: Option<f64>) {
    if let Some(value) = threshold {
        let _ = policy.set_threshold(value);
    }
}

#[cfg(test)]
mod tests;
