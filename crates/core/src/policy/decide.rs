//! The loop that drives a policy. Live camera, evaluation, benches and tests differ only in their source of evidence.

use super::{Evidence, FrameHead, GreyPicture, Need, Outcome, Policy};
use crate::detection::Detection;
use std::convert::Infallible;

/// A source of the evidence about one frame that is available immediately.
pub trait EvidenceAtHand {
    /// The error that abandons the frame.
    type Error: Send;

    /// Returns the evidence for `need`, which is never [`Need::Nothing`].
    ///
    /// # Errors
    /// An error if the frame must be abandoned.
    fn evidence(&mut self, need: Need) -> Result<Evidence<'_>, Self::Error>;
}

/// Runs `policy` on one frame: delivers evidence until it needs nothing, then overwrites `outcome` with state and
/// boxes. Does not allocate.
///
/// # Errors
/// The source's error, which abandons the frame. `outcome` is then unchanged, and the policy continues with the next
/// frame as after a lost one.
pub fn decide<S: EvidenceAtHand>(
    policy: &mut dyn Policy,
    head: FrameHead,
    source: &mut S,
    outcome: &mut Outcome,
) -> Result<(), S::Error> {
    let mut need = policy.begin(head);
    while need != Need::Nothing {
        need = policy.answer(source.evidence(need)?);
    }
    policy.finish(outcome);
    Ok(())
}

/// Precomputed evidence about a frame, for benches, tests and recordings without pictures. `None` means
/// [`Evidence::Unavailable`].
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameEvidence<'a> {
    /// True if the empty-scene screen reports that nothing is in view.
    pub empty: Option<bool>,
    /// The grey picture, at the requested size.
    pub grey: Option<GreyPicture<'a>>,
    /// The detections.
    pub detections: Option<&'a [Detection]>,
}

impl<'a> FrameEvidence<'a> {
    /// Creates the evidence of a frame with `detections`, without a screen or a picture.
    pub fn detections(detections: &'a [Detection]) -> Self {
        Self {
            detections: Some(detections),
            ..Self::default()
        }
    }

    /// Creates the evidence of a frame with `detections` for which the screen reports "not empty".
    pub fn in_view(detections: &'a [Detection]) -> Self {
        Self {
            empty: Some(false),
            ..Self::detections(detections)
        }
    }
}

impl EvidenceAtHand for FrameEvidence<'_> {
    type Error = Infallible;

    fn evidence(&mut self, need: Need) -> Result<Evidence<'_>, Infallible> {
        let known = match need {
            Need::Nothing => None,
            Need::Screen => self.empty.map(|empty| Evidence::Screen { empty }),
            Need::GreyPicture | Need::SmallGreyPicture { .. } => {
                self.grey.map(Evidence::GreyPicture)
            }
            Need::Detections => self.detections.map(Evidence::Detections),
        };
        Ok(known.unwrap_or(Evidence::Unavailable))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::tests::{head, seen};
    use crate::policy::{Albireo, AlbireoSettings, FrameState};

    /// A picture that cannot be decoded.
    struct Broken;

    impl EvidenceAtHand for Broken {
        type Error = Need;

        fn evidence(&mut self, need: Need) -> Result<Evidence<'_>, Need> {
            Err(need)
        }
    }

    #[test]
    fn an_abandoned_frame_keeps_the_outcome_and_the_next_one_is_decided() {
        let mut policy = Albireo::new(AlbireoSettings::paper(), 3e-4).unwrap();
        let found = [seen(0.5, 0.9)];
        let mut outcome = Outcome {
            state: FrameState::AI,
            ..Outcome::default()
        };
        let before = outcome.clone();
        let given_up = decide(&mut policy, head(0), &mut Broken, &mut outcome);
        assert_eq!(given_up, Err(Need::Screen));
        assert_eq!(outcome, before);
        let mut known = FrameEvidence::in_view(&found);
        let Ok(()) = decide(&mut policy, head(1), &mut known, &mut outcome);
        assert_eq!(outcome.state, FrameState::EI);
        assert_eq!(outcome.boxes.len(), 1);
    }
}
