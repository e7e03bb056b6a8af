//! The state of one object, its predicted miss probability and its confidence.

use super::motion::{AxisValues, LARGEST_LOG, MotionFilter, X, Y};
use super::settings::{
    ALPHA_RATE, DETECTED_SHARE, HITS_TO_CONFIRM, LARGEST_INNOVATION, LAST_SCORE, LEAST_ALPHA,
    MISS_CONFIDENCE, MISS_WEIGHT, MISSES_TO_REMOVAL, MOST_ALPHA, NEWCOMER, NEWCOMER_FADING,
    PREDICTION, Pixels, SCORE_RATE,
};
use crate::detection::{ClassId, Detection};
use crate::geometry::BoundingBox;
use crate::policy::{ObjectId, ObjectRecord};

/// Converts a box to the filter's units: the unit of length is the picture's height, so that it is the same in both
/// directions and independent of the resolution. `aspect` is the picture's width in that unit.
pub(super) fn measure(bounding_box: BoundingBox, aspect: f64) -> AxisValues {
    [
        bounding_box.center_x * aspect,
        bounding_box.center_y,
        log_side(bounding_box.width * aspect),
        log_side(bounding_box.height),
    ]
}

/// Returns the logarithm of a side, within the limits of the filter.
fn log_side(side: f64) -> f64 {
    side.ln().clamp(-LARGEST_LOG, LARGEST_LOG)
}

/// One object.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Object {
    pub id: ObjectId,
    pub class: ClassId,
    pub filter: MotionFilter,
    /// The scale α of the covariance in the trigger and the gate.
    pub alpha: f64,
    /// Detections matched so far, including the first.
    pub hits: u32,
    /// Consecutive detector frames without a match.
    pub misses: u32,
    /// Frames since the last match.
    pub since_match: u32,
    /// Frames since the last detector answer.
    pub since_detector: u32,
    /// Moving average m of the scores.
    pub mean_score: f64,
    pub last_score: f64,
    /// The probability π that the predicted box is off by too much: see [`Object::judge`].
    pub miss_probability: f64,
    /// The detector's box of this frame, if it found the object.
    pub detected_box: Option<BoundingBox>,
    /// True if optical flow followed the object into this frame.
    pub followed: bool,
    /// Probability, 0 to 1, that the followed box still shows this object, given the flow since the last detection.
    pub health: f64,
    /// Offset of the followed box from the filter's, if boxes are followed: see [`Object::trail`].
    pub offset: Option<AxisValues>,
    /// True if the object was followed since its last detection.
    pub trailing: bool,
    /// Distances over which sides were held at the picture's border since the last detection, while what is inside
    /// moved away: `held_x` and `held_y` of [`judge`](Self::judge), in picture heights.
    pub border_shift: [f64; 2],
}

impl Object {
    /// Creates an object from a detection. `velocity` is the expected one of the centre along x and y, and of both
    /// log-sides, in the units U of the [filter](super::motion).
    pub(crate) fn new(
        id: ObjectId,
        detection: &Detection,
        aspect: f64,
        velocity: &[f64; 3],
        alpha: f64,
        pixels: Pixels,
    ) -> Self {
        let measured = measure(detection.bounding_box, aspect);
        Self {
            id,
            class: detection.class,
            filter: MotionFilter::new(&measured, velocity),
            alpha,
            hits: 1,
            misses: 0,
            since_match: 0,
            since_detector: 0,
            mean_score: detection.confidence,
            last_score: detection.confidence,
            miss_probability: 0.0,
            detected_box: Some(detection.bounding_box),
            followed: false,
            health: 1.0,
            trailing: false,
            border_shift: [0.0; 2],
            offset: (pixels == Pixels::Flow).then_some([0.0; 4]),
        }
    }

    /// Advances by one frame.
    pub(crate) fn predict(&mut self) {
        self.filter.predict();
        self.since_match = self.since_match.saturating_add(1);
        self.since_detector = self.since_detector.saturating_add(1);
        self.detected_box = None;
        self.followed = false;
    }

    /// Applies its detection; returns the mean squared normalised innovation `n = ¼ Σ min(y²/S, largest)`.
    pub(crate) fn update(&mut self, detection: &Detection, aspect: f64) -> f64 {
        let measured = measure(detection.bounding_box, aspect);
        // The innovation must judge the reported box, because α measures its error.
        if self.trailing
            && let Some(offset) = self.offset
        {
            self.filter.shift(&offset);
        }
        let squares = self.filter.update(&measured);
        let limited = squares.map(|square| square.min(LARGEST_INNOVATION));
        let n = limited.iter().sum::<f64>() / 4.0;
        self.alpha = scale(self.alpha, n, ALPHA_RATE);
        self.class = detection.class;
        self.hits = self.hits.saturating_add(1);
        self.misses = 0;
        self.since_match = 0;
        self.since_detector = 0;
        self.last_score = detection.confidence;
        let rate = SCORE_RATE.max(1.0 / f64::from(self.hits));
        self.mean_score += rate * (detection.confidence - self.mean_score);
        self.detected_box = Some(detection.bounding_box);
        self.health = 1.0;
        self.trailing = false;
        self.border_shift = [0.0; 2];
        if let Some(offset) = &mut self.offset {
            let own = self.filter.position();
            *offset = std::array::from_fn(|axis| DETECTED_SHARE * (measured[axis] - own[axis]));
        }
        n
    }

    /// Returns the followed box, in the filter's units. It begins between the detector's box and the filter's and moves
    /// by the measured flow, not by the filter's estimate of it: a filter that is right about speed lags behind the
    /// detector's boxes.
    pub(crate) fn trail(&self) -> AxisValues {
        let own = self.filter.position();
        match self.offset {
            Some(offset) => std::array::from_fn(|axis| own[axis] + offset[axis]),
            None => own,
        }
    }

