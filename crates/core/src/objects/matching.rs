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

/// Cost in stage 1 of a pair that does not overlap.
const APART: f64 = 1.0;

/// Cost in stage 2 of a pair beyond the gate (published code).
const BEYOND_GATE: f64 = 1e9;

/// The two-stage matcher with its buffers, which are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct Matcher {
    pairing: Pairing,
    /// Buffers for the case that all pairs compete: the candidate objects and detections, the place of each detection
    /// among the candidates, and the costs.
    full: AssignmentSolver,
    rows: Vec<usize>,
    columns: Vec<usize>,
    column_of: Vec<usize>,
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
        // If all pairs compete, each that overlaps at all has a cost of its own.
        let least_overlap = match settings.gate {
            GateOrder::BeforeAssignment => settings.iou_gate,
            GateOrder::AfterAssignment => 0.0,
        };
        let reach_by_overlap = |row: usize| {
            let state = &states[row];
            if state.since_update > settings.iou_frames {
                return None;
            }
            let own = state.filter.bounding_box().corners();
            Some(by_overlap(own, least_overlap))
        };
        let overlaps_enough = |cost: f64| overlaps(cost, settings.iou_gate);
        self.stage(
            settings.gate,
            detections,
            reach_by_overlap,
            overlaps_enough,
            APART,
        );
        let is_near = |cost: f64| cost < settings.mahalanobis_gate;
        let reach_by_distance = |row: usize| {
            let gauge = states[row].filter.gauge(model);
            let cost = move |_, other: BoundingBox| {
                let distance = gauge.squared_distance(other);
                if is_near(distance) {
                    distance
                } else {
                    BEYOND_GATE
                }
            };
            Some((gauge.reach(settings.mahalanobis_gate), cost))
        };
        self.stage(
            settings.gate,
            detections,
            reach_by_distance,
            is_near,
            BEYOND_GATE,
        );
        self.pairing.detection_of()
    }

    /// True for each detection that is usable and was not matched by the last [`associate`](Self::associate).
    pub(crate) fn is_free(&self) -> &[bool] {
        self.pairing.is_free()
    }

    /// Runs one stage: `reach` and `within` are those of [`Pairing::stage`], and `far` is the cost of a box outside an
    /// object's reach when all pairs compete.
    fn stage<C: Fn(Corners, BoundingBox) -> f64>(
        &mut self,
        order: GateOrder,
        detections: &[Detection],
        reach: impl Fn(usize) -> Option<(Corners, C)>,
        within: impl Fn(f64) -> bool,
        far: f64,
    ) {
        match order {
            GateOrder::BeforeAssignment => self.pairing.stage(detections, reach, within),
            GateOrder::AfterAssignment => self.stage_of_all_pairs(detections, reach, within, far),
        }
    }

    /// As [`stage`](Self::stage), with the whole matrix of costs: whatever is outside an object's reach costs `far`, so
    /// only the costs within it are computed.
    fn stage_of_all_pairs<C: Fn(Corners, BoundingBox) -> f64>(
        &mut self,
        detections: &[Detection],
        reach: impl Fn(usize) -> Option<(Corners, C)>,
        within: impl Fn(f64) -> bool,
        far: f64,
    ) {
        let is_free = self.pairing.is_free();
        self.columns.clear();
        self.column_of.clear();
        for (detection, is_free) in is_free.iter().enumerate() {
            // Only the place of a free one is used.
            self.column_of.push(self.columns.len());
            if *is_free {
                self.columns.push(detection);
            }
        }
        let columns = self.columns.len();
        let near = self.pairing.near();
        self.rows.clear();
        self.matrix.clear();
        for (row, detection) in self.pairing.detection_of().iter().enumerate() {
            if detection.is_some() {
                continue;
            }
            let Some((area, cost_of)) = reach(row) else {
                continue;
            };
            self.rows.push(row);
            if !near.is_selective() {
                // Half the time of a visit to each box: the compiler computes several costs at once.
                let boxes = self.columns.iter().map(|column| detections[*column].bounding_box);
                self.matrix
                    .extend(boxes.map(|of_column| cost_of(of_column.corners(), of_column)));
                continue;
            }
            let begin = self.matrix.len();
            self.matrix.resize(begin + columns, far);
            let of_row = &mut self.matrix[begin..];
            near.visit(area, |detection, corners| {
                let detection = detection as usize;
                if is_free[detection] {
                    let cost = cost_of(corners, detections[detection].bounding_box);
                    of_row[self.column_of[detection]] = cost;
                }
            });
        }
        // Usable detections and live filters give finite costs; others would give no pairs.
        for &(row, column) in self.full.solve(self.rows.len(), columns, &self.matrix) {
            if within(self.matrix[row * columns + column]) {
                self.pairing.pair(self.rows[row], self.columns[column]);
            }
        }
    }
}

#[cfg(test)]
mod tests;
