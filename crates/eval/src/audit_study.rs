//! The audit's claim, put to the test on recordings: does what it estimates from a sample hold for all frames, and what
//! does that say of accuracy against the truth?
//!
//! On a recording everything is known: what the detector says of the frames that a policy answered without it, and the
//! ground truth. So the full comparison with the detector stands beside what samples of it estimate, many times over, and
//! beside the change of average precision that skipping really costs.

mod text;

pub use text::render;

use crate::against_detector::{ComparedFrame, total};
use crate::data::Clip;
use crate::frontier::{Candidate, FrontierError, OperatingPoint, View, ViewedClip};
use crate::statistics::mean;
use albireo_core::audit::{AuditDraw, AuditRate, AuditSums};
use albireo_core::policy::Vanilla;
use rayon::iter::{IntoParallelIterator, IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;

/// The policies of the table, each at several settings from hardly a skip to most frames.
pub const POLICIES: [&str; 16] = [
    "albireo:2e-4",
    "albireo:3e-4",
    "albireo:5e-4",
    "albireo:7e-4",
    "albireo:1e-3",
    "expected-loss:0.05",
    "expected-loss:0.1",
    "expected-loss:0.2",
    "expected-loss:0.3",
    "expected-loss:0.5",
    "expected-loss:0.8",
    "expected-loss:1.2",
    "fixed-skip:2",
    "fixed-skip:3",
    "fixed-skip:5",
    "fixed-skip:8",
];

/// Shares of the frames without the detector that are looked at.
pub const SHARES: [f64; 3] = [0.02, 0.05, 0.10];

/// A policy at one setting: against the detector on all its skipped frames, and against the truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the policy.
    pub policy: String,
    /// The value of its knob.
    pub value: Option<f64>,
    /// Mean share of frames without the detector.
    pub skip_rate: f64,
    /// Share of the detector's boxes on skipped frames that are shown, all clips together.
    pub recall: f64,
    /// Share of the boxes shown on skipped frames that the detector confirms.
    pub precision: f64,
    /// Harmonic mean of the two.
    pub f1: f64,
    /// Mean AP@50 against ground truth, over all frames.
    pub ap50: f64,
    /// Mean change of AP@50 against Vanilla on the same detections.
    pub change: f64,
    /// Samples of the comparison, one entry a share.
    pub samples: Vec<Sample>,
}

/// What samples of one share estimate, over many seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sample {
    /// Share of skipped frames looked at.
    pub share: f64,
    /// Mean number of frames looked at.
    pub frames: f64,
    /// Of recall.
    pub recall: Claim,
    /// Of precision.
    pub precision: Claim,
}

/// How a claim fares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Claim {
    /// Number of samples that could say something.
    pub samples: usize,
    /// Mean estimate minus the full comparison.
    pub bias: f64,
    /// Standard deviation of the estimates.
    pub deviation: f64,
    /// Share of the 95 % intervals that hold the full comparison.
    pub coverage: f64,
    /// Mean half width of the intervals.
    pub half_width: f64,
}

/// The study.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AuditStudy {
    /// How the recordings were looked at.
    pub view: View,
    /// Number of clips.
    pub clips: usize,
    /// Vanilla's mean AP@50.
    pub vanilla: f64,
    /// Samples drawn for each share.
    pub seeds: u64,
    /// One row a policy and setting.
    pub rows: Vec<Row>,
}

