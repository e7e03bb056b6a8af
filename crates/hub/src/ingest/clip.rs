//! Converts a report into the row of a clip, in whole microjoules, microseconds and millionths, and checks every
//! figure.

use super::plan::Present;
use crate::store::row::{Columns, Row, text};
use albireo_service::clock::DAY_MS;
use albireo_wire::{AuditReport, ClipReport};
use serde_json::json;

/// Largest energy of a clip, joules: about 3 kWh.
const MOST_JOULES: f64 = 1e7;
/// The longest clip or latency, and the longest sum of latencies in a clip, milliseconds: more than eleven days.
const MOST_MS: f64 = 1e9;
/// The largest sum of an audit in a clip: of squares, or of overlaps in millionths.
const MOST_AUDITED: f64 = 1e13;
/// The largest number of frames, and of anything else that is counted.
const MOST_COUNT: f64 = 1e7;
/// The range of energy-delay products that are stored; a database can store their squares.
const EDP: std::ops::RangeInclusive<f64> = 1e-9..=1e12;
/// Longest text, bytes.
const LONGEST_TEXT: usize = 256;
/// The clock of a node is wrong if a clip claims to begin this long after its receipt, milliseconds.
const FUTURE_MS: i64 = 3_600_000;
/// The clock of a node is wrong if a clip claims to begin this long before its receipt, milliseconds.
const PAST_MS: i64 = 400 * DAY_MS;

/// The figures of a report, before its camera and setup have row ids.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Clip {
    pub(crate) camera: String,
    /// The row of its setup, without its id.
    pub(crate) setup: Row,
    /// The row without its day, camera and setup.
    pub(crate) row: Columns<'static>,
    /// True if the node's clock is believed.
    pub(crate) clock: bool,
}

