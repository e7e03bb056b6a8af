//! The detector's counters as metrics.

use super::family::family;
use albireo_vision::detector::DetectorCounts;
use prometheus_client::encoding::DescriptorEncoder;
use prometheus_client::metrics::MetricType;
use std::fmt;

/// Writes what the detector has counted.
pub(super) fn detector(
    encoder: &mut DescriptorEncoder<'_>,
    counters: &DetectorCounts,
) -> fmt::Result {
    let worker = &counters.worker;
    let head = &counters.head;
    family(
        encoder,
        "detector_batches",
        "Runs of the model that ended well: fewer than completed pictures where cameras share a run",
        MetricType::Counter,
        |family| family.counter(Vec::new(), worker.batches as f64),
    )?;
    family(
        encoder,
        "detector_queue",
        "Pictures that wait for the detector",
        MetricType::Gauge,
        |family| {
            let waiting = i64::try_from(worker.waiting).unwrap_or(i64::MAX);
            family.gauge(Vec::new(), waiting)
        },
    )?;
    family(
        encoder,
        "detector_audit_runs",
        "Pictures that the detector looked at for the audit, after their frames were answered; not among detector_runs",
        MetricType::Counter,
        |family| family.counter(Vec::new(), worker.spare as f64),
    )?;
    for (name, help, label, counts) in [
        (
            "detector_runs",
            "Pictures given to the detector, by what became of them",
            "outcome",
            &[
                ("completed", worker.completed),
                ("timed_out", worker.timed_out),
                ("failed", worker.failed),
                ("panicked", worker.panicked),
                ("refused", worker.refused),
                ("cancelled", worker.cancelled),
            ][..],
        ),
        (
            "detector_rebuilds",
            "Sessions built again after a failure, by outcome",
            "outcome",
            &[
                ("completed", worker.rebuilds),
                ("failed", worker.rebuilds_failed),
            ],
        ),
        (
            "detector_boxes_dropped",
            "Boxes in the model's output that were not reported, by reason",
            "reason",
            &[
                ("impossible", head.rejected),
                ("outside", head.outside),
                ("unknown_class", head.unknown_class),
                ("over_limit", head.over_limit),
            ],
        ),
    ] {
        family(encoder, name, help, MetricType::Counter, |family| {
            counts
                .iter()
                .try_for_each(|&(value, count)| family.counter(vec![(label, value)], count as f64))
        })?;
    }
    Ok(())
}
