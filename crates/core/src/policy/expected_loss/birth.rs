//! The expected number of new objects since the last detector call.

use super::settings::{BIRTH_MEMORY, BIRTH_PRIOR, BIRTH_WEIGHT};

/// The birth rate b: summed scores of new objects per frame, with a memory of [`BIRTH_MEMORY`] frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BirthRate {
    /// Summed scores; each frame forgets the share `1/BIRTH_MEMORY`.
    sum: f64,
}

impl Default for BirthRate {
    /// The prior rate, before any observation.
    fn default() -> Self {
        Self {
            sum: BIRTH_PRIOR * BIRTH_MEMORY,
        }
    }
}

impl BirthRate {
    /// Replaces [`BIRTH_PRIOR`] by `prior`.
    pub(crate) fn expect(&mut self, prior: f64) {
        self.sum = (self.sum + (prior - BIRTH_PRIOR) * BIRTH_MEMORY).max(0.0);
    }

    /// Fades the rate over `frames` frames.
    pub(crate) fn fade(&mut self, frames: u32) {
        let kept = 1.0 - 1.0 / BIRTH_MEMORY;
        // As good as all of it is forgotten long before so many frames.
        self.sum *= kept.powi(frames.min(1_000_000) as i32);
    }

    /// Adds the summed scores of new objects.
    pub(crate) fn count(&mut self, scores: f64) {
        self.sum += scores;
    }

    /// Returns the expected loss of objects that appeared in `frames` frames: `B = birth·b·T`.
    pub(crate) fn expected_loss(&self, frames: u32) -> f64 {
        BIRTH_WEIGHT * self.sum / BIRTH_MEMORY * f64::from(frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_prior_keeps_the_counts() {
        let rate = |prior: Option<f64>| {
            let mut births = BirthRate::default();
            births.fade(1);
            births.count(2.0);
            if let Some(prior) = prior {
                births.expect(prior);
            }
            births.expected_loss(1)
        };
        assert_eq!(rate(Some(BIRTH_PRIOR)), rate(None));
        let more = (rate(Some(0.2)) - rate(None)) / BIRTH_WEIGHT;
        assert!((more - (0.2 - BIRTH_PRIOR)).abs() < 1e-12);
        let mut births = BirthRate::default();
        births.fade(1000);
        births.expect(0.0);
        assert_eq!(births.expected_loss(1), 0.0);
    }
}