/// Reads the figures of a report. A clip is stored under the time when it began, or under that of its receipt if the node's
/// clock is not believed.
///
/// # Errors
/// The figure that cannot be stored, and the reason: the report is then set aside.
pub(crate) fn clip(report: &ClipReport, present: Present) -> Result<Clip, String> {
    let now_ms = present.hub_ms;
    let started_ms = i64::try_from(report.started_ns / 1_000_000).unwrap_or(i64::MAX);
    let believable = now_ms - PAST_MS..=now_ms.saturating_add(FUTURE_MS);
    let clock = present.clocks_agree() && believable.contains(&started_ms);
    let states = &report.states;
    let energy = &report.energy;
    let total = &report.total_latency_ms;
    let detector = &report.detector_latency_ms;
    let skipped = states.e.saturating_add(states.p);
    let avoided_calls = skipped.saturating_sub(report.degraded_frames);
    // If the node does not know the cost of a call, the avoided energy is known only without avoided calls: it is 0.
    let none_avoided = (avoided_calls == 0).then_some(0.0);
    let dropped = report
        .dropped
        .by_kind()
        .iter()
        .fold(0_u64, |sum, (_, frames)| sum.saturating_add(*frames));
    let count = |count: u64| (Some(count as f64), MOST_COUNT, 1.0);
    let ms = |ms: f64| (Some(ms), MOST_MS, 1e3);
    let joules = |joules: Option<f64>| (joules, MOST_JOULES, 1e6);
    let audit = |count: fn(&AuditReport) -> u64| {
        let count = report.audit.as_ref().map(count);
        (count.map(|count| count as f64), MOST_AUDITED, 1.0)
    };
    // Each figure with its largest value, and the factor to the whole numbers of its column.
    let figures = [
        ("duration_us", ms(report.duration_s * 1e3)),
        ("frames", count(report.frames)),
        ("frames_e", count(states.e)),
        ("frames_p", count(states.p)),
        ("frames_ei", count(states.ei)),
        ("frames_i", count(states.i)),
        ("frames_ai", count(states.ai)),
        ("degraded", count(report.degraded_frames)),
        ("dropped", count(dropped)),
        ("latency_mean_us", ms(total.mean)),
        ("latency_p99_us", ms(total.p99)),
        ("latency_us", ms(total.mean * total.count as f64)),
        ("detector_calls", count(detector.count)),
        ("detector_mean_us", ms(detector.mean)),
        ("detector_us", ms(detector.mean * detector.count as f64)),
        ("avoided_calls", count(avoided_calls)),
        (
            "avoided_uj",
            joules(energy.saved_joules_estimated.or(none_avoided)),
        ),
        ("energy_uj", joules(energy.joules)),
        ("node_uj", joules(energy.node_joules)),
        ("audit_frames", audit(|a| a.sums.frames)),
        ("audit_missed", audit(|a| a.sums.missed)),
        ("audit_missed_boxes", audit(|a| a.sums.missed_boxes)),
        ("audit_calls", audit(|a| a.calls)),
        ("audit_us", audit(|a| a.detector_us)),
        (
            "audit_uj",
            joules(report.audit.as_ref().and_then(|audit| audit.joules)),
        ),
        ("audit_detected", audit(|a| a.sums.detected)),
        ("audit_shown", audit(|a| a.sums.shown)),
        ("audit_paired", audit(|a| a.sums.paired)),
        ("audit_detected_sq", audit(|a| a.sums.squares.detected)),
        ("audit_shown_sq", audit(|a| a.sums.squares.shown)),
        ("audit_paired_sq", audit(|a| a.sums.squares.paired)),
        (
            "audit_detected_x",
            audit(|a| a.sums.squares.detected_paired),
        ),
        ("audit_shown_x", audit(|a| a.sums.squares.shown_paired)),
    ];
    let mut row = Columns::new();
    for (column, (value, most, unit)) in figures {
        if let Some(value) = value.filter(|value| !(0.0..=most).contains(value)) {
            return Err(format!("{column}: {value} is not from 0 to {most}"));
        }
        let whole = value.map(|value| (value * unit).round() as i64);
        row.push((column, json!(whole)));
    }
    if states.frames() != report.frames {
        let frames = report.frames;
        let added = states.frames();
        return Err(format!(
            "frames is {frames}, but the five states add up to {added}"
        ));
    }
    let sums = report.audit.as_ref().map(|audit| &audit.sums);
    if sums.is_some_and(|sums| sums.paired > sums.detected.min(sums.shown)) {
        return Err("audit: more pairs than boxes".to_owned());
    }
    if !(0.0..=1.0 + 1e-6).contains(&energy.coverage) {
        return Err(format!("coverage: {} is not from 0 to 1", energy.coverage));
    }
    let number = report.count.and_then(|count| i64::try_from(count).ok());
    row.extend([
        ("report_id", json!(report.id.as_bytes())),
        ("count", json!(number)),
        ("at_ms", json!(if clock { started_ms } else { now_ms })),
        ("received_ms", json!(now_ms)),
        ("clip", json!(name("clip", &report.clip)?)),
        ("part", json!(report.part)),
        ("ended_by", json!(report.ended_by)),
        ("quality", json!(energy.quality as i64)),
        ("edp", json!(energy.edp.filter(|edp| EDP.contains(edp)))),
        (
            "coverage_ppm",
            json!((energy.coverage * 1e6).round() as i64),
        ),
        (
            "threshold_changed",
            json!(i64::from(report.threshold_changes.len() > 1)),
        ),
    ]);
    // A target moves the threshold with every clip, so it names the setup in its place. A missing text is empty. The value is
    // the shortest text that parses to the same number.
    let (setting, value) = match (report.target, &report.threshold) {
        (Some(target), _) => (target.name().to_owned(), target.value().to_string()),
        (None, Some(threshold)) => (threshold.name.to_string(), threshold.value.to_string()),
        (None, None) => Default::default(),
    };
    let setup = [
        ("policy", name("policy", &report.policy)?),
        ("threshold", setting),
        ("value", value),
        ("model", name("model", &report.model)?),
        ("provider", name("provider", &report.provider)?),
        ("power_source", name("energy.source", &energy.source)?),
        ("total_from", name("energy.total_from", &energy.total_from)?),
    ]
    .map(|(column, text)| (column.to_owned(), text.into()));
    Ok(Clip {
        camera: name("camera", &report.camera)?,
        setup: Row::from_iter(setup),
        row,
        clock,
    })
}

/// Converts a text to a form that both databases can store, and checks its length.
fn name(what: &str, given: &str) -> Result<String, String> {
    if given.len() > LONGEST_TEXT {
        let length = given.len();
        return Err(format!(
            "{what} has {length} bytes, more than {LONGEST_TEXT}"
        ));
    }
    Ok(text(given))
}
