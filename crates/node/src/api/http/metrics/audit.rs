//! What the audit has found, as metrics: sums that add up over cameras and nodes, and each camera's rates.

use super::Snapshots;
use super::family::family;
use albireo_wire::{AuditRate, AuditSums};
use prometheus_client::encoding::DescriptorEncoder;
use prometheus_client::metrics::MetricType;
use std::fmt;

/// A rate of the sums, and what it is called.
type RateOf = (
    &'static str,
    &'static str,
    fn(&AuditSums) -> Option<AuditRate>,
);

/// Writes what the audit of each camera has counted.
pub(super) fn audit(encoder: &mut DescriptorEncoder<'_>, cameras: &Snapshots<'_>) -> fmt::Result {
    let audited = || {
        let on = cameras.iter().filter(|(camera, _)| camera.audit_is_on());
        on.map(|(camera, snapshot)| (camera.name(), snapshot))
    };
    family(
        encoder,
        "audit_frames",
        "Skipped frames that were drawn, by what became of them: compared, or missed because the detector had no time",
        MetricType::Counter,
        |family| {
            audited().try_for_each(|(camera, snapshot)| {
                let sums = &snapshot.audit.sums;
                [("compared", sums.frames), ("missed", sums.missed)]
                    .into_iter()
                    .try_for_each(|(result, count)| {
                        family.counter(vec![("camera", camera), ("result", result)], count as f64)
                    })
            })
        },
    )?;
    family(
        encoder,
        "audit_boxes",
        "Boxes of audited frames by side (detected: the detector's; shown: what had been published) and by result: paired \
         with one of the other side, or unpaired. Against the detector, not the truth",
        MetricType::Counter,
        |family| {
            audited().try_for_each(|(camera, snapshot)| {
                let sums = &snapshot.audit.sums;
                [("detected", sums.detected), ("shown", sums.shown)]
                    .into_iter()
                    .flat_map(|(side, boxes)| {
                        let unpaired = boxes.saturating_sub(sums.paired);
                        [(side, "paired", sums.paired), (side, "unpaired", unpaired)]
                    })
                    .try_for_each(|(side, result, count)| {
                        let labels = vec![("camera", camera), ("side", side), ("result", result)];
                        family.counter(labels, count as f64)
                    })
            })
        },
    )?;
    let rates: [RateOf; 2] = [
        (
            "audit_recall",
            "Share of the detector's boxes on audited frames that had been shown, since the start, with the ends of its \
             interval at 95 %, missed frames included",
            AuditSums::recall,
        ),
        (
            "audit_precision",
            "Share of the shown boxes on audited frames that the detector confirms, since the start, with the ends of its \
             interval at 95 %, missed frames included; low where a policy shows objects that the detector misses",
            AuditSums::precision,
        ),
    ];
    for (name, help, rate) in rates {
        family(encoder, name, help, MetricType::Gauge, |family| {
            audited().try_for_each(|(camera, snapshot)| {
                let Some(rate) = rate(&snapshot.audit.sums) else {
                    return Ok(());
                };
                [("rate", rate.rate), ("low", rate.low), ("high", rate.high)]
                    .into_iter()
                    .try_for_each(|(end, value)| {
                        family.gauge(vec![("camera", camera), ("end", end)], value)
                    })
            })
        })?;
    }
    family(
        encoder,
        "audit_detector_seconds",
        "Time the detector worked for the audit",
        MetricType::Counter,
        |family| {
            audited().try_for_each(|(camera, snapshot)| {
                let seconds = snapshot.audit.detector_us as f64 / 1e6;
                family.counter(vec![("camera", camera)], seconds)
            })
        },
    )?;
    family(
        encoder,
        "audit_energy_joules",
        "Estimate of what the audit added in the clips that ended: its detector time times the watts that a running detector adds; a part of camera_energy_joules",
        MetricType::Counter,
        |family| {
            audited().try_for_each(|(camera, snapshot)| {
                family.counter(vec![("camera", camera)], snapshot.audit_joules)
            })
        },
    )
}
