//! Judges boxes as they are published: at arrival, with a detector that takes time, or settled some frames later.
//!
//! At arrival, a frame is judged by what has been published when it arrives. A policy that predicts answers each frame
//! at once and receives detections late ([`LatePolicy`]). With any other policy, frames wait for the detector: when it
//! is free it runs on the newest frame, and every frame is judged by the boxes of the last finished frame.

mod run_times;

use super::{in_parallel, on_clip};
use crate::boxes::ScoredBox;
use crate::data::Clip;
use crate::error::EvalError;
use crate::judge::{Truth, accuracy, newcomers};
use crate::replay::{ClipFrame, StoredEvidence, drive, score_all, score_published};
use crate::result::ClipResult;
use crate::settings::Settings;
use crate::spec::{BASELINE, PolicySpec, short_label};
use crate::summary::{Difference, NEWCOMERS, PolicySummary, summarise};
use crate::text::{self, Column, one_decimal, three_decimals, two_decimals};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    EvidenceAtHand, FrameHead, LatePolicy, Need, Outcome, OutputBox, Policy, Settler, decide,
};
pub use run_times::RunTimes;
use std::time::Duration;

/// The longest delay of a settled frame, as in a node.
const MAX_DELAY: Duration = Duration::from_secs(2);

/// The tolerance when times are compared, seconds: frame times have rounding errors.
const TIME_TOLERANCE: f64 = 1e-9;

/// The published boxes that are judged.
#[derive(Clone, Debug, PartialEq)]
pub enum Stream {
    /// The boxes that have been published when a frame arrives.
    AtArrival {
        /// The times of the detector's runs.
        detector: RunTimes,
    },
    /// The boxes drawn between two detector calls once the second is known; the detector takes no time.
    Settled,
}

/// The results of all policies over all clips.
#[derive(Clone, Debug)]
pub struct StreamResults {
    stream: Stream,
    /// One entry per clip and policy.
    results: Vec<ClipResult>,
}

/// The boxes of a clip that are judged, with the detector calls they took.
#[derive(Default)]
struct Published {
    boxes: Vec<Vec<OutputBox>>,
    calls: usize,
    /// The delays of all frames together, in frames. Those that are settled by the end of the clip count as 0.
    delay: u64,
}

/// Runs `policies` over `clips` and judges `stream`.
///
/// # Errors
/// [`EvalError`] when a policy cannot be built, or a clip has no detections or no frame rate.
pub fn run<'a>(
    clips: impl IntoIterator<Item = &'a Clip>,
    policies: &[PolicySpec],
    settings: &Settings,
    stream: Stream,
) -> Result<StreamResults, EvalError> {
    let do_nothing = || ();
    let results = in_parallel(
        clips,
        policies,
        settings,
        &do_nothing,
        &|clip, spec, settings| run_clip(clip, spec, settings, &stream),
    )?;
    Ok(StreamResults { stream, results })
}

/// Runs a policy over a clip and judges what it publishes.
fn run_clip(
    clip: &Clip,
    spec: &PolicySpec,
    settings: &Settings,
    stream: &Stream,
) -> Result<ClipResult, EvalError> {
    let policy = spec.build(clip.frame_rate)?;
    let Some(rate) = clip.frame_rate.filter(|rate| *rate > 0.0) else {
        let what = "frames have no times, as the data has no frame rate: give it with --rate";
        return Err(on_clip(EvalError::new(what), spec, clip));
    };
    let mut evidence =
        StoredEvidence::new(clip, settings).map_err(|error| on_clip(error, spec, clip))?;
    let published = publish(policy, &mut evidence, stream, 1.0 / rate)
        .map_err(|error| on_clip(error, spec, clip))?;
    let mut result = ClipResult {
        clip: clip.name.clone(),
        policy: spec.label.clone(),
        frames: clip.frames,
        frame_rate: clip.frame_rate,
        detector_frames: published.calls,
        delay: published.delay as f64 / clip.frames.max(1) as f64,
        ..ClipResult::default()
    };
    let Some(objects) = &clip.truth else {
        return Ok(result);
    };
    let truth = Truth {
        objects,
        ignored: &clip.ignored,
    };
    let min_confidence = settings.min_confidence();
    let mut boxes = Vec::with_capacity(clip.frames);
    let mut all = Vec::with_capacity(clip.frames);
    for frame in &published.boxes {
        boxes.push(score_published(frame, clip.picture, min_confidence));
        all.push(score_all(frame, clip.picture));
    }
    let accuracy_of =
        |boxes: &[Vec<ScoredBox>]| accuracy(boxes, truth, settings.classes, settings.interpolation);
    result.accuracy = accuracy_of(&boxes);
    result.accuracy_all = accuracy_of(&all);
    result.newcomers = newcomers(&boxes, truth, settings.classes);
    Ok(result)
}

