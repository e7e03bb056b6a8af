//! The node itself as metrics: what runs, whether its parts work, its outbox, its power.

use super::super::health::provider;
use super::family::Page;
use crate::state::board::Board;
use crate::state::readiness::PARTS;
use albireo_vision::detector::DetectorStatus;
use albireo_wire::EnergyQuality;
use std::fmt;

fn flag(on: bool) -> f64 {
    f64::from(u8::from(on))
}

/// Writes what runs, and whether its parts work.
pub(super) fn node(page: &mut Page<'_>, board: &Board) -> fmt::Result {
    let (status, health) = (board.detector_status(), board.readiness().health());
    let version = ("version", env!("CARGO_PKG_VERSION"));
    page.gauges(
        "build_info",
        "The program that runs, always 1",
        [(vec![version, ("node", board.node())], 1.0)],
    )?;
    page.gauge(
        "uptime_seconds",
        "Time since the node started",
        board.uptime().as_secs_f64(),
    )?;
    page.gauge(
        "ready",
        "Whether the node works as configured",
        flag(health.is_ready()),
    )?;
    page.gauge(
        "detector_ready",
        "Whether the detector works",
        flag(matches!(status, DetectorStatus::Ready { .. })),
    )?;
    let facts = board.detector_facts();
    let (wanted, runs) = (facts.requested.first(), provider(&status));
    let fell_back = runs.is_some_and(|runs| wanted.is_some_and(|wanted| wanted.as_str() != runs));
    page.gauge(
        "detector_fallback",
        "Whether another execution provider runs the detector than the first that is configured",
        flag(fell_back),
    )?;
    let labels = vec![
        ("model", facts.model.as_str()),
        ("provider", runs.unwrap_or("none")),
        ("policy", board.policy()),
    ];
    page.gauges(
        "detector_info",
        "The detector's model and the execution provider that really runs it, always 1",
        [(labels, 1.0)],
    )?;
    page.gauges(
        "part_working",
        "Whether a part works: 1, or 0 when /readyz has a reason for it",
        PARTS.into_iter().map(|part| {
            let works = health.faults.iter().all(|fault| fault.part != part);
            (vec![("part", part)], flag(works))
        }),
    )?;
    let tasks = board.tasks().counts();
    page.counters(
        "task_failures",
        "Times a task of the node panicked, failed or ended before the shutdown",
        (tasks.iter()).map(|(task, counts)| (vec![("task", &**task)], counts.failures as f64)),
    )?;
    page.counters(
        "task_restarts",
        "Times a task of the node was restarted",
        (tasks.iter()).map(|(task, counts)| (vec![("task", &**task)], counts.restarts as f64)),
    )
}

/// Writes the counts of the outbox.
pub(super) fn outbox(page: &mut Page<'_>, board: &Board) -> fmt::Result {
    let counts = board.outbox().counts();
    for (name, help, value) in [
        (
            "outbox_waiting",
            "Clip reports that no hub has acknowledged",
            counts.waiting,
        ),
        (
            "outbox_in_memory",
            "Of these, reports that are not on disk",
            counts.in_memory,
        ),
        (
            "outbox_again",
            "Clip reports that a hub lost, to be sent again",
            counts.again,
        ),
        (
            "outbox_durable",
            "Whether clip reports survive a power loss",
            u64::from(counts.durable),
        ),
    ] {
        page.gauge(name, help, value as f64)?;
    }
    for (name, help, value) in [
        ("outbox_kept", "Clip reports taken in", counts.kept),
        (
            "outbox_acknowledged",
            "Clip reports that a hub has acknowledged",
            counts.acknowledged,
        ),
        (
            "outbox_lost",
            "Clip reports lost: the outbox was full or its disk broken",
            counts.lost,
        ),
        (
            "outbox_undeliverable",
            "Clip reports that a hub refused for good, or that could not be read",
            counts.undeliverable,
        ),
        (
            "outbox_disk_failures",
            "Times the state directory failed",
            counts.disk_failures,
        ),
    ] {
        page.counter(name, help, value as f64)?;
    }
    Ok(())
}

/// Writes power and energy.
pub(super) fn power(page: &mut Page<'_>, board: &Board) -> fmt::Result {
    let power = board.power();
    let source = ("source", power.source.as_str());
    let quality = match power.quality {
        EnergyQuality::Measured => "measured",
        EnergyQuality::Partial => "partial",
        EnergyQuality::Estimated => "estimated",
        EnergyQuality::Unavailable => "unavailable",
    };
    page.gauges(
        "power_info",
        "Whether power is measured or estimated now, or unavailable: always 1",
        [(vec![source, ("quality", quality)], 1.0)],
    )?;
    page.gauges(
        "power_watts",
        "Power now; `power_info` says whether it is measured or estimated",
        (power.watts.iter()).map(|now| (vec![("domain", &*now.domain), source], now.watts)),
    )?;
    page.counters(
        "energy_joules",
        "Energy since the node started, over the time that samples cover; `power_info` says whether it is measured or \
         estimated",
        (power.joules.iter()).map(|(domain, joules)| (vec![("domain", domain.as_str()), source], *joules)),
    )?;
    page.counters(
        "energy_covered_seconds",
        "Time that samples of power cover since the node started: `energy_joules` divided by it is the mean power",
        (power.covered_s.iter())
            .map(|(domain, seconds)| (vec![("domain", domain.as_str()), source], *seconds)),
    )?;
    if let Some((sensor, celsius)) = &power.hottest {
        page.gauges(
            "temperature_celsius",
            "The machine's hottest sensor",
            [(vec![("sensor", sensor.as_str())], *celsius)],
        )?;
    }
    page.counters(
        "power_failed_reads",
        "Times the power source could not be read",
        [(vec![source], power.failed_reads as f64)],
    )?;
    page.counters(
        "power_meter_cpu_seconds",
        "CPU time spent on reading the power source",
        [(vec![source], power.cost.cpu.as_secs_f64())],
    )
}
