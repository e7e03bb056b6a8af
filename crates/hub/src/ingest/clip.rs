//! A report as the row of a clip: figures in whole microjoules, microseconds and parts per million, each checked.

use super::plan::Present;
use crate::store::row::text;
use crate::store::tables::{ClipRow, SetupKey};
use albireo_wire::{AuditReport, ClipEnd, ClipReport, EnergyQuality};

/// Largest energy of a clip, joules: about 3 kWh.
const MOST_JOULES: f64 = 1e7;
/// Longest time of all calls or frames of a clip, microseconds.
const MOST_TIME_US: i64 = 1_000_000_000_000;
/// Longest clip and latency, seconds.
const MOST_SECONDS: f64 = 86_400.0;
/// Most that an audit sums up in a clip: squares, overlaps in millionths.
const MOST_AUDITED: i64 = 10_000_000_000_000;
/// Most frames of a clip, and of any other count.
const MOST_COUNT: u64 = 10_000_000;
/// The range of an energy-delay product: its square is no number that a database refuses.
const EDP: std::ops::RangeInclusive<f64> = 1e-9..=1e12;
/// Longest text, bytes.
const LONGEST_TEXT: usize = 256;
/// A clip that began later than this after it was received has a clock that is off, milliseconds.
const FUTURE_MS: i64 = 3_600_000;
/// A clip that began earlier than this before it was received, too.
const PAST_MS: i64 = 400 * 86_400_000;

/// The time that a clip is filed under, milliseconds since the Unix epoch, and whether it is the node's own.
pub(crate) fn filed_under(started_ns: u64, present: Present) -> (i64, bool) {
    let now_ms = present.hub_ms;
    let started_ms = i64::try_from(started_ns / 1_000_000).unwrap_or(i64::MAX);
    let believable = (now_ms - PAST_MS..=now_ms.saturating_add(FUTURE_MS)).contains(&started_ms);
    if believable && present.clocks_agree() {
        (started_ms, true)
    } else {
        (now_ms, false)
    }
}

/// The code of an energy quality in the database.
pub(crate) const fn quality_code(quality: EnergyQuality) -> i64 {
    match quality {
        EnergyQuality::Measured => 0,
        EnergyQuality::Partial => 1,
        EnergyQuality::Estimated => 2,
        EnergyQuality::Unavailable => 3,
    }
}

/// What a report says, before its names have numbers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClipRecord {
    pub(crate) camera: String,
    pub(crate) setup: SetupKey,
    /// Its day, camera and setup are 0.
    pub(crate) row: ClipRow,
    /// Whether the node's clock is believed.
    pub(crate) clock: bool,
}

