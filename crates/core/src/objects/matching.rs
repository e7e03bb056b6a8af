//! Matching of detections with objects: first by overlap, then by statistical distance.

use super::pairing::{Pairing, by_overlap, overlaps};
use super::{AssignmentSolver, ObjectState};
use crate::detection::Detection;
use crate::geometry::{BoundingBox, Corners};
use crate::kalman::FilterModel;

/// The point at which pairs beyond the gate are excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GateOrder {
    /// Before the assignment: only pairs within the gate compete. Makes as many pairs as possible at the smallest total
    /// cost.
    BeforeAssignment,
    /// After it (published code): all pairs compete, and those beyond the gate are then discarded. A hopeless pair may
    /// thus displace a good one. Costs the full matrix.
    AfterAssignment,
}

/// The rules of matching. The class is ignored: the published code adopts the detection's class, and the paper does not
/// say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Association {
    /// Stage 1 accepts an intersection over union of at least this. Not in the paper.
    pub iou_gate: f64,
    /// Stage 1 considers objects updated at most this many frames ago, including this one; older ones take part in
    /// stage 2 only. Not in the paper.
    pub iou_frames: u32,
    /// Stage 2 accepts squared Mahalanobis distances below this (the 95 % quantile of χ² with four degrees of freedom).
    /// Not in the paper.
    pub mahalanobis_gate: f64,
    /// The point at which the gates apply.
    pub gate: GateOrder,
}

/// Cost in stage 2 of a pair beyond the gate (published code).
const BEYOND_GATE: f64 = 1e9;

/// The two-stage matcher with its buffers, which are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct Matcher {
    pairing: Pairing,
    /// Buffers for the case that all pairs compete: the candidate objects and detections, and their costs.
    full: AssignmentSolver,
    rows: Vec<usize>,
    columns: Vec<usize>,
    matrix: Vec<f64>,
}

impl Matcher {
    /// Matches `states`, predicted to this frame, with the `usable` ones of `detections`. Returns the index of each
    /// state's detection.
    pub(crate) fn associate(
        &mut self,
        settings: &Association,
        model: &FilterModel,
        states: &[ObjectState],
        detections: &[Detection],
        usable: impl Iterator<Item = bool>,
    ) -> &[Option<u32>] {
        self.pairing.begin(states.len(), detections, usable);
        let reach_by_overlap = |row: usize| {
            let state = &states[row];
            if state.since_update > settings.iou_frames {
                return None;
            }
            let own = state.filter.bounding_box().corners();
            Some(by_overlap(own, settings.iou_gate))
        };
        let overlaps_enough = |cost: f64| overlaps(cost, settings.iou_gate);
        self.stage(
            settings.gate,
            detections,
            reach_by_overlap,
            overlaps_enough,
            |cost| cost,
        );
        let reach_by_distance = |row: usize| {
            let gauge = states[row].filter.gauge(model);
            let cost = move |other: BoundingBox| gauge.squared_distance(other);
            Some((gauge.reach(settings.mahalanobis_gate), cost))
        };
        let is_near = |cost: f64| cost < settings.mahalanobis_gate;
        let competing = |cost: f64| if is_near(cost) { cost } else { BEYOND_GATE };
        self.stage(
            settings.gate,
            detections,
            reach_by_distance,
            is_near,
            competing,
        );
        self.pairing.detection_of()
    }

    /// True for each detection that is usable and was not matched by the last [`associate`](Self::associate).
    pub(crate) fn is_free(&self) -> &[bool] {
        self.pairing.is_free()
    }

    /// Runs one stage: `reach` and `within` are those of [`Pairing::stage`], and `competing` maps a cost to its value
    /// when all pairs compete.
    fn stage<C: Fn(BoundingBox) -> f64>(
        &mut self,
        order: GateOrder,
        detections: &[Detection],
        reach: impl Fn(usize) -> Option<(Corners, C)>,
        within: impl Fn(f64) -> bool,
        competing: impl Fn(f64) -> f64,
    ) {
        if order == GateOrder::BeforeAssignment {
            self.pairing.stage(detections, reach, within);
            return;
        }
        self.rows.clear();
        self.columns.clear();
        self.matrix.clear();
        for (column, is_free) in self.pairing.is_free().iter().enumerate() {
            if *is_free {
                self.columns.push(column);
            }
        }
        for (row, detection) in self.pairing.detection_of().iter().enumerate() {
            if detection.is_some() {
                continue;
            }
            if let Some((_, cost_of)) = reach(row) {
                self.rows.push(row);
                // Half the time of a push for each: the length is known, and there is a cost for every pair.
                let boxes = self.columns.iter().map(|column| detections[*column].bounding_box);
                self.matrix.extend(boxes.map(|of_column| competing(cost_of(of_column))));
            }
        }
        let rows = &self.rows;
        let columns = &self.columns;
        // Usable detections and live filters give finite costs; others would give no pairs.
        for &(row, column) in self.full.solve(rows.len(), columns.len(), &self.matrix) {
            if within(self.matrix[row * columns.len() + column]) {
                self.pairing.pair(rows[row], columns[column]);
            }
        }
    }
}

#[cfg(test)]
mod tests;
