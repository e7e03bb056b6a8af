//! Pairs rows with columns so that the sum of their scores is highest.

/// Returns the pairs of the best one-to-one assignment of `rows` to `columns`; `scores` are row by row. Scores are finite,
/// so a solution always exists.
pub(super) fn assign(
    rows: usize,
    columns: usize,
    scores: &Vec<f64>,
) -> impl Iterator<Item = (usize, usize)> {
    let (rows, columns) = lsap::solve(rows, columns, scores, true).unwrap_or_default();
    rows.into_iter().zip(columns)
}
