//! Which detection belongs to which object: first by overlap, then by statistical distance.

mod overlap_costs;

use super::components::{ComponentSolver, Edge};
use super::{AssignmentSolver, ObjectState, OverlapIndex};
use crate::detection::Detection;
use crate::kalman::FilterModel;
use overlap_costs::OverlapCosts;

/// When pairs beyond the gate are ruled out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GateOrder {
    /// Before the assignment: only pairs within the gate compete. As many as can be are made, at the
    /// smallest total cost.
    BeforeAssignment,
    /// After it (published code): all pairs compete, and those beyond the gate are undone. A hopeless
    /// pair may so displace a good one. Costs the full matrix.
    AfterAssignment,
}

/// The rules of matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Association {
    /// Stage 1 accepts intersection over union of this or more. Not in the paper.
    pub iou_gate: f64,
    /// Stage 1 takes objects updated at most this many frames ago, this one included; older ones have
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

/// Cost in stage 2 of a pair beyond the gate (published code).
const BEYOND_GATE: f64 = 1e9;

/// The two-stage matcher with its buffers, which are kept from call to call.
#[derive(Clone, Debug, Default)]
pub(crate) struct Matcher {
    full: AssignmentSolver,
    components: ComponentSolver,
    /// Object states and detections that the stage at hand may pair, by index.
    rows: Vec<u32>,
    columns: Vec<u32>,
    overlaps: OverlapCosts,
    /// Where the centres of `columns` lie, when they are many.
    centers: OverlapIndex,
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
        self.edges.clear();
        self.matrix.clear();
        let rows = self.rows.iter().map(|&row| &states[row as usize]);
        let columns = self
            .columns
            .iter()
            .map(|&column| &detections[column as usize]);
        match settings.gate {
            GateOrder::AfterAssignment => {
                self.overlaps
                    .fill(settings, rows, columns, &mut self.matrix);
            }
            GateOrder::BeforeAssignment => {
                let class_of = |column: usize| detections[self.columns[column] as usize].class;
                self.overlaps
                    .gate(settings, rows, columns, class_of, &mut self.edges);
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
        let Self {
            rows,
            columns,
            centers,
            edges,
            matrix,
            ..
        } = self;
        let many = columns.len() >= OverlapIndex::WORTH_WHILE;
        if settings.gate == GateOrder::BeforeAssignment && many {
            let center = |&column: &u32| detections[column as usize].bounding_box.center();
            centers.fill(columns.iter().map(center));
        }
        for (place, &row) in rows.iter().enumerate() {
            let state = &states[row as usize];
            let gauge = state.filter.gauge(model);
            let distance_to = |column: usize| {
                let detection = &detections[columns[column] as usize];
                let distance = gauge.squared_distance(detection.bounding_box);
                let within = distance < settings.mahalanobis_gate
                    && (!settings.same_class_only || detection.class == state.class);
                within.then_some(distance)
            };
            let mut compete = |column: usize| {
                edges.extend(distance_to(column).map(|cost| Edge {
                    row: place as u32,
                    column: column as u32,
                    cost,
                }));
            };
            match settings.gate {
                GateOrder::AfterAssignment => {
                    let costs = (0..columns.len()).map(distance_to);
                    matrix.extend(costs.map(|cost| cost.unwrap_or(BEYOND_GATE)));
                }
                GateOrder::BeforeAssignment if many => {
                    centers.visit(gauge.reach(settings.mahalanobis_gate), compete);
                }
                GateOrder::BeforeAssignment => (0..columns.len()).for_each(&mut compete),
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
