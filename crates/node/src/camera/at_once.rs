//! Answers every frame at once by prediction, while the detector works for at most one of them.

use super::evidence::LiveEvidence;
use super::{BegunFrame, Spent};
use crate::rate_limit::SharedLimit;
use albireo_core::policy::{
    CannotRewind, Evidence, FrameHead, KnobError, LatePolicy, Need, Outcome, Policy,
};
use albireo_vision::picture::FrameFault;
use std::future::Future;
use std::pin::Pin;
use std::time::Duration;
use tokio::time::Instant;

static BROKEN: SharedLimit = SharedLimit::new();

/// A policy that answers at once, and the evidence that it waits for.
pub(crate) struct AtOnce {
    policy: LatePolicy,
    /// The frame that waits for its final answer.
    pending: Option<PendingFrame>,
    /// Where evidence comes from; not here while some is being fetched.
    evidence: Option<LiveEvidence>,
    fetching: Option<Pin<Box<dyn Future<Output = Fetched> + Send>>>,
}

/// A frame that was answered by prediction and waits for its final answer.
pub(super) struct PendingFrame {
    pub frame: BegunFrame,
    /// From its reception to the prediction.
    pub first_answer: Duration,
    need: Need,
    /// Time of the policy since the prediction.
    deciding: Duration,
}

/// A frame that was pending, with its final answer.
pub(super) struct Answered {
    pub pending: PendingFrame,
    pub spent: Spent,
}

/// What was fetched of frame `index` of the camera.
pub(super) struct Fetched {
    index: u64,
    need: Need,
    evidence: LiveEvidence,
    fetched: Result<(), FrameFault>,
}

impl AtOnce {
    /// Answers at once by `policy`.
    ///
    /// # Errors
    /// [`CannotRewind`] for a policy that does not predict.
    pub(crate) fn new(
        policy: Box<dyn Policy>,
        evidence: LiveEvidence,
    ) -> Result<Self, CannotRewind> {
        Ok(Self {
            policy: LatePolicy::new(policy)?,
            pending: None,
            evidence: Some(evidence),
            fetching: None,
        })
    }

    pub(super) fn policy(&self) -> &dyn Policy {
        self.policy.policy()
    }

    /// Whether a frame waits for its final answer.
    pub(super) fn is_pending(&self) -> bool {
        self.pending.is_some()
    }

    pub(super) fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        self.policy.set_knob(value)
    }

    /// Forgets the objects. The pending frame must have been [given up](Self::give_up).
    pub(super) fn reset(&mut self) {
        self.policy.reset();
    }

    /// Answers a frame; what is needed for its final answer, if this one is not.
    pub(super) fn frame(&mut self, head: FrameHead, outcome: &mut Outcome) -> Need {
        self.policy.frame(head, outcome)
    }

    /// Fetches what a frame needs that was answered by prediction.
    pub(super) fn fetch(&mut self, frame: BegunFrame, need: Need, first_answer: Duration) {
        self.pending = Some(PendingFrame {
            frame,
            first_answer,
            need,
            deciding: Duration::ZERO,
        });
        if let Some(evidence) = &mut self.evidence {
            evidence.next_frame();
        }
        self.fetch_next();
    }

    /// Begins to fetch what the pending frame needs, unless the frame before is still being examined.
    fn fetch_next(&mut self) {
        let Some(pending) = &self.pending else {
            return;
        };
        let Some(mut evidence) = self.evidence.take() else {
            return;
        };
        let (index, need) = (pending.frame.incoming.index, pending.need);
        let picture = pending.frame.incoming.frame.picture.clone();
        self.fetching = Some(Box::pin(async move {
            let fetched = evidence.fetch(need, &picture, std::future::pending).await;
            Fetched {
                index,
                need,
                evidence,
                fetched,
            }
        }));
    }

    /// What was fetched last, when it comes; for ever when nothing is being fetched.
    pub(super) async fn fetched(&mut self) -> Fetched {
        let Some(fetching) = &mut self.fetching else {
            return std::future::pending().await;
        };
        let fetched = fetching.await;
        self.fetching = None;
        fetched
    }

    /// Gives the pending frame what was fetched, and fetches what it needs next. With its final answer, that is in
    /// `outcome`.
    pub(super) fn deliver(&mut self, fetched: Fetched, outcome: &mut Outcome) -> Option<Answered> {
        let Fetched {
            index,
            need,
            mut evidence,
            fetched,
        } = fetched;
        let waits = self
            .pending
            .as_ref()
            .is_some_and(|pending| pending.frame.incoming.index == index);
        if !waits {
            // Of a frame that was given up. Another one may wait for its turn.
            evidence.next_frame();
            self.evidence = Some(evidence);
            self.fetch_next();
            return None;
        }
        let found = match &fetched {
            Ok(()) => evidence.fetched(need),
            Err(fault) => {
                BROKEN.log(|held_back| {
                    tracing::warn!(held_back, %fault, "a frame that was answered at once stays as predicted");
                });
                Evidence::Unavailable
            }
        };
        let done = self.give(found, outcome).map(|pending| Answered {
            spent: Spent::of(&evidence, pending.deciding),
            pending,
        });
        if done.is_some() {
            evidence.end_frame();
        }
        self.evidence = Some(evidence);
        self.fetch_next();
        done
    }

    /// Takes what the policy predicts for the final answer of the pending frame, if there is one.
    pub(super) fn give_up(&mut self, outcome: &mut Outcome) -> Option<Answered> {
        while self.pending.is_some() {
            if let Some(pending) = self.give(Evidence::Unavailable, outcome) {
                let spent = Spent {
                    policy: pending.deciding,
                    ..Spent::default()
                };
                return Some(Answered { pending, spent });
            }
        }
        None
    }

    /// Gives the policy evidence for the pending frame; the frame, if it needs nothing more.
    fn give(&mut self, evidence: Evidence<'_>, outcome: &mut Outcome) -> Option<PendingFrame> {
        let mut pending = self.pending.take()?;
        let frame = pending.frame.head.index;
        let deciding = Instant::now();
        let delivered = self.policy.deliver(frame, evidence, outcome);
        pending.deciding += deciding.elapsed();
        pending.need = delivered.unwrap_or(Need::Nothing);
        if pending.need == Need::Nothing {
            return Some(pending);
        }
        self.pending = Some(pending);
        None
    }
}