/// Publishes the boxes of a clip; `interval` is the time between two frames, seconds.
fn publish(
    mut policy: Box<dyn Policy>,
    source: &mut StoredEvidence<'_>,
    stream: &Stream,
    interval: f64,
) -> Result<Published, EvalError> {
    match stream {
        Stream::Settled => {
            // Ten seconds are longer than any delay of a settled frame, and short enough for a `Duration`.
            let capped = Duration::from_secs_f64(interval.min(10.0));
            settled(&mut *policy, source, capped)
        }
        Stream::AtArrival { detector } => {
            let timing = Timing { interval, detector };
            if policy.can_rewind() {
                at_once(policy, source, timing)
            } else {
                when_known(&mut *policy, source, timing)
            }
        }
    }
}

/// The times at which frames and the detector's results arrive.
#[derive(Clone, Copy, Debug)]
struct Timing<'a> {
    /// The time between two frames, seconds.
    interval: f64,
    detector: &'a RunTimes,
}

impl Timing<'_> {
    /// The seconds that it takes to fetch `need` after `calls` detector runs.
    fn seconds_for(self, need: Need, calls: usize) -> f64 {
        match need {
            Need::Detections => self.detector.seconds_of(calls),
            _ => 0.0,
        }
    }
}

/// A frame that waits for what it needs.
#[derive(Clone, Copy)]
struct Waiting {
    frame: usize,
    need: Need,
    /// The time at which the need is met, seconds.
    met_at: f64,
}

impl Waiting {
    /// A frame that asks for `need` at the time `now`, after `calls` detector runs; `None` if it needs nothing.
    fn new(frame: usize, need: Need, now: f64, timing: Timing<'_>, calls: usize) -> Option<Self> {
        if need == Need::Nothing {
            return None;
        }
        Some(Self {
            frame,
            need,
            met_at: now + timing.seconds_for(need, calls),
        })
    }
}

/// Answers frames at once; the detector works on one of them at a time.
fn at_once(
    policy: Box<dyn Policy>,
    source: &mut StoredEvidence<'_>,
    timing: Timing<'_>,
) -> Result<Published, EvalError> {
    let mut late = LatePolicy::new(policy).map_err(EvalError::new)?;
    let mut published = Published::default();
    let mut outcome = Outcome::default();
    // What the frame that waits is answered with, too late to be published.
    let mut unused = Outcome::default();
    let mut waiting: Option<Waiting> = None;
    for frame in 0..source.frames() {
        let now = frame as f64 * timing.interval;
        while let Some(earlier) = waiting
            && earlier.met_at <= now + TIME_TOLERANCE
        {
            let mut stored = ClipFrame::new(source, earlier.frame);
            let evidence = stored.evidence(earlier.need)?;
            let need = late
                .deliver(earlier.frame as u64, evidence, &mut unused)
                .map_err(EvalError::new)?;
            waiting = Waiting::new(earlier.frame, need, earlier.met_at, timing, published.calls);
            if need == Need::Detections {
                published.calls += 1;
            }
        }
        // Every frame is answered.
        let step = 1;
        let need = late.frame(head(frame, step, source.picture()), &mut outcome);
        if need != Need::Nothing {
            waiting = Waiting::new(frame, need, now, timing, published.calls);
        }
        if need == Need::Detections {
            published.calls += 1;
        }
        published.boxes.push(outcome.boxes.clone());
    }
    Ok(published)
}

/// Lets frames wait for the detector. Of the frames that arrive while it runs, only the newest is kept.
fn when_known(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    timing: Timing<'_>,
) -> Result<Published, EvalError> {
    let mut published = Published::default();
    let mut outcome = Outcome::default();
    // The time at which the detector is free again, seconds.
    let mut free = 0.0;
    let mut next = 0;
    let mut last = Vec::new();
    while next < source.frames() {
        let newest = (free / timing.interval + TIME_TOLERANCE).floor() as usize;
        let frame = newest.max(next);
        if frame >= source.frames() {
            break;
        }
        let start = f64::max(free, frame as f64 * timing.interval);
        let step = (frame + 1 - next) as u32;
        let head = head(frame, step, source.picture());
        let mut stored = ClipFrame::new(source, frame);
        decide(policy, head, &mut stored, &mut outcome)?;
        free = start;
        if stored.detector {
            free += timing.detector.seconds_of(published.calls);
            published.calls += 1;
        }
        next = frame + 1;
        // Frames that arrive before this answer show the previous one.
        while published.boxes.len() < source.frames()
            && (published.boxes.len() as f64 * timing.interval) < free - TIME_TOLERANCE
        {
            published.boxes.push(last.clone());
        }
        last.clone_from(&outcome.boxes);
    }
    published.boxes.resize(source.frames(), last);
    Ok(published)
}

