//! The node's target, as metrics: what is wanted, what is measured of it, and why the knob stands where it stands.

use super::family::family;
use crate::state::board::Board;
use albireo_wire::TargetStatus;
use prometheus_client::encoding::DescriptorEncoder;
use prometheus_client::metrics::MetricType;
use std::fmt;

/// Writes where the target stands; nothing of it while none is held.
pub(super) fn target(encoder: &mut DescriptorEncoder<'_>, board: &Board) -> fmt::Result {
    let report = board.target().report();
    let held = report.target;
    let state = report.state.filter(|_| held.is_some());
    family(
        encoder,
        "target",
        "What is held in the place of the knob's number, in its own unit; absent while nothing is",
        MetricType::Gauge,
        |family| {
            held.iter().try_for_each(|target| {
                family.gauge(vec![("target", target.name())], target.value())
            })
        },
    )?;
    family(
        encoder,
        "target_actual",
        "What is measured of the target; for recall the lower end of its interval. Absent before anything is",
        MetricType::Gauge,
        |family| {
            let actual = state.and_then(|state| state.actual);
            held.iter().zip(actual).try_for_each(|(target, actual)| {
                family.gauge(vec![("target", target.name())], actual)
            })
        },
    )?;
    family(
        encoder,
        "target_status",
        "Whether the target is met, and if not why: 1 for the status that holds, 0 for the others",
        MetricType::Gauge,
        |family| {
            state.iter().try_for_each(|state| {
                TargetStatus::ALL.into_iter().try_for_each(|status| {
                    let holds = u8::from(status == state.status);
                    family.gauge(vec![("status", status.name())], f64::from(holds))
                })
            })
        },
    )?;
    family(
        encoder,
        "target_unmet",
        "How often it began that the target could not be met inside the knob's range, since it was set",
        MetricType::Counter,
        |family| {
            (state.iter()).try_for_each(|state| family.counter(Vec::new(), state.unmet as f64))
        },
    )?;
    family(
        encoder,
        "target_unmet_seconds",
        "Time in which the target could not be met inside the knob's range, since it was set",
        MetricType::Counter,
        |family| {
            state
                .iter()
                .try_for_each(|state| family.counter(Vec::new(), state.unmet_s))
        },
    )
}
