//! Judges boxes when frames arrive, with a detector that takes its time, and boxes that are settled afterwards.
//!
//! At arrival, a frame is judged by what has been published when it comes. A policy that predicts answers each frame at
//! once and takes detections late ([`LatePolicy`]). Any other one lets frames wait for the detector: it takes the newest
//! frame when it is free, and every frame is judged by the boxes of the last frame that it has finished.

mod run_times;

pub use run_times::RunTimes;

use crate::average_precision::Accuracy;
use crate::data::Clip;
use crate::pictures::{PictureEvidence, PicturedClip};
use crate::replay::{ClipFrame, drive};
use crate::run::{RunError, Settings, in_parallel, judge, no_evidence};
use crate::scoring::score_published;
use crate::source::{ClipEvidence, SourceError, StoredEvidence};
use crate::spec::{BASELINE, PolicySpec};
use crate::statistics::mean;
use crate::summary::Difference;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    EvidenceAtHand, FrameHead, LatePolicy, Need, Outcome, OutputBox, Policy, Settler,
    decide_at_once,
};
use std::fmt::Write;
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

/// One policy over one clip.
#[derive(Clone, Debug)]
struct Judged {
    policy: usize,
    /// Of the published boxes.
    accuracy: Option<Accuracy>,
    /// Of all boxes of the policy.
    accuracy_all: Option<Accuracy>,
    /// Detector calls per frame.
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
    boxes: Vec<Vec<OutputBox>>,
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
    let steps: Vec<(usize, usize)> = (0..policies.len())
        .flat_map(|policy| (0..clips).map(move |clip| (policy, clip)))
        .collect();
    let judged = in_parallel(&steps, settings.threads, &|| (), &|(index, clip)| {
        let spec = &policies[index];
        let (clip, evidence) = open(clip);
        let policy = spec.config.build().map_err(|source| RunError::Policy {
            policy: spec.label.clone(),
            source,
        })?;
        let published = evidence
            .and_then(|mut evidence| publish(clip, policy, &mut *evidence, &stream))
            .map_err(|source| no_evidence(clip, spec, source))?;
        let frames = clip.frames.max(1) as f64;
        let min_confidence = settings.min_confidence();
        let (boxes, all): (Vec<_>, Vec<_>) = (published.boxes.iter())
            .map(|boxes| score_published(boxes, clip.picture, min_confidence))
            .unzip();
        Ok(Judged {
            policy: index,
            accuracy: judge(clip, &boxes, settings),
            accuracy_all: judge(clip, &all, settings),
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

fn publish(
    clip: &Clip,
    mut policy: Box<dyn Policy>,
    source: &mut dyn ClipEvidence,
    stream: &Stream,
) -> Result<Published, SourceError> {
    let Stream::AtArrival { detector } = stream else {
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
        while let Some((waiting_frame, need, at)) = waits
            && at <= now + SAME_TIME
        {
            let mut stored = ClipFrame::new(&mut *source, waiting_frame);
            let evidence = stored.evidence(need)?;
            let next = late.deliver(waiting_frame as u64, evidence, &mut unused);
            let next = next.map_err(|error| failed(&error))?;
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
        let mut stored = ClipFrame::new(&mut *source, frame);
        decide_at_once(policy, head, &mut stored, &mut outcome)?;
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
    source: &mut dyn ClipEvidence,
    interval: Duration,
) -> Result<Published, SourceError> {
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

/// One of the figures of a policy on a clip.
type Figure = fn(&Judged) -> Option<f64>;

/// A column of the table: the mean, and the difference to the baseline with its interval, in points.
const FIGURES: [(&str, Figure); 3] = [
    ("AP@50", |judged| Some(judged.accuracy?.ap50)),
    ("AP@75", |judged| Some(judged.accuracy?.ap75)),
    ("F1@50 >=.3", |judged| Some(judged.accuracy?.f1_50_shown)),
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

    /// The table: one line per policy.
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
        let _ = writeln!(text, " {:>5} {:>5} {:>5}", "mAP", "all", "delay");
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
            let map = three(&own, |judged| Some(judged.accuracy?.map));
            let all = three(&own, |judged| Some(judged.accuracy_all?.ap50));
            let delay = average(|judged| judged.delay);
            let _ = writeln!(text, " {map:>5} {all:>5} {delay:>5.1}");
        }
        if let Some(baseline) = baseline {
            self.write_differences(baseline, &mut text);
        }
        text.push_str("\ncalls%: detector calls of 100 frames; all: AP@50 of all boxes, also those too\nfaint for a node to publish; delay: frames.\n");
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
            .filter_map(|(own, base)| Some(figure(own)? - figure(base)?))
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
    let values = judged.iter().filter_map(|judged| figure(judged));
    mean(values).map_or("    -".to_owned(), |value| format!("{value:.3}"))
}

#[cfg(test)]
mod tests;
