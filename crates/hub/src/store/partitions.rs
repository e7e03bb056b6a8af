//! The partitions of PostgreSQL's tables: one for each day.

use super::{Database, StoreError};

/// The tables that PostgreSQL partitions by day, and the units of their keys per day.
pub(crate) const DAILY: [(&str, i64); 3] = [("clips", 1), ("report_ids", 1), ("sums_5m", 86_400)];

/// Creates and drops partitions of a table in PostgreSQL; days before `first` are dropped.
pub(crate) fn keep_days(
    database: &mut dyn Database,
    (table, unit): (&str, i64),
    first: i64,
    today: i64,
) -> Result<(), StoreError> {
    let values = [table.into(), unit.into(), first.into(), today.into()];
    let kept = database.query("SELECT keep_days($1, $2, $3, $4)", &values);
    kept.map(drop)
}
