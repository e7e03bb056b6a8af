//! Judges boxes when frames arrive, with a detector that takes its time, and boxes that are settled afterwards.
//!
//! At arrival, a frame is judged by what has been published when it comes. A policy that predicts answers each frame at
//! once and takes detections late ([`LatePolicy`]). Any other one lets frames wait for the detector: it takes the newest
//! frame when it is free, and every frame is judged by the boxes of the last frame that it has finished.

mod run_times;

pub use run_times::RunTimes;

use crate::average_precision::{Accuracy, ScoredBox, outside_ignored};
use crate::data::Clip;
use crate::pictures::{PictureEvidence, PicturedClip};
use crate::replay::drive;
use crate::run::{RunError, Settings, in_parallel, judge, no_evidence};
use crate::scoring::{DEFAULT_DECAY_U, score_reported};
use crate::source::{ClipEvidence, SourceError, StoredEvidence};
use crate::spec::{BASELINE, PolicySpec};
use crate::statistics::mean;
use crate::summary::Difference;
use albireo_core::detection::ObjectId;
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{
    Albireo, BoxSource, Evidence, EvidenceAtHand, FrameHead, LatePolicy, Need, Outcome, OutputBox,
    Policy, PolicyConfig, PolicyConfigError, Settler, decide_at_once,
};
use std::collections::HashMap;
use std::fmt::Write;
use std::time::Duration;

/// Settled frames are held back by this at most, as a node does.
const LONGEST_DELAY: Duration = Duration::from_secs(2);

/// The label of Vanilla's own boxes, smoothed.
const SMOOTHED: &str = "vanilla-smoothed";

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

/// One policy over one clip.
#[derive(Clone, Debug)]
struct Judged {
    policy: usize,
    accuracy: Option<Accuracy>,
    /// Detector calls a frame.
    calls: f64,
    /// Mean delay of a settled frame, frames.
    delay: f64,
}

/// All policies over all clips.
#[derive(Clone, Debug)]
pub struct StreamResults {
    stream: Stream,
    policies: Vec<String>,
    /// By policy, then clip.
    judged: Vec<Judged>,
}

/// The boxes of a clip to be judged.
#[derive(Default)]
struct Published {
    boxes: Vec<Vec<ScoredBox>>,
    calls: usize,
    /// Summed delay, frames.
    delay: u64,
}

/// Runs `policies` over the stored detections of `clips` and judges `stream`.
///
/// # Errors
/// [`RunError`] when a policy cannot be built or a clip has no detections or, at arrival, no frame rate.
pub fn run(
    clips: &[Clip],
    policies: &[PolicySpec],
    settings: &Settings,
    stream: Stream,
) -> Result<StreamResults, RunError> {
    run_clips(clips.len(), policies, settings, stream, &|clip| {
        let clip = &clips[clip];
        let evidence = StoredEvidence::new(clip, settings);
        (clip, evidence.map(|evidence| Box::new(evidence) as _))
    })
}

/// The same of one clip, for policies that look at its pictures.
///
/// # Errors
/// As [`run`].
pub fn run_pictured(
    pictured: &PicturedClip,
    policies: &[PolicySpec],
    settings: &Settings,
    stream: Stream,
) -> Result<StreamResults, RunError> {
    run_clips(1, policies, settings, stream, &|_| {
        let evidence = PictureEvidence::new(pictured, settings);
        (
            &pictured.clip,
            evidence.map(|evidence| Box::new(evidence) as _),
        )
    })
}

/// A clip and the evidence that policies get of it.
type Opened<'a> = (&'a Clip, Result<Box<dyn ClipEvidence + 'a>, SourceError>);

