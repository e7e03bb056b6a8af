//! Selects the boxes of a frame that are scored, with their corners and confidences.
//!
//! The published evaluator and the paper's text differ here:
//!
//! - `reference`: every object is scored, even a tentative one, with the filter's box truncated to whole pixels
//!   towards zero and clamped to the picture, and with the confidence of its last detection times
//!   `max(0.1, 1 − τ/u)`. The boxes of a policy without objects are truncated but not clamped, and keep their
//!   confidences.
//! - `paper`: the boxes are scored that a node publishes, as it publishes them, and separately all boxes of the policy.

use crate::boxes::ScoredBox;
use crate::spec::takes_u;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::{MinConfidence, ObjectRecord, OutputBox, Policy};

/// The published decay never reduces a confidence below this share.
const DECAY_FLOOR: f64 = 0.1;

/// The `u` that the published code uses for the decay if the policy has none.
const DEFAULT_DECAY_U: f64 = 3e-4;

/// Returns the threshold by which the published code decays confidences.
pub(crate) fn decay_threshold(policy: &dyn Policy) -> f64 {
    match policy.threshold() {
        Some(u) if takes_u(policy) => u,
        _ => DEFAULT_DECAY_U,
    }
}

/// Computes the confidence that the published code scores: it falls linearly with the uncertainty.
pub(crate) fn decayed_confidence(last: f64, tau: f64, u: f64) -> f64 {
    last * (1.0 - tau / u).max(DECAY_FLOOR)
}

/// Returns an object's box as the published evaluator scores it, with its last confidence.
pub(crate) fn score_object(object: &ObjectRecord, picture: PictureSize) -> ScoredBox {
    let [center_x, center_y, width, height] = object.bounding_box.into();
    let (x1, x2) = whole_edges(center_x, width, picture.width);
    let (y1, y2) = whole_edges(center_y, height, picture.height);
    ScoredBox {
        corners: Corners { x1, y1, x2, y2 },
        class: object.class,
        confidence: object.confidence,
        object: Some(object.id.0),
    }
}

/// Computes the two edges along one axis in whole pixels. Scaling comes before subtracting, as in the published
/// code: the edge of a new object can lie on a whole pixel, where the rounding error of this order decides
/// whether truncation removes a pixel.
fn whole_edges(center: f64, side: f64, pixels: u32) -> (f64, f64) {
    let scale = f64::from(pixels);
    let middle = center * scale;
    let half = side * scale / 2.0;
    let cut = |edge: f64| edge.trunc().clamp(0.0, scale - 1.0);
    (cut(middle - half), cut(middle + half))
}

/// Returns a detector's box as the published evaluator scores it under Vanilla: truncated to whole pixels, not clamped.
pub(crate) fn score_truncated(output: &OutputBox, picture: PictureSize) -> ScoredBox {
    let corners = output.bounding_box.pixel_corners(picture);
    ScoredBox {
        corners: Corners {
            x1: truncate(corners.x1),
            y1: truncate(corners.y1),
            x2: truncate(corners.x2),
            y2: truncate(corners.y2),
        },
        class: output.class,
        confidence: output.confidence,
        object: output.object.map(|object| object.0),
    }
}

/// Returns a box as the policy reports it.
fn score_reported(output: &OutputBox, picture: PictureSize) -> ScoredBox {
    ScoredBox {
        corners: output.bounding_box.pixel_corners(picture),
        class: output.class,
        confidence: output.confidence,
        object: output.object.map(|object| object.0),
    }
}

/// Returns all boxes of a frame, as the policy reports them.
pub(crate) fn score_all(boxes: &[OutputBox], picture: PictureSize) -> Vec<ScoredBox> {
    boxes.iter().map(|output| score_reported(output, picture)).collect()
}

/// Returns the boxes of a frame that a node publishes.
pub(crate) fn score_published(
    boxes: &[OutputBox],
    picture: PictureSize,
    min_confidence: MinConfidence,
) -> Vec<ScoredBox> {
    let mut published = boxes.to_vec();
    min_confidence.select(&mut published);
    score_all(&published, picture)
}

/// Truncates towards zero. Normalising can move a detector's edge by a rounding error below its whole pixel,
/// which must not cost a pixel.
fn truncate(edge: f64) -> f64 {
    let nearest = edge.round();
    if (edge - nearest).abs() < 1e-9 {
        nearest
    } else {
        edge.trunc()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::judge::average_precision::tests::square;
    use albireo_core::detection::{ClassId, ObjectId};

    #[test]
    fn confidence_decays_linearly_and_never_below_a_tenth() {
        assert!((decayed_confidence(0.8, 0.0, 3e-4) - 0.8).abs() < 1e-15);
        assert!((decayed_confidence(0.9, 2.5e-4, 3e-4) - 0.15).abs() < 1e-12);
        assert!((decayed_confidence(0.9, 1.0, 3e-4) - 0.09).abs() < 1e-15);
    }

    pub(crate) fn object(bounding_box: [f64; 4]) -> ObjectRecord {
        ObjectRecord {
            id: ObjectId(7),
            class: ClassId(2),
            confirmed: true,
            confidence: 1.0 / 3.0,
            bounding_box: bounding_box.into(),
            tau: 2.4961199111764362e-5,
            hits: 3,
            since_update: 1,
            since_infer: 1,
            misses: 0,
        }
    }

    #[test]
    fn an_objects_box_is_cut_and_clamped_to_the_last_pixel() {
        let cut = score_object(&object([0.95, 0.2, 0.3, 0.6]), PictureSize::new(100, 50)).corners;
        assert_eq!([cut.x1, cut.y1, cut.x2, cut.y2], [80.0, 0.0, 99.0, 25.0]);
    }

    #[test]
    fn a_detectors_whole_pixel_edge_survives_the_normalised_form() {
        for (width, height) in [
            (1242, 375),
            (1224, 370),
            (1238, 374),
            (1920, 1080),
            (640, 480),
        ] {
            let picture = PictureSize::new(width, height);
            for x1 in 0..width - 7 {
                let corners = square(f64::from(x1), 3.0, 7.0);
                let found = corners.normalise(picture).pixel_corners(picture);
                let cut = [found.x1, found.y1, found.x2, found.y2].map(truncate);
                assert_eq!(cut, [corners.x1, corners.y1, corners.x2, corners.y2]);
            }
        }
    }
}
