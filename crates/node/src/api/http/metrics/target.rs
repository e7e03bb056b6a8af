//! The node's target, as metrics: what is wanted, what is measured of it, and whether it is met.

use super::family::Page;
use crate::state::board::Board;
use albireo_wire::TargetStatus;
use std::fmt;

/// Writes the state of the target; nothing of it while there is none.
pub(super) fn target(page: &mut Page<'_>, board: &Board) -> fmt::Result {
    let report = board.target().report();
    let target = report.target;
    let state = report.state.filter(|_| target.is_some());
    let label = || target.iter().map(|target| vec![("target", target.name())]);
    page.gauges(
        "target",
        "What is held instead of a fixed threshold, in its own unit; absent while nothing is",
        label().zip(target.map(|target| target.value())),
    )?;
    page.gauges(
        "target_actual",
        "What is measured of the target; for recall the lower end of its interval. Absent before anything is",
        label().zip(state.and_then(|state| state.actual)),
    )?;
    page.gauges(
        "target_status",
        "Whether the target is met, and if not why: 1 for the status that holds, 0 for the others",
        state.iter().flat_map(|state| {
            TargetStatus::ALL.into_iter().map(|status| {
                let holds = u8::from(status == state.status);
                (vec![("status", status.name())], f64::from(holds))
            })
        }),
    )?;
    page.counters(
        "target_unmet",
        "How often it began that the target could not be met inside the knob's range, since it was set",
        state.map(|state| (Vec::new(), state.unmet as f64)),
    )?;
    page.counters(
        "target_unmet_seconds",
        "Time in which the target could not be met inside the knob's range, since it was set",
        state.map(|state| (Vec::new(), state.unmet_s)),
    )
}
