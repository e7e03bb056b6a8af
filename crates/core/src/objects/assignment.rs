//! The optimal assignment of rows to columns at minimum total cost, for any rectangle.
//!
//! The shortest augmenting path algorithm (D. F. Crouse, "On implementing 2D rectangular assignment algorithms", IEEE
//! Transactions on Aerospace and Electronic Systems 52(4), 2016), with the search order, tie-breaking and transposition
//! of tall matrices of SciPy's `linear_sum_assignment`. The published code uses that function, so its traces can only
//! be reproduced with the same ties.

/// Largest magnitude of a cost, so that sums of costs do not overflow.
pub(crate) const LARGEST_COST: f64 = 1e100;

const NONE: usize = usize::MAX;

/// The solver with its buffers, which are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct AssignmentSolver {
    transposed_cost: Vec<f64>,
    row_dual: Vec<f64>,
    column_dual: Vec<f64>,
    shortest: Vec<f64>,
    previous_row: Vec<usize>,
    column_of_row: Vec<usize>,
    row_of_column: Vec<usize>,
    row_visited: Vec<bool>,
    column_visited: Vec<bool>,
    remaining: Vec<usize>,
    pairs: Vec<(usize, usize)>,
}

impl AssignmentSolver {
    /// Returns the `min(rows, columns)` pairs with the smallest total cost. `cost` is the matrix in row order. The
    /// pairs are `(row, column)` in row order; there are none if the matrix has another number of entries, or if a cost
    /// is not a number or exceeds [`LARGEST_COST`].
    pub(crate) fn solve(&mut self, rows: usize, columns: usize, cost: &[f64]) -> &[(usize, usize)] {
        self.pairs.clear();
        let is_matrix = rows.checked_mul(columns) == Some(cost.len());
        let is_usable = is_matrix && cost.iter().all(|cost| cost.abs() <= LARGEST_COST);
        if !is_usable || cost.is_empty() {
            return &self.pairs;
        }
        if columns < rows {
            let mut transposed = std::mem::take(&mut self.transposed_cost);
            transposed.clear();
            for column in 0..columns {
                transposed.extend((0..rows).map(|row| cost[row * columns + column]));
            }
            self.assign(columns, rows, &transposed);
            self.transposed_cost = transposed;
            let assigned = self.column_of_row.iter().enumerate();
            self.pairs.extend(assigned.map(|(row, &column)| (column, row)));
            self.pairs.sort_unstable();
        } else {
            self.assign(rows, columns, cost);
            self.pairs.extend(self.column_of_row.iter().copied().enumerate());
        }
        &self.pairs
    }

    /// Fills `column_of_row` for a matrix with at least as many columns as rows.
    fn assign(&mut self, rows: usize, columns: usize, cost: &[f64]) {
        refill(&mut self.row_dual, rows, 0.0);
        refill(&mut self.column_dual, columns, 0.0);
        refill(&mut self.shortest, columns, f64::INFINITY);
        refill(&mut self.previous_row, columns, NONE);
        refill(&mut self.column_of_row, rows, NONE);
        refill(&mut self.row_of_column, columns, NONE);
        refill(&mut self.row_visited, rows, false);
        refill(&mut self.column_visited, columns, false);
        for row in 0..rows {
            let (sink, distance) = self.shortest_augmenting_path(row, columns, cost);
            self.update_duals(row, distance);
            self.augment(row, sink);
        }
    }

