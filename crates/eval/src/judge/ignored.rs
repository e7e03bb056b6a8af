//! Leaves out boxes that cannot be judged, because the ground truth labels no objects where they are.

use super::average_precision::IOU_THRESHOLDS;
use crate::boxes::ScoredBox;
use albireo_core::geometry::Corners;

/// Returns `predictions` without those that cannot be judged, because they lie where the ground truth labels no objects.
/// As in KITTI's evaluation, these have at least half of their area in a region of `ignored` (one list per frame) and
/// overlap no ground truth by IoU 0.5.
pub(crate) fn outside_ignored(
    predictions: &[Vec<ScoredBox>],
    truth: &[Vec<ScoredBox>],
    ignored: &[Vec<Corners>],
) -> Vec<Vec<ScoredBox>> {
    let mut judged = predictions.to_vec();
    for (frame, (boxes, regions)) in judged.iter_mut().zip(ignored).enumerate() {
        let truth = truth.get(frame).map_or(&[][..], Vec::as_slice);
        boxes.retain(|found| {
            let own = found.corners;
            let inside = |region: &Corners| 2.0 * own.shared_area(*region) >= own.area();
            let is_object = |truth: &ScoredBox| {
                found.corners.intersection_over_union(truth.corners) >= IOU_THRESHOLDS[0]
            };
            !regions.iter().any(inside) || truth.iter().any(is_object)
        });
    }
    judged
}