/// Reads the figures of a report.
///
/// # Errors
/// Which figure cannot be, in words: the report is then set aside.
pub(crate) fn record(report: &ClipReport, present: Present) -> Result<ClipRecord, String> {
    let (at_ms, clock) = filed_under(report.started_ns, present);
    let energy = &report.energy;
    let (total, detector) = (&report.total_latency_ms, &report.detector_latency_ms);
    let states = &report.states;
    let frames = count("frames", report.frames)?;
    let added = [states.e, states.p, states.ei, states.i, states.ai]
        .into_iter()
        .try_fold(0_u64, u64::checked_add);
    if added != Some(report.frames) {
        return Err(format!(
            "frames is {frames}, and the five states add up to {added:?}"
        ));
    }
    let detector_calls = count("detector_latency_ms.count", detector.count)?;
    let detector_mean_us = micro(
        "detector_latency_ms.mean",
        detector.mean / 1e3,
        MOST_SECONDS,
    )?;
    let latencies = count("total_latency_ms.count", total.count)?;
    let latency_mean_us = micro("total_latency_ms.mean", total.mean / 1e3, MOST_SECONDS)?;
    let duration_us = micro("duration_s", report.duration_s, MOST_SECONDS)?;
    let degraded = count("degraded_frames", report.degraded_frames)?;
    let avoided_calls = (count("E", states.e)? + count("P", states.p)? - degraded).max(0);
    let joules = |name: &str, joules: Option<f64>| {
        joules
            .map(|joules| micro(name, joules, MOST_JOULES))
            .transpose()
    };
    let energy_uj = joules("energy.joules", energy.joules)?;
    let node_uj = joules("energy.node_joules", energy.node_joules)?;
    // A domain is the whole node's; the clip has the same share of it as of the total.
    let share = match (energy.joules, energy.node_joules) {
        (Some(own), Some(node)) if node > 0.0 => (own / node).clamp(0.0, 1.0),
        _ => 1.0,
    };
    let domain = |name: &str| {
        let found = energy.domains.iter().find(|domain| domain.domain == name);
        joules(name, found.map(|domain| domain.joules * share))
    };
    // Without a price where the node does not know what a call costs.
    let avoided_uj = joules(
        "energy.saved_joules_estimated",
        energy.saved_joules_estimated,
    )?
    .or((avoided_calls == 0).then_some(0));
    let product = |mean_us: i64, count: i64| {
        mean_us
            .checked_mul(count)
            .filter(|product| *product <= MOST_TIME_US)
            .ok_or_else(|| "a mean latency times its count is too large".to_owned())
    };
    let edp = energy.edp.filter(|edp| EDP.contains(edp));
    let audit = |name: &str, count: fn(&AuditReport) -> u64| {
        let count = report.audit.as_ref().map(count);
        count.map(|count| audited(name, count)).transpose()
    };
    let sums = |audit: &AuditReport| (audit.sums.paired, audit.sums.detected.min(audit.sums.shown));
    if (report.audit.as_ref().map(sums)).is_some_and(|(pairs, boxes)| pairs > boxes) {
        return Err("audit: more pairs than boxes".to_owned());
    }
    let audit_uj = joules(
        "audit.joules",
        report.audit.as_ref().and_then(|audit| audit.joules),
    )?;
    let row = ClipRow {
        day: 0,
        report_id: report.id,
        count: report.count.and_then(|count| i64::try_from(count).ok()),
        camera_id: 0,
        setup_id: 0,
        at_ms,
        received_ms: present.hub_ms,
        started_ns: i64::try_from(report.started_ns).unwrap_or(i64::MAX),
        clip: name("clip", &report.clip)?,
        part: report.part.into(),
        ended_by: match report.ended_by {
            ClipEnd::NextClip => "next_clip",
            ClipEnd::Window => "window",
            ClipEnd::Silence => "silence",
            ClipEnd::Shutdown => "shutdown",
            ClipEnd::Length => "length",
            ClipEnd::Other => "other",
        }
        .to_owned(),
        duration_us,
        frames,
        frames_e: count("E", states.e)?,
        frames_p: count("P", states.p)?,
        frames_ei: count("E+I", states.ei)?,
        frames_i: count("I", states.i)?,
        frames_ai: count("AI", states.ai)?,
        degraded,
        dropped: dropped(report)?,
        latency_mean_us,
        latency_p50_us: micro("total_latency_ms.p50", total.p50 / 1e3, MOST_SECONDS)?,
        latency_p95_us: micro("total_latency_ms.p95", total.p95 / 1e3, MOST_SECONDS)?,
        latency_p99_us: micro("total_latency_ms.p99", total.p99 / 1e3, MOST_SECONDS)?,
        latency_us: product(latency_mean_us, latencies)?,
        detector_calls,
        detector_mean_us,
        detector_p50_us: micro("detector_latency_ms.p50", detector.p50 / 1e3, MOST_SECONDS)?,
        detector_p95_us: micro("detector_latency_ms.p95", detector.p95 / 1e3, MOST_SECONDS)?,
        detector_p99_us: micro("detector_latency_ms.p99", detector.p99 / 1e3, MOST_SECONDS)?,
        detector_us: product(detector_mean_us, detector_calls)?,
        avoided_calls,
        avoided_uj,
        quality: quality_code(energy.quality),
        energy_uj,
        node_uj,
        gpu_uj: domain("gpu")?,
        cpu_uj: domain("cpu")?,
        io_mem_uj: domain("io_mem")?,
        edp,
        samples: count("energy.samples", energy.samples)?,
        coverage_ppm: micro("energy.coverage", energy.coverage, 1.0 + 1e-6)?,
        threshold_changed: i64::from(report.threshold_changes.len() > 1),
        audit_frames: audit("audit_frames", |a| a.sums.frames)?,
        audit_missed: audit("audit_missed", |a| a.sums.missed)?,
        audit_missed_boxes: audit("audit_missed_boxes", |a| a.sums.missed_boxes)?,
        audit_calls: audit("audit_calls", |a| a.calls)?,
        audit_us: audit("audit_us", |a| a.detector_us)?,
        audit_uj,
        audit_detected: audit("audit_detected", |a| a.sums.detected)?,
        audit_shown: audit("audit_shown", |a| a.sums.shown)?,
        audit_paired: audit("audit_paired", |a| a.sums.paired)?,
        audit_detected_sq: audit("audit_detected_sq", |a| a.sums.squares.detected)?,
        audit_shown_sq: audit("audit_shown_sq", |a| a.sums.squares.shown)?,
        audit_paired_sq: audit("audit_paired_sq", |a| a.sums.squares.paired)?,
        audit_detected_x: audit("audit_detected_x", |a| a.sums.squares.detected_paired)?,
        audit_shown_x: audit("audit_shown_x", |a| a.sums.squares.shown_paired)?,
    };
    let threshold = report.threshold;
    let setup = SetupKey {
        policy: name("policy", &report.policy)?,
        knob: threshold
            .map(|threshold| threshold.name.to_string())
            .unwrap_or_default(),
        value: threshold
            .map(|threshold| threshold.value.to_string())
            .unwrap_or_default(),
        model: name("model", &report.model)?,
        provider: name("provider", &report.provider)?,
        power_source: name("energy.source", &energy.source)?,
        total_from: name("energy.total_from", &energy.total_from)?,
    };
    Ok(ClipRecord {
        camera: name("camera", &report.camera)?,
        setup,
        row,
        clock,
    })
}

