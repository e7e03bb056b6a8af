//! The optimal assignment of rows to columns at minimum total cost, for any rectangle.
//!
//! The shortest augmenting path algorithm (D. F. Crouse, "On implementing 2D rectangular assignment algorithms", IEEE
//! Transactions on Aerospace and Electronic Systems 52(4), 2016), with the search order, tie-breaking and transposition
//! of tall matrices of SciPy's `linear_sum_assignment`. The published code uses that function, so its traces can only
//! be reproduced with the same ties.

/// Largest magnitude of a cost, so that sums of costs do not overflow.
pub(crate) const LARGEST_COST: f64 = 1e100;

const NONE: usize = usize::MAX;

/// A row of the matrix.
#[derive(Clone, Copy, Debug)]
struct RowState {
    dual: f64,
    /// The column that it is paired with.
    column: usize,
}

/// A column of the matrix.
#[derive(Clone, Copy, Debug)]
struct ColumnState {
    dual: f64,
    /// The row that it is paired with.
    row: usize,
    /// The shortest distance that the search has found so far, and the row before the column on that path.
    shortest: f64,
    previous_row: usize,
}

/// The solver with its buffers, which are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct AssignmentSolver {
    transposed_cost: Vec<f64>,
    rows: Vec<RowState>,
    columns: Vec<ColumnState>,
    /// The columns that the search has not reached, and those that it has, in order.
    remaining: Vec<usize>,
    reached: Vec<usize>,
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
            let assigned = self.rows.iter().enumerate();
            self.pairs.extend(assigned.map(|(row, paired)| (paired.column, row)));
            self.pairs.sort_unstable();
        } else {
            self.assign(rows, columns, cost);
            let assigned = self.rows.iter().enumerate();
            self.pairs.extend(assigned.map(|(row, paired)| (row, paired.column)));
        }
        &self.pairs
    }

    /// Pairs every row with a column, for a matrix with at least as many columns as rows.
    fn assign(&mut self, rows: usize, columns: usize, cost: &[f64]) {
        let row = RowState {
            dual: 0.0,
            column: NONE,
        };
        let column = ColumnState {
            dual: 0.0,
            row: NONE,
            shortest: f64::INFINITY,
            previous_row: NONE,
        };
        self.rows.clear();
        self.rows.resize(rows, row);
        self.columns.clear();
        self.columns.resize(columns, column);
        for row in 0..rows {
            let (sink, distance) = self.shortest_augmenting_path(row, cost);
            self.update_duals(row, distance);
            self.augment(row, sink);
        }
    }

    /// Dijkstra's search over reduced costs from the free `start` row to the nearest free column. Returns that column
    /// and its distance. One always exists, as costs are finite and there are at least as many columns as rows.
    fn shortest_augmenting_path(&mut self, start: usize, cost: &[f64]) -> (usize, f64) {
        let columns = self.columns.len();
        self.remaining.clear();
        // From the last column to the first: this order decides ties.
        self.remaining.extend((0..columns).rev());
        self.reached.clear();
        for column in &mut self.columns {
            column.shortest = f64::INFINITY;
        }
        let mut row = start;
        let mut distance = 0.0;
        loop {
            let row_cost = &cost[row * columns..(row + 1) * columns];
            let row_dual = self.rows[row].dual;
            let mut lowest = f64::INFINITY;
            let mut nearest = 0;
            for (index, &place) in self.remaining.iter().enumerate() {
                let column = &mut self.columns[place];
                // The order of these operations also affects ties.
                let reduced = distance + row_cost[place] - row_dual - column.dual;
                if reduced < column.shortest {
                    column.previous_row = row;
                    column.shortest = reduced;
                }
                // Among equally near columns, a free one ends the search soonest.
                let is_free = column.row == NONE;
                if column.shortest < lowest || (column.shortest == lowest && is_free) {
                    lowest = column.shortest;
                    nearest = index;
                }
            }
            distance = lowest;
            let column = self.remaining.swap_remove(nearest);
            self.reached.push(column);
            match self.columns[column].row {
                NONE => return (column, distance),
                next => row = next,
            }
        }
    }

    /// Keeps the reduced costs of the pairs zero and all others above it, as the next search needs.
    fn update_duals(&mut self, start: usize, distance: f64) {
        self.rows[start].dual += distance;
        for &column in &self.reached {
            let column = &mut self.columns[column];
            let lead = distance - column.shortest;
            column.dual -= lead;
            // The search went on from the column's row, and ended at the one without.
            if column.row != NONE {
                self.rows[column.row].dual += lead;
            }
        }
    }

    /// Flips the pairs along the path that ends in `sink`, so that one more row has a column.
    fn augment(&mut self, start: usize, sink: usize) {
        let mut column = sink;
        loop {
            let row = self.columns[column].previous_row;
            self.columns[column].row = row;
            std::mem::swap(&mut self.rows[row].column, &mut column);
            if row == start {
                return;
            }
        }
    }
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
