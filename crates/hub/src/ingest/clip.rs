//! Converts a report into the row of a clip, in whole microjoules, microseconds and millionths, and checks every
//! figure.

use super::counters::IngestCounts;
use super::plan::Present;
use super::travel::TravelRow;
use crate::store::StoreError;
use crate::store::row::{Columns, FromRow, IntoRow, Row, text};
use albireo_service::clock::DAY_MS;
use albireo_wire::{AuditReport, ClipEnd, ClipReport};
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
    pub(crate) is_clock_believed: bool,
}

/// The columns of a setup: what the clips of one configuration share. A missing text is empty.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
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

impl FromRow for SetupRow {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            policy: row.take()?,
            threshold: row.take()?,
            value: row.take()?,
            model: row.take()?,
            provider: row.take()?,
            power_source: row.take()?,
            total_from: row.take()?,
        })
    }
}

impl IntoRow for &SetupRow {
    const TABLE: &'static str = "setups";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        Ok(vec![
            ("policy", self.policy.as_str().into()),
            ("threshold", self.threshold.as_str().into()),
            ("value", self.value.as_str().into()),
            ("model", self.model.as_str().into()),
            ("provider", self.provider.as_str().into()),
            ("power_source", self.power_source.as_str().into()),
            ("total_from", self.total_from.as_str().into()),
        ])
    }
}

/// The row of a clip, with its day, camera and setup.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StoredClipRow {
    pub(crate) day: i64,
    pub(crate) camera_id: i64,
    pub(crate) setup_id: i64,
    pub(crate) clip: ClipRow,
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
    let is_clock_believed = present.clocks_agree() && believable.contains(&started_ms);
    let step_ms = behind_ms.filter(|behind_ms| behind_ms.saturating_abs() >= LEAST_STEP_MS);
    let begun_ms = started_ms.saturating_add(step_ms.unwrap_or(0));
    let is_begin_known = step_ms.is_some() || is_clock_believed;
    let at_ms = if is_begin_known && believable.contains(&begun_ms) {
        begun_ms
    } else {
        now_ms
    };
    Ok(Clip {
        camera: name("camera", &report.camera)?,
        setup: setup(report)?,
        row: row(report, at_ms, now_ms)?,
        is_clock_believed,
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
    if let Some(audit) = &report.audit
        && audit.sums.paired > audit.sums.detected.min(audit.sums.shown)
    {
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
        (None, None) => (String::new(), String::new()),
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
    let avoided_joules = match energy.saved_joules_estimated {
        None if avoided_calls == 0 => Some(0.0),
        saved => saved,
    };
    let mut dropped = 0_u64;
    for (_, frames) in report.dropped.by_kind() {
        dropped = dropped.saturating_add(frames);
    }
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
        avoided_uj: microjoules("avoided_uj", avoided_joules)?,
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

/// Converts a figure to the whole units of its column, of which it has `units` each, and checks that it is from 0 to `most`.
pub(super) fn whole(column: &str, value: f64, most: f64, units: f64) -> Result<i64, String> {
    if !(0.0..=most).contains(&value) {
        return Err(format!("{column}: {value} is not from 0 to {most}"));
    }
    Ok((value * units).round() as i64)
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

/// The name of an end in the table, which is its name in a report.
const fn ended_by(end: ClipEnd) -> &'static str {
    match end {
        ClipEnd::NextClip => "next_clip",
        ClipEnd::Window => "window",
        ClipEnd::Silence => "silence",
        ClipEnd::Shutdown => "shutdown",
        ClipEnd::Length => "length",
        ClipEnd::Policy => "policy",
        ClipEnd::Other => "other",
    }
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
}

impl IntoRow for StoredClipRow {
    const TABLE: &'static str = "clips";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        let clip = &self.clip;
        let audit = clip.audit.as_ref();
        let travel = clip.travel.as_ref();
        Ok(vec![
            ("day", self.day.into()),
            ("camera_id", self.camera_id.into()),
            ("setup_id", self.setup_id.into()),
            ("report_id", clip.report_id.into()),
            ("count", clip.count.into()),
            ("at_ms", clip.at_ms.into()),
            ("received_ms", clip.received_ms.into()),
            ("clip", clip.clip.as_str().into()),
            ("part", i64::from(clip.part).into()),
            ("ended_by", ended_by(clip.ended_by).into()),
            ("duration_us", clip.duration_us.into()),
            ("frames", clip.frames.into()),
            ("frames_e", clip.frames_e.into()),
            ("frames_p", clip.frames_p.into()),
            ("frames_ei", clip.frames_ei.into()),
            ("frames_i", clip.frames_i.into()),
            ("frames_ai", clip.frames_ai.into()),
            ("degraded", clip.degraded.into()),
            ("dropped", clip.dropped.into()),
            ("latency_mean_us", clip.latency_mean_us.into()),
            ("latency_p99_us", clip.latency_p99_us.into()),
            ("latency_us", clip.latency_us.into()),
            ("detector_calls", clip.detector_calls.into()),
            ("detector_mean_us", clip.detector_mean_us.into()),
            ("detector_us", clip.detector_us.into()),
            ("avoided_calls", clip.avoided_calls.into()),
            ("avoided_uj", clip.avoided_uj.into()),
            ("quality", clip.quality.into()),
            ("energy_uj", clip.energy_uj.into()),
            ("node_uj", clip.node_uj.into()),
            ("edp", clip.edp.into()),
            ("coverage_ppm", clip.coverage_ppm.into()),
            ("threshold_changed", clip.threshold_changed.into()),
            ("audit_frames", audit.map(|audit| audit.frames).into()),
            ("audit_missed", audit.map(|audit| audit.missed).into()),
            (
                "audit_missed_boxes",
                audit.map(|audit| audit.missed_boxes).into(),
            ),
            ("audit_calls", audit.map(|audit| audit.calls).into()),
            ("audit_us", audit.map(|audit| audit.us).into()),
            ("audit_uj", audit.and_then(|audit| audit.uj).into()),
            ("audit_detected", audit.map(|audit| audit.detected).into()),
            ("audit_shown", audit.map(|audit| audit.shown).into()),
            ("audit_paired", audit.map(|audit| audit.paired).into()),
            (
                "audit_detected_sq",
                audit.map(|audit| audit.detected_sq).into(),
            ),
            ("audit_shown_sq", audit.map(|audit| audit.shown_sq).into()),
            ("audit_paired_sq", audit.map(|audit| audit.paired_sq).into()),
            (
                "audit_detected_x",
                audit.map(|audit| audit.detected_x).into(),
            ),
            ("audit_shown_x", audit.map(|audit| audit.shown_x).into()),
            (
                "distance_mm",
                travel.map(|travel| travel.distance_mm).into(),
            ),
            ("travel", travel.map(|travel| travel.json.as_str()).into()),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_clip_has_one_name_in_the_table_and_in_reports() {
        for end in [
            ClipEnd::NextClip,
            ClipEnd::Window,
            ClipEnd::Silence,
            ClipEnd::Shutdown,
            ClipEnd::Length,
            ClipEnd::Policy,
            ClipEnd::Other,
        ] {
            assert_eq!(serde_json::to_value(end).unwrap(), ended_by(end));
        }
    }
}