    /// Counts a miss of the detector. Returns true if the object is kept.
    pub(crate) fn miss(&mut self) -> bool {
        self.misses += 1;
        self.since_detector = 0;
        self.misses < MISSES_TO_REMOVAL
    }

    /// Computes the probability π that the predicted box is off by too much, from the variance of its error relative to
    /// its sides, `σ² = α·(4·p_x/w² + 4·p_y/h² + p_lw + p_lh)`: `π = exp(−0.25 / (2σ²))`, the probability that a
    /// Rayleigh variable of that variance exceeds 1/2.
    ///
    /// Optical flow's loss of health is an independent probability: `1 − (1 − π)·h`. A side held at the picture's
    /// border may be off by the distance over which it was held: `σ² += (held_x/w)² + (held_y/h)²`.
    pub(crate) fn judge(&mut self) {
        let [width, height] = self.filter.sides();
        let [held_x, held_y] = self.border_shift;
        let held_variance = (held_x / width).powi(2) + (held_y / height).powi(2);
        let variance = self.alpha * self.filter.relative_variance() + held_variance;
        // 0.25 / (2σ²).
        let probability = fading(0.125 / variance);
        // Without a loss of health, π itself: 1 − (1 − π) may differ from it in the last bit.
        self.miss_probability = if self.health < 1.0 {
            1.0 - (1.0 - probability) * self.health
        } else {
            probability
        };
    }

    /// Returns the current cost of losing the object: `m · miss^misses · π`.
    pub(crate) fn expected_loss(&self) -> f64 {
        self.mean_score * power(MISS_WEIGHT, self.misses) * self.miss_probability
    }

    /// Returns the confidence to report.
    pub(crate) fn confidence(&self) -> f64 {
        let blend = LAST_SCORE * self.last_score + (1.0 - LAST_SCORE) * self.mean_score;
        let later_hits = f64::from(self.hits.saturating_sub(1));
        let base = blend * (1.0 - NEWCOMER * fading(NEWCOMER_FADING * later_hits));
        if self.detected_box.is_some() {
            return base;
        }
        let located = 1.0 - PREDICTION * self.miss_probability;
        base * power(MISS_CONFIDENCE, self.misses) * located
    }

    /// Returns the box of the filter.
    pub(crate) fn filter_box(&self, aspect: f64) -> BoundingBox {
        let position = self.filter.position();
        let [width, height] = self.filter.sides();
        BoundingBox {
            center_x: position[X] / aspect,
            center_y: position[Y],
            width: width / aspect,
            height,
        }
    }

    /// Returns the share of the predicted box inside the picture.
    pub(crate) fn visible_share(&self, aspect: f64) -> f64 {
        let [width, height] = self.filter.sides();
        let position = self.filter.position();
        let inside = |center: f64, side: f64, end: f64| {
            let visible = (center + side / 2.0).min(end) - (center - side / 2.0).max(0.0);
            visible.max(0.0) / side
        };
        inside(position[X], width, aspect) * inside(position[Y], height, 1.0)
    }

    /// Returns the box to report, not clipped: if detected, the mean of the detector's box and the filter's; else the
    /// followed box, if one is trailed; else the filter's.
    pub(crate) fn bounding_box(&self, aspect: f64) -> BoundingBox {
        let own = self.filter_box(aspect);
        if let Some(detected_box) = self.detected_box {
            return BoundingBox {
                center_x: (own.center_x + detected_box.center_x) / 2.0,
                center_y: (own.center_y + detected_box.center_y) / 2.0,
                width: (own.width + detected_box.width) / 2.0,
                height: (own.height + detected_box.height) / 2.0,
            };
        }
        match self.offset {
            Some([x, y, log_width, log_height]) if self.trailing => BoundingBox {
                center_x: own.center_x + x / aspect,
                center_y: own.center_y + y,
                width: own.width * log_width.exp(),
                height: own.height * log_height.exp(),
            },
            _ => own,
        }
    }

    /// Returns the paper's uncertainty τ of this filter: the summed variance of the box in normalised form.
    pub(crate) fn tau(&self, aspect: f64) -> f64 {
        let [x, y, log_width, log_height] = &self.filter.axes;
        let [width_in_heights, height] = self.filter.sides();
        let width = width_in_heights / aspect;
        x.p00 / (aspect * aspect)
            + y.p00
            + width * width * log_width.p00
            + height * height * log_height.p00
    }

    /// Returns the record for traces.
    pub(crate) fn record(&self, aspect: f64) -> ObjectRecord {
        ObjectRecord {
            id: self.id,
            class: self.class,
            confirmed: self.hits >= HITS_TO_CONFIRM,
            confidence: self.last_score,
            bounding_box: self.filter_box(aspect),
            tau: self.tau(aspect),
            hits: self.hits,
            since_update: self.since_match,
            since_infer: self.since_detector,
            misses: self.misses,
        }
    }
}

/// Returns e⁻ˣ for x ≥ 0; zero for x above 40, where it is below 1e-17 and the library computes it on a slow path.
fn fading(x: f64) -> f64 {
    if x > 40.0 { 0.0 } else { (-x).exp() }
}

/// Returns the covariance scale after an innovation: `α ← clamp(α + rate·(n − α))`.
pub(super) fn scale(alpha: f64, n: f64, rate: f64) -> f64 {
    (alpha + rate * (n - alpha)).clamp(LEAST_ALPHA, MOST_ALPHA)
}

/// Returns `base` to the power of the number of misses.
fn power(base: f64, misses: u32) -> f64 {
    // An object is removed long before; the limit only keeps the conversion exact.
    base.powi(misses.min(1000) as i32)
}
