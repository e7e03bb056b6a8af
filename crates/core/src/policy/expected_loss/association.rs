//! Which detection belongs to which object: by overlap first, then by Mahalanobis distance. The class
//! plays no part. Both stages make as many pairs within the gate as can be, at the smallest total cost.

use super::object::{Object, measure};
use super::settings::{IOU_GATE, MAHALANOBIS_GATE};
use crate::detection::Detection;
use crate::geometry::Corners;
use crate::objects::{ComponentSolver, Edge, OverlapIndex};

/// The matcher with its buffers, which are kept from call to call.
#[derive(Clone, Debug, Default)]
pub(super) struct Associator {
    solver: ComponentSolver,
    edges: Vec<Edge>,
    pairs: Vec<(u32, u32)>,
    corners: Vec<Corners>,
    /// Where the detections lie, when they are many.
    index: OverlapIndex,
    detection_of: Vec<Option<u32>>,
    matched: Vec<bool>,
}

impl Associator {
    /// Matches `objects`, predicted to this frame, with the `detections` that are `usable`. Returns the
    /// detection of each object by index.
    pub(crate) fn associate(
        &mut self,
        objects: &[Object],
        detections: &[Detection],
        usable: &[bool],
        aspect: f64,
    ) -> &[Option<u32>] {
        self.detection_of.clear();
        self.detection_of.resize(objects.len(), None);
        self.matched.clear();
        self.matched.extend(usable.iter().map(|usable| !usable));
        self.corners.clear();
        self.corners.extend(
            detections
                .iter()
                .map(|detection| detection.bounding_box.corners()),
        );

        self.pair_by_overlap(objects, aspect);
        if self.matched.iter().any(|matched| !matched) {
            self.pair_by_distance(objects, detections, aspect);
        }
        &self.detection_of
    }

    /// Stage 1: cost 1 − IoU.
    fn pair_by_overlap(&mut self, objects: &[Object], aspect: f64) {
        let Self {
            corners,
            matched,
            index,
            edges,
            ..
        } = self;
        edges.clear();
        let many = corners.len() >= OverlapIndex::WORTH_WHILE;
        if many {
            index.fill(corners.iter().copied());
        }
        for (row, object) in (0u32..).zip(objects) {
            let own = object.filter_box(aspect).corners();
            let compete = |column: usize| {
                let corners = corners[column];
                // One branch for the four sides: nearly all pairs are apart, one way or another.
                let apart = (corners.x1 >= own.x2)
                    | (corners.x2 <= own.x1)
                    | (corners.y1 >= own.y2)
                    | (corners.y2 <= own.y1);
                if apart {
                    return;
                }
                let overlap = own.intersection_over_union(corners);
                if overlap >= IOU_GATE && !matched[column] {
                    edges.push(Edge {
                        row,
                        column: column as u32,
                        cost: 1.0 - overlap,
                    });
                }
            };
            if many {
                index.visit(own, compete);
            } else {
                (0..corners.len()).for_each(compete);
            }
        }
        self.take_pairs();
    }

    /// Stage 2: the cost is the squared distance `Σ y²/S` with `S = max(1, α)·(p00 + R)`.
    fn pair_by_distance(&mut self, objects: &[Object], detections: &[Detection], aspect: f64) {
        self.edges.clear();
        for (row, object) in (0u32..).zip(objects) {
            if self.detection_of[row as usize].is_some() {
                continue;
            }
            let scale = object.alpha.max(1.0);
            let variance = object.filter.innovation_variance();
            let position = object.filter.position();
            for (column, detection) in (0u32..).zip(detections) {
                if self.matched[column as usize] {
                    continue;
                }
                let measured = measure(detection.bounding_box, aspect);
                let cost: f64 = (0..4)
                    .map(|axis| (measured[axis] - position[axis]).powi(2) / variance[axis])
                    .sum();
                let cost = cost / scale;
                if cost < MAHALANOBIS_GATE {
                    self.edges.push(Edge { row, column, cost });
                }
            }
        }
        self.take_pairs();
    }

    /// Whether each detection has an object, or is not usable.
    pub(crate) fn matched(&self) -> &[bool] {
        &self.matched
    }

    /// Solves what was put in `edges`.
    fn take_pairs(&mut self) {
        self.pairs.clear();
        let (rows, columns) = (self.detection_of.len(), self.matched.len());
        self.solver
            .solve(rows, columns, &self.edges, &mut self.pairs);
        for &(row, column) in &self.pairs {
            self.detection_of[row as usize] = Some(column);
            self.matched[column as usize] = true;
        }
    }
}
