//! Deletes what is too old, a small range at a time, so that the thread that writes never waits long for it.

use super::StoreError;
use super::database::Transaction;
use crate::config::HistoryConfig;
use albireo_wire::IDENTITY_DAYS;

/// Most rows of one step.
pub(crate) const STEP: i64 = 2000;

const DAY_MS: i64 = 86_400_000;

/// Deletes at most [`STEP`] rows of each table that are older than is kept at `now_ms`; how many it were. 0: there is
/// nothing more to delete.
pub(crate) fn retain(
    writing: &mut dyn Transaction,
    history: &HistoryConfig,
    now_ms: i64,
) -> Result<u64, StoreError> {
    let before = |days: u32| now_ms.saturating_sub(i64::from(days) * DAY_MS);
    // Reports of the day before are still taken.
    let first_day = now_ms.div_euclid(DAY_MS) - i64::from(IDENTITY_DAYS) - 1;
    let mut deleted = 0;
    for (text, bound) in [
        (
            "DELETE FROM clips WHERE id IN (SELECT id FROM clips WHERE received_ms < $1 \
             AND id < (SELECT COALESCE(min(id), 0) FROM clips) + $2)",
            before(history.clips_days),
        ),
        (
            "DELETE FROM report_ids WHERE (day, id) IN (SELECT day, id FROM report_ids WHERE day > 0 AND day < $1 \
             ORDER BY day LIMIT $2)",
            first_day,
        ),
        // Those without a day of their own are under that of receipt, negative.
        (
            "DELETE FROM report_ids WHERE (day, id) IN (SELECT day, id FROM report_ids WHERE day < 0 AND day > $1 \
             ORDER BY day LIMIT $2)",
            -first_day,
        ),
        (
            "DELETE FROM sums_5m WHERE (bucket_s, camera_id, setup_id, quality) IN (SELECT bucket_s, camera_id, \
             setup_id, quality FROM sums_5m WHERE bucket_s < $1 ORDER BY bucket_s LIMIT $2)",
            before(history.five_minutes_days).div_euclid(1000),
        ),
        (
            "DELETE FROM events WHERE id IN (SELECT id FROM events WHERE at_ms < $1 \
             AND id < (SELECT COALESCE(min(id), 0) FROM events) + $2)",
            before(history.events_days),
        ),
        // What is desired stays: a node that returns after years still finds it.
        (
            "DELETE FROM order_nodes WHERE (revision, node) IN (SELECT n.revision, n.node FROM order_nodes n \
             JOIN orders o ON o.revision = n.revision WHERE o.at_ms < $1 ORDER BY 1, 2 LIMIT $2)",
            before(history.events_days),
        ),
        (
            "DELETE FROM orders WHERE revision IN (SELECT o.revision FROM orders o WHERE o.at_ms < $1 \
             AND NOT EXISTS (SELECT 1 FROM order_nodes n WHERE n.revision = o.revision) LIMIT $2)",
            before(history.events_days),
        ),
        (
            "DELETE FROM set_aside WHERE id IN (SELECT id FROM set_aside WHERE received_ms < $1 \
             AND id < (SELECT COALESCE(min(id), 0) FROM set_aside) + $2)",
            before(history.set_aside_days),
        ),
    ] {
        deleted += writing.execute(text, &[bound.into(), STEP.into()])?;
    }
    Ok(deleted)
}
