//! How unlike the known empty pictures a picture is.

use super::thumbnail::{FEATURES, Features};

/// Weight of a new empty picture in the memory, once there are enough of them.
const MEMORY: f32 = 0.02;
/// Variance of a feature before anything is known of it, and what is added to the variance learnt.
const PRIOR_VARIANCE: f32 = 0.05;
const LEAST_VARIANCE: f32 = 1e-3;
/// Novelty is the mean of so many of the largest deviations: one alone is noise, and an object that enters
/// fills few tiles.
const LARGEST: usize = 3;

/// Running mean and variance of every feature over the pictures that were found empty.
#[derive(Clone, Debug)]
pub(super) struct EmptyScenes {
    mean: Box<Features>,
    variance: Box<Features>,
    seen: u32,
}

impl EmptyScenes {
    pub(super) fn new() -> Self {
        Self {
            mean: Box::new([0.0; FEATURES]),
            variance: Box::new([PRIOR_VARIANCE; FEATURES]),
            seen: 0,
        }
    }

    /// Takes a picture in which the detector found nothing.
    pub(super) fn learn(&mut self, features: &Features) {
        self.seen = self.seen.saturating_add(1);
        if self.seen == 1 {
            *self.mean = *features;
            return;
        }
        let rate = (1.0 / self.seen as f32).max(MEMORY);
        for ((mean, variance), feature) in
            (self.mean.iter_mut().zip(&mut *self.variance)).zip(features)
        {
            let difference = feature - *mean;
            *mean += rate * difference;
            *variance = (1.0 - rate) * (*variance + rate * difference * difference);
        }
    }

    /// Standard deviations from the known empty pictures, over the features that are furthest off;
    /// infinite while none is known.
    pub(super) fn novelty(&self, features: &Features) -> f32 {
        if self.seen == 0 {
            return f32::INFINITY;
        }
        let mut largest = [0.0f32; LARGEST];
        for ((mean, variance), feature) in (self.mean.iter().zip(&*self.variance)).zip(features) {
            let deviation = (feature - mean).abs() / (variance + LEAST_VARIANCE).sqrt();
            if deviation > largest[LARGEST - 1] {
                largest[LARGEST - 1] = deviation;
                largest.sort_by(|a, b| b.total_cmp(a));
            }
        }
        largest.iter().sum::<f32>() / LARGEST as f32
    }
}
