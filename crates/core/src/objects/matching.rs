//! Which detection belongs to which object: first by overlap, then by statistical distance.

use super::components::{ComponentSolver, Edge};
use super::{AssignmentSolver, ObjectState};
use crate::detection::Detection;
use crate::geometry::Corners;
use crate::kalman::FilterModel;
use serde::{Deserialize, Serialize};

/// When pairs beyond the gate are ruled out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GateOrder {
    /// Before the assignment: only pairs within the gate compete. As many as can be are made, at the
    /// smallest total cost.
    BeforeAssignment,
    /// After it (published code): all pairs compete, and those beyond the gate are undone. A hopeless
    /// pair may so displace a good one. Costs the full matrix.
    AfterAssignment,
}

/// The rules of matching.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Association {
    /// Stage 1 accepts intersection over union of this or more. Not in the paper.
    pub iou_gate: f64,
    /// Stage 1 takes objects updated at most so many frames ago, this one included; older ones have
    /// stage 2 only. Not in the paper.
    pub iou_frames: u32,
    /// Stage 2 accepts squared Mahalanobis distances below this (the 95 % quantile of χ² with four
    /// degrees of freedom). Not in the paper.
    pub mahalanobis_gate: f64,
    /// When the gates are applied.
    pub gate: GateOrder,
    /// Whether only a detection of the object's own class may match it. The published code ignores the
    /// class and takes over that of the detection; the paper does not say.
    pub same_class_only: bool,
}

/// What stands in the cost matrix of stage 2 for a pair beyond the gate (published code).
const BEYOND_GATE: f64 = 1e9;

/// The two-stage matcher with its buffers, which are kept from call to call.
#[derive(Clone, Debug, Default)]
pub(crate) struct Matcher {
    full: AssignmentSolver,
    components: ComponentSolver,
    /// Object states and detections that the stage at hand may pair, by index.
    rows: Vec<u32>,
    columns: Vec<u32>,
    /// Corners and areas of `columns`, one list a number: so the compiler can compute several at once.
    left: Vec<f64>,
    top: Vec<f64>,
    right: Vec<f64>,
    bottom: Vec<f64>,
    area: Vec<f64>,
    /// Overlaps of one object with `columns`.
    overlap: Vec<f64>,
    edges: Vec<Edge>,
    matrix: Vec<f64>,
    /// Pairs of the stage, as places in `rows` and `columns`.
    pairs: Vec<(u32, u32)>,
    detection_of: Vec<Option<u32>>,
    matched: Vec<bool>,
}

impl Matcher {
    /// Matches `states`, predicted to this frame, with those of `detections` whose indices are in
    /// `usable`. Returns for each state the index of its detection.
    pub(crate) fn associate(
        &mut self,
        settings: &Association,
        model: &FilterModel,
        states: &[ObjectState],
        detections: &[Detection],
        usable: &[u32],
    ) -> &[Option<u32>] {
        self.detection_of.clear();
        self.detection_of.resize(states.len(), None);
        self.matched.clear();
        self.matched.resize(detections.len(), false);

        self.rows.clear();
        self.rows.extend(indices(states, |state| {
            state.since_update <= settings.iou_frames
        }));
        self.columns.clear();
        self.columns.extend_from_slice(usable);
        self.pair_by_overlap(settings, states, detections);
        self.take_pairs();

        self.rows.clear();
        let detection_of = &self.detection_of;
        self.rows.extend(
            (0..states.len() as u32).filter(|&index| detection_of[index as usize].is_none()),
        );
        let matched = &self.matched;
        self.columns.retain(|&index| !matched[index as usize]);
        self.pair_by_distance(settings, model, states, detections);
        self.take_pairs();
        &self.detection_of
    }

    /// Whether each detection was matched by the last [`associate`](Self::associate).
    pub(crate) fn matched(&self) -> &[bool] {
        &self.matched
    }

    fn take_pairs(&mut self) {
        for &(row, column) in &self.pairs {
            let detection = self.columns[column as usize];
            self.detection_of[self.rows[row as usize] as usize] = Some(detection);
            self.matched[detection as usize] = true;
        }
    }

