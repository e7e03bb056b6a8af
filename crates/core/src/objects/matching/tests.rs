use super::*;
use crate::detection::ObjectId;
use crate::kalman::FilterParameters;
use crate::objects::{ComponentSolver, Edge};
use crate::policy::tests::{PICTURE, seen};
use proptest::prelude::*;

const SETTINGS: Association = Association {
    iou_gate: 0.25,
    iou_frames: 2,
    mahalanobis_gate: 9.4877,
    gate: GateOrder::BeforeAssignment,
};

fn model() -> FilterModel {
    FilterModel::new(&FilterParameters::default(), PICTURE)
}

fn detection(bounding_box: BoundingBox) -> Detection {
    Detection {
        bounding_box,
        ..seen(0.5, 0.9)
    }
}

/// An object seen once at `bounding_box`, `age` frames ago.
fn object(bounding_box: BoundingBox, age: u32) -> ObjectState {
    let model = model();
    let mut state = ObjectState::new(ObjectId(0), &detection(bounding_box), 3, &model);
    for _ in 0..age {
        state.predict(&model);
    }
    state
}

fn associate(
    settings: &Association,
    states: &[ObjectState],
    detections: &[Detection],
) -> Vec<Option<u32>> {
    let usable = detections.iter().map(|_| true);
    Matcher::default()
        .associate(settings, &model(), states, detections, usable)
        .to_vec()
}

fn at(x: f64, side: f64) -> BoundingBox {
    BoundingBox::new(x, 0.5, side, side)
}

#[test]
fn an_object_unseen_for_long_is_matched_by_distance_alone() {
    // Small boxes without overlap, but close given the filter's uncertainty.
    let near = [detection(at(0.512, 0.01))];
    for gate in [GateOrder::BeforeAssignment, GateOrder::AfterAssignment] {
        let settings = Association { gate, ..SETTINGS };
        let young = [object(at(0.5, 0.01), 1)];
        assert_eq!(associate(&settings, &young, &near), [Some(0)]);
        let no_second_stage = Association {
            mahalanobis_gate: 0.0,
            ..settings
        };
        assert_eq!(associate(&no_second_stage, &young, &near), [None]);
        // Full overlap, but too old for stage 1.
        let same = [detection(at(0.5, 0.01))];
        for (age, matched) in [(2, Some(0)), (3, None)] {
            let states = [object(at(0.5, 0.01), age)];
            assert_eq!(associate(&no_second_stage, &states, &same), [matched]);
        }
    }
}

#[test]
fn a_hopeless_pair_displaces_a_good_one_only_if_gates_are_applied_last() {
    // Overlaps .82 and .67 for the first, .23 and .04 for the second: .67 + .23 is the most, but .23 is beyond the gate.
    let states = [object(at(0.5, 0.1), 1), object(at(0.572, 0.1), 1)];
    let of_interest = [detection(at(0.51, 0.1)), detection(at(0.48, 0.1))];
    // Among many boxes only those near an object are looked at.
    for others in [0, 20] {
        let far_away = std::iter::repeat_n(detection(at(5.0, 0.1)), others);
        let detections: Vec<_> = of_interest.iter().copied().chain(far_away).collect();
        for (gate, first) in [
            (GateOrder::BeforeAssignment, Some(0)),
            (GateOrder::AfterAssignment, Some(1)),
        ] {
            let settings = Association {
                gate,
                iou_gate: 0.5,
                mahalanobis_gate: 0.0,
                ..SETTINGS
            };
            let matches = associate(&settings, &states, &detections);
            assert_eq!(matches, [first, None], "{gate:?}, {others} others");
        }
    }
}

/// The matcher's definition: all pairs are measured, and those within the gate compete.
fn associate_without_index(
    settings: &Association,
    states: &[ObjectState],
    detections: &[Detection],
) -> Vec<Option<u32>> {
    let mut overlapping = Vec::new();
    for (row, state) in (0..).zip(states) {
        if state.since_update > settings.iou_frames {
            continue;
        }
        for (column, detection) in (0..).zip(detections) {
            let own = state.filter.bounding_box();
            // The overlap follows from the cost: 1e-30, a rounding error, is no overlap.
            let cost = 1.0 - own.intersection_over_union(detection.bounding_box);
            if 1.0 - cost >= settings.iou_gate && cost < 1.0 {
                overlapping.push(Edge { row, column, cost });
            }
        }
    }
    let mut matches = vec![None; states.len()];
    add_best(&mut matches, &overlapping, detections.len());

    let mut near = Vec::new();
    for (row, state) in (0..).zip(states) {
        if matches[row as usize].is_some() {
            continue;
        }
        for (column, detection) in (0..).zip(detections) {
            let cost = state.filter.gauge(&model()).squared_distance(detection.bounding_box);
            if cost < settings.mahalanobis_gate && !matches.contains(&Some(column)) {
                near.push(Edge { row, column, cost });
            }
        }
    }
    add_best(&mut matches, &near, detections.len());
    matches
}

/// Adds the best pairs among `edges` to the matches of the states.
fn add_best(matches: &mut [Option<u32>], edges: &[Edge], detections: usize) {
    let mut pairs = Vec::new();
    ComponentSolver::default().solve(matches.len(), detections, edges, &mut pairs);
    for (row, column) in pairs {
        matches[row as usize] = Some(column);
    }
}

