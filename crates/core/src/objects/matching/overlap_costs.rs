//! Stage 1's costs: 1 − intersection over union of objects and detections.

use super::{Association, ObjectState, OverlapIndex};
use crate::detection::{ClassId, Detection};
use crate::geometry::Corners;
use crate::objects::Edge;

/// The costs with their buffers, which are kept from call to call.
#[derive(Clone, Debug, Default)]
pub(super) struct OverlapCosts {
    /// Corners and areas of the detections, one list a number: so the compiler can compute several at once.
    left: Vec<f64>,
    top: Vec<f64>,
    right: Vec<f64>,
    bottom: Vec<f64>,
    area: Vec<f64>,
    /// Overlaps of one object with each of them.
    overlap: Vec<f64>,
    /// Corners and areas of many, and where they lie.
    boxes: Vec<(Corners, f64)>,
    index: OverlapIndex,
}

impl OverlapCosts {
    /// Appends the costs of all pairs to `matrix`, row by row.
    pub(super) fn fill<'a>(
        &mut self,
        settings: &Association,
        rows: impl Iterator<Item = &'a ObjectState>,
        columns: impl Iterator<Item = &'a Detection> + Clone,
        matrix: &mut Vec<f64>,
    ) {
        self.take(columns.clone());
        for state in rows {
            self.measure(state.filter.bounding_box().corners());
            if settings.same_class_only {
                for (overlap, detection) in self.overlap.iter_mut().zip(columns.clone()) {
                    if detection.class != state.class {
                        *overlap = 0.0;
                    }
                }
            }
            matrix.extend(self.overlap.iter().map(|iou| 1.0 - iou));
        }
    }

    /// Appends the pairs within the gate to `edges`, in order of rows and columns. Of many columns only those are
    /// measured that reach far enough into the row's box.
    pub(super) fn gate<'a>(
        &mut self,
        settings: &Association,
        rows: impl Iterator<Item = &'a ObjectState>,
        columns: impl ExactSizeIterator<Item = &'a Detection> + Clone,
        class_of: impl Fn(usize) -> ClassId,
        edges: &mut Vec<Edge>,
    ) {
        let many = columns.len() >= OverlapIndex::WORTH_WHILE;
        if many {
            self.boxes.clear();
            self.boxes.extend(columns.map(|detection| {
                let corners = detection.bounding_box.corners();
                (corners, corners.area())
            }));
            self.index
                .fill(self.boxes.iter().map(|(corners, _)| *corners));
        } else {
            self.take(columns);
        }
        for (row, state) in (0u32..).zip(rows) {
            let object = state.filter.bounding_box().corners();
            let mut compete = |column: usize, iou: f64| {
                let within = iou >= settings.iou_gate
                    && iou > 0.0
                    && (!settings.same_class_only || class_of(column) == state.class);
                if within {
                    edges.push(Edge {
                        row,
                        column: column as u32,
                        cost: 1.0 - iou,
                    });
                }
            };
            if many {
                let own = object.area();
                let within_reach = core_of(object, settings.iou_gate);
                self.index.visit(within_reach, |column| {
                    compete(column, overlap((object, own), self.boxes[column]));
                });
            } else {
                self.measure(object);
                for (column, &iou) in self.overlap.iter().enumerate() {
                    compete(column, iou);
                }
            }
        }
    }

    fn take<'a>(&mut self, columns: impl Iterator<Item = &'a Detection>) {
        for list in [
            &mut self.left,
            &mut self.top,
            &mut self.right,
            &mut self.bottom,
            &mut self.area,
        ] {
            list.clear();
        }
        for detection in columns {
            let corners = detection.bounding_box.corners();
            self.left.push(corners.x1);
            self.top.push(corners.y1);
            self.right.push(corners.x2);
            self.bottom.push(corners.y2);
            self.area.push(corners.area());
        }
    }

    /// Fills `overlap` with the intersection over union of `object` and each column.
    fn measure(&mut self, object: Corners) {
        let own = object.area();
        let horizontal = self.left.iter().zip(&self.right);
        let vertical = self.top.iter().zip(&self.bottom);
        let columns = horizontal.zip(vertical).zip(&self.area);
        self.overlap.clear();
        self.overlap
            .extend(columns.map(|(((&x1, &x2), (&y1, &y2)), &area)| {
                overlap((object, own), (Corners { x1, y1, x2, y2 }, area))
            }));
    }
}

/// What every box reaches into that is within the gate. With I and U the areas of intersection and union, and w, h the
/// sides of `object`: the part of w that both share is at least I/h ≥ gate·U/h ≥ gate·w. So the other begins before
/// `x2 − gate·w` and ends behind `x1 + gate·w`, and likewise along y. Where the gate is above one half, these are the
/// other way round, and still right.
fn core_of(object: Corners, gate: f64) -> Corners {
    // A little less, so that rounding excludes no pair.
    let share = (gate - 1e-6).max(0.0);
    let (x, y) = (
        share * (object.x2 - object.x1),
        share * (object.y2 - object.y1),
    );
    Corners {
        x1: object.x1 + x,
        y1: object.y1 + y,
        x2: object.x2 - x,
        y2: object.y2 - y,
    }
}

/// [`Corners::intersection_over_union`] of two boxes with their areas, but without branches.
#[inline]
fn overlap((one, one_area): (Corners, f64), (other, other_area): (Corners, f64)) -> f64 {
    // Comparisons, not `f64::min`: nothing here is NaN, and this is one instruction.
    let min = |a: f64, b: f64| if a < b { a } else { b };
    let max = |a: f64, b: f64| if a > b { a } else { b };
    let width = max(min(other.x2, one.x2) - max(other.x1, one.x1), 0.0);
    let height = max(min(other.y2, one.y2) - max(other.y1, one.y1), 0.0);
    let shared = width * height;
    shared / (one_area + other_area - shared)
}
