//! A rate with the interval it is known to.

use super::{BoxCounts, SquareSums};
use serde::{Deserialize, Serialize};

/// The quantile of the normal distribution for an interval that holds 95 times of 100.
const QUANTILE_95: f64 = 1.959_963_984_540_054;

/// A share of boxes, and between what it lies at a confidence of 95 %.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditRate {
    /// The share, 0 to 1.
    pub rate: f64,
    /// Lower end of the Wilson interval.
    pub low: f64,
    /// Upper end of the Wilson interval.
    pub high: f64,
    /// The boxes it is a share of.
    pub boxes: u64,
    /// As how many independent boxes they count: those of one frame are shown or missed together.
    pub independent: f64,
}

impl AuditRate {
    /// The share `counts` of a sample whose boxes count `effect` times less than independent ones. `None` without
    /// boxes.
    pub(super) fn new(counts: &BoxCounts, effect: f64) -> Option<Self> {
        if counts.boxes == 0 {
            return None;
        }
        let boxes = counts.boxes as f64;
        let independent = (boxes / effect).clamp(1.0, boxes);
        let rate = (counts.paired as f64 / boxes).min(1.0);
        let (low, high) = wilson(rate, independent);
        Some(Self {
            rate,
            low,
            high,
            boxes: counts.boxes,
            independent,
        })
    }
}

/// The interval of E. B. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
/// American Statistical Association 22, 1927.
fn wilson(rate: f64, count: f64) -> (f64, f64) {
    let z2 = QUANTILE_95 * QUANTILE_95;
    let center = (rate + z2 / (2.0 * count)) / (1.0 + z2 / count);
    let reach = QUANTILE_95 / (1.0 + z2 / count)
        * (rate * (1.0 - rate) / count + z2 / (4.0 * count * count)).sqrt();
    // At the ends rounding would leave a trace beside 0 and 1.
    let low = if rate <= 0.0 { 0.0 } else { center - reach };
    let high = if rate >= 1.0 { 1.0 } else { center + reach };
    (low.max(0.0), high.min(1.0))
}

/// How much less than independent ones the boxes of these frames tell (L. Kish's design effect): frames are drawn, not
/// boxes, and the boxes of a frame are shown or missed together. The variance is that of a ratio over drawn frames.
///
/// One frame more is assumed, half of it shown: from few frames that all agree no certainty follows.
pub(super) fn design_effect(counts: &BoxCounts, squares: &SquareSums) -> f64 {
    let boxes = counts.boxes as f64;
    if boxes <= 0.0 {
        return 1.0;
    }
    let paired = counts.paired as f64;
    let crowd = (squares.boxes as f64 / boxes).max(1.0);
    let rate = ((paired + crowd / 2.0) / (boxes + crowd)).min(1.0);
    let assumed = crowd * crowd / 2.0 * ((1.0 - rate).powi(2) + rate * rate);
    let residuals = squares.paired as f64 - 2.0 * rate * squares.product as f64
        + rate * rate * squares.boxes as f64
        + assumed;
    let clustered = residuals / (boxes + crowd);
    let independent = rate * (1.0 - rate);
    if independent > 0.0 && clustered.is_finite() {
        (clustered / independent).max(1.0)
    } else {
        1.0
    }
}