/// The published matcher: every pair is measured and competes, and those beyond the gate are discarded.
fn associate_all_pairs(
    settings: &Association,
    states: &[ObjectState],
    detections: &[Detection],
) -> Vec<Option<u32>> {
    let mut matches = vec![None; states.len()];
    let is_young = |row: &usize| states[*row].since_update <= settings.iou_frames;
    let young: Vec<usize> = (0..states.len()).filter(is_young).collect();
    let apart = |row: usize, column: usize| {
        let own = states[row].filter.bounding_box();
        1.0 - own.intersection_over_union(detections[column].bounding_box)
    };
    add_cheapest(&mut matches, &young, detections.len(), apart, |cost| {
        1.0 - cost >= settings.iou_gate && cost < 1.0
    });

    let is_unmatched = |row: &usize| matches[*row].is_none();
    let unmatched: Vec<usize> = (0..states.len()).filter(is_unmatched).collect();
    let distance = |row: usize, column: usize| {
        let squared = states[row]
            .filter
            .gauge(&model())
            .squared_distance(detections[column].bounding_box);
        if squared < settings.mahalanobis_gate {
            squared
        } else {
            BEYOND_GATE
        }
    };
    add_cheapest(
        &mut matches,
        &unmatched,
        detections.len(),
        distance,
        |cost| cost < settings.mahalanobis_gate,
    );
    matches
}

/// Assigns the detections without a match to `rows`, and adds the pairs whose cost is within the gate.
fn add_cheapest(
    matches: &mut [Option<u32>],
    rows: &[usize],
    detections: usize,
    cost: impl Fn(usize, usize) -> f64,
    within: impl Fn(f64) -> bool,
) {
    let is_free = |column: &usize| !matches.contains(&Some(*column as u32));
    let columns: Vec<usize> = (0..detections).filter(is_free).collect();
    let mut matrix = Vec::new();
    for row in rows {
        for column in &columns {
            matrix.push(cost(*row, *column));
        }
    }
    let mut solver = AssignmentSolver::default();
    for &(row, column) in solver.solve(rows.len(), columns.len(), &matrix) {
        if within(matrix[row * columns.len() + column]) {
            matches[rows[row]] = Some(columns[column] as u32);
        }
    }
}

/// Boxes on a coarse grid with few sizes, so that many coincide and costs tie; or boxes anywhere, some large, some far outside.
fn scene(most: usize) -> impl Strategy<Value = Vec<(BoundingBox, u32)>> {
    let step = |steps: u8, unit: f64| (0..steps).prop_map(move |step| f64::from(step) * unit);
    let coarse = (step(24, 0.04), step(24, 0.04), step(3, 0.02), step(3, 0.02));
    let fine = (
        -0.2..1.2,
        -0.2..1.2,
        prop_oneof![9 => 0.0..0.2, 1 => 0.0..3.0],
        0.0..0.2,
    );
    let place = prop_oneof![coarse, fine];
    let one = place.prop_map(|(x, y, w, h)| BoundingBox::new(x, y, w + 0.03, h + 0.03));
    prop::collection::vec((one, 0..6u32), 0..most)
}

fn objects(seen: Vec<(BoundingBox, u32)>) -> Vec<ObjectState> {
    seen.into_iter().map(|(place, age)| object(place, age)).collect()
}

fn detections(found: Vec<(BoundingBox, u32)>) -> Vec<Detection> {
    found.into_iter().map(|(place, _)| detection(place)).collect()
}

proptest! {
    /// The most pairs match at the smallest cost, as the solver's own tests show.
    #[test]
    fn the_search_near_boxes_changes_no_match_even_with_ties(
        seen in scene(150), found in scene(150),
        iou_gate in prop_oneof![Just(0.0), Just(SETTINGS.iou_gate), Just(0.5), 0.0..1.0],
    ) {
        let states = objects(seen);
        let detections = detections(found);
        let settings = Association { iou_gate, ..SETTINGS };
        let expected = associate_without_index(&settings, &states, &detections);
        prop_assert_eq!(associate(&settings, &states, &detections), expected);
    }

    #[test]
    fn costs_within_reach_are_enough_for_the_whole_matrix_even_with_ties(
        seen in scene(60), found in scene(60),
        iou_gate in prop_oneof![Just(0.0), Just(SETTINGS.iou_gate), Just(0.5), 0.0..1.0],
    ) {
        let states = objects(seen);
        let detections = detections(found);
        let settings = Association { iou_gate, gate: GateOrder::AfterAssignment, ..SETTINGS };
        let expected = associate_all_pairs(&settings, &states, &detections);
        prop_assert_eq!(associate(&settings, &states, &detections), expected);
    }

    #[test]
    fn no_detection_is_matched_twice_and_no_pair_is_beyond_both_gates(
        seen in scene(60), found in scene(60), late in any::<bool>(),
        iou_gate in prop_oneof![Just(0.0), Just(SETTINGS.iou_gate)],
    ) {
        let states = objects(seen);
        let detections = detections(found);
        let gate = if late { GateOrder::AfterAssignment } else { GateOrder::BeforeAssignment };
        let matches = associate(&Association { gate, iou_gate, ..SETTINGS }, &states, &detections);
        let mut taken = vec![false; detections.len()];
        for (state, matched) in states.iter().zip(&matches) {
            let Some(index) = *matched else { continue };
            prop_assert!(!taken[index as usize]);
            taken[index as usize] = true;
            let measured = detections[index as usize].bounding_box;
            let iou = state.filter.bounding_box().intersection_over_union(measured);
            let distance = state.filter.gauge(&model()).squared_distance(measured);
            let is_young = state.since_update <= SETTINGS.iou_frames;
            let overlaps = is_young && iou > 0.0 && iou >= iou_gate - 1e-12;
            prop_assert!(overlaps || distance < SETTINGS.mahalanobis_gate);
        }
    }
}
