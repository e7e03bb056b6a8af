//! The optimal assignment when most pairs are forbidden: each connected component is solved alone.
//!
//! A pair that passes its gate is an edge between an object and a detection. Objects and detections
//! that no edge links, directly or through others, cannot influence each other, and in real scenes most
//! components are one object and one detection. Within a component as many pairs as can be are made,
//! and of all ways to do so the one with the smallest total cost.

use super::AssignmentSolver;

/// A pair that passed its gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Edge {
    pub row: u32,
    pub column: u32,
    /// Zero or more.
    pub cost: f64,
}

const UNSEEN: u32 = u32::MAX;

/// The solver with its buffers, which are kept from call to call.
#[derive(Clone, Debug, Default)]
pub(crate) struct ComponentSolver {
    dense: AssignmentSolver,
    /// First edge of each row, and the end.
    row_start: Vec<u32>,
    /// Edges of each column; then where each column's rows begin in `rows_of_columns`.
    column_degree: Vec<u32>,
    column_start: Vec<u32>,
    rows_of_columns: Vec<u32>,
    /// Place of each row and column within its component.
    row_place: Vec<u32>,
    column_place: Vec<u32>,
    rows: Vec<u32>,
    columns: Vec<u32>,
    matrix: Vec<f64>,
}

impl ComponentSolver {
    /// Appends the pairs `(row, column)` to `pairs`. `edges` are in order of rows, without repetition.
    pub(crate) fn solve(
        &mut self,
        rows: usize,
        columns: usize,
        edges: &[Edge],
        pairs: &mut Vec<(u32, u32)>,
    ) {
        if edges.is_empty() {
            return;
        }
        self.index_rows(rows, columns, edges);
        let mut columns_indexed = false;
        for row in 0..rows {
            let own = self.edges_of(row, edges);
            match own {
                [] => {}
                [edge] if self.column_degree[edge.column as usize] == 1 => {
                    pairs.push((edge.row, edge.column));
                }
                _ => {
                    if !columns_indexed {
                        self.index_columns(rows, columns, edges);
                        columns_indexed = true;
                    }
                    if self.row_place[row] == UNSEEN {
                        self.collect(row as u32, edges);
                        self.solve_component(edges, pairs);
                    }
                }
            }
        }
    }

