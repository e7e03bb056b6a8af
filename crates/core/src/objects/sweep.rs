//! Finds the boxes that may overlap a given one without testing each, so that matching need not compute all pairs to
//! find the few within its gate.

use crate::geometry::Corners;
use wide::f64x4;

/// Boxes in order of their left sides. The buffer is reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sweep {
    boxes: Vec<Swept>,
    widest: f64,
}

#[derive(Clone, Copy, Debug)]
struct Swept {
    left: f64,
    /// Right side, bottom and negated top: all must exceed their limits, which takes one comparison.
    others: f64x4,
    place: u32,
}

impl Sweep {
    /// Replaces the boxes by `boxes`, each with its index. Their sides are not NaN.
    pub(crate) fn fill(&mut self, boxes: impl Iterator<Item = (Corners, u32)>) {
        self.boxes.clear();
        self.boxes.extend(boxes.map(|(corners, place)| Swept {
            left: corners.x1,
            others: f64x4::new([corners.x2, corners.y2, -corners.y1, f64::INFINITY]),
            place,
        }));
        let widths = (self.boxes.iter()).map(|swept| swept.others.to_array()[0] - swept.left);
        // Slightly more, so that rounding excludes no box.
        self.widest = widths.fold(0.0, f64::max) * (1.0 + 1e-9) + 1e-9;
        (self.boxes).sort_unstable_by(|a, b| a.left.total_cmp(&b.left));
    }

    /// Calls `visit` with the index of each box that overlaps `area`.
    #[inline]
    pub(crate) fn visit(&self, area: Corners, mut visit: impl FnMut(u32)) {
        let from = area.x1 - self.widest;
        let first = self.boxes.partition_point(|swept| swept.left < from);
        let limits = f64x4::new([area.x1, area.y1, -area.y2, 0.0]);
        for swept in &self.boxes[first..] {
            if swept.left >= area.x2 {
                break;
            }
            if swept.others.simd_gt(limits).all() {
                visit(swept.place);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn boxes() -> impl Strategy<Value = Vec<(Corners, u32)>> {
        let side = || (-1e3..1e3_f64, 0.0..1e3_f64, prop::bool::weighted(0.9));
        let interval = |(begin, length, small): (f64, f64, bool)| {
            let scale = if small { 1e-3 } else { 1.0 };
            (begin * scale, (begin + length) * scale)
        };
        let corners = (side(), side()).prop_map(move |(x, y)| {
            let ((x1, x2), (y1, y2)) = (interval(x), interval(y));
            Corners { x1, y1, x2, y2 }
        });
        prop::collection::vec(corners, 0..100)
            .prop_map(|boxes| boxes.into_iter().zip(0..).collect())
    }

    proptest! {
        #[test]
        fn exactly_the_overlapping_boxes_are_found(ones in boxes(), many in boxes()) {
            let mut sweep = Sweep::default();
            // A used one must answer as a fresh one.
            sweep.fill(ones.iter().copied());
            sweep.fill(many.iter().copied());
            for (one, _) in ones.iter().chain(&many) {
                let mut near = Vec::new();
                sweep.visit(*one, |place| near.push(place));
                near.sort_unstable();
                let meets = |other: &Corners| {
                    other.x1 < one.x2 && other.x2 > one.x1 && other.y1 < one.y2 && other.y2 > one.y1
                };
                let expected = many.iter().filter(|(other, _)| meets(other));
                prop_assert_eq!(near, expected.map(|(_, place)| *place).collect::<Vec<_>>());
            }
        }
    }
}
