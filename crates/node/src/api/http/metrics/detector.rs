//! What the detector and the empty-scene screen have counted, as metrics.

use super::family::Page;
use crate::state::board::Board;
use std::fmt;

/// Writes the counters of both.
pub(super) fn detector(page: &mut Page<'_>, board: &Board) -> fmt::Result {
    let counts = board.detector_counters();
    let (worker, head) = (&counts.worker, &counts.head);
    page.counter(
        "detector_batches",
        "Runs of the model that ended well: fewer than completed pictures where cameras share a run",
        worker.batches as f64,
    )?;
    page.gauge(
        "detector_queue",
        "Pictures that wait for the detector",
        worker.waiting as f64,
    )?;
    page.counter(
        "detector_audit_runs",
        "Pictures that the detector ran on for the audit, after their frames were answered; not among detector_runs",
        worker.spare as f64,
    )?;
    let dropped = [
        ("impossible", head.rejected),
        ("outside", head.outside),
        ("unknown_class", head.unknown_class),
        ("over_limit", head.over_limit),
    ];
    page.counters(
        "detector_boxes_dropped",
        "Boxes in the model's output that were not reported, by reason",
        dropped.map(|(reason, count)| (vec![("reason", reason)], count as f64)),
    )?;
    let screen = board.screen_counters();
    for (prefix, what, counts) in [
        ("detector", "detector", &counts.worker),
        ("screen", "empty-scene screen", &screen),
    ] {
        let runs = [
            ("completed", counts.completed),
            ("timed_out", counts.timed_out),
            ("failed", counts.failed),
            ("panicked", counts.panicked),
            ("refused", counts.refused),
            ("cancelled", counts.cancelled),
        ];
        page.counters(
            &format!("{prefix}_runs"),
            &format!("Pictures given to the {what}, by what became of them"),
            runs.map(|(outcome, count)| (vec![("outcome", outcome)], count as f64)),
        )?;
        let rebuilds = [
            ("completed", counts.rebuilds),
            ("failed", counts.rebuilds_failed),
        ];
        page.counters(
            &format!("{prefix}_rebuilds"),
            &format!("Sessions of the {what} built again after a failure, by outcome"),
            rebuilds.map(|(outcome, count)| (vec![("outcome", outcome)], count as f64)),
        )?;
    }
    Ok(())
}
