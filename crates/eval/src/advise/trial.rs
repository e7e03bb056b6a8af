//! One candidate with one value of its knob, over the whole recording.

use super::estimate::Estimate;
use super::recording::Recording;
use super::target::Target;
use crate::against_detector::{ComparedFrame, against_detector};
use crate::energy_model::EnergyModel;
use crate::run;
use crate::source::{ScreenRule, SourceError};
use albireo_core::detection::Detection;
use albireo_core::policy::{FrameState, PolicyConfig, PolicyConfigError};
use serde::Serialize;

/// Blocks that a recording is cut into, if it is long enough.
const BLOCKS: usize = 40;

/// Frames of a block at least: one that ends with an object's visit says nothing of the next.
const LEAST_FRAMES: usize = 20;

/// How the advice is found.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Detections below this are not used.
    pub confidence: f64,
    /// Frames in a row that a screen may call empty before the detector looks anyway; 0 for any number.
    pub longest_empty_run: u32,
    /// What the loads come from.
    pub costs: Costs,
}

/// What a load is made of.
#[derive(Clone, Debug, Default)]
pub struct Costs {
    /// Frames a second, where the recording does not say.
    pub frame_rate: Option<f64>,
    /// Milliseconds of the detector on a frame; without it what the pass measured, else the energy model's.
    pub detector_ms: Option<f64>,
    /// Joules and milliseconds of the kinds of work.
    pub model: Option<EnergyModel>,
}

/// Why there is no advice.
#[derive(Debug, thiserror::Error)]
pub enum AdviceError {
    /// A policy cannot be built.
    #[error("--policy {policy}: {source}")]
    Policy {
        /// What was asked for.
        policy: String,
        /// Why not.
        source: PolicyConfigError,
    },
    /// A policy has nothing to turn.
    #[error("--policy {policy}: it has no knob to meet a target with")]
    NoKnob {
        /// What was asked for.
        policy: String,
    },
    /// A clip's evidence does not suffice.
    #[error("{clip}: {source}")]
    Source {
        /// The clip.
        clip: String,
        /// What it does not have.
        source: SourceError,
    },
    /// There is nothing to learn from.
    #[error("the recording has no frame, or the detector found nothing in it at this --confidence")]
    Nothing,
    /// The target needs a figure that is not there.
    #[error("{0}")]
    Missing(&'static str),
}

/// Which empty-scene screen a candidate has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Screen {
    /// None.
    None,
    /// The model whose verdicts were recorded.
    Model,
}

impl Screen {
    /// Its name in tables.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Model => "model",
        }
    }
}

/// Consecutive frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Block {
    frames: u32,
    skipped: u32,
    predicted: u32,
    detector: u32,
    screened: u32,
    /// The detector's boxes on the skipped frames, and those of them that were shown.
    detected: [u64; 2],
    /// Shown boxes on the skipped frames, and those that the detector confirms.
    shown: [u64; 2],
}

impl Block {
    fn count(&mut self, frame: &ComparedFrame) {
        self.frames += 1;
        self.predicted += u32::from(frame.state == FrameState::P);
        self.detector += u32::from(!frame.state.is_skipped());
        self.screened += u32::from(frame.screen);
        if let Some(sums) = &frame.sums {
            self.skipped += 1;
            for (own, boxes) in [
                (&mut self.detected, sums.detected),
                (&mut self.shown, sums.shown),
            ] {
                own[0] += boxes;
                own[1] += sums.paired;
            }
        }
    }
}

/// What became of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Trial {
    /// The value of the knob.
    pub value: f64,
    pub blocks: Vec<Block>,
    screen: Screen,
}

const SHARE: [f64; 2] = [0.0, 1.0];
const AMOUNT: [f64; 2] = [0.0, f64::INFINITY];

/// A sum over a block as a floating-point number.
type Part = fn(&Block) -> f64;

impl Trial {
    /// Of the blocks whose number is `parity` modulo 2.
    pub(super) fn half(&self, parity: usize) -> Self {
        let blocks = self.blocks.iter().enumerate();
        Self {
            blocks: blocks
                .filter(|(index, _)| index % 2 == parity)
                .map(|(_, block)| *block)
                .collect(),
            ..*self
        }
    }

