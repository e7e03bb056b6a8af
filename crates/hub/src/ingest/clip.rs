//! Converts a report into the row of a clip, in whole microjoules, microseconds and millionths, and checks every
//! figure.

use super::counters::IngestCounts;
use super::plan::Present;
use super::travel::TravelRow;
use crate::store::row::{Columns, text};
use albireo_service::clock::DAY_MS;
use albireo_wire::{AuditReport, ClipEnd, ClipReport};
use serde::{Deserialize, Serialize};
use serde_json::json;
use uuid::Uuid;

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
    pub(crate) setup: SetupRow,
    pub(crate) row: ClipRow,
    /// True if the node's clock is believed.
    pub(crate) clock: bool,
}

/// The columns of a setup: what the clips of one configuration share. A missing text is empty.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct SetupRow {
    policy: String,
    /// The name of the threshold, or of the target that moves it with every clip.
    threshold: String,
    /// Its value: the shortest text that parses to the same number.
    value: String,
    model: String,
    provider: String,
    power_source: String,
    total_from: String,
}

/// The columns of a clip, without its day, camera and setup. In `_us` they are microseconds, in `_uj` microjoules.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClipRow {
    report_id: Uuid,
    count: Option<i64>,
    pub(super) at_ms: i64,
    received_ms: i64,
    clip: String,
    part: u32,
    ended_by: ClipEnd,
    duration_us: i64,
    frames: i64,
    frames_e: i64,
    frames_p: i64,
    frames_ei: i64,
    frames_i: i64,
    frames_ai: i64,
    degraded: i64,
    dropped: i64,
    latency_mean_us: i64,
    latency_p99_us: i64,
    latency_us: i64,
    detector_calls: i64,
    detector_mean_us: i64,
    detector_us: i64,
    avoided_calls: i64,
    avoided_uj: Option<i64>,
    quality: i64,
    energy_uj: Option<i64>,
    node_uj: Option<i64>,
    edp: Option<f64>,
    coverage_ppm: i64,
    threshold_changed: bool,
    audit: Option<AuditRow>,
    travel: Option<TravelRow>,
}

/// The columns of a clip's audit.
#[derive(Clone, Debug, PartialEq)]
struct AuditRow {
    frames: i64,
    missed: i64,
    missed_boxes: i64,
    calls: i64,
    us: i64,
    uj: Option<i64>,
    detected: i64,
    shown: i64,
    paired: i64,
    detected_sq: i64,
    shown_sq: i64,
    paired_sq: i64,
    detected_x: i64,
    shown_x: i64,
}

/// Smaller steps of a node's clock move no clip: its ages are in whole seconds, and clocks are adjusted slowly.
const LEAST_STEP_MS: i64 = 60_000;

/// Reads the figures of a report. A clip is stored under the time when it began: if the clock with which it was made is known
/// to have been `behind_ms` behind, by that much later. Without that knowledge, it is stored under the time of its receipt if
/// the node's clock is not believed.
///
/// # Errors
/// The figure that cannot be stored, and the reason: the report is then set aside.
pub(crate) fn clip(
    report: &ClipReport,
    present: Present,
    behind_ms: Option<i64>,
) -> Result<Clip, String> {
    check(report)?;
    let now_ms = present.hub_ms;
    let started_ms = i64::try_from(report.started_ns / 1_000_000).unwrap_or(i64::MAX);
    let believable = now_ms - PAST_MS..=now_ms.saturating_add(FUTURE_MS);
    let clock = present.clocks_agree() && believable.contains(&started_ms);
    let set_since = behind_ms.filter(|behind_ms| behind_ms.saturating_abs() >= LEAST_STEP_MS);
    let begun_ms = started_ms.saturating_add(set_since.unwrap_or(0));
    let is_known = (set_since.is_some() || clock) && believable.contains(&begun_ms);
    Ok(Clip {
        camera: name("camera", &report.camera)?,
        setup: setup(report)?,
        row: row(report, if is_known { begun_ms } else { now_ms }, now_ms)?,
        clock,
    })
}

/// Checks what figures say together.
fn check(report: &ClipReport) -> Result<(), String> {
    let frames = report.frames;
    let added = report.states.frames();
    if added != frames {
        return Err(format!(
            "frames is {frames}, but the five states add up to {added}"
        ));
    }
    let sums = report.audit.as_ref().map(|audit| &audit.sums);
    if sums.is_some_and(|sums| sums.paired > sums.detected.min(sums.shown)) {
        return Err("audit: more pairs than boxes".to_owned());
    }
    let coverage = report.energy.coverage;
    if !(0.0..=1.0 + 1e-6).contains(&coverage) {
        return Err(format!("coverage: {coverage} is not from 0 to 1"));
    }
    Ok(())
}