    /// Stage 1: cost 1 − IoU.
    fn pair_by_overlap(
        &mut self,
        settings: &Association,
        states: &[ObjectState],
        detections: &[Detection],
    ) {
        self.pairs.clear();
        if self.rows.is_empty() || self.columns.is_empty() {
            return;
        }
        self.measure_columns(detections);
        self.edges.clear();
        self.matrix.clear();
        for place in 0..self.rows.len() {
            let state = &states[self.rows[place] as usize];
            self.measure_overlaps(state.filter.bounding_box().corners());
            if settings.same_class_only {
                for (overlap, &column) in self.overlap.iter_mut().zip(&self.columns) {
                    if detections[column as usize].class != state.class {
                        *overlap = 0.0;
                    }
                }
            }
            match settings.gate {
                GateOrder::AfterAssignment => {
                    self.matrix.extend(self.overlap.iter().map(|iou| 1.0 - iou));
                }
                GateOrder::BeforeAssignment => {
                    for (column, &iou) in self.overlap.iter().enumerate() {
                        if iou >= settings.iou_gate && iou > 0.0 {
                            self.edges.push(Edge {
                                row: place as u32,
                                column: column as u32,
                                cost: 1.0 - iou,
                            });
                        }
                    }
                }
            }
        }
        let within_gate = |cost: f64| 1.0 - cost >= settings.iou_gate && cost < 1.0;
        self.pair_up(settings.gate, within_gate);
    }

    /// Stage 2: cost squared Mahalanobis distance.
    fn pair_by_distance(
        &mut self,
        settings: &Association,
        model: &FilterModel,
        states: &[ObjectState],
        detections: &[Detection],
    ) {
        self.pairs.clear();
        if self.rows.is_empty() || self.columns.is_empty() {
            return;
        }
        self.edges.clear();
        self.matrix.clear();
        for (place, &row) in self.rows.iter().enumerate() {
            let state = &states[row as usize];
            let gauge = state.filter.gauge(model);
            for (column, &index) in self.columns.iter().enumerate() {
                let detection = &detections[index as usize];
                let distance = gauge.squared_distance(detection.bounding_box);
                let within = distance < settings.mahalanobis_gate
                    && (!settings.same_class_only || detection.class == state.class);
                match settings.gate {
                    GateOrder::AfterAssignment => {
                        self.matrix
                            .push(if within { distance } else { BEYOND_GATE });
                    }
                    GateOrder::BeforeAssignment if within => self.edges.push(Edge {
                        row: place as u32,
                        column: column as u32,
                        cost: distance,
                    }),
                    GateOrder::BeforeAssignment => {}
                }
            }
        }
        let within_gate = |cost: f64| cost < settings.mahalanobis_gate;
        self.pair_up(settings.gate, within_gate);
    }

    /// Solves what was put in `edges` or `matrix`, as `gate` asks.
    fn pair_up(&mut self, gate: GateOrder, within_gate: impl Fn(f64) -> bool) {
        let (rows, columns) = (self.rows.len(), self.columns.len());
        match gate {
            GateOrder::BeforeAssignment => {
                self.components
                    .solve(rows, columns, &self.edges, &mut self.pairs);
            }
            GateOrder::AfterAssignment => {
                // Usable detections and live filters give finite costs. A refusal would mean no pairs.
                let assigned = self.full.solve(rows, columns, &self.matrix);
                for &(row, column) in assigned.unwrap_or_default() {
                    if within_gate(self.matrix[row * columns + column]) {
                        self.pairs.push((row as u32, column as u32));
                    }
                }
            }
        }
    }

    fn measure_columns(&mut self, detections: &[Detection]) {
        for list in [
            &mut self.left,
            &mut self.top,
            &mut self.right,
            &mut self.bottom,
            &mut self.area,
        ] {
            list.clear();
        }
        for &column in &self.columns {
            let corners = detections[column as usize].bounding_box.corners();
            self.left.push(corners.x1);
            self.top.push(corners.y1);
            self.right.push(corners.x2);
            self.bottom.push(corners.y2);
            self.area.push(corners.area());
        }
    }

    /// Fills `overlap` with the intersection over union of `object` and each of `columns`, as
    /// [`Corners::intersection_over_union`] but without branches.
    fn measure_overlaps(&mut self, object: Corners) {
        let area = object.area();
        // Comparisons, not `f64::min`: nothing here is NaN, and this is one instruction.
        let min = |a: f64, b: f64| if a < b { a } else { b };
        let max = |a: f64, b: f64| if a > b { a } else { b };
        let horizontal = self.left.iter().zip(&self.right);
        let vertical = self.top.iter().zip(&self.bottom);
        let columns = horizontal.zip(vertical).zip(&self.area);
        self.overlap.clear();
        self.overlap
            .extend(columns.map(|(((&left, &right), (&top, &bottom)), &own)| {
                let width = max(min(right, object.x2) - max(left, object.x1), 0.0);
                let height = max(min(bottom, object.y2) - max(top, object.y1), 0.0);
                let shared = width * height;
                shared / (area + own - shared)
            }));
    }
}

fn indices(
    states: &[ObjectState],
    wanted: impl Fn(&ObjectState) -> bool,
) -> impl Iterator<Item = u32> {
    (0u32..)
        .zip(states)
        .filter(move |(_, state)| wanted(state))
        .map(|(index, _)| index)
}

#[cfg(test)]
mod tests;
