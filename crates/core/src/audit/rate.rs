//! A rate and its confidence interval.

use serde::{Deserialize, Serialize};

/// The quantile of the normal distribution for a 95 % interval.
const QUANTILE_95: f64 = 1.959_963_984_540_054;

/// A share of boxes with its 95 % confidence interval.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditRate {
    /// The share on the compared frames, 0 to 1.
    pub rate: f64,
    /// Lower end of the interval: the Wilson interval of the sample, with every box of the missed frames counted as a
    /// failure.
    pub low: f64,
    /// Upper end of the interval: the same, with every box of the missed frames counted as a success.
    pub high: f64,
    /// Number of compared boxes.
    pub boxes: u64,
    /// Equivalent number of independent boxes: the boxes of one frame are shown or missed together.
    pub independent: f64,
}

/// Sums over frames: the boxes of one side, how many of them are paired, and the squares and product of both counts.
#[derive(Clone, Copy)]
pub(super) struct SideSums {
    pub paired: u64,
    pub boxes: u64,
    pub paired_squared: u64,
    pub boxes_paired: u64,
    pub boxes_squared: u64,
}

/// An interval of shares.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interval {
    pub low: f64,
    pub high: f64,
}

impl AuditRate {
    /// Returns the share of the boxes that are paired. `None` without boxes.
    pub(super) fn new(sums: SideSums) -> Option<Self> {
        if sums.boxes == 0 {
            return None;
        }
        let boxes = sums.boxes as f64;
        let rate = (sums.paired as f64).min(boxes) / boxes;
        let independent = (boxes / design_effect(sums)).clamp(1.0, boxes);
        let Interval { low, high } = wilson(rate, independent);
        Some(Self {
            rate,
            low,
            high,
            boxes: sums.boxes,
            independent,
        })
    }

    /// Returns the rate with an interval that includes `missed` unknown boxes: all are failures at its lower end and
    /// successes at its upper end (C. F. Manski, "Nonparametric bounds on treatment effects", 1990).
    pub(super) fn widened(self, missed: u64) -> Self {
        let known = self.boxes as f64 / (self.boxes as f64 + missed as f64);
        Self {
            low: self.low * known,
            high: 1.0 - (1.0 - self.high) * known,
            ..self
        }
    }
}

/// The interval of E. B. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
/// American Statistical Association 22, 1927.
pub(super) fn wilson(rate: f64, count: f64) -> Interval {
    let z2 = QUANTILE_95 * QUANTILE_95;
    let scale = 1.0 + z2 / count;
    let center = (rate + z2 / (2.0 * count)) / scale;
    let spread = (rate * (1.0 - rate) / count + z2 / (4.0 * count * count)).sqrt();
    let reach = QUANTILE_95 / scale * spread;
    // Rounding would not give exactly 0 or 1 at the ends.
    let low = if rate <= 0.0 { 0.0 } else { center - reach };
    let high = if rate >= 1.0 { 1.0 } else { center + reach };
    Interval {
        low: low.max(0.0),
        high: high.min(1.0),
    }
}

/// The variance of the rate relative to independent boxes (L. Kish's design effect), because frames are drawn, not
/// boxes. The variance is that of a ratio over drawn frames.
///
/// One more frame is assumed, half of it shown: a few frames that all agree give no certainty.
pub(super) fn design_effect(sums: SideSums) -> f64 {
    let boxes = sums.boxes as f64;
    let paired = (sums.paired as f64).min(boxes);
    let paired_squared = sums.paired_squared as f64;
    let boxes_paired = sums.boxes_paired as f64;
    let boxes_squared = sums.boxes_squared as f64;
    let crowd = (boxes_squared / boxes).max(1.0);
    let rate = ((paired + crowd / 2.0) / (boxes + crowd)).min(1.0);
    let assumed = crowd * crowd / 2.0 * ((1.0 - rate).powi(2) + rate * rate);
    let residuals =
        paired_squared - 2.0 * rate * boxes_paired + rate * rate * boxes_squared + assumed;
    let clustered = residuals / (boxes + crowd);
    let independent = rate * (1.0 - rate);
    if independent > 0.0 && clustered.is_finite() {
        (clustered / independent).max(1.0)
    } else {
        1.0
    }
}