fn setup(report: &ClipReport) -> Result<SetupRow, String> {
    // A target moves the threshold with every clip, so it names the setup in its place.
    let (threshold, value) = match (report.target, &report.threshold) {
        (Some(target), _) => (target.name().to_owned(), target.value().to_string()),
        (None, Some(threshold)) => (threshold.name.to_string(), threshold.value.to_string()),
        (None, None) => Default::default(),
    };
    Ok(SetupRow {
        policy: name("policy", &report.policy)?,
        threshold,
        value,
        model: name("model", &report.model)?,
        provider: name("provider", &report.provider)?,
        power_source: name("energy.source", &report.energy.source)?,
        total_from: name("energy.total_from", &report.energy.total_from)?,
    })
}

fn row(report: &ClipReport, at_ms: i64, received_ms: i64) -> Result<ClipRow, String> {
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
    Ok(ClipRow {
        report_id: report.id,
        count: report.count.and_then(|count| i64::try_from(count).ok()),
        at_ms,
        received_ms,
        clip: name("clip", &report.clip)?,
        part: report.part,
        ended_by: report.ended_by,
        duration_us: microseconds("duration_us", report.duration_s * 1e3)?,
        frames: counted("frames", report.frames)?,
        frames_e: counted("frames_e", states.e)?,
        frames_p: counted("frames_p", states.p)?,
        frames_ei: counted("frames_ei", states.ei)?,
        frames_i: counted("frames_i", states.i)?,
        frames_ai: counted("frames_ai", states.ai)?,
        degraded: counted("degraded", report.degraded_frames)?,
        dropped: counted("dropped", dropped)?,
        latency_mean_us: microseconds("latency_mean_us", total.mean)?,
        latency_p99_us: microseconds("latency_p99_us", total.p99)?,
        latency_us: microseconds("latency_us", total.mean * total.count as f64)?,
        detector_calls: counted("detector_calls", detector.count)?,
        detector_mean_us: microseconds("detector_mean_us", detector.mean)?,
        detector_us: microseconds("detector_us", detector.mean * detector.count as f64)?,
        avoided_calls: counted("avoided_calls", avoided_calls)?,
        avoided_uj: microjoules("avoided_uj", energy.saved_joules_estimated.or(none_avoided))?,
        quality: energy.quality as i64,
        energy_uj: microjoules("energy_uj", energy.joules)?,
        node_uj: microjoules("node_uj", energy.node_joules)?,
        edp: energy.edp.filter(|edp| EDP.contains(edp)),
        coverage_ppm: (energy.coverage * 1e6).round() as i64,
        threshold_changed: report.threshold_changes.len() > 1,
        audit: report.audit.as_ref().map(audit).transpose()?,
        travel: report.travel.as_ref().map(TravelRow::new).transpose()?,
    })
}

fn audit(audit: &AuditReport) -> Result<AuditRow, String> {
    let sums = &audit.sums;
    let squares = &sums.squares;
    Ok(AuditRow {
        frames: audited("audit_frames", sums.frames)?,
        missed: audited("audit_missed", sums.missed)?,
        missed_boxes: audited("audit_missed_boxes", sums.missed_boxes)?,
        calls: audited("audit_calls", audit.calls)?,
        us: audited("audit_us", audit.detector_us)?,
        uj: microjoules("audit_uj", audit.joules)?,
        detected: audited("audit_detected", sums.detected)?,
        shown: audited("audit_shown", sums.shown)?,
        paired: audited("audit_paired", sums.paired)?,
        detected_sq: audited("audit_detected_sq", squares.detected)?,
        shown_sq: audited("audit_shown_sq", squares.shown)?,
        paired_sq: audited("audit_paired_sq", squares.paired)?,
        detected_x: audited("audit_detected_x", squares.detected_paired)?,
        shown_x: audited("audit_shown_x", squares.shown_paired)?,
    })
}

/// Converts a figure to whole units of its column, and checks that it is from 0 to `most`.
pub(super) fn whole(column: &str, value: f64, most: f64, units: f64) -> Result<i64, String> {
    if (0.0..=most).contains(&value) {
        Ok((value * units).round() as i64)
    } else {
        Err(format!("{column}: {value} is not from 0 to {most}"))
    }
}

fn counted(column: &str, count: u64) -> Result<i64, String> {
    whole(column, count as f64, MOST_COUNT, 1.0)
}

