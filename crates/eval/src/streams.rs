//! Judges boxes when frames arrive, with a detector that takes its time, and boxes that are settled afterwards.
//!
//! At arrival, a frame is judged by what has been published when it comes. A policy that predicts answers each frame at
//! once and takes detections late ([`LatePolicy`]). Any other one lets frames wait for the detector: it takes the newest
//! frame when it is free, and every frame is judged by the boxes of the last frame that it has finished.

mod run_times;

pub use run_times::RunTimes;

use crate::data::Clip;
use crate::error::EvalError;
use crate::replay::{ClipFrame, drive};
use crate::result::ClipResult;
use crate::run::{Settings, build, in_parallel, judge, no_evidence};
use crate::scoring::score_published;
use crate::source::StoredEvidence;
use crate::spec::{BASELINE, PolicySpec};
use crate::summary::{Difference, PolicySummary, summarise};
use crate::table::short;
use crate::text::{self, Column, three};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    EvidenceAtHand, FrameHead, LatePolicy, Need, Outcome, OutputBox, Policy, Settler, decide,
};
use std::time::Duration;

/// Settled frames are held back by this at most, as a node does.
const LONGEST_DELAY: Duration = Duration::from_secs(2);

/// Times are compared with this tolerance, seconds: frame times are sums of rounded intervals.
const SAME_TIME: f64 = 1e-9;

/// Which boxes of a frame are judged.
#[derive(Clone, Debug, PartialEq)]
pub enum Stream {
    /// Those that have been published when the frame comes.
    AtArrival {
        /// Times of the detector's runs.
        detector: RunTimes,
    },
    /// Those drawn between two detector calls; the detector takes no time.
    Settled,
}

/// All policies over all clips.
#[derive(Clone, Debug)]
pub struct StreamResults {
    stream: Stream,
    /// By clip or policy.
    results: Vec<ClipResult>,
}

/// The boxes of a clip to be judged.
#[derive(Default)]
struct Published {
    boxes: Vec<Vec<OutputBox>>,
    calls: usize,
    /// Summed delay, frames.
    delay: u64,
}

/// Runs `policies` over `clips` and judges `stream`.
///
/// # Errors
/// [`EvalError`] when a policy cannot be built or a clip has no detections or, at arrival, no frame rate.
pub fn run<'a>(
    clips: impl IntoIterator<Item = &'a Clip>,
    policies: &[PolicySpec],
    settings: &Settings,
    stream: Stream,
) -> Result<StreamResults, EvalError> {
    let results = in_parallel(
        clips,
        policies,
        settings,
        &|| (),
        &|clip, spec, settings| {
            let policy = build(spec)?;
            let published = StoredEvidence::new(clip, settings)
                .and_then(|mut evidence| publish(clip, policy, &mut evidence, &stream))
                .map_err(|source| no_evidence(clip, spec, source))?;
            let min_confidence = settings.min_confidence();
            let (boxes, all): (Vec<_>, Vec<_>) = (published.boxes.iter())
                .map(|boxes| score_published(boxes, clip.picture, min_confidence))
                .unzip();
            Ok(ClipResult {
                clip: clip.name.clone(),
                policy: spec.label.clone(),
                frames: clip.frames,
                accuracy: judge(clip, &boxes, settings),
                accuracy_all: judge(clip, &all, settings),
                detector_frames: published.calls,
                delay: published.delay as f64 / clip.frames.max(1) as f64,
                ..ClipResult::default()
            })
        },
    )?;
    Ok(StreamResults { stream, results })
}

fn publish(
    clip: &Clip,
    mut policy: Box<dyn Policy>,
    source: &mut StoredEvidence<'_>,
    stream: &Stream,
) -> Result<Published, EvalError> {
    let Stream::AtArrival { detector } = stream else {
        let interval = Duration::from_secs_f64(1.0 / clip.frame_rate.unwrap_or(10.0).max(0.1));
        return settled(&mut *policy, source, interval);
    };
    let rate = clip.frame_rate.filter(|rate| *rate > 0.0);
    let rate =
        rate.ok_or_else(|| EvalError::new("frames have no times: the clip has no frame rate"))?;
    let timing = Timing {
        interval: 1.0 / rate,
        detector,
    };
    if policy.can_rewind() {
        at_once(policy, source, timing)
    } else {
        when_known(&mut *policy, source, timing)
    }
}

/// When frames and the detector's results come.
#[derive(Clone, Copy, Debug)]
struct Timing<'a> {
    /// From frame to frame, seconds.
    interval: f64,
    detector: &'a RunTimes,
}

impl Timing<'_> {
    /// How long `need` takes to be fetched after `calls` detector runs, seconds.
    fn of(self, need: Need, calls: usize) -> f64 {
        match need {
            Need::Detections => self.detector.of(calls),
            _ => 0.0,
        }
    }
}

/// Frames are answered at once; the detector works on one of them at a time.
fn at_once(
    policy: Box<dyn Policy>,
    source: &mut StoredEvidence<'_>,
    timing: Timing<'_>,
) -> Result<Published, EvalError> {
    let mut late = LatePolicy::new(policy).map_err(EvalError::new)?;
    let mut published = Published::default();
    let (mut outcome, mut unused) = (Outcome::default(), Outcome::default());
    // The frame that waits, what for, and when that comes.
    let mut waits: Option<(usize, Need, f64)> = None;
    for frame in 0..source.frames() {
        let now = frame as f64 * timing.interval;
        while let Some((waiting_frame, need, at)) = waits
            && at <= now + SAME_TIME
        {
            let mut stored = ClipFrame::new(source, waiting_frame);
            let evidence = stored.evidence(need)?;
            let next = late.deliver(waiting_frame as u64, evidence, &mut unused);
            let next = next.map_err(EvalError::new)?;
            let took = timing.of(next, published.calls);
            published.calls += usize::from(next == Need::Detections);
            waits = (next != Need::Nothing).then_some((waiting_frame, next, at + took));
        }
        let need = late.frame(head(frame, 1, source.picture()), &mut outcome);
        if need != Need::Nothing {
            waits = Some((frame, need, now + timing.of(need, published.calls)));
        }
        published.calls += usize::from(need == Need::Detections);
        published.boxes.push(outcome.boxes.clone());
    }
    Ok(published)
}

