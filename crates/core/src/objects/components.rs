//! The optimal assignment when most pairs are forbidden: each connected component is solved separately.
//!
//! A pair that passes its gate is an edge between an object and a detection. Objects and detections that no edges
//! connect, directly or through others, cannot influence each other, and in real scenes most components are one object
//! and one detection. Each component gets as many pairs as possible, at the smallest total cost.

use super::AssignmentSolver;

/// A pair that passed its gate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Edge {
    pub row: u32,
    pub column: u32,
    /// Zero or more.
    pub cost: f64,
}

const NONE: u32 = u32::MAX;

/// The solver with its buffers, which are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct ComponentSolver {
    dense: AssignmentSolver,
    /// For each row, another row of its component; the row itself if it represents the component.
    parent: Vec<u32>,
    /// For each column, the first row with an edge to it; later its position within its component.
    of_column: Vec<u32>,
    /// The edges, each with the row that represents its component.
    sorted: Vec<(u32, Edge)>,
    /// For each component, the position of its next edge in `sorted`.
    place_of: Vec<usize>,
    rows: Vec<u32>,
    columns: Vec<u32>,
    matrix: Vec<f64>,
}

impl ComponentSolver {
    /// Appends the pairs `(row, column)` to `pairs`. `edges` are in row order without duplicates.
    pub(crate) fn solve(
        &mut self,
        rows: usize,
        columns: usize,
        edges: &[Edge],
        pairs: &mut Vec<(u32, u32)>,
    ) {
        self.parent.clear();
        self.parent.extend(0..rows as u32);
        self.of_column.clear();
        self.of_column.resize(columns, NONE);
        let mut all_alone = edges.windows(2).all(|pair| pair[0].row != pair[1].row);
        for edge in edges {
            let first = &mut self.of_column[edge.column as usize];
            if *first == NONE {
                *first = edge.row;
                continue;
            }
            // Two rows with an edge to one column belong together.
            all_alone = false;
            let known = *first;
            let one = self.root(known);
            let other = self.root(edge.row);
            self.parent[one.max(other) as usize] = one.min(other);
        }
        // As in most frames with few objects: every component is one edge.
        if all_alone {
            pairs.extend(edges.iter().map(|edge| (edge.row, edge.column)));
            return;
        }
        // A parent comes before its rows, so it knows its root already.
        for row in 0..rows {
            self.parent[row] = self.parent[self.parent[row] as usize];
        }
        let sorted = self.sorted_by_root(rows, edges);
        for component in sorted.chunk_by(|(one, _), (other, _)| one == other) {
            match component {
                [(_, edge)] => pairs.push((edge.row, edge.column)),
                several => self.solve_component(several, pairs),
            }
        }
        self.sorted = sorted;
    }

    /// Returns the edges grouped by component, each with its root, the parent of its row; within a component they keep
    /// their order. Sorted by counting: roots are small numbers.
    fn sorted_by_root(&mut self, rows: usize, edges: &[Edge]) -> Vec<(u32, Edge)> {
        self.place_of.clear();
        self.place_of.resize(rows + 1, 0);
        for edge in edges {
            let root = self.parent[edge.row as usize];
            self.place_of[root as usize + 1] += 1;
        }
        // From counts to the places at which the components begin.
        for row in 0..rows {
            self.place_of[row + 1] += self.place_of[row];
        }
        let mut sorted = std::mem::take(&mut self.sorted);
        // Whatever is in it is overwritten.
        sorted.resize(edges.len(), (NONE, Edge::default()));
        for edge in edges {
            let root = self.parent[edge.row as usize];
            let place = &mut self.place_of[root as usize];
            sorted[*place] = (root, *edge);
            *place += 1;
        }
        sorted
    }

    /// Returns the row that represents the component of `row`, and halves the path to it.
    fn root(&mut self, mut row: u32) -> u32 {
        while self.parent[row as usize] != row {
            let parent = self.parent[row as usize];
            self.parent[row as usize] = self.parent[parent as usize];
            row = parent;
        }
        row
    }

