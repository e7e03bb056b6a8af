//! One frame: what was shown beside what the detector finds.

use super::{AUDIT_NEAR, AUDIT_OVERLAP};
use crate::detection::{ClassId, Detection};
use crate::geometry::Corners;
use crate::objects::{ComponentSolver, Edge, is_usable};
use crate::policy::OutputBox;

/// One box of either side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    corners: Corners,
    class: ClassId,
    /// Intersection over union with the box of its pair.
    pub paired: Option<f64>,
    /// No box of the other side is near.
    pub alone: bool,
    pub same_class: bool,
}

impl Side {
    fn new(corners: Corners, class: ClassId) -> Option<Self> {
        // What is outside of the picture nobody sees, and no detector finds.
        let corners = Corners {
            x1: corners.x1.clamp(0.0, 1.0),
            y1: corners.y1.clamp(0.0, 1.0),
            x2: corners.x2.clamp(0.0, 1.0),
            y2: corners.y2.clamp(0.0, 1.0),
        };
        (corners.area() > 0.0).then_some(Self {
            corners,
            class,
            paired: None,
            alone: true,
            same_class: false,
        })
    }

    /// Share of the picture's area.
    pub(super) fn area(&self) -> f64 {
        self.corners.area()
    }
}

/// The two sides of a frame, paired: as many pairs as can be, and of all ways to do so the one with the largest total
/// overlap. Classes are ignored.
pub(super) fn compare(shown: &[OutputBox], detected: &[Detection]) -> (Vec<Side>, Vec<Side>) {
    let mut shown: Vec<Side> = shown
        .iter()
        .filter(|output| output.bounding_box.is_finite())
        .filter_map(|output| Side::new(output.bounding_box.corners(), output.class))
        .collect();
    let mut detected: Vec<Side> = detected
        .iter()
        .filter(|detection| is_usable(detection))
        .filter_map(|found| Side::new(found.bounding_box.corners(), found.class))
        .collect();
    let mut edges = Vec::new();
    for (row, shown) in shown.iter_mut().enumerate() {
        for (column, detected) in detected.iter_mut().enumerate() {
            let overlap = shown.corners.intersection_over_union(detected.corners);
            if overlap >= AUDIT_NEAR {
                shown.alone = false;
                detected.alone = false;
            }
            if overlap >= AUDIT_OVERLAP {
                edges.push(Edge {
                    row: row as u32,
                    column: column as u32,
                    cost: (1.0 - overlap).max(0.0),
                });
            }
        }
    }
    let mut pairs = Vec::new();
    ComponentSolver::default().solve(shown.len(), detected.len(), &edges, &mut pairs);
    for (row, column) in pairs {
        let (Some(shown), Some(detected)) = (
            shown.get_mut(row as usize),
            detected.get_mut(column as usize),
        ) else {
            continue;
        };
        let overlap = shown.corners.intersection_over_union(detected.corners);
        let same_class = shown.class == detected.class;
        for side in [shown, detected] {
            side.paired = Some(overlap);
            side.same_class = same_class;
        }
    }
    (shown, detected)
}