    fn edges_of<'a>(&self, row: usize, edges: &'a [Edge]) -> &'a [Edge] {
        &edges[self.row_start[row] as usize..self.row_start[row + 1] as usize]
    }

    fn index_rows(&mut self, rows: usize, columns: usize, edges: &[Edge]) {
        self.row_start.clear();
        self.row_start.resize(rows + 1, 0);
        self.column_degree.clear();
        self.column_degree.resize(columns, 0);
        for edge in edges {
            self.row_start[edge.row as usize + 1] += 1;
            self.column_degree[edge.column as usize] += 1;
        }
        for row in 0..rows {
            self.row_start[row + 1] += self.row_start[row];
        }
    }

    fn index_columns(&mut self, rows: usize, columns: usize, edges: &[Edge]) {
        self.column_start.clear();
        let mut start = 0;
        for degree in &self.column_degree {
            self.column_start.push(start);
            start += degree;
        }
        self.column_start.push(start);
        self.rows_of_columns.clear();
        self.rows_of_columns.resize(edges.len(), 0);
        // Filled from behind, so that each column's start ends where it began.
        for edge in edges.iter().rev() {
            let remaining = &mut self.column_degree[edge.column as usize];
            *remaining -= 1;
            let start = self.column_start[edge.column as usize];
            self.rows_of_columns[(start + *remaining) as usize] = edge.row;
        }
        for column in 0..columns {
            self.column_degree[column] = self.column_start[column + 1] - self.column_start[column];
        }
        self.row_place.clear();
        self.row_place.resize(rows, UNSEEN);
        self.column_place.clear();
        self.column_place.resize(columns, UNSEEN);
    }

    /// Gathers the component of `first` in `rows` and `columns`.
    fn collect(&mut self, first: u32, edges: &[Edge]) {
        self.rows.clear();
        self.columns.clear();
        self.row_place[first as usize] = 0;
        self.rows.push(first);
        let mut next = 0;
        while let Some(&row) = self.rows.get(next) {
            next += 1;
            let range = self.row_start[row as usize]..self.row_start[row as usize + 1];
            for edge in &edges[range.start as usize..range.end as usize] {
                let column = edge.column as usize;
                if self.column_place[column] != UNSEEN {
                    continue;
                }
                self.column_place[column] = self.columns.len() as u32;
                self.columns.push(edge.column);
                let others = self.column_start[column]..self.column_start[column + 1];
                for &other in &self.rows_of_columns[others.start as usize..others.end as usize] {
                    if self.row_place[other as usize] == UNSEEN {
                        self.row_place[other as usize] = self.rows.len() as u32;
                        self.rows.push(other);
                    }
                }
            }
        }
    }

    fn solve_component(&mut self, edges: &[Edge], pairs: &mut Vec<(u32, u32)>) {
        let (rows, columns) = (self.rows.len(), self.columns.len());
        let mut largest = 0.0;
        let mut cheapest: Option<&Edge> = None;
        for &row in &self.rows {
            for edge in self.edges_of(row as usize, edges) {
                if edge.cost > largest {
                    largest = edge.cost;
                }
                if cheapest.is_none_or(|best| edge.cost < best.cost) {
                    cheapest = Some(edge);
                }
            }
        }
        if rows == 1 || columns == 1 {
            pairs.extend(cheapest.map(|edge| (edge.row, edge.column)));
            return;
        }
        // One forbidden pair more must cost more than all that choosing other edges can save.
        let forbidden = (largest + 1.0) * (rows.min(columns) + 1) as f64;
        self.matrix.clear();
        self.matrix.resize(rows * columns, forbidden);
        for (place, &row) in self.rows.iter().enumerate() {
            let range = self.row_start[row as usize]..self.row_start[row as usize + 1];
            for edge in &edges[range.start as usize..range.end as usize] {
                let column = self.column_place[edge.column as usize] as usize;
                self.matrix[place * columns + column] = edge.cost;
            }
        }
        // The costs are finite: gates let no other pass. A refusal would mean no pairs.
        let assigned = self.dense.solve(rows, columns, &self.matrix);
        for &(row, column) in assigned.unwrap_or_default() {
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

    /// Number of pairs and their cost for the best way to pair the rows from `row` on.
    fn best(row: u32, rows: u32, edges: &[Edge], used: u32) -> (i32, f64) {
        if row == rows {
            return (0, 0.0);
        }
        let mut best_found = best(row + 1, rows, edges, used);
        for edge in edges.iter().filter(|edge| edge.row == row) {
            if used & (1 << edge.column) == 0 {
                let (pairs, cost) = best(row + 1, rows, edges, used | (1 << edge.column));
                let candidate = (pairs + 1, cost + edge.cost);
                if candidate.0 > best_found.0
                    || (candidate.0 == best_found.0 && candidate.1 < best_found.1)
                {
                    best_found = candidate;
                }
            }
        }
        best_found
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
        fn as_many_pairs_as_can_be_at_the_smallest_cost((rows, columns, edges) in graphs()) {
            let mut solver = ComponentSolver::default();
            let mut pairs = Vec::new();
            // A used solver must answer as a fresh one.
            let warm_up = [Edge { row: 0, column: 0, cost: 1.0 }, Edge { row: 1, column: 0, cost: 0.5 }];
            solver.solve(2, 1, &warm_up, &mut pairs);
            prop_assert_eq!(&pairs, &[(1, 0)]);
            pairs.clear();
            solver.solve(rows as usize, columns as usize, &edges, &mut pairs);
            let cost_of = |pair: &(u32, u32)| {
                edges.iter().find(|e| (e.row, e.column) == *pair).map(|e| e.cost)
            };
            let total: Option<f64> = pairs.iter().map(cost_of).sum();
            let (count, cost) = best(0, rows, &edges, 0);
            prop_assert_eq!(pairs.len() as i32, count);
            prop_assert!((total.unwrap() - cost).abs() < 1e-9);
            for (index, &(row, column)) in pairs.iter().enumerate() {
                prop_assert!(pairs[..index].iter().all(|&(r, c)| r != row && c != column));
            }
        }
    }
}