/// Frames wait for the detector; those that come meanwhile are lost but for the newest.
fn when_known(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    timing: Timing<'_>,
) -> Result<Published, EvalError> {
    let mut published = Published::default();
    let mut outcome = Outcome::default();
    let mut free = 0.0;
    let mut next = 0;
    let mut last = Vec::new();
    while next < source.frames() {
        let newest = (free / timing.interval + SAME_TIME).floor() as usize;
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
            free += timing.detector.of(published.calls);
            published.calls += 1;
        }
        next = frame + 1;
        // Frames that come before this answer show the one before it.
        while published.boxes.len() < source.frames()
            && (published.boxes.len() as f64 * timing.interval) < free - SAME_TIME
        {
            published.boxes.push(last.clone());
        }
        last.clone_from(&outcome.boxes);
    }
    published.boxes.resize(source.frames(), last);
    Ok(published)
}

/// Frames wait for the detector, which takes no time, and are settled.
fn settled(
    policy: &mut dyn Policy,
    source: &mut StoredEvidence<'_>,
    interval: Duration,
) -> Result<Published, EvalError> {
    let mut published = Published::default();
    let mut settler = Settler::new(LONGEST_DELAY);
    let mut calls = 0;
    let mut boxes = Vec::new();
    let mut delay = 0;
    drive(policy, source, &mut |_, played| {
        calls += usize::from(played.record.detector);
        let now = played.head.index;
        let time = interval.saturating_mul(u32::try_from(now).unwrap_or(u32::MAX));
        settler.frame(now, time, played.outcome, false, |frame| {
            delay += now - frame.index;
            boxes.push(frame.boxes.to_vec());
        });
    })?;
    settler.flush(|frame| boxes.push(frame.boxes.to_vec()));
    published.boxes = boxes;
    published.calls = calls;
    published.delay = delay;
    Ok(published)
}

fn head(frame: usize, step: u32, picture: PictureSize) -> FrameHead {
    FrameHead {
        index: frame as u64,
        step,
        picture,
    }
}

impl StreamResults {
    /// Name of the file for the table.
    pub fn file_name(&self) -> &'static str {
        match self.stream {
            Stream::AtArrival { .. } => "at-arrival.txt",
            Stream::Settled => "settled.txt",
        }
    }

    /// Takes in the results of other clips, of the same policies and stream.
    pub fn extend(&mut self, others: Self) {
        self.results.extend(others.results);
    }

    /// The table: one line per policy, and one for its differences to the baseline.
    pub fn table(&self) -> String {
        let title = match &self.stream {
            Stream::AtArrival { detector } => format!(
                "Judged when frames arrive, with a detector that takes {}",
                detector.describe()
            ),
            Stream::Settled => "Judged when settled between two detector calls".to_owned(),
        };
        let mut summaries = summarise(&self.results);
        let clips = summaries.first().map_or(0, |first| first.clips);
        type Cell = fn(&PolicySummary) -> String;
        let table = |summaries: &[PolicySummary], columns: &[(&str, Cell)]| {
            let columns: Vec<_> = (columns.iter())
                .map(|(head, cell)| Column::new([head, ""], summaries.iter().map(cell).collect()))
                .collect();
            text::table(columns.iter(), "  ")
        };
        let figures = table(
            &summaries,
            &[
                ("policy", |s| short(&s.policy).to_owned()),
                ("calls%", |s| format!("{:.1}", 100.0 * s.calls)),
                ("AP@50", |s| three(s.ap50)),
                ("AP@75", |s| three(s.ap75)),
                ("F1@50 >=.3", |s| three(s.f1_50_shown)),
                ("mAP", |s| three(s.map)),
                ("all", |s| three(s.ap50_all)),
                ("delay", |s| format!("{:.1}", s.delay)),
            ],
        );
        summaries.retain(|summary| summary.policy != BASELINE);
        let differences = table(
            &summaries,
            &[
                ("policy", |s| short(&s.policy).to_owned()),
                ("AP@50", |s| points(s.ap50_change)),
                ("AP@75", |s| points(s.ap75_change)),
                ("F1@50 >=.3", |s| points(s.f1_50_shown_change)),
            ],
        );
        format!(
            "{title};\nmeans over {clips} clips\n\n{figures}\nDifferences to vanilla in points, with their 95 % intervals\n\n\
             {differences}\ncalls%: detector calls of 100 frames; all: AP@50 of all boxes, also those too\n\
             faint for a node to publish; delay: frames.\n"
        )
    }
}

/// `+24.1 [18.2, 30.1]`, in points.
fn points(difference: Option<Difference>) -> String {
    let text = difference.map(|difference| match difference.interval {
        None => format!("{:+.1}", 100.0 * difference.mean),
        Some([lower, upper]) => {
            let [mean, lower, upper] = [difference.mean, lower, upper].map(|s| 100.0 * s);
            format!("{mean:+.1} [{lower:.1}, {upper:.1}]")
        }
    });
    text.unwrap_or_default()
}

#[cfg(test)]
mod tests;