    fn ratio(&self, above: Part, below: Part, range: [f64; 2]) -> Option<Estimate> {
        let parts = self.blocks.iter().map(|block| (above(block), below(block)));
        Estimate::ratio(parts, range)
    }

    fn per_frame(&self, part: Part) -> Option<Estimate> {
        self.ratio(part, |block| f64::from(block.frames), SHARE)
    }

    /// Share of the detector's boxes on skipped frames that were shown; `None` where it has none.
    pub(super) fn recall(&self) -> Option<Estimate> {
        self.ratio(
            |block| block.detected[1] as f64,
            |block| block.detected[0] as f64,
            SHARE,
        )
    }

    /// Share of the boxes shown on skipped frames that the detector confirms.
    pub(super) fn precision(&self) -> Option<Estimate> {
        self.ratio(
            |block| block.shown[1] as f64,
            |block| block.shown[0] as f64,
            SHARE,
        )
    }

    pub(super) fn skip_rate(&self) -> Option<Estimate> {
        self.per_frame(|block| f64::from(block.skipped))
    }

    /// Milliseconds of detector a second.
    pub(super) fn detector_ms_per_s(&self, rates: &Rates) -> Option<Estimate> {
        let factor = rates.frame_rate? * rates.detector_ms?;
        let calls = self.per_frame(|block| f64::from(block.detector))?;
        (factor > 0.0).then(|| calls.times(factor))
    }

    /// Joules of a frame, without what is drawn between frames.
    pub(super) fn joules_per_frame(&self, model: &EnergyModel) -> Option<Estimate> {
        self.cost(&model.energy_j)
    }

    fn cost(&self, costs: &crate::energy_model::Costs) -> Option<Estimate> {
        let screen = match self.screen {
            Screen::Model => 1.0,
            Screen::None => 0.0,
        };
        let parts = self.blocks.iter().map(|block| {
            let work = [
                f64::from(block.detector),
                f64::from(block.predicted),
                screen * f64::from(block.screened),
            ];
            (costs.total(work), f64::from(block.frames))
        });
        Estimate::ratio(parts, AMOUNT)
    }

    /// Watts of a camera: with what is drawn between frames where the model knows it.
    pub(super) fn watts(&self, rates: &Rates) -> Option<Estimate> {
        let (model, rate) = (rates.model.as_ref()?, rates.frame_rate?);
        let work = self.joules_per_frame(model)?.times(rate);
        Some(match model.idle_power_w {
            None => work,
            Some(idle) => {
                let busy = self.cost(&model.time_ms)?.value * rate / 1e3;
                work.plus(idle * (1.0 - busy).max(0.0))
            }
        })
    }

    /// Whether this meets `target`.
    pub(super) fn meets(&self, target: Target, rates: &Rates) -> bool {
        match target {
            // Where nothing was there to be shown nothing was lost.
            Target::Recall(least) => self.recall().is_none_or(|recall| recall.low >= least),
            Target::SkipRate(least) => self.skip_rate().is_some_and(|rate| rate.value >= least),
            Target::DetectorMsPerS(most) => {
                (self.detector_ms_per_s(rates)).is_some_and(|load| load.value <= most)
            }
            Target::Watts(most) => self.watts(rates).is_some_and(|load| load.value <= most),
            Target::JoulesPerDay(most) => {
                (self.watts(rates)).is_some_and(|load| load.value * SECONDS_PER_DAY <= most)
            }
        }
    }
}

const SECONDS_PER_DAY: f64 = 86_400.0;

/// What turns calls into loads.
#[derive(Clone, Debug)]
pub(super) struct Rates {
    pub frame_rate: Option<f64>,
    pub detector_ms: Option<f64>,
    pub model: Option<EnergyModel>,
}

