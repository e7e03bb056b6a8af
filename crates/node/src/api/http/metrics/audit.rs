//! What the audit has found, as metrics: sums that add up over cameras and nodes, and each camera's rates.

use super::Snapshots;
use super::family::Page;
use albireo_wire::AuditRate;
use std::fmt;

/// Writes what the audit of each camera has counted.
pub(super) fn audit(page: &mut Page<'_>, cameras: &Snapshots<'_>) -> fmt::Result {
    let audited = || {
        let on = cameras.iter().filter(|(camera, _)| camera.audit_is_on());
        on.map(|(camera, snapshot)| (("camera", camera.name()), &snapshot.audit, snapshot))
    };
    page.counters(
        "audit_frames",
        "Skipped frames that were drawn, by what became of them: compared, or missed because the detector had no time",
        audited().flat_map(|(camera, audit, _)| {
            let results = [("compared", audit.sums.frames), ("missed", audit.sums.missed)];
            results.map(|(result, count)| (vec![camera, ("result", result)], count as f64))
        }),
    )?;
    page.counters(
        "audit_boxes",
        "Boxes of audited frames by side (detected: the detector's; shown: what had been published) and by result: paired \
         with one of the other side, or unpaired. Against the detector, not the truth",
        audited().flat_map(|(camera, audit, _)| {
            let sums = &audit.sums;
            let sides = [("detected", sums.detected), ("shown", sums.shown)];
            sides.into_iter().flat_map(move |(side, boxes)| {
                let unpaired = boxes.saturating_sub(sums.paired);
                [("paired", sums.paired), ("unpaired", unpaired)].map(|(result, count)| {
                    (vec![camera, ("side", side), ("result", result)], count as f64)
                })
            })
        }),
    )?;
    let ends = |camera, rate: Option<AuditRate>| {
        rate.into_iter().flat_map(move |rate| {
            let ends = [("rate", rate.rate), ("low", rate.low), ("high", rate.high)];
            ends.map(|(end, value)| (vec![camera, ("end", end)], value))
        })
    };
    page.gauges(
        "audit_recall",
        "Share of the detector's boxes on audited frames that had been shown, since the start, with the ends of its \
         interval at 95 %, missed frames included",
        audited().flat_map(|(camera, audit, _)| ends(camera, audit.sums.recall())),
    )?;
    page.gauges(
        "audit_precision",
        "Share of the shown boxes on audited frames that the detector confirms, since the start, with the ends of its \
         interval at 95 %, missed frames included; low where a policy shows objects that the detector misses",
        audited().flat_map(|(camera, audit, _)| ends(camera, audit.sums.precision())),
    )?;
    page.counters(
        "audit_detector_seconds",
        "Time the detector worked for the audit",
        audited().map(|(camera, audit, _)| (vec![camera], audit.detector_us as f64 / 1e6)),
    )?;
    page.counters(
        "audit_energy_joules",
        "Estimate of what the audit added in the clips that ended: its detector time times the watts that a running \
         detector adds; a part of camera_energy_joules",
        audited().map(|(camera, _, snapshot)| (vec![camera], snapshot.audit_joules)),
    )
}