    /// Dijkstra's search over reduced costs from the free `start` row to the nearest free column. Returns that column
    /// and its distance. One always exists, as costs are finite and there are at least as many columns as rows.
    fn shortest_augmenting_path(
        &mut self,
        start: usize,
        columns: usize,
        cost: &[f64],
    ) -> (usize, f64) {
        self.remaining.clear();
        // From the last column to the first: this order decides ties.
        self.remaining.extend((0..columns).rev());
        self.row_visited.fill(false);
        self.column_visited.fill(false);
        self.shortest.fill(f64::INFINITY);
        let mut row = start;
        let mut distance = 0.0;
        loop {
            self.row_visited[row] = true;
            let row_cost = &cost[row * columns..(row + 1) * columns];
            let row_dual = self.row_dual[row];
            let mut lowest = f64::INFINITY;
            let mut nearest = 0;
            for (index, &column) in self.remaining.iter().enumerate() {
                // The order of these operations also affects ties.
                let reduced = distance + row_cost[column] - row_dual - self.column_dual[column];
                if reduced < self.shortest[column] {
                    self.previous_row[column] = row;
                    self.shortest[column] = reduced;
                }
                let shortest = self.shortest[column];
                // Among equally near columns, a free one ends the search soonest.
                if shortest < lowest || (shortest == lowest && self.row_of_column[column] == NONE) {
                    lowest = shortest;
                    nearest = index;
                }
            }
            distance = lowest;
            let column = self.remaining.swap_remove(nearest);
            self.column_visited[column] = true;
            match self.row_of_column[column] {
                NONE => return (column, distance),
                next => row = next,
            }
        }
    }

    /// Keeps the reduced costs of the pairs zero and all others above it, as the next search needs.
    fn update_duals(&mut self, start: usize, distance: f64) {
        self.row_dual[start] += distance;
        for row in 0..self.row_dual.len() {
            if self.row_visited[row] && row != start {
                self.row_dual[row] += distance - self.shortest[self.column_of_row[row]];
            }
        }
        for column in 0..self.column_dual.len() {
            if self.column_visited[column] {
                self.column_dual[column] -= distance - self.shortest[column];
            }
        }
    }

    /// Flips the pairs along the path that ends in `sink`, so that one more row has a column.
    fn augment(&mut self, start: usize, sink: usize) {
        let mut column = sink;
        loop {
            let row = self.previous_row[column];
            self.row_of_column[column] = row;
            std::mem::swap(&mut self.column_of_row[row], &mut column);
            if row == start {
                return;
            }
        }
    }
}

fn refill<T: Copy>(buffer: &mut Vec<T>, length: usize, value: T) {
    buffer.clear();
    buffer.resize(length, value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rectangles with whole costs among them so that ties happen.
    fn matrices() -> impl Strategy<Value = (usize, usize, Vec<f64>)> {
        let side = || prop_oneof![1..=6usize, 1..=40usize];
        (side(), side(), any::<bool>()).prop_flat_map(|(rows, columns, whole)| {
            let cost = if whole {
                (0u8..4).prop_map(f64::from).boxed()
            } else {
                (-5.0..5.0).boxed()
            };
            let costs = prop::collection::vec(cost, rows * columns);
            costs.prop_map(move |costs| (rows, columns, costs))
        })
    }

    proptest! {
        /// `lsap` is a port of SciPy's solver, so the total cost is minimal, and even ties must agree.
        #[test]
        fn pairs_equal_those_of_scipy_even_with_ties((rows, columns, cost) in matrices()) {
            let mut solver = AssignmentSolver::default();
            // A used solver must answer as a fresh one.
            solver.solve(2, 3, &[1.0, 2.0, 3.0, 0.0, 0.0, 0.0]);
            let pairs = solver.solve(rows, columns, &cost);
            let (expected_rows, expected_columns) = lsap::solve(rows, columns, &cost, false).unwrap();
            let expected: Vec<_> = expected_rows.into_iter().zip(expected_columns).collect();
            prop_assert_eq!(pairs, &expected);
        }
    }

    #[test]
    fn an_empty_or_unsolvable_matrix_has_no_pairs() {
        let mut solver = AssignmentSolver::default();
        assert!(solver.solve(0, 5, &[]).is_empty());
        assert!(solver.solve(5, 0, &[]).is_empty());
        assert!(solver.solve(2, 2, &[0.0; 3]).is_empty());
        for cost in [f64::NAN, f64::INFINITY, -2.0 * LARGEST_COST] {
            assert!(solver.solve(1, 2, &[0.0, cost]).is_empty());
        }
    }
}