/// Puts `policies` (`NAME:VALUE`) to the test on `clips`; `done` is called after each.
///
/// # Errors
/// [`FrontierError`] when no clip can be judged or a policy fails.
pub fn study(
    clips: &[Clip],
    view: &View,
    policies: &[String],
    seeds: u64,
    done: &dyn Fn(),
) -> Result<AuditStudy, FrontierError> {
    let viewed: Vec<_> = clips.iter().filter_map(|clip| view.look(clip)).collect();
    if viewed.is_empty() {
        return Err(FrontierError::NoClips);
    }
    let vanilla = Candidate::as_reported(Vanilla::NAME)?.run(&viewed)?;
    let rows = policies
        .iter()
        .map(|asked| {
            let row = row(&Candidate::as_reported(asked)?, &viewed, &vanilla, seeds);
            done();
            row
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(AuditStudy {
        view: view.clone(),
        clips: viewed.len(),
        vanilla: vanilla.ap50,
        seeds,
        rows,
    })
}

fn row(
    candidate: &Candidate,
    viewed: &[ViewedClip],
    vanilla: &OperatingPoint,
    seeds: u64,
) -> Result<Row, FrontierError> {
    let point = candidate.run(viewed)?;
    let compared = viewed
        .par_iter()
        .map(|clip| candidate.against_detector(clip))
        .collect::<Result<Vec<_>, _>>()?;
    let mut full = AuditSums::default();
    for frames in &compared {
        full.merge(&total(frames));
    }
    let rate = |of: Option<AuditRate>| of.map_or(0.0, |rate| rate.rate);
    let (recall, precision) = (rate(full.recall()), rate(full.precision()));
    let pairs = point.clips.iter().zip(&vanilla.clips);
    Ok(Row {
        policy: point.policy,
        value: point.value,
        skip_rate: point.skip_rate,
        recall,
        precision,
        f1: if recall + precision > 0.0 {
            2.0 * recall * precision / (recall + precision)
        } else {
            0.0
        },
        ap50: point.ap50,
        change: mean(pairs.map(|(own, other)| own.ap50 - other.ap50)).unwrap_or_default(),
        samples: SHARES
            .map(|share| sample(&compared, share, seeds, &full))
            .to_vec(),
    })
}

/// The sums of the frames of all clips that are drawn with `seed`; every clip is a camera with draws of its own.
pub fn drawn(compared: &[Vec<ComparedFrame>], share: f64, seed: u64) -> AuditSums {
    let mut sums = AuditSums::default();
    for (camera, frames) in (0u64..).zip(compared) {
        let draw = AuditDraw::new(share, (seed << 16) + camera);
        for frame in frames.iter().filter(|frame| draw.draw(frame.index)) {
            if let Some(compared) = &frame.sums {
                sums.merge(compared);
            }
        }
    }
    sums
}

fn sample(compared: &[Vec<ComparedFrame>], share: f64, seeds: u64, full: &AuditSums) -> Sample {
    let samples: Vec<AuditSums> = (0..seeds)
        .into_par_iter()
        .map(|seed| drawn(compared, share, seed))
        .collect();
    let claim = |of: fn(&AuditSums) -> Option<AuditRate>| {
        of(full).map_or_else(Claim::default, |full| {
            let estimates: Vec<_> = samples.iter().filter_map(of).collect();
            Claim::new(&estimates, full.rate)
        })
    };
    Sample {
        share,
        frames: mean(samples.iter().map(|sums| sums.total().frames as f64)).unwrap_or_default(),
        recall: claim(AuditSums::recall),
        precision: claim(AuditSums::precision),
    }
}

impl Claim {
    fn new(estimates: &[AuditRate], truth: f64) -> Self {
        let over = |of: &dyn Fn(&AuditRate) -> f64| mean(estimates.iter().map(of));
        let average = over(&|estimate| estimate.rate).unwrap_or_default();
        let variance = over(&|estimate| (estimate.rate - average).powi(2)).unwrap_or_default();
        let holds = |estimate: &AuditRate| (estimate.low..=estimate.high).contains(&truth);
        Self {
            samples: estimates.len(),
            bias: average - truth,
            deviation: variance.sqrt(),
            coverage: over(&|estimate| f64::from(u8::from(holds(estimate)))).unwrap_or_default(),
            half_width: over(&|estimate| (estimate.high - estimate.low) / 2.0).unwrap_or_default(),
        }
    }

    /// How many standard errors of the mean the bias is.
    pub fn standard_errors(&self) -> f64 {
        if self.deviation > 0.0 {
            self.bias / (self.deviation / (self.samples as f64).sqrt())
        } else {
            0.0
        }
    }
}