fn audited(column: &str, sum: u64) -> Result<i64, String> {
    whole(column, sum as f64, MOST_AUDITED, 1.0)
}

fn microseconds(column: &str, ms: f64) -> Result<i64, String> {
    whole(column, ms, MOST_MS, 1e3)
}

fn microjoules(column: &str, joules: Option<f64>) -> Result<Option<i64>, String> {
    joules.map(|joules| whole(column, joules, MOST_JOULES, 1e6)).transpose()
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

impl ClipRow {
    /// The additions to the counters.
    pub(super) fn counted(&self) -> IngestCounts {
        let count = |value: i64| value.unsigned_abs();
        let audited =
            |value: fn(&AuditRow) -> i64| self.audit.as_ref().map_or(0, value).unsigned_abs();
        IngestCounts {
            clips: 1,
            frames: count(self.frames),
            frames_skipped: count(self.avoided_calls),
            audit_frames: audited(|audit| audit.frames),
            audit_missed: audited(|audit| audit.missed),
            audit_detected: audited(|audit| audit.detected),
            audit_shown: audited(|audit| audit.shown),
            audit_paired: audited(|audit| audit.paired),
            // A clip whose energy was not measured adds nothing to the sum of those that have a figure.
            energy_uj: count(self.energy_uj.unwrap_or(0)),
            ..IngestCounts::default()
        }
    }

    /// The row to insert.
    pub(super) fn columns(&self, day: i64, camera_id: i64, setup_id: i64) -> Columns<'static> {
        let audit = |value: fn(&AuditRow) -> i64| json!(self.audit.as_ref().map(value));
        vec![
            ("day", json!(day)),
            ("camera_id", json!(camera_id)),
            ("setup_id", json!(setup_id)),
            ("report_id", json!(self.report_id.as_bytes())),
            ("count", json!(self.count)),
            ("at_ms", json!(self.at_ms)),
            ("received_ms", json!(self.received_ms)),
            ("clip", json!(self.clip)),
            ("part", json!(self.part)),
            ("ended_by", json!(self.ended_by)),
            ("duration_us", json!(self.duration_us)),
            ("frames", json!(self.frames)),
            ("frames_e", json!(self.frames_e)),
            ("frames_p", json!(self.frames_p)),
            ("frames_ei", json!(self.frames_ei)),
            ("frames_i", json!(self.frames_i)),
            ("frames_ai", json!(self.frames_ai)),
            ("degraded", json!(self.degraded)),
            ("dropped", json!(self.dropped)),
            ("latency_mean_us", json!(self.latency_mean_us)),
            ("latency_p99_us", json!(self.latency_p99_us)),
            ("latency_us", json!(self.latency_us)),
            ("detector_calls", json!(self.detector_calls)),
            ("detector_mean_us", json!(self.detector_mean_us)),
            ("detector_us", json!(self.detector_us)),
            ("avoided_calls", json!(self.avoided_calls)),
            ("avoided_uj", json!(self.avoided_uj)),
            ("quality", json!(self.quality)),
            ("energy_uj", json!(self.energy_uj)),
            ("node_uj", json!(self.node_uj)),
            ("edp", json!(self.edp)),
            ("coverage_ppm", json!(self.coverage_ppm)),
            (
                "threshold_changed",
                json!(i64::from(self.threshold_changed)),
            ),
            ("audit_frames", audit(|audit| audit.frames)),
            ("audit_missed", audit(|audit| audit.missed)),
            ("audit_missed_boxes", audit(|audit| audit.missed_boxes)),
            ("audit_calls", audit(|audit| audit.calls)),
            ("audit_us", audit(|audit| audit.us)),
            (
                "audit_uj",
                json!(self.audit.as_ref().and_then(|audit| audit.uj)),
            ),
            ("audit_detected", audit(|audit| audit.detected)),
            ("audit_shown", audit(|audit| audit.shown)),
            ("audit_paired", audit(|audit| audit.paired)),
            ("audit_detected_sq", audit(|audit| audit.detected_sq)),
            ("audit_shown_sq", audit(|audit| audit.shown_sq)),
            ("audit_paired_sq", audit(|audit| audit.paired_sq)),
            ("audit_detected_x", audit(|audit| audit.detected_x)),
            ("audit_shown_x", audit(|audit| audit.shown_x)),
            (
                "distance_mm",
                json!(self.travel.as_ref().map(|travel| travel.distance_mm)),
            ),
            (
                "travel",
                json!(self.travel.as_ref().map(|travel| &travel.json)),
            ),
        ]
    }
}
