//! Matching of detections with objects: by overlap first, then by Mahalanobis distance. The class is ignored. Both
//! stages make as many pairs within the gate as possible, at the smallest total cost.

use super::motion::{X, Y};
use super::object::{Object, measure};
use super::settings::{IOU_GATE, MAHALANOBIS_GATE};
use crate::detection::Detection;
use crate::geometry::BoundingBox;
use crate::objects::{Pairing, by_overlap, overlaps};

/// Matches `objects`, predicted to this frame, with the `usable` ones of `detections`.
pub(super) fn associate(
    pairing: &mut Pairing,
    objects: &[Object],
    detections: &[Detection],
    usable: impl Iterator<Item = bool>,
    aspect: f64,
) {
    pairing.begin(objects.len(), detections, usable);
    let by_overlap = |row: usize| {
        let own = objects[row].filter_box(aspect).corners();
        Some(by_overlap(own, IOU_GATE))
    };
    pairing.stage(detections, by_overlap, |cost| overlaps(cost, IOU_GATE));
    // Stage 2: the cost is the squared distance `Σ y²/S` with `S = max(1, α)·(p00 + R)`.
    let by_distance = |row: usize| {
        let object = &objects[row];
        let scale = object.alpha.max(1.0);
        let variance = object.filter.innovation_variance();
        let position = object.filter.position();
        let cost = move |_, other: BoundingBox| {
            let measured = measure(other, aspect);
            let squares =
                (0..4).map(|axis| (measured[axis] - position[axis]).powi(2) / variance[axis]);
            squares.sum::<f64>() / scale
        };
        // All centres within the gate, with a margin for rounding.
        let side = |axis: usize| 2.0 * (MAHALANOBIS_GATE * scale * variance[axis]).sqrt() + 1e-9;
        let area = BoundingBox {
            center_x: position[X] / aspect,
            center_y: position[Y],
            width: side(X) / aspect,
            height: side(Y),
        };
        Some((area.corners(), cost))
    };
    pairing.stage(detections, by_distance, |cost| cost < MAHALANOBIS_GATE);
}