/// Settles frames; the detector takes no time.
fn settled(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    interval: Duration,
) -> Result<Published, EvalError> {
    let mut settler = Settler::new(MAX_DELAY);
    let mut calls = 0;
    let mut boxes = Vec::new();
    let mut delay = 0;
    drive(policy, source, &mut |_, decided| {
        if decided.record.detector {
            calls += 1;
        }
        let now = decided.head.index;
        let time = interval.saturating_mul(u32::try_from(now).unwrap_or(u32::MAX));
        // The answer is final: the detector takes no time.
        let is_pending = false;
        settler.frame(now, time, decided.outcome, is_pending, |frame| {
            delay += now - frame.index;
            boxes.push(frame.boxes.to_vec());
        });
    })?;
    settler.flush(|frame| boxes.push(frame.boxes.to_vec()));
    Ok(Published {
        boxes,
        calls,
        delay,
    })
}

fn head(frame: usize, step: u32, picture: PictureSize) -> FrameHead {
    FrameHead {
        index: frame as u64,
        step,
        picture,
    }
}

impl StreamResults {
    /// The name of the file for the table.
    pub fn file_name(&self) -> &'static str {
        match self.stream {
            Stream::AtArrival { .. } => "at-arrival.txt",
            Stream::Settled => "settled.txt",
        }
    }

    /// Adds the results of other clips, which must be of the same policies and stream.
    pub fn extend(&mut self, others: Self) {
        self.results.extend(others.results);
    }

    /// Formats a table with one line per policy, and one with the differences to the baseline.
    pub fn table(&self) -> String {
        let title = match &self.stream {
            Stream::AtArrival { detector } => format!(
                "Judged when frames arrive, with a detector that takes {}",
                detector.describe()
            ),
            Stream::Settled => "Judged when settled between two detector calls".to_owned(),
        };
        let summaries = summarise(&self.results);
        let clips = summaries.first().map_or(0, |first| first.clips);
        type Cell = fn(&PolicySummary) -> String;
        let table = |summaries: &[PolicySummary], columns: &[(&str, Cell)]| {
            let columns: Vec<_> = columns
                .iter()
                .map(|(head, cell)| Column::new([head, ""], summaries.iter().map(cell).collect()))
                .collect();
            text::table(columns.iter(), " ")
        };
        let figures = table(
            &summaries,
            &[
                ("policy", |summary| short_label(&summary.policy).to_owned()),
                ("calls%", |summary| format!("{:.1}", 100.0 * summary.calls)),
                ("AP@50", |summary| three_decimals(summary.ap50)),
                ("AP@75", |summary| three_decimals(summary.ap75)),
                ("F1", |summary| three_decimals(summary.f1_50_shown)),
                ("mAP", |summary| three_decimals(summary.map)),
                ("all", |summary| three_decimals(summary.ap50_all)),
                ("delay", |summary| format!("{:.1}", summary.delay)),
                ("new", |summary| {
                    two_decimals(summary.newcomers.map(|new| new.frames))
                }),
                ("ms", |summary| {
                    one_decimal(summary.newcomers.and_then(|new| new.ms))
                }),
                ("never%", |summary| {
                    one_decimal(summary.newcomers.map(|new| 100.0 * new.never_found))
                }),
            ],
        );
        let is_compared = |summary: &PolicySummary| summary.policy != BASELINE;
        let compared: Vec<PolicySummary> = summaries.into_iter().filter(is_compared).collect();
        let differences = table(
            &compared,
            &[
                ("policy", |summary| short_label(&summary.policy).to_owned()),
                ("AP@50", |summary| points(summary.ap50_change)),
                ("AP@75", |summary| points(summary.ap75_change)),
                ("F1", |summary| points(summary.f1_50_shown_change)),
                ("new", |summary| frames(summary.newcomers_change)),
            ],
        );
        let legend = text::wrapped(
            &format!(
                "calls%: detector calls of 100 frames; F1: at IoU 0.5, of boxes of confidence 0.3 and above; all: AP@50 of \
                 all boxes, also those too faint for a node to publish; delay: frames. {NEWCOMERS}"
            ),
            80,
        );
        format!(
            "{title};\nmeans over {}\n\n{figures}\nDifferences to vanilla in points (new: in frames), with their \
             95 % intervals\n\n{differences}\n{legend}\n",
            text::counted(clips, "clip")
        )
    }
}

/// `+24.1 [18.2, 30.1]`, in points.
fn points(difference: Option<Difference>) -> String {
    difference.map(|found| found.scaled(100.0).text(1)).unwrap_or_default()
}

/// `+0.31 [0.10, 0.52]`, in frames.
fn frames(difference: Option<Difference>) -> String {
    difference.map(|found| found.text(2)).unwrap_or_default()
}

#[cfg(test)]
mod tests;