fn run_clips<'a>(
    clips: usize,
    policies: &[PolicySpec],
    settings: &Settings,
    stream: Stream,
    open: &(dyn Fn(usize) -> Opened<'a> + Sync),
) -> Result<StreamResults, RunError> {
    let mut policies = policies.to_vec();
    if stream == Stream::Settled {
        policies.extend(smoothing());
    }
    let steps: Vec<(usize, usize)> = (0..policies.len())
        .flat_map(|policy| (0..clips).map(move |clip| (policy, clip)))
        .collect();
    let judged = in_parallel(&steps, settings.threads, &|| (), &|(index, clip)| {
        let spec = &policies[index];
        let (clip, evidence) = open(clip);
        let policy = spec
            .config
            .build()
            .map_err(|source| cannot_build(spec, source))?;
        let published = evidence
            .and_then(|mut evidence| publish(clip, spec, policy, &mut *evidence, &stream))
            .map_err(|source| no_evidence(clip, spec, source))?;
        let frames = clip.frames.max(1) as f64;
        let boxes = match &clip.truth {
            Some(truth) => outside_ignored(&published.boxes, truth, &clip.ignored),
            None => published.boxes,
        };
        Ok(Judged {
            policy: index,
            accuracy: judge(clip, &boxes, settings),
            calls: published.calls as f64 / frames,
            delay: published.delay as f64 / frames,
        })
    })?;
    Ok(StreamResults {
        stream,
        policies: policies.iter().map(|policy| policy.label.clone()).collect(),
        judged,
    })
}

fn cannot_build(spec: &PolicySpec, source: PolicyConfigError) -> RunError {
    RunError::Policy {
        policy: spec.label.clone(),
        source,
    }
}

fn publish(
    clip: &Clip,
    spec: &PolicySpec,
    mut policy: Box<dyn Policy>,
    source: &mut dyn ClipEvidence,
    stream: &Stream,
) -> Result<Published, SourceError> {
    let Stream::AtArrival { detector } = stream else {
        if spec.label == SMOOTHED {
            return smoothed(&mut *policy, source);
        }
        let interval = Duration::from_secs_f64(1.0 / clip.frame_rate.unwrap_or(10.0).max(0.1));
        return settled(&mut *policy, source, interval);
    };
    let rate = clip.frame_rate.filter(|rate| *rate > 0.0);
    let rate = rate.ok_or_else(|| {
        SourceError::Failed("frames have no times: the clip has no frame rate".to_owned())
    })?;
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
    source: &mut dyn ClipEvidence,
    timing: Timing<'_>,
) -> Result<Published, SourceError> {
    let failed = |error: &dyn std::fmt::Display| SourceError::Failed(error.to_string());
    let mut late = LatePolicy::new(policy).map_err(|error| failed(&error))?;
    let mut published = Published::default();
    let (mut outcome, mut unused) = (Outcome::default(), Outcome::default());
    // The frame that waits, what for, and when that comes.
    let mut waits: Option<(usize, Need, f64)> = None;
    for frame in 0..source.frames() {
        let now = frame as f64 * timing.interval;
        while let Some((asked, need, at)) = waits
            && at <= now + SAME_TIME
        {
            let mut stored = Stored {
                source: &mut *source,
                frame: asked,
                calls: 0,
            };
            let evidence = stored.evidence(need)?;
            let next = late.deliver(asked as u64, evidence, &mut unused);
            let next = next.map_err(|error| failed(&error))?;
            let took = timing.of(next, published.calls);
            published.calls += usize::from(next == Need::Detections);
            waits = (next != Need::Nothing).then_some((asked, next, at + took));
        }
        let need = late.frame(head(frame, 1, source.picture()), &mut outcome);
        if need != Need::Nothing {
            waits = Some((frame, need, now + timing.of(need, published.calls)));
        }
        published.calls += usize::from(need == Need::Detections);
        published
            .boxes
            .push(scored(&outcome.boxes, source.picture()));
    }
    Ok(published)
}

/// Frames wait for the detector; those that come meanwhile are lost but for the newest.
fn when_known(
    policy: &mut dyn Policy,
    source: &mut dyn ClipEvidence,
    timing: Timing<'_>,
) -> Result<Published, SourceError> {
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
        let mut stored = Stored {
            source: &mut *source,
            frame,
            calls: 0,
        };
        decide_at_once(policy, head, &mut stored, &mut outcome)?;
        free = start;
        for _ in 0..stored.calls {
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
        last = scored(&outcome.boxes, source.picture());
    }
    published.boxes.resize(source.frames(), last);
    Ok(published)
}

