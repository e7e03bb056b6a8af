//! Pairs rows with columns so that the sum of their scores is highest.

/// Returns the pairs of the best one-to-one assignment of `rows` to `columns`; `scores` are row by row. Scores are
/// finite, so a solution always exists.
pub(super) fn assign(
    rows: usize,
    columns: usize,
    scores: &Vec<f64>,
) -> impl Iterator<Item = (usize, usize)> {
    let for_the_highest_sum = true;
    let (assigned_rows, their_columns) =
        lsap::solve(rows, columns, scores, for_the_highest_sum).unwrap_or_default();
    assigned_rows.into_iter().zip(their_columns)
}
