//! What the node's readiness, its tasks, its screen and its meter's failures count.

use super::family::family;
use crate::state::board::Board;
use crate::state::readiness::PARTS;
use prometheus_client::encoding::DescriptorEncoder;
use prometheus_client::metrics::MetricType;
use std::fmt;

/// Writes whether each part works, and how often tasks failed.
pub(super) fn parts(encoder: &mut DescriptorEncoder<'_>, board: &Board) -> fmt::Result {
    let health = board.readiness().health();
    let help = "Whether a part works: 1, or 0 when /readyz has a reason for it";
    family(encoder, "part_working", help, MetricType::Gauge, |family| {
        PARTS.into_iter().try_for_each(|part| {
            let works = health.faults.iter().all(|fault| fault.part != part);
            family.gauge(vec![("part", part)], i64::from(works))
        })
    })?;
    let tasks = board.tasks().counts();
    let help = "Times a task of the node panicked, failed or ended without being told to";
    family(
        encoder,
        "task_failures",
        help,
        MetricType::Counter,
        |family| {
            (tasks.iter()).try_for_each(|(task, counts)| {
                family.counter(vec![("task", task)], counts.failures as f64)
            })
        },
    )?;
    let help = "Times a task of the node was started anew";
    family(
        encoder,
        "task_restarts",
        help,
        MetricType::Counter,
        |family| {
            (tasks.iter()).try_for_each(|(task, counts)| {
                family.counter(vec![("task", task)], counts.restarts as f64)
            })
        },
    )
}

/// Writes what the screen has counted.
pub(super) fn screen(encoder: &mut DescriptorEncoder<'_>, board: &Board) -> fmt::Result {
    let screen = board.screen_counters();
    let help = "Pictures given to the empty-scene screen, by what became of them";
    family(
        encoder,
        "screen_runs",
        help,
        MetricType::Counter,
        |family| {
            [
                ("completed", screen.completed),
                ("timed_out", screen.timed_out),
                ("failed", screen.failed),
                ("panicked", screen.panicked),
                ("refused", screen.refused),
                ("cancelled", screen.cancelled),
            ]
            .into_iter()
            .try_for_each(|(outcome, count)| {
                family.counter(vec![("outcome", outcome)], count as f64)
            })
        },
    )?;
    let help = "Sessions of the screen built again after a failure, by outcome";
    family(
        encoder,
        "screen_rebuilds",
        help,
        MetricType::Counter,
        |family| {
            [
                ("completed", screen.rebuilds),
                ("failed", screen.rebuilds_failed),
            ]
            .into_iter()
            .try_for_each(|(outcome, count)| {
                family.counter(vec![("outcome", outcome)], count as f64)
            })
        },
    )
}
