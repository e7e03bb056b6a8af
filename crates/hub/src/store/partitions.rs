//! The partitions of PostgreSQL's tables: one for each day.

use super::{Database, StoreError};

/// A table that PostgreSQL partitions by day.
#[derive(Clone, Copy)]
pub(crate) struct DailyTable {
    name: &'static str,
    /// The units of its partition key per day.
    units_per_day: i64,
}

pub(crate) const CLIPS: DailyTable = DailyTable {
    name: "clips",
    units_per_day: 1,
};
pub(crate) const REPORT_IDS: DailyTable = DailyTable {
    name: "report_ids",
    units_per_day: 1,
};
pub(crate) const FIVE_MINUTE_SUMS: DailyTable = DailyTable {
    name: "sums_5m",
    units_per_day: 86_400,
};

/// Creates and drops partitions of a table in PostgreSQL; days before `first` are dropped.
pub(crate) fn keep_days(
    database: &mut dyn Database,
    table: DailyTable,
    first: i64,
    today: i64,
) -> Result<(), StoreError> {
    let values = [
        table.name.into(),
        table.units_per_day.into(),
        first.into(),
        today.into(),
    ];
    database.query("SELECT keep_days($1, $2, $3, $4)", &values)?;
    Ok(())
}
