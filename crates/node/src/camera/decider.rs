//! A camera's policy, and the frame that waits for evidence.

use super::BegunFrame;
use super::evidence::LiveEvidence;
use albireo_core::policy::{Evidence, LatePolicy, Need, Outcome};
use albireo_service::clock::milliseconds;
use albireo_service::rate_limit::RateLimit;
use albireo_vision::picture::FrameFault;
use std::future::Future;
use std::pin::Pin;
use std::time::Duration;
use tokio::time::Instant;

static BROKEN: RateLimit = RateLimit::new(Duration::from_secs(10));

/// Decides a camera's frames one at a time, and gives the policy the evidence it needs.
pub(super) struct Decider {
    pub policy: LatePolicy,
    /// The frame that waits for evidence.
    pending: Option<BegunFrame>,
    /// The source of evidence; `None` while it is fetching.
    evidence: Option<LiveEvidence>,
    fetching: Option<Pin<Box<dyn Future<Output = Fetched> + Send>>>,
}

/// A frame that no longer waits: with its final answer, or the fault of a broken picture that gets none.
type Decided = Result<BegunFrame, FrameFault>;

/// The evidence fetched for frame `index` of the camera.
pub(super) struct Fetched {
    index: u64,
    evidence: LiveEvidence,
    result: Result<(), FrameFault>,
}

impl Decider {
    /// Creates a decider for `policy`.
    pub(super) fn new(policy: LatePolicy, evidence: LiveEvidence) -> Self {
        Self {
            policy,
            pending: None,
            evidence: Some(evidence),
            fetching: None,
        }
    }

    /// True if a frame waits for evidence.
    pub(super) fn is_pending(&self) -> bool {
        self.pending.is_some()
    }

    /// True if frames that need evidence are answered by prediction first.
    pub(super) fn answers_at_once(&self) -> bool {
        !self.policy.waits()
    }

    /// Asks the policy about a frame: overwrites `outcome` with its answer so far, and returns what it needs. A call that is
    /// near joins a run that is about to begin, if the picture can be used and the evidence is not busy with another frame.
    pub(super) fn ask(&mut self, frame: &BegunFrame, outcome: &mut Outcome) -> Need {
        let join = match &self.evidence {
            Some(evidence) if !frame.incoming.is_broken => evidence.join(frame.head.picture),
            _ => 0.0,
        };
        self.policy.set_join(join);
        self.policy.frame(frame.head, outcome)
    }

    /// Fetches the evidence for a frame.
    pub(super) fn fetch(&mut self, frame: BegunFrame) {
        self.pending = Some(frame);
        self.fetch_next();
    }

    /// Starts fetching for the pending frame, unless the previous frame is still being examined.
    fn fetch_next(&mut self) {
        let Some(frame) = &self.pending else {
            return;
        };
        let Some(mut evidence) = self.evidence.take() else {
            return;
        };
        let index = frame.incoming.index;
        let need = frame.need;
        let picture = frame.incoming.frame.picture.clone();
        self.fetching = Some(Box::pin(async move {
            let result = evidence.fetch(need, &picture).await;
            Fetched {
                index,
                evidence,
                result,
            }
        }));
    }

    /// Waits for the evidence being fetched; forever if there is none.
    pub(super) async fn fetched(&mut self) -> Fetched {
        let Some(fetching) = &mut self.fetching else {
            return std::future::pending().await;
        };
        let fetched = fetching.await;
        self.fetching = None;
        fetched
    }

    /// Gives the fetched evidence to the pending frame and fetches its next need. Returns the frame if it no longer
    /// waits; its final answer is then in `outcome`.
    pub(super) fn deliver(&mut self, fetched: Fetched, outcome: &mut Outcome) -> Option<Decided> {
        let Fetched {
            index,
            mut evidence,
            result,
        } = fetched;
        let waiting = self.pending.as_ref().filter(|frame| frame.incoming.index == index);
        let asked = waiting.map(|frame| (frame.need, frame.head.picture));
        let mut decided = match (asked, result) {
            // For a frame that was given up. Another one may be waiting.
            (None, _) => None,
            (Some((need, picture)), Ok(())) => {
                // The run that it could have joined may have begun while its picture was examined.
                self.policy.set_join(evidence.join(picture));
                self.give(evidence.fetched(need), outcome).map(Ok)
            }
            (Some(_), Err(fault)) => self.broken(fault, outcome),
        };
        if let Some(Ok(frame)) = &mut decided {
            let policy = frame.times.latency.policy;
            frame.times = evidence.times();
            frame.times.latency.policy = policy;
        }
        if decided.is_some() || asked.is_none() {
            evidence.next_frame();
        }
        self.evidence = Some(evidence);
        self.fetch_next();
        decided
    }

    /// Makes the policy's prediction the final answer of a frame whose picture is not to be trusted.
    pub(super) fn without_evidence(
        &mut self,
        frame: BegunFrame,
        outcome: &mut Outcome,
    ) -> Option<BegunFrame> {
        self.pending = Some(frame);
        self.give_up(outcome)
    }

    /// Makes the policy's prediction the final answer of the pending frame, if there is one.
    pub(super) fn give_up(&mut self, outcome: &mut Outcome) -> Option<BegunFrame> {
        while self.pending.is_some() {
            if let Some(frame) = self.give(Evidence::Unavailable, outcome) {
                return Some(frame);
            }
        }
        None
    }

    /// Handles a broken picture of the pending frame: if it was answered at once, its prediction becomes final;
    /// otherwise it gets no answer.
    fn broken(&mut self, fault: FrameFault, outcome: &mut Outcome) -> Option<Decided> {
        if self.answers_at_once() {
            BROKEN.log(|held_back| {
                tracing::warn!(held_back, %fault, "broken picture: the frame keeps its predicted answer");
            });
            return self.give(Evidence::Unavailable, outcome).map(Ok);
        }
        self.pending = None;
        Some(Err(fault))
    }

    /// Gives the policy evidence for the pending frame. Returns the frame if it needs nothing more.
    fn give(&mut self, evidence: Evidence<'_>, outcome: &mut Outcome) -> Option<BegunFrame> {
        let frame = self.pending.as_mut()?;
        let deciding = Instant::now();
        let delivered = self.policy.deliver(frame.head.index, evidence, outcome);
        frame.times.latency.policy += milliseconds(deciding.elapsed());
        frame.need = delivered.unwrap_or(Need::Nothing);
        self.pending.take_if(|frame| frame.need == Need::Nothing)
    }
}
