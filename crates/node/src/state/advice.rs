//! Detects a policy that skips nothing although objects are tracked, and suggests a value for its threshold.

use albireo_core::policy::{ThresholdSpec, short};
use albireo_wire::{DetectionsMessage, Threshold, significant};
use serde::Serialize;
use utoipa::ToSchema;

/// The number of frames after which a policy that has skipped none is reported.
const FRAMES: u64 = 300;

/// The required number of frames with objects: frames without objects do not depend on the threshold.
const FOLLOWED: u64 = 100;

/// The number of uncertainties kept for the suggestion.
const KEPT: usize = 512;

/// A policy that has skipped nothing, and a value to try.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Advice {
    /// Frames since the last change of the threshold; the detector ran on every one.
    pub frames: u64,
    /// The number of these frames with objects.
    pub followed: u64,
    /// The threshold's name.
    pub threshold: &'static str,
    /// Its value.
    pub value: f64,
    /// A value under which about half of those frames would have been predicted.
    #[serde(rename = "try")]
    pub attempt: f64,
}

impl std::fmt::Display for Advice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "no frame of {} was skipped, although objects were tracked in {} of them; try {} = {} (it is {})",
            self.frames,
            self.followed,
            self.threshold,
            short(self.attempt),
            short(self.value)
        )
    }
}

/// Counts frames until it is clear whether a policy skips any.
#[derive(Clone, Debug, Default)]
pub struct SkipWatch {
    threshold: Option<Threshold>,
    frames: u64,
    followed: u64,
    has_skipped: bool,
    taus: Vec<f64>,
}

impl SkipWatch {
    /// Counts an answered frame; true at the frame with which it becomes clear that nothing is skipped. A changed
    /// threshold restarts the count. Degraded frames do not count.
    pub fn count(&mut self, message: &DetectionsMessage) -> bool {
        if message.threshold != self.threshold {
            *self = Self {
                threshold: message.threshold,
                ..Self::default()
            };
        }
        if message.degraded || self.has_skipped {
            return false;
        }
        let was_clear = self.is_clear();
        self.has_skipped = message.state.is_skipped();
        self.frames += 1;
        if message.tau_max.is_some() || !message.boxes.is_empty() {
            self.followed += 1;
        }
        if let Some(tau) = message.tau_max
            && self.taus.len() < KEPT
        {
            self.taus.push(tau);
        }
        self.is_clear() && !was_clear
    }

    fn is_clear(&self) -> bool {
        !self.has_skipped && self.frames >= FRAMES && self.followed >= FOLLOWED
    }

    /// Suggests a value, if it is clear that nothing is skipped and `spec` can change that.
    pub(crate) fn advice(&self, spec: &ThresholdSpec) -> Option<Advice> {
        if self.is_clear() {
            self.attempt(spec)
        } else {
            None
        }
    }

    /// Like [`Self::advice`], from any number of frames: for a finished clip.
    pub fn advice_so_far(&self, spec: &ThresholdSpec) -> Option<Advice> {
        if self.has_skipped || self.followed == 0 {
            return None;
        }
        self.attempt(spec)
    }

    /// The value to try, if a larger one can make a difference.
    fn attempt(&self, spec: &ThresholdSpec) -> Option<Advice> {
        let value = self.threshold?.value_of(spec).ok()?;
        let attempt = match spec.name {
            "u" => above_the_median(&self.taus)?,
            "lambda" if value < spec.default => spec.default,
            "lambda" => one_digit_above(value * 1.5),
            // For other thresholds, the value itself shows that they skip nothing.
            _ => return None,
        };
        // If the threshold is already above it, a cap calls the detector, and no value helps.
        if attempt <= value || attempt > spec.maximum {
            return None;
        }
        Some(Advice {
            frames: self.frames,
            followed: self.followed,
            threshold: spec.name,
            value,
            attempt,
        })
    }
}

/// A round number above the median.
fn above_the_median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().map(one_digit_above)
}

/// The smallest larger number with one significant digit.
fn one_digit_above(value: f64) -> f64 {
    let unit = 10_f64.powf(value.log10().floor());
    // 3e-4 / 1e-4 is slightly less than 3.
    let digit = (value / unit + 1e-9).floor() + 1.0;
    // Equals the printed number: 4e-4, not 4.0000000000000003e-4.
    significant(digit * unit, 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::answer;
    use albireo_core::policy::{Albireo, ExpectedLoss, FrameState};

    fn count(
        watch: &mut SkipWatch,
        state: FrameState,
        spec: &ThresholdSpec,
        value: f64,
        tau: f64,
    ) -> bool {
        let message = DetectionsMessage {
            threshold: Some(Threshold::new(spec.name, value)),
            tau_max: if tau > 0.0 { Some(tau) } else { None },
            ..answer(0, state)
        };
        watch.count(&message)
    }

    /// The advised value after frames that are all alike; without objects where `tau` is 0.
    fn advised(state: FrameState, spec: &ThresholdSpec, value: f64, tau: f64) -> Option<f64> {
        let mut watch = SkipWatch::default();
        for _ in 0..1000 {
            count(&mut watch, state, spec, value, tau);
        }
        watch.advice(spec).map(|advice| advice.attempt)
    }

    #[test]
    fn a_policy_that_skips_nothing_gets_a_value_that_would_skip() {
        let spec = Albireo::THRESHOLD;
        let mut watch = SkipWatch::default();
        let mut became_clear_at = Vec::new();
        for frame in 0..400_u32 {
            let tau = 1.9e-4 + 1e-6 * f64::from(frame % 10);
            if count(&mut watch, FrameState::I, &spec, 1e-4, tau) {
                became_clear_at.push(frame);
            }
        }
        assert_eq!(became_clear_at, [299], "once");
        assert_eq!(
            watch.advice(&spec).unwrap().to_string(),
            "no frame of 400 was skipped, although objects were tracked in 400 of them; try u = 2e-4 (it is 1e-4)"
        );
        // A changed threshold begins again, and one skipped frame is enough to be silent.
        count(&mut watch, FrameState::P, &spec, 2e-4, 1.9e-4);
        for _ in 0..400 {
            count(&mut watch, FrameState::I, &spec, 2e-4, 3e-4);
        }
        assert_eq!(watch.advice(&spec), None);
        assert_eq!(watch.advice_so_far(&spec), None);
    }

    #[test]
    fn only_a_threshold_that_prevents_skipping_gets_advice() {
        let spec = Albireo::THRESHOLD;
        // An empty street.
        assert_eq!(advised(FrameState::EI, &spec, 3e-4, 0.0), None);
        // The uncertainty is below the threshold already: a cap calls the detector.
        assert_eq!(advised(FrameState::I, &spec, 1e-3, 2e-4), None);
        let lambda = ExpectedLoss::THRESHOLD;
        let advised = advised(FrameState::I, &lambda, 0.0, 0.1);
        assert_eq!(advised, Some(lambda.default));
    }

    #[test]
    fn the_next_round_number_is_greater_and_prints_short() {
        for (value, next) in [(1.91e-4, 2e-4), (3e-4, 4e-4), (9.5e-4, 1e-3), (0.45, 0.5)] {
            assert_eq!(one_digit_above(value), next);
        }
    }
}