/// Frames wait for the detector, which takes no time, and are settled.
fn settled(
    policy: &mut dyn Policy,
    source: &mut dyn ClipEvidence,
    interval: Duration,
) -> Result<Published, SourceError> {
    let picture = source.picture();
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
            boxes.push(scored(frame.boxes, picture));
        });
    })?;
    settler.flush(|frame| boxes.push(scored(frame.boxes, picture)));
    published.boxes = boxes;
    published.calls = calls;
    published.delay = delay;
    Ok(published)
}

/// The control of what is settled: Vanilla's own boxes, and where the detector missed an object between two of its
/// detections, boxes on the line between these.
fn smoothed(
    policy: &mut dyn Policy,
    source: &mut dyn ClipEvidence,
) -> Result<Published, SourceError> {
    let picture = source.picture();
    let mut published = Published::default();
    let mut last: HashMap<ObjectId, (usize, OutputBox)> = HashMap::new();
    drive(policy, source, &mut |_, played| {
        published.calls += usize::from(played.record.detector);
        let detected = |found: &&OutputBox| found.source == BoxSource::Detected;
        let found = played.outcome.boxes.iter().filter(detected);
        let now = played.frame;
        published.boxes.push(Vec::new());
        for own in found {
            published.boxes[now].push(score_reported(own, picture));
            let Some(object) = own.object else {
                continue;
            };
            let Some((then, before)) = last.insert(object, (now, *own)) else {
                continue;
            };
            for missed in then + 1..now {
                let share = (missed - then) as f64 / (now - then) as f64;
                let line = |before: f64, now: f64| before + share * (now - before);
                let (from, to) = (before.bounding_box, own.bounding_box);
                let drawn = OutputBox {
                    bounding_box: BoundingBox {
                        center_x: line(from.center_x, to.center_x),
                        center_y: line(from.center_y, to.center_y),
                        width: line(from.width, to.width),
                        height: line(from.height, to.height),
                    },
                    confidence: (before.confidence + own.confidence) / 2.0,
                    ..*own
                };
                published.boxes[missed].push(score_reported(&drawn, picture));
            }
        }
    })?;
    Ok(published)
}

/// What joins Vanilla's detections to objects for [`smoothed`]: Albireo's matching, with the detector on every frame.
fn smoothing() -> Option<PolicySpec> {
    let mut config = PolicyConfig {
        u: Albireo::KNOB.minimum,
        ..PolicyConfig::default()
    };
    config.select(Albireo::NAME).ok()?;
    Some(PolicySpec {
        label: SMOOTHED.to_owned(),
        config,
        decay_u: DEFAULT_DECAY_U,
    })
}

fn head(frame: usize, step: u32, picture: PictureSize) -> FrameHead {
    FrameHead {
        index: frame as u64,
        step,
        picture,
    }
}

fn scored(boxes: &[OutputBox], picture: PictureSize) -> Vec<ScoredBox> {
    let score = |output| score_reported(output, picture);
    boxes.iter().map(score).collect()
}

/// One frame of a source.
struct Stored<'a> {
    source: &'a mut dyn ClipEvidence,
    frame: usize,
    /// Detector calls so far.
    calls: usize,
}

impl EvidenceAtHand for Stored<'_> {
    type Error = SourceError;

    fn evidence(&mut self, need: Need) -> Result<Evidence<'_>, SourceError> {
        let known = match need {
            Need::Nothing => None,
            Need::Screen => {
                let empty = self.source.screen_says_empty(self.frame)?;
                empty.map(|empty| Evidence::Screen { empty })
            }
            Need::GreyPicture | Need::SmallGreyPicture { .. } => {
                let grey = self.source.grey_picture(self.frame, need)?;
                grey.map(Evidence::GreyPicture)
            }
            Need::Detections => {
                self.calls += 1;
                self.source
                    .detections(self.frame)?
                    .map(Evidence::Detections)
            }
        };
        Ok(known.unwrap_or(Evidence::Unavailable))
    }
}

/// One of the figures of accuracy.
type Figure = fn(&Accuracy) -> f64;

