//! Tries one value of a policy's threshold on the whole recording.

use super::estimate::Estimate;
use super::target::Target;
use crate::data::Clip;
use crate::error::EvalError;
use crate::run::against_detector;
use crate::settings::ScreenRule;
use crate::settings::Settings;
use albireo_core::audit::AuditSums;
use albireo_core::policy::PolicyConfig;

/// The number of blocks that a recording is cut into, if it is long enough.
const BLOCKS: usize = 40;

/// The fewest frames per block. Shorter blocks would share objects and would not be independent.
const MIN_BLOCK_FRAMES: usize = 20;

/// The counts of a block of consecutive frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Block {
    frames: u32,
    skipped: u32,
    /// The detector's boxes on the skipped frames.
    detected: u64,
    /// Shown boxes on the skipped frames.
    shown: u64,
    /// Pairs of a detected and a shown box.
    paired: u64,
}

impl Block {
    /// Adds a frame and, if it skipped the detector, the comparison of its boxes.
    fn count(&mut self, compared: Option<&AuditSums>) {
        self.frames += 1;
        if let Some(sums) = compared {
            self.skipped += 1;
            self.detected += sums.detected;
            self.shown += sums.shown;
            self.paired += sums.paired;
        }
    }
}

/// The outcome of one value on a recording, or on a part of it: the counts of its blocks.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Trial(Vec<Block>);

impl Trial {
    /// Every second block: those whose index is `parity` modulo 2.
    pub(super) fn half(&self, parity: usize) -> Self {
        Self(self.0.iter().skip(parity).step_by(2).copied().collect())
    }

    /// Adds the blocks of another part.
    pub(super) fn extend(&mut self, other: Self) {
        self.0.extend(other.0);
    }

    fn ratio(&self, part: fn(&Block) -> [f64; 2]) -> Option<Estimate> {
        Estimate::ratio(self.0.iter().map(part))
    }

    /// Share of the detector's boxes on skipped frames that were shown; `None` where it has none.
    pub(super) fn recall(&self) -> Option<Estimate> {
        self.ratio(|block| [block.paired as f64, block.detected as f64])
    }

    /// Share of the boxes shown on skipped frames that the detector confirms.
    pub(super) fn precision(&self) -> Option<Estimate> {
        self.ratio(|block| [block.paired as f64, block.shown as f64])
    }

    /// Share of frames without the detector.
    pub(super) fn skip_rate(&self) -> Option<Estimate> {
        self.ratio(|block| [block.skipped.into(), block.frames.into()])
    }

    /// True if this meets `target`, and the detector confirms at least a share of `least_precision` of the boxes shown.
    pub(super) fn meets(&self, target: Target, least_precision: f64) -> bool {
        // If nothing was shown on the skipped frames, nothing was wrong.
        let is_precise = self.precision().is_none_or(|precision| precision.low >= least_precision);
        let reaches_target = match target {
            // If the detector found nothing on the skipped frames, nothing was lost.
            Target::Recall(least) => self.recall().is_none_or(|recall| recall.low >= least),
            Target::SkipRate(least) => self.skip_rate().is_some_and(|rate| rate.value >= least),
        };
        is_precise && reaches_target
    }
}

/// Creates the error for a policy that cannot be used.
pub(super) fn refused(reason: impl std::fmt::Display) -> EvalError {
    EvalError::new(reason).context("--policy")
}

/// Replays the policy of `config`, with its threshold at `value`, over all clips.
pub(super) fn try_out(
    clips: &[Clip],
    config: &PolicyConfig,
    value: f64,
    screen: ScreenRule,
    settings: &Settings,
) -> Result<Trial, EvalError> {
    let mut config = config.clone();
    config.set_argument(&format!("{value:e}")).map_err(refused)?;
    let mut policy = config.build().map_err(refused)?;
    let settings = Settings {
        screen,
        ..settings.clone()
    };
    let frames: usize = clips.iter().map(|clip| clip.frames).sum();
    let length = (frames / BLOCKS).max(MIN_BLOCK_FRAMES);
    let mut blocks = Vec::new();
    for clip in clips {
        let compared = against_detector(policy.as_mut(), clip, &settings)
            .map_err(|error| error.context(&clip.name))?;
        // The last block of a clip includes the remainder, which is too short for a block of its own.
        let count = (compared.len() / length).max(1);
        let mut own = vec![Block::default(); count];
        for (index, frame) in compared.iter().enumerate() {
            let block = (index / length).min(count - 1);
            own[block].count(frame.as_deref());
        }
        blocks.extend(own);
    }
    Ok(Trial(blocks))
}
