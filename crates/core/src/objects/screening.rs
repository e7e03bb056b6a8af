//! Screening of detections: one invalid number would stay in a filter forever.

use crate::detection::Detection;

/// Largest distance from the picture and largest size of a box, in picture sizes. Larger values show nothing real, and
/// areas and distances would overflow.
pub(crate) const LARGEST_COORDINATE: f64 = 1e3;

/// True if a detection is usable: finite numbers, sides above zero, a box that is not absurdly far or large, and a
/// confidence from 0 to 1.
pub(crate) fn is_usable(detection: &Detection) -> bool {
    let place = &detection.bounding_box;
    let inside = |value: f64| value.abs() <= LARGEST_COORDINATE;
    // Comparisons with NaN are false.
    inside(place.center_x)
        && inside(place.center_y)
        && inside(place.width)
        && inside(place.height)
        && place.width > 0.0
        && place.height > 0.0
        && (0.0..=1.0).contains(&detection.confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::BoundingBox;
    use crate::policy::tests::seen;

    /// A usable detection with `number` in one of its five fields.
    fn with(field: usize, number: f64) -> Detection {
        let mut numbers = [0.5, 0.5, 0.1, 0.2, 0.5];
        numbers[field] = number;
        let [x, y, width, height, confidence] = numbers;
        Detection {
            bounding_box: BoundingBox::new(x, y, width, height),
            ..seen(x, confidence)
        }
    }

    #[test]
    fn only_detections_that_a_filter_can_process_are_accepted() {
        assert!(is_usable(&with(0, 0.5)));
        for field in 0..5 {
            for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300] {
                assert!(!is_usable(&with(field, number)), "{field}: {number}");
            }
        }
        for side in [2, 3] {
            for number in [0.0, -0.1] {
                assert!(!is_usable(&with(side, number)), "{side}: {number}");
            }
        }
    }
}