/// A column of the table: the mean, and the difference to the baseline with its interval, in points.
const FIGURES: [(&str, Figure); 3] = [
    ("AP@50", |accuracy| accuracy.ap50),
    ("AP@75", |accuracy| accuracy.ap75),
    ("F1@50 >=.3", |accuracy| accuracy.f1_50_shown),
];

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
        self.judged.extend(others.judged);
    }

    /// The table: one line a policy.
    pub fn table(&self) -> String {
        let title = match &self.stream {
            Stream::AtArrival { detector } => format!(
                "Judged when frames arrive, with a detector that takes {}",
                detector.describe()
            ),
            Stream::Settled => "Judged when settled between two detector calls".to_owned(),
        };
        let baseline = self.policies.iter().position(|policy| policy == BASELINE);
        let clips = baseline.map_or(0, |baseline| self.of(baseline).len());
        // Writing to a string cannot fail.
        let mut text = format!("{title};\nmeans over {clips} clips\n\n");
        let _ = write!(text, "{:<22} {:>6}", "policy", "calls%");
        for (name, _) in FIGURES {
            let _ = write!(text, " {name:>10}");
        }
        let _ = writeln!(text, " {:>5} {:>5} {:>5}", "F1@50", "mAP", "delay");
        for (index, policy) in self.policies.iter().enumerate() {
            let own = self.of(index);
            let average = |figure: fn(&Judged) -> f64| {
                mean(own.iter().map(|judged| figure(judged))).unwrap_or_default()
            };
            let calls = 100.0 * average(|judged| judged.calls);
            let _ = write!(text, "{:<22} {calls:>6.1}", crate::table::short(policy));
            for (_, figure) in FIGURES {
                let _ = write!(text, " {:>10}", three(&own, figure));
            }
            let rest = [three(&own, |a| a.f1_50), three(&own, |a| a.map)];
            let delay = average(|judged| judged.delay);
            let _ = writeln!(text, " {} {} {delay:>5.1}", rest[0], rest[1]);
        }
        if let Some(baseline) = baseline {
            self.write_differences(baseline, &mut text);
        }
        text.push_str("\ncalls%: detector calls of 100 frames; delay: frames.\n");
        if self.stream == Stream::Settled {
            text.push_str("vanilla-smoothed fills gaps when an object is found again, however late:\nits delay is not counted.\n");
        }
        text
    }

    /// The table of differences to the baseline: one line for each other policy.
    fn write_differences(&self, baseline: usize, text: &mut String) {
        text.push_str("\nDifferences to vanilla in points, with their 95 % intervals\n\n");
        let _ = write!(text, "{:<22}", "policy");
        for (name, _) in FIGURES {
            let _ = write!(text, " {name:>18}");
        }
        text.push('\n');
        for (index, policy) in self.policies.iter().enumerate() {
            if index == baseline {
                continue;
            }
            let _ = write!(text, "{:<22}", crate::table::short(policy));
            for (_, figure) in FIGURES {
                let _ = write!(text, " {:>18}", self.against(index, baseline, figure));
            }
            text.push('\n');
        }
    }

    /// A policy's results on the clips with ground truth, in order of clips.
    fn of(&self, policy: usize) -> Vec<&Judged> {
        let own = self.judged.iter().filter(|judged| judged.policy == policy);
        own.filter(|judged| judged.accuracy.is_some()).collect()
    }

    fn against(&self, policy: usize, baseline: usize, figure: Figure) -> String {
        let (own, base) = (self.of(policy), self.of(baseline));
        let differences: Vec<f64> = (own.iter().zip(&base))
            .filter_map(|(own, base)| Some(figure(&own.accuracy?) - figure(&base.accuracy?)))
            .collect();
        let points = |share: f64| 100.0 * share;
        match Difference::of(&differences) {
            None => String::new(),
            Some(Difference { mean, t: None, .. }) => format!("{:+.1}", points(mean)),
            Some(Difference {
                mean, t: Some(t), ..
            }) => {
                let (mean, lower, upper) = (points(mean), points(t.lower), points(t.upper));
                format!("{mean:+.1} [{lower:.1}, {upper:.1}]")
            }
        }
    }
}

/// The mean of a figure with three decimals.
fn three(judged: &[&Judged], figure: Figure) -> String {
    let values = judged
        .iter()
        .filter_map(|judged| judged.accuracy.as_ref().map(figure));
    mean(values).map_or("    -".to_owned(), |value| format!("{value:.3}"))
}

#[cfg(test)]
mod tests;
