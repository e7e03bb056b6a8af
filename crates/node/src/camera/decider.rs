//! A camera's policy, and the one frame that waits for evidence.

use super::BegunFrame;
use super::evidence::LiveEvidence;
use albireo_core::policy::{Evidence, LatePolicy, Need, Outcome};
use albireo_service::clock::milliseconds;
use albireo_service::rate_limit::SharedLimit;
use albireo_vision::picture::FrameFault;
use std::future::Future;
use std::pin::Pin;
use tokio::time::Instant;

static BROKEN: SharedLimit = SharedLimit::new();

/// Decides a camera's frames, one after the other: gives the policy what it needs of each.
pub(crate) struct Decider {
    pub policy: LatePolicy,
    /// The frame that waits for evidence, and what it needs.
    pending: Option<(BegunFrame, Need)>,
    /// Evidence comes from there. It is away while some is being fetched.
    evidence: Option<LiveEvidence>,
    fetching: Option<Pin<Box<dyn Future<Output = Fetched> + Send>>>,
}

/// A frame that waits no longer: its final answer is known, unless its picture is broken and it gets none.
pub(super) type Decided = Result<BegunFrame, FrameFault>;

/// The evidence that was fetched of frame `index` of the camera.
pub(super) struct Fetched {
    index: u64,
    need: Need,
    evidence: LiveEvidence,
    fetched: Result<(), FrameFault>,
}

impl Decider {
    /// Decides by `policy`.
    pub(crate) fn new(policy: LatePolicy, evidence: LiveEvidence) -> Self {
        Self {
            policy,
            pending: None,
            evidence: Some(evidence),
            fetching: None,
        }
    }

    /// Says whether a frame waits for evidence.
    pub(super) fn is_pending(&self) -> bool {
        self.pending.is_some()
    }

    /// Says whether frames that need evidence are answered by prediction first.
    pub(super) fn answers_at_once(&self) -> bool {
        !self.policy.waits()
    }

    /// Fetches what a frame needs.
    pub(super) fn fetch(&mut self, frame: BegunFrame, need: Need) {
        self.pending = Some((frame, need));
        if let Some(evidence) = &mut self.evidence {
            evidence.next_frame();
        }
        self.fetch_next();
    }

    /// Begins to fetch what the pending frame needs, unless the frame before is still being examined.
    fn fetch_next(&mut self) {
        let Some((frame, need)) = &self.pending else {
            return;
        };
        let Some(mut evidence) = self.evidence.take() else {
            return;
        };
        let (index, need) = (frame.incoming.index, *need);
        let picture = frame.incoming.frame.picture.clone();
        self.fetching = Some(Box::pin(async move {
            let fetched = evidence.fetch(need, &picture).await;
            Fetched {
                index,
                need,
                evidence,
                fetched,
            }
        }));
    }

    /// Waits for what is being fetched; forever when that is nothing.
    pub(super) async fn fetched(&mut self) -> Fetched {
        let Some(fetching) = &mut self.fetching else {
            return std::future::pending().await;
        };
        let fetched = fetching.await;
        self.fetching = None;
        fetched
    }

    /// Gives the pending frame what was fetched, and fetches what it needs next; the frame, if it waits no longer. Its final
    /// answer is in `outcome` then.
    pub(super) fn deliver(&mut self, fetched: Fetched, outcome: &mut Outcome) -> Option<Decided> {
        let Fetched {
            index,
            need,
            mut evidence,
            fetched,
        } = fetched;
        let mut decided = None;
        if (self.pending.as_ref()).is_some_and(|(frame, _)| frame.incoming.index == index) {
            decided = match fetched {
                Ok(()) => self.give(evidence.fetched(need), outcome).map(Ok),
                Err(fault) => self.broken(fault, outcome),
            };
            if let Some(decided) = &mut decided {
                if let Ok(frame) = decided {
                    let policy = frame.times.latency.policy;
                    frame.times = evidence.times();
                    frame.times.latency.policy = policy;
                }
                evidence.end_frame();
            }
        } else {
            // Of a frame that was given up. Another one may wait for its turn.
            evidence.next_frame();
        }
        self.evidence = Some(evidence);
        self.fetch_next();
        decided
    }

    /// Takes what the policy predicts for the final answer of the pending frame, if there is one.
    pub(super) fn give_up(&mut self, outcome: &mut Outcome) -> Option<BegunFrame> {
        while self.pending.is_some() {
            if let Some(frame) = self.give(Evidence::Unavailable, outcome) {
                return Some(frame);
            }
        }
        None
    }

    /// The pending frame's picture is broken: it gets no answer, unless it has one that stays.
    fn broken(&mut self, fault: FrameFault, outcome: &mut Outcome) -> Option<Decided> {
        if self.answers_at_once() {
            BROKEN.log(|held_back| {
                tracing::warn!(held_back, %fault, "a frame that was answered at once stays as predicted");
            });
            return self.give(Evidence::Unavailable, outcome).map(Ok);
        }
        self.pending.take().map(|_| Err(fault))
    }

    /// Gives the policy evidence for the pending frame; the frame, if it needs nothing more.
    fn give(&mut self, evidence: Evidence<'_>, outcome: &mut Outcome) -> Option<BegunFrame> {
        let (mut frame, _) = self.pending.take()?;
        let deciding = Instant::now();
        let delivered = (self.policy).deliver(frame.head.index, evidence, outcome);
        frame.times.latency.policy += milliseconds(deciding.elapsed());
        match delivered.unwrap_or(Need::Nothing) {
            Need::Nothing => Some(frame),
            need => {
                self.pending = Some((frame, need));
                None
            }
        }
    }
}
