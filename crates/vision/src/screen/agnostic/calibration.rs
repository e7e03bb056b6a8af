//! From how unlike the empty scenes a picture is to whether that is little enough, with a bounded share of
//! occupied pictures that are called empty.
//!
//! The threshold is the conformal quantile of the novelty of recent pictures in which the detector did find
//! something: as long as the next occupied picture is like them, at most the share α of such pictures lies
//! below it (split conformal prediction; Vovk, Gammerman and Shafer 2005). Scenes drift, so α itself is
//! driven by the errors that are found (adaptive conformal inference; Gibbs and Candès 2021): each occupied
//! picture that was called empty costs, each that was not earns. Only a sample of the pictures called empty
//! is looked at, so what is found there counts by the inverse of its chance.

use std::collections::VecDeque;

/// Occupied pictures remembered.
const WINDOW: usize = 400;
/// Step of the drive of α.
const STEP: f64 = 0.05;

/// The threshold and what it comes from.
#[derive(Clone, Debug)]
pub(super) struct Calibration {
    /// The share α that may be missed.
    allowed: f64,
    /// α as driven by what was found; at most `allowed`.
    share: f64,
    /// Novelty and weight of the occupied pictures.
    occupied: VecDeque<(f32, f64)>,
    threshold: f32,
}

impl Calibration {
    pub(super) fn new(allowed: f64) -> Self {
        Self {
            allowed,
            share: allowed,
            occupied: VecDeque::with_capacity(WINDOW),
            threshold: f32::NEG_INFINITY,
        }
    }

    /// Below this novelty a picture is called empty; nothing is while it is minus infinity.
    pub(super) const fn threshold(&self) -> f32 {
        self.threshold
    }

    /// Takes a picture in which the detector found something. `called_empty` when the screen had said
    /// otherwise; `weight` is the inverse of the chance with which the picture was looked at.
    pub(super) fn learn(&mut self, novelty: f32, called_empty: bool, weight: f64) {
        let error = if called_empty { weight } else { 0.0 };
        self.share = (self.share + STEP * (self.allowed - error)).min(self.allowed);
        if self.occupied.len() == WINDOW {
            self.occupied.pop_front();
        }
        self.occupied.push_back((novelty, weight));
        self.threshold = self.quantile();
    }

    /// The largest novelty seen for which the weight of all smaller ones, and one more, is at most the
    /// share of the whole.
    fn quantile(&self) -> f32 {
        let mut sorted: Vec<_> = self.occupied.iter().copied().collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let all = 1.0 + sorted.iter().map(|(_, weight)| weight).sum::<f64>();
        let most = self.share.max(0.0) * all;
        let mut below = 1.0;
        let mut threshold = f32::NEG_INFINITY;
        for (novelty, weight) in sorted {
            if below > most {
                break;
            }
            threshold = novelty;
            below += weight;
        }
        threshold
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_empty_before_enough_occupied_pictures_bound_the_share() {
        let mut calibration = Calibration::new(0.05);
        for _ in 0..18 {
            calibration.learn(10.0, false, 1.0);
            assert_eq!(calibration.threshold(), f32::NEG_INFINITY);
        }
        calibration.learn(10.0, false, 1.0);
        assert_eq!(calibration.threshold(), 10.0);
    }

    #[test]
    fn at_most_the_allowed_share_lies_below_the_threshold() {
        let mut calibration = Calibration::new(0.05);
        for novelty in 0..400 {
            calibration.learn((novelty * 7 % 400) as f32, false, 1.0);
        }
        let below = (0..400).filter(|&novelty| (novelty as f32) < calibration.threshold());
        assert_eq!(below.count(), 19);
    }

    #[test]
    fn an_object_found_in_a_picture_called_empty_lowers_the_threshold_at_once() {
        let mut calibration = Calibration::new(0.05);
        for novelty in 0..200 {
            calibration.learn(novelty as f32, false, 1.0);
        }
        let before = calibration.threshold();
        assert!(before > 5.0);
        calibration.learn(3.0, true, 5.0);
        assert!(calibration.threshold() <= 3.0);
        // It takes many good answers to be believed again.
        for _ in 0..60 {
            calibration.learn(50.0, false, 1.0);
            assert!(calibration.threshold() <= 3.0);
        }
    }
}