    /// Appends the pairs of one component of several edges.
    fn solve_component(&mut self, edges: &[(u32, Edge)], pairs: &mut Vec<(u32, u32)>) {
        self.rows.clear();
        self.columns.clear();
        let mut largest = 0.0_f64;
        for (_, edge) in edges {
            largest = largest.max(edge.cost);
            if self.rows.last() != Some(&edge.row) {
                self.rows.push(edge.row);
            }
            self.columns.push(edge.column);
        }
        // Sorted, so that the order of the edges does not decide among equal costs.
        self.columns.sort_unstable();
        self.columns.dedup();
        for (place, column) in (0..).zip(&self.columns) {
            self.of_column[*column as usize] = place;
        }
        let (rows, columns) = (self.rows.len(), self.columns.len());
        if rows == 1 || columns == 1 {
            let cheapest = edges
                .iter()
                .min_by(|(_, a), (_, b)| a.cost.total_cmp(&b.cost).then(a.column.cmp(&b.column)));
            pairs.extend(cheapest.map(|(_, edge)| (edge.row, edge.column)));
            return;
        }
        // One more forbidden pair must cost more than any other choice of edges can save.
        let forbidden = (largest + 1.0) * (rows.min(columns) + 1) as f64;
        self.matrix.clear();
        self.matrix.resize(rows * columns, forbidden);
        let mut row = 0;
        for (_, edge) in edges {
            if self.rows[row] != edge.row {
                row += 1;
            }
            let column = self.of_column[edge.column as usize] as usize;
            self.matrix[row * columns + column] = edge.cost;
        }
        for &(row, column) in self.dense.solve(rows, columns, &self.matrix) {
            if self.matrix[row * columns + column] < forbidden {
                pairs.push((self.rows[row], self.columns[column]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Number of pairs and their cost for the best way to pair the rows from `row` on. The bits of `used` are the columns
    /// that have a row.
    fn best(row: u32, rows: u32, edges: &[Edge], used: u32) -> (i32, f64) {
        if row == rows {
            return (0, 0.0);
        }
        // Without a pair of this row, and then with each of its edges.
        let (mut most_pairs, mut least_cost) = best(row + 1, rows, edges, used);
        for edge in edges {
            let column = 1 << edge.column;
            if edge.row != row || used & column != 0 {
                continue;
            }
            let (mut pairs, mut cost) = best(row + 1, rows, edges, used | column);
            pairs += 1;
            cost += edge.cost;
            if pairs > most_pairs || (pairs == most_pairs && cost < least_cost) {
                most_pairs = pairs;
                least_cost = cost;
            }
        }
        (most_pairs, least_cost)
    }

    fn graphs() -> impl Strategy<Value = (u32, u32, Vec<Edge>)> {
        (1..7u32, 1..7u32, 0.05..0.9f64).prop_flat_map(|(rows, columns, density)| {
            let pair = prop::option::weighted(density, 0.0..10.0);
            prop::collection::vec(pair, (rows * columns) as usize).prop_map(move |costs| {
                let edges = costs.into_iter().enumerate().filter_map(|(index, cost)| {
                    Some(Edge {
                        row: index as u32 / columns,
                        column: index as u32 % columns,
                        cost: cost?,
                    })
                });
                (rows, columns, edges.collect())
            })
        })
    }

    proptest! {
        #[test]
        fn the_most_pairs_are_found_at_the_smallest_cost((rows, columns, edges) in graphs()) {
            let mut solver = ComponentSolver::default();
            let mut pairs = Vec::new();
            // A used solver must answer as a fresh one.
            let warm_up = [Edge { row: 0, column: 0, cost: 1.0 }, Edge { row: 1, column: 0, cost: 0.5 }];
            solver.solve(2, 1, &warm_up, &mut pairs);
            prop_assert_eq!(&pairs, &[(1, 0)]);
            pairs.clear();
            solver.solve(rows as usize, columns as usize, &edges, &mut pairs);
            let mut total = 0.0;
            for (index, &(row, column)) in pairs.iter().enumerate() {
                let edge = edges.iter().find(|edge| edge.row == row && edge.column == column);
                total += edge.unwrap().cost;
                prop_assert!(pairs[..index].iter().all(|pair| pair.0 != row && pair.1 != column));
            }
            let (count, cost) = best(0, rows, &edges, 0);
            prop_assert_eq!(pairs.len() as i32, count);
            prop_assert!((total - cost).abs() < 1e-9);
        }
    }
}