impl Rates {
    /// What `costs` say, and the recordings where they do not.
    pub(super) fn new(costs: &Costs, recordings: &[Recording]) -> Self {
        let (mut frames, mut seconds) = (0.0, 0.0);
        let mut known = true;
        for recording in recordings {
            let clip = &recording.clip;
            match costs.frame_rate.or(clip.frame_rate) {
                Some(rate) if rate > 0.0 => {
                    frames += clip.frames as f64;
                    seconds += clip.frames as f64 / rate;
                }
                _ => known = false,
            }
        }
        let (mut timed, mut milliseconds) = (0.0, 0.0);
        for recording in recordings {
            if let Some(mean) = recording.detector_ms {
                timed += recording.clip.frames as f64;
                milliseconds += mean * recording.clip.frames as f64;
            }
        }
        let measured = (timed > 0.0).then(|| milliseconds / timed);
        let projected = || costs.model.as_ref().map(|model| model.time_ms.detector);
        Self {
            frame_rate: (known && seconds > 0.0).then(|| frames / seconds),
            detector_ms: costs.detector_ms.or(measured).or_else(projected),
            model: costs.model.clone(),
        }
    }

    /// Whether `target` can be judged.
    pub(super) fn suffice_for(&self, target: Target) -> Result<(), AdviceError> {
        let needs_rate = !matches!(target, Target::Recall(_) | Target::SkipRate(_));
        if needs_rate && self.frame_rate.is_none() {
            return Err(AdviceError::Missing(
                "the recording does not say how many frames a second it has: give --rate",
            ));
        }
        match target {
            Target::Recall(_) | Target::SkipRate(_) => Ok(()),
            Target::DetectorMsPerS(_) if self.detector_ms.is_none() => Err(AdviceError::Missing(
                "nobody knows how long the detector takes: give --detector-ms",
            )),
            Target::DetectorMsPerS(_) => Ok(()),
            Target::Watts(_) | Target::JoulesPerDay(_) => match self.model {
                Some(_) => Ok(()),
                None => Err(AdviceError::Missing(
                    "watts and joules need an energy model: name one with --energy-model",
                )),
            },
        }
    }
}

/// A recording made ready: detections as policies take them, and the blocks that its frames fall into.
pub(super) struct Prepared<'a> {
    recording: &'a Recording,
    detected: Vec<Vec<Detection>>,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(recording: &'a Recording, confidence: f64) -> Self {
        let clip = &recording.clip;
        let sure = |frame: &Vec<crate::data::StoredDetection>| {
            (frame.iter())
                .filter(|detection| detection.confidence >= confidence)
                .map(|detection| detection.normalise(clip.picture))
                .collect()
        };
        Self {
            recording,
            detected: clip.detections.iter().flatten().map(sure).collect(),
        }
    }

    pub(super) fn frames(&self) -> usize {
        self.detected.len()
    }

    pub(super) fn boxes(&self) -> usize {
        self.detected.iter().map(Vec::len).sum()
    }
}

/// Frames of a block in recordings of so many frames in all.
pub(super) fn block_length(frames: usize) -> usize {
    (frames / BLOCKS).max(LEAST_FRAMES)
}

/// Replays the policy of `config`, whose knob is at `value`, over all recordings.
pub(super) fn try_out(
    prepared: &[Prepared<'_>],
    config: &PolicyConfig,
    value: f64,
    screen: Screen,
    settings: &Settings,
) -> Result<Trial, AdviceError> {
    let refused = |source| AdviceError::Policy {
        policy: config.name.clone(),
        source,
    };
    let mut turned = config.clone();
    turned
        .set_argument(&format!("{value:e}"))
        .map_err(refused)?;
    let mut policy = turned.build().map_err(refused)?;
    let settings = run::Settings {
        confidence: settings.confidence,
        longest_empty_run: settings.longest_empty_run,
        screen: match screen {
            Screen::None => ScreenRule::Nonempty,
            Screen::Model => ScreenRule::Recorded,
        },
        ..run::Settings::default()
    };
    let length = block_length(prepared.iter().map(Prepared::frames).sum());
    let mut blocks = Vec::new();
    for clip in prepared {
        let recording = clip.recording;
        let failed = |source| AdviceError::Source {
            clip: recording.clip.name.clone(),
            source,
        };
        let compared = against_detector(policy.as_mut(), &recording.clip, &settings);
        // The rest of a clip, too short for a block of its own, belongs to its last one.
        let compared = compared.map_err(failed)?;
        let count = (compared.len() / length).max(1);
        let mut own = vec![Block::default(); count];
        for (index, frame) in compared.iter().enumerate() {
            own[(index / length).min(count - 1)].count(frame);
        }
        blocks.extend(own);
    }
    Ok(Trial {
        value,
        blocks,
        screen,
    })
}
