//! Screening of detections: one invalid number would stay in a filter forever.

use crate::detection::Detection;

/// Largest distance from the picture and largest size of a box, in picture sizes. Larger values show nothing real, and
/// areas and distances would overflow.
pub(crate) const LARGEST_COORDINATE: f64 = 1e3;

/// True if a detection is usable: finite numbers, sides above zero, a box that is not absurdly far or large, and a
/// confidence from 0 to 1.
pub(crate) fn is_usable(detection: &Detection) -> bool {
    let b = &detection.bounding_box;
    let inside = |value: f64| value.abs() <= LARGEST_COORDINATE;
    // Comparisons with NaN are false.
    inside(b.center_x)
        && inside(b.center_y)
        && inside(b.width)
        && inside(b.height)
        && b.width > 0.0
        && b.height > 0.0
        && (0.0..=1.0).contains(&detection.confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::ClassId;
    use crate::geometry::BoundingBox;

    #[test]
    fn only_detections_that_a_filter_can_process_are_accepted() {
        let good = Detection {
            bounding_box: BoundingBox::new(0.5, 0.5, 0.1, 0.2),
            class: ClassId(0),
            confidence: 0.5,
        };
        assert!(is_usable(&good));
        let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300];
        for number in bad {
            for field in 0..5 {
                let mut detection = good;
                let b = &mut detection.bounding_box;
                *[
                    &mut b.center_x,
                    &mut b.center_y,
                    &mut b.width,
                    &mut b.height,
                    &mut detection.confidence,
                ][field] = number;
                assert!(!is_usable(&detection), "{detection:?}");
            }
        }
        for side in [0.0, -0.1] {
            let mut detection = good;
            detection.bounding_box.width = side;
            assert!(!is_usable(&detection));
            let mut detection = good;
            detection.bounding_box.height = side;
            assert!(!is_usable(&detection));
        }
    }
}
