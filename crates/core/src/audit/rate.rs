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

impl AuditRate {
    /// Returns the share `paired` of `boxes`, given the sums over frames of `paired²`, `boxes·paired` and `boxes²`.
    /// `None` without boxes.
    pub(super) fn new([paired, boxes]: [u64; 2], squares: [u64; 3]) -> Option<Self> {
        if boxes == 0 {
            return None;
        }
        let count = boxes as f64;
        let paired = (paired as f64).min(count);
        let effect = design_effect(paired, count, squares.map(|sum| sum as f64));
        let independent = (count / effect).clamp(1.0, count);
        let rate = paired / count;
        let (low, high) = wilson(rate, independent);
        Some(Self {
            rate,
            low,
            high,
            boxes,
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
pub(super) fn wilson(rate: f64, count: f64) -> (f64, f64) {
    let z2 = QUANTILE_95 * QUANTILE_95;
    let center = (rate + z2 / (2.0 * count)) / (1.0 + z2 / count);
    let reach = QUANTILE_95 / (1.0 + z2 / count)
        * (rate * (1.0 - rate) / count + z2 / (4.0 * count * count)).sqrt();
    // Rounding would not give exactly 0 or 1 at the ends.
    let low = if rate <= 0.0 { 0.0 } else { center - reach };
    let high = if rate >= 1.0 { 1.0 } else { center + reach };
    (low.max(0.0), high.min(1.0))
}

/// The variance of the rate relative to independent boxes (L. Kish's design effect), because frames are drawn, not
/// boxes. The variance is that of a ratio over drawn frames.
///
/// One more frame is assumed, half of it shown: a few frames that all agree give no certainty.
pub(super) fn design_effect(
    paired: f64,
    boxes: f64,
    [paired_2, product, boxes_2]: [f64; 3],
) -> f64 {
    let crowd = (boxes_2 / boxes).max(1.0);
    let rate = ((paired + crowd / 2.0) / (boxes + crowd)).min(1.0);
    let assumed = crowd * crowd / 2.0 * ((1.0 - rate).powi(2) + rate * rate);
    let residuals = paired_2 - 2.0 * rate * product + rate * rate * boxes_2 + assumed;
    let clustered = residuals / (boxes + crowd);
    let independent = rate * (1.0 - rate);
    if independent > 0.0 && clustered.is_finite() {
        (clustered / independent).max(1.0)
    } else {
        1.0
    }
}