/// A text that both databases keep.
fn name(what: &str, given: &str) -> Result<String, String> {
    if given.len() > LONGEST_TEXT {
        let length = given.len();
        return Err(format!("{what} has {length} bytes, above {LONGEST_TEXT}"));
    }
    Ok(text(given))
}

/// A count or a sum of an audit.
fn audited(name: &str, count: u64) -> Result<i64, String> {
    i64::try_from(count)
        .ok()
        .filter(|count| *count <= MOST_AUDITED)
        .ok_or_else(|| format!("{name} is {count}, above {MOST_AUDITED}"))
}

fn dropped(report: &ClipReport) -> Result<i64, String> {
    let kinds = report.dropped.by_kind();
    let mut frames = kinds.iter().map(|(_, frames)| *frames);
    match frames.try_fold(0_u64, u64::checked_add) {
        Some(total) => count("dropped", total),
        None => Err("dropped: more frames than can be counted".to_owned()),
    }
}

fn count(name: &str, value: u64) -> Result<i64, String> {
    if value > MOST_COUNT {
        return Err(format!("{name} is {value}, above {MOST_COUNT}"));
    }
    i64::try_from(value).map_err(|error| error.to_string())
}

/// A value in millionths.
fn micro(name: &str, value: f64, most: f64) -> Result<i64, String> {
    if !(value >= 0.0 && value <= most) {
        return Err(format!("{name} is {value}, and not from 0 to {most}"));
    }
    Ok((value * 1e6).round() as i64)
}
