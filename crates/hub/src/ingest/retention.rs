//! Deletes old rows: whole days in PostgreSQL, else a few rows at a time, so that the thread that writes never waits
//! long.

use crate::config::HistoryConfig;
use crate::store::{
    CLIPS, Database, DatabaseKind, FIVE_MINUTE_SUMS, REPORT_IDS, StoreError, keep_days, statements,
};
use albireo_service::clock::DAY_MS;
use albireo_wire::IDENTITY_DAYS;

/// Most rows that a statement deletes.
const STEP: usize = 1000;

/// Earlier than any day of a row.
const NO_DAY: i64 = -1_000_000;

/// Deletes at most [`STEP`] rows of each of a room's tables that are older than the day (since the Unix epoch) up to which
/// events and revisions are kept. Returns the largest number of rows of one table.
pub(crate) type DeleteOld = fn(&mut dyn Database, i64) -> Result<usize, StoreError>;

/// Deletes at most [`STEP`] rows of each table that are too old at `now_ms`, and whole partitions. If the clock is not
/// believed (`is_believed`), it only creates the partitions of the next days. Returns true if there are more old rows.
pub(crate) fn retain(
    database: &mut dyn Database,
    history: &HistoryConfig,
    delete_more: Option<DeleteOld>,
    now_ms: i64,
    is_believed: bool,
) -> Result<bool, StoreError> {
    let today = now_ms.div_euclid(DAY_MS);
    let first = |days: u32| {
        if is_believed {
            today - i64::from(days)
        } else {
            NO_DAY
        }
    };
    // One day more, because a report of the day before is still accepted.
    let clips = first(history.clips_days);
    let ids = first(IDENTITY_DAYS + 1);
    let sums = first(history.five_minutes_days);
    if database.kind() == DatabaseKind::Postgres {
        // Creating or dropping a partition locks its table for a moment. Each table has its own transaction, so that
        // none waits for one table while holding another.
        for (table, first) in [(CLIPS, clips), (REPORT_IDS, ids), (FIVE_MINUTE_SUMS, sums)] {
            database.begin()?;
            // A long read delays the drop of a partition, and a waiting drop blocks everything else.
            database.query("SET LOCAL lock_timeout TO '1s'", &[])?;
            keep_days(database, table, first, today)?;
            database.commit()?;
        }
    }
    let events = first(history.events_days);
    let aside = first(history.set_aside_days);
    let days = match database.kind() {
        DatabaseKind::Sqlite => include_str!("sql/delete_days_sqlite.sql"),
        DatabaseKind::Postgres => include_str!("sql/delete_days_postgres.sql"),
    };
    let others = include_str!("sql/delete_old.sql");
    database.begin()?;
    let in_days = delete(database, days, &[clips, ids, ids, sums])?;
    let in_others = delete(database, others, &[events, aside])?;
    let mut most = in_days.max(in_others);
    if let Some(delete_more) = delete_more {
        let in_room = delete_more(database, events)?;
        most = most.max(in_room);
    }
    database.commit()?;
    Ok(most >= STEP)
}

/// Runs the statements of a file, each with its first day to keep. Returns the largest number of rows that one deleted.
fn delete(
    database: &mut dyn Database,
    file: &str,
    first_days: &[i64],
) -> Result<usize, StoreError> {
    let mut most = 0;
    for (statement, first) in statements(file).iter().zip(first_days) {
        let gone = database.query(statement, &[(*first).into()])?;
        most = most.max(gone.len());
    }
    Ok(most)
}
