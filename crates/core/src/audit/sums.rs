//! Counts of compared frames, which can be summed over clips, cameras and nodes.

use super::AUDIT_OVERLAP;
use super::rate::{AuditRate, SideSums};
use crate::detection::Detection;
use crate::geometry::{BoundingBox, Corners};
use crate::objects::{ComponentSolver, Edge, is_usable};
use crate::policy::OutputBox;
use serde::{Deserialize, Serialize};

/// Sums over the drawn frames. A pooled rate covers all compared boxes: of two cameras with equally many boxes per
/// frame, the one that audits the larger share of its frames weighs more.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AuditSums {
    /// Drawn frames that the detector had no time for.
    #[serde(skip_serializing_if = "is_zero")]
    pub missed: u64,
    /// Boxes shown on the missed frames, at least one per frame: the weight of missed frames in an interval.
    #[serde(skip_serializing_if = "is_zero")]
    pub missed_boxes: u64,
    /// Frames compared.
    #[serde(skip_serializing_if = "is_zero")]
    pub frames: u64,
    /// Boxes that the detector found on the compared frames.
    #[serde(skip_serializing_if = "is_zero")]
    pub detected: u64,
    /// Boxes shown on the compared frames.
    #[serde(skip_serializing_if = "is_zero")]
    pub shown: u64,
    /// Pairs of a detected and a shown box of the same object.
    #[serde(skip_serializing_if = "is_zero")]
    pub paired: u64,
    /// Sums of squares and products of the counts, for the intervals.
    #[serde(skip_serializing_if = "AuditSquares::is_empty")]
    pub squares: AuditSquares,
}

/// Sums over the compared frames of the squares and products of their counts, from which the intervals are computed.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AuditSquares {
    /// Detected boxes, squared.
    pub detected: u64,
    /// Shown boxes, squared.
    pub shown: u64,
    /// Pairs, squared.
    pub paired: u64,
    /// Detected boxes times pairs.
    pub detected_paired: u64,
    /// Shown boxes times pairs.
    pub shown_paired: u64,
}

const fn is_zero(number: &u64) -> bool {
    *number == 0
}

impl AuditSquares {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

impl AuditSums {
    /// Compares one frame answered without the detector: the boxes `shown` with those `detected`. Makes as many pairs
    /// as possible and ignores classes. Boxes outside the picture do not count.
    pub fn add(&mut self, shown: &[OutputBox], detected: &[Detection]) {
        let reported = shown.iter().map(|output| output.bounding_box);
        let shown_boxes = visible(reported.filter(|reported| reported.is_finite()));
        let usable = detected.iter().filter(|found| is_usable(found));
        let detected_boxes = visible(usable.map(|found| found.bounding_box));
        let pairs = pairs(&shown_boxes, &detected_boxes);
        let shown = shown_boxes.len() as u64;
        let detected = detected_boxes.len() as u64;
        self.merge(&Self {
            frames: 1,
            detected,
            shown,
            paired: pairs,
            squares: AuditSquares {
                detected: detected * detected,
                shown: shown * shown,
                paired: pairs * pairs,
                detected_paired: detected * pairs,
                shown_paired: shown * pairs,
            },
            ..Self::default()
        });
    }

    /// Counts a drawn frame that the detector had no time for and that showed `shown` boxes.
    pub const fn add_missed(&mut self, shown: usize) {
        self.missed = self.missed.saturating_add(1);
        let boxes = if shown == 0 { 1 } else { shown as u64 };
        self.missed_boxes = self.missed_boxes.saturating_add(boxes);
    }

    /// Adds the sums of `more`.
    pub const fn merge(&mut self, more: &Self) {
        const fn add(sum: &mut u64, more: u64) {
            *sum = sum.saturating_add(more);
        }
        add(&mut self.missed, more.missed);
        add(&mut self.missed_boxes, more.missed_boxes);
        add(&mut self.frames, more.frames);
        add(&mut self.detected, more.detected);
        add(&mut self.shown, more.shown);
        add(&mut self.paired, more.paired);
        let squares = &mut self.squares;
        let more = &more.squares;
        add(&mut squares.detected, more.detected);
        add(&mut squares.shown, more.shown);
        add(&mut squares.paired, more.paired);
        add(&mut squares.detected_paired, more.detected_paired);
        add(&mut squares.shown_paired, more.shown_paired);
    }

    /// True if nothing was counted.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the number of drawn frames, compared or missed.
    pub const fn drawn(&self) -> u64 {
        self.missed.saturating_add(self.frames)
    }

    /// Returns the share of the drawn frames that were missed, 0 to 1; 0 if none was drawn.
    pub(crate) fn missed_share(&self) -> f64 {
        self.missed as f64 / self.drawn().max(1) as f64
    }

    /// Returns the recall against the detector: the share of its boxes that were shown. The interval includes the
    /// missed frames. `None` if the detector found nothing.
    pub fn recall(&self) -> Option<AuditRate> {
        Some(self.compared_recall()?.widened(self.missed_boxes))
    }

    /// Returns the recall of the compared frames alone, as if no frame had been missed.
    pub(crate) fn compared_recall(&self) -> Option<AuditRate> {
        let squares = &self.squares;
        AuditRate::new(SideSums {
            paired: self.paired,
            boxes: self.detected,
            paired_squared: squares.paired,
            boxes_paired: squares.detected_paired,
            boxes_squared: squares.detected,
        })
    }

    /// Returns the precision against the detector: the share of the shown boxes that it confirms. The interval includes
    /// the missed frames. `None` if nothing was shown.
    pub fn precision(&self) -> Option<AuditRate> {
        let squares = &self.squares;
        let compared = AuditRate::new(SideSums {
            paired: self.paired,
            boxes: self.shown,
            paired_squared: squares.paired,
            boxes_paired: squares.shown_paired,
            boxes_squared: squares.shown,
        })?;
        Some(compared.widened(self.missed_boxes))
    }
}

/// Clips the boxes to the picture, in normalised coordinates, and drops empty ones.
fn visible(boxes: impl Iterator<Item = BoundingBox>) -> Vec<Corners> {
    boxes
        .map(|bounding_box| bounding_box.corners().clipped())
        .filter(|clipped| clipped.area() > 0.0)
        .collect()
}

/// Returns the maximum number of pairs of boxes of the same object.
fn pairs(shown: &[Corners], detected: &[Corners]) -> u64 {
    let mut edges = Vec::new();
    for (row, shown) in (0..).zip(shown) {
        for (column, detected) in (0..).zip(detected) {
            let overlap = shown.intersection_over_union(*detected);
            if overlap >= AUDIT_OVERLAP {
                let cost = 1.0 - overlap;
                edges.push(Edge { row, column, cost });
            }
        }
    }
    let mut pairs = Vec::new();
    ComponentSolver::default().solve(shown.len(), detected.len(), &edges, &mut pairs);
    pairs.len() as u64
}
