//! Pairs of objects and detections within a gate, made in stages: a later stage pairs only those still free.

use super::components::{ComponentSolver, Edge};
use super::near::NearBoxes;
use crate::detection::Detection;
use crate::geometry::{BoundingBox, Corners};

/// Returns an object's arguments for [`Pairing::stage`] to pair by overlap: the area that overlaps every box whose
/// intersection over union with `own` is at least `gate`, and the cost of a box, 1 − intersection over union.
pub(crate) fn by_overlap(
    own: Corners,
    gate: f64,
) -> (Corners, impl Fn(Corners, BoundingBox) -> f64) {
    let cost = move |corners: Corners, _| 1.0 - own.intersection_over_union(corners);
    (own.core(gate), cost)
}

/// True if a box with this cost overlaps enough. A box that only touches does not, for any gate.
pub(crate) fn overlaps(cost: f64, gate: f64) -> bool {
    1.0 - cost >= gate && cost < 1.0
}

/// The pairs of a frame, with buffers that are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pairing {
    solver: ComponentSolver,
    near: NearBoxes,
    edges: Vec<Edge>,
    pairs: Vec<(u32, u32)>,
    detection_of: Vec<Option<u32>>,
    is_free: Vec<bool>,
}

impl Pairing {
    /// Begins with `objects` objects and the `usable` ones of `detections`.
    pub(crate) fn begin(
        &mut self,
        objects: usize,
        detections: &[Detection],
        usable: impl Iterator<Item = bool>,
    ) {
        self.detection_of.clear();
        self.detection_of.resize(objects, None);
        self.is_free.clear();
        self.is_free.extend(usable);
        let boxes = (0..)
            .zip(detections)
            .zip(&self.is_free)
            .filter(|(_, is_usable)| **is_usable)
            .map(|((place, detection), _)| (detection.bounding_box.corners(), place));
        self.near.fill(boxes);
    }

    /// Makes as many pairs of free objects and detections as possible, at the smallest total cost. For an object that
    /// takes part, `reach` returns the area that its detections' boxes overlap, and the cost of a box, which is given as
    /// its corners and as its centre and sides; a pair is allowed if its cost is `within` the gate.
    pub(crate) fn stage<C: Fn(Corners, BoundingBox) -> f64>(
        &mut self,
        detections: &[Detection],
        reach: impl Fn(usize) -> Option<(Corners, C)>,
        within: impl Fn(f64) -> bool,
    ) {
        self.edges.clear();
        for (row, detection) in (0u32..).zip(&self.detection_of) {
            if detection.is_some() {
                continue;
            }
            let Some((area, cost_of)) = reach(row as usize) else {
                continue;
            };
            self.near.visit(area, |column, corners| {
                let cost = cost_of(corners, detections[column as usize].bounding_box);
                if within(cost) && self.is_free[column as usize] {
                    self.edges.push(Edge { row, column, cost });
                }
            });
        }
        self.pairs.clear();
        let rows = self.detection_of.len();
        let columns = self.is_free.len();
        self.solver.solve(rows, columns, &self.edges, &mut self.pairs);
        for &(row, column) in &self.pairs {
            self.detection_of[row as usize] = Some(column);
            self.is_free[column as usize] = false;
        }
    }

    /// Pairs a free object with a free detection.
    pub(crate) fn pair(&mut self, object: usize, detection: usize) {
        self.detection_of[object] = Some(detection as u32);
        self.is_free[detection] = false;
    }

    /// The boxes of the usable detections.
    pub(crate) fn near(&self) -> &NearBoxes {
        &self.near
    }

    /// Returns the index of each object's detection.
    pub(crate) fn detection_of(&self) -> &[Option<u32>] {
        &self.detection_of
    }

    /// True for each detection that is usable and not paired.
    pub(crate) fn is_free(&self) -> &[bool] {
        &self.is_free
    }
}
