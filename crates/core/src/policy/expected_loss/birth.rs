//! How much may have appeared since the detector last looked.

use super::settings::Call;

/// The birth rate b: summed scores of new objects per frame, remembered for `birth_memory` frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BirthRate {
    /// Summed scores, of which each frame forgets the share `1/birth_memory`.
    sum: f64,
}

impl BirthRate {
    /// The rate before anything was seen.
    pub(crate) fn new(settings: &Call) -> Self {
        Self {
            sum: settings.birth_prior * settings.birth_memory,
        }
    }

    /// Another `prior` takes the place of `birth_prior`.
    pub(crate) fn expect(&mut self, settings: &Call, prior: f64) {
        self.sum = (self.sum + (prior - settings.birth_prior) * settings.birth_memory).max(0.0);
    }

    /// `frames` went by.
    pub(crate) fn fade(&mut self, settings: &Call, frames: u32) {
        let kept = 1.0 - 1.0 / settings.birth_memory;
        self.sum *= kept.powi(frames.min(1_000_000) as i32);
    }

    /// Objects with these summed scores were new.
    pub(crate) fn count(&mut self, scores: f64) {
        self.sum += scores;
    }

    /// What is expected to have appeared in `frames` frames and to be lost: `B = birth·b·T`.
    pub(crate) fn expected_loss(&self, settings: &Call, frames: u32) -> f64 {
        settings.birth * self.sum / settings.birth_memory * f64::from(frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_prior_leaves_what_was_counted() {
        let settings = Call::default();
        let rate = |prior: f64| {
            let mut births = BirthRate::new(&settings);
            births.fade(&settings, 1);
            births.count(2.0);
            births.expect(&settings, prior);
            births.expected_loss(&settings, 1)
        };
        assert_eq!(rate(settings.birth_prior), {
            let mut births = BirthRate::new(&settings);
            births.fade(&settings, 1);
            births.count(2.0);
            births.expected_loss(&settings, 1)
        });
        let more = (rate(0.2) - rate(settings.birth_prior)) / settings.birth;
        assert!((more - (0.2 - settings.birth_prior)).abs() < 1e-12);
        let mut births = BirthRate::new(&settings);
        births.fade(&settings, 1000);
        births.expect(&settings, 0.0);
        assert_eq!(births.expected_loss(&settings, 1), 0.0);
    }
}
