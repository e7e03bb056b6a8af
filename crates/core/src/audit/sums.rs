//! What comparisons add up to.

use super::AUDIT_SIZES;
use super::comparison::{Side, compare};
use super::rate::{AuditRate, design_effect};
use crate::detection::Detection;
use crate::policy::{FrameState, OutputBox};
use serde::{Deserialize, Serialize};

/// Overlaps are kept in millionths: whole numbers add up to the same in any order.
const MILLION: f64 = 1e6;

/// Boxes of one side, the detector's or the shown ones.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct BoxCounts {
    /// Boxes.
    #[serde(skip_serializing_if = "is_zero")]
    pub boxes: u64,
    /// Those that have a box of the other side as their pair.
    #[serde(skip_serializing_if = "is_zero")]
    pub paired: u64,
    /// Those that no box of the other side is even near: of the detector's, objects that have newly appeared; of the
    /// shown ones, objects that are gone or that the detector misses.
    #[serde(skip_serializing_if = "is_zero")]
    pub alone: u64,
}

/// Comparisons of one group of frames or boxes.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AuditTally {
    /// Frames that were compared; not counted by size.
    #[serde(skip_serializing_if = "is_zero")]
    pub frames: u64,
    /// The detector's boxes.
    #[serde(skip_serializing_if = "BoxCounts::is_empty")]
    pub detected: BoxCounts,
    /// The shown boxes.
    #[serde(skip_serializing_if = "BoxCounts::is_empty")]
    pub shown: BoxCounts,
    /// Summed intersection over union of the pairs, in millionths; by size, of the detector's boxes.
    #[serde(skip_serializing_if = "is_zero")]
    pub overlap_millionths: u64,
    /// Pairs of one class; by size, of the detector's boxes.
    #[serde(skip_serializing_if = "is_zero")]
    pub same_class: u64,
}

/// By the state of the frame.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ByState {
    /// The screen had said "empty".
    #[serde(rename = "E", skip_serializing_if = "AuditTally::is_empty")]
    pub e: AuditTally,
    /// Boxes had been predicted.
    #[serde(rename = "P", skip_serializing_if = "AuditTally::is_empty")]
    pub p: AuditTally,
}

/// By the number of frames since the detector last looked, the compared one included.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ByPause {
    /// The first frame after one that the detector looked at.
    #[serde(rename = "1", skip_serializing_if = "AuditTally::is_empty")]
    pub one: AuditTally,
    /// The second.
    #[serde(rename = "2", skip_serializing_if = "AuditTally::is_empty")]
    pub two: AuditTally,
    /// The third and fourth.
    #[serde(rename = "3-4", skip_serializing_if = "AuditTally::is_empty")]
    pub three: AuditTally,
    /// The fifth to eighth.
    #[serde(rename = "5-8", skip_serializing_if = "AuditTally::is_empty")]
    pub five: AuditTally,
    /// The ninth to sixteenth.
    #[serde(rename = "9-16", skip_serializing_if = "AuditTally::is_empty")]
    pub nine: AuditTally,
    /// Later ones.
    #[serde(rename = "17+", skip_serializing_if = "AuditTally::is_empty")]
    pub seventeen: AuditTally,
}

/// By the size of the box: a share of the picture's area below 1/300 (COCO's 32² pixels of 640x480), up to 3 % (96²), and
/// above. Recall goes by the size of the detector's box, precision by that of the shown one.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct BySize {
    /// Below 1/300 of the picture.
    #[serde(skip_serializing_if = "AuditTally::is_empty")]
    pub small: AuditTally,
    /// From there to 3 %.
    #[serde(skip_serializing_if = "AuditTally::is_empty")]
    pub medium: AuditTally,
    /// 3 % and more.
    #[serde(skip_serializing_if = "AuditTally::is_empty")]
    pub large: AuditTally,
}

/// Summed squares over the frames of one side's counts: how far the frames differ.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SquareSums {
    /// Of the boxes of a frame.
    #[serde(skip_serializing_if = "is_zero")]
    pub boxes: u64,
    /// Of the paired ones of a frame.
    #[serde(skip_serializing_if = "is_zero")]
    pub paired: u64,
    /// Of boxes times paired ones.
    #[serde(skip_serializing_if = "is_zero")]
    pub product: u64,
}

/// How far the compared frames differ, from which the intervals come.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AuditSpread {
    /// Of the detector's boxes.
    #[serde(skip_serializing_if = "SquareSums::is_empty")]
    pub detected: SquareSums,
    /// Of the shown boxes.
    #[serde(skip_serializing_if = "SquareSums::is_empty")]
    pub shown: SquareSums,
}

/// What an audit has found. All are whole numbers that only grow: sums over parts are the sums over the whole.
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AuditSums {
    /// Frames that were drawn and could not be looked at in time.
    #[serde(skip_serializing_if = "is_zero")]
    pub missed: u64,
    /// By the state of the frame; together they are the total.
    #[serde(skip_serializing_if = "ByState::is_empty")]
    pub by_state: ByState,
    /// By the length of the pause.
    #[serde(skip_serializing_if = "ByPause::is_empty")]
    pub by_pause: ByPause,
    /// By the size of the box.
    #[serde(skip_serializing_if = "BySize::is_empty")]
    pub by_size: BySize,
    /// How far the frames differ.
    #[serde(skip_serializing_if = "AuditSpread::is_empty")]
    pub spread: AuditSpread,
}

const fn is_zero(number: &u64) -> bool {
    *number == 0
}

impl BoxCounts {
    /// Whether there was no box.
    pub const fn is_empty(&self) -> bool {
        self.boxes == 0 && self.paired == 0 && self.alone == 0
    }

    fn count(&mut self, side: &Side) {
        self.boxes = self.boxes.saturating_add(1);
        self.paired = self.paired.saturating_add(side.paired.is_some().into());
        self.alone = self.alone.saturating_add(side.alone.into());
    }

    const fn merge(&mut self, more: &Self) {
        self.boxes = self.boxes.saturating_add(more.boxes);
        self.paired = self.paired.saturating_add(more.paired);
        self.alone = self.alone.saturating_add(more.alone);
    }
}

impl AuditTally {
    /// Whether nothing was compared.
    pub const fn is_empty(&self) -> bool {
        self.frames == 0 && self.detected.is_empty() && self.shown.is_empty()
    }

    /// Mean intersection over union of the pairs; `None` without any.
    pub fn mean_overlap(&self) -> Option<f64> {
        let pairs = self.detected.paired;
        (pairs > 0).then(|| self.overlap_millionths as f64 / MILLION / pairs as f64)
    }

    fn count_detected(&mut self, side: &Side) {
        self.detected.count(side);
        if let Some(overlap) = side.paired {
            let millionths = (overlap * MILLION).round() as u64;
            self.overlap_millionths = self.overlap_millionths.saturating_add(millionths);
            self.same_class = self.same_class.saturating_add(side.same_class.into());
        }
    }

    /// Adds the other's counts.
    pub const fn merge(&mut self, more: &Self) {
        self.frames = self.frames.saturating_add(more.frames);
        self.detected.merge(&more.detected);
        self.shown.merge(&more.shown);
        self.overlap_millionths = self
            .overlap_millionths
            .saturating_add(more.overlap_millionths);
        self.same_class = self.same_class.saturating_add(more.same_class);
    }
}

impl ByState {
    const fn is_empty(&self) -> bool {
        self.e.is_empty() && self.p.is_empty()
    }
}

impl ByPause {
    fn is_empty(&self) -> bool {
        self.groups().iter().all(|(_, tally)| tally.is_empty())
    }

    /// The groups with their names, shortest first.
    pub const fn groups(&self) -> [(&'static str, &AuditTally); 6] {
        [
            ("1", &self.one),
            ("2", &self.two),
            ("3-4", &self.three),
            ("5-8", &self.five),
            ("9-16", &self.nine),
            ("17+", &self.seventeen),
        ]
    }

    const fn of(&mut self, pause: u32) -> &mut AuditTally {
        match pause {
            0..=1 => &mut self.one,
            2 => &mut self.two,
            3..=4 => &mut self.three,
            5..=8 => &mut self.five,
            9..=16 => &mut self.nine,
            _ => &mut self.seventeen,
        }
    }
}

impl BySize {
    const fn is_empty(&self) -> bool {
        self.small.is_empty() && self.medium.is_empty() && self.large.is_empty()
    }

    /// The groups with their names, smallest first.
    pub const fn groups(&self) -> [(&'static str, &AuditTally); 3] {
        [
            ("small", &self.small),
            ("medium", &self.medium),
            ("large", &self.large),
        ]
    }

    fn of(&mut self, area: f64) -> &mut AuditTally {
        let [medium, large] = AUDIT_SIZES;
        if area < medium {
            &mut self.small
        } else if area < large {
            &mut self.medium
        } else {
            &mut self.large
        }
    }
}

impl SquareSums {
    const fn is_empty(&self) -> bool {
        self.boxes == 0 && self.paired == 0 && self.product == 0
    }

    const fn count(&mut self, boxes: u64, paired: u64) {
        self.boxes = self.boxes.saturating_add(boxes.saturating_mul(boxes));
        self.paired = self.paired.saturating_add(paired.saturating_mul(paired));
        self.product = self.product.saturating_add(boxes.saturating_mul(paired));
    }

    const fn merge(&mut self, more: &Self) {
        self.boxes = self.boxes.saturating_add(more.boxes);
        self.paired = self.paired.saturating_add(more.paired);
        self.product = self.product.saturating_add(more.product);
    }
}

impl AuditSpread {
    const fn is_empty(&self) -> bool {
        self.detected.is_empty() && self.shown.is_empty()
    }
}

impl AuditSums {
    /// Compares one frame: the boxes `shown` for it with those that the detector finds in it. `pause` is the number of
    /// frames since the detector last looked, this one included. On a frame that the detector had looked at nothing is
    /// compared: it is the reference.
    ///
    /// Every box of either side counts: who wants to leave out faint ones leaves them out of both before.
    pub fn add(
        &mut self,
        shown: &[OutputBox],
        detected: &[Detection],
        state: FrameState,
        pause: u32,
    ) {
        let of_state = match state {
            FrameState::E => &mut self.by_state.e,
            FrameState::P => &mut self.by_state.p,
            FrameState::EI | FrameState::I | FrameState::AI => return,
        };
        let (shown, detected) = compare(shown, detected);
        let mut frame = AuditTally {
            frames: 1,
            ..AuditTally::default()
        };
        for side in &detected {
            frame.count_detected(side);
            self.by_size.of(side.area()).count_detected(side);
        }
        for side in &shown {
            frame.shown.count(side);
            self.by_size.of(side.area()).shown.count(side);
        }
        of_state.merge(&frame);
        self.by_pause.of(pause).merge(&frame);
        let (detected, shown) = (&frame.detected, &frame.shown);
        self.spread.detected.count(detected.boxes, detected.paired);
        self.spread.shown.count(shown.boxes, shown.paired);
    }

    /// Counts a frame that was drawn and could not be looked at in time.
    pub const fn add_missed(&mut self) {
        self.missed = self.missed.saturating_add(1);
    }

    /// Adds the other's sums.
    pub const fn merge(&mut self, more: &Self) {
        self.missed = self.missed.saturating_add(more.missed);
        self.by_state.e.merge(&more.by_state.e);
        self.by_state.p.merge(&more.by_state.p);
        self.by_pause.one.merge(&more.by_pause.one);
        self.by_pause.two.merge(&more.by_pause.two);
        self.by_pause.three.merge(&more.by_pause.three);
        self.by_pause.five.merge(&more.by_pause.five);
        self.by_pause.nine.merge(&more.by_pause.nine);
        self.by_pause.seventeen.merge(&more.by_pause.seventeen);
        self.by_size.small.merge(&more.by_size.small);
        self.by_size.medium.merge(&more.by_size.medium);
        self.by_size.large.merge(&more.by_size.large);
        self.spread.detected.merge(&more.spread.detected);
        self.spread.shown.merge(&more.spread.shown);
    }

    /// Whether no frame was drawn.
    pub const fn is_empty(&self) -> bool {
        self.missed == 0 && self.by_state.is_empty()
    }

    /// All comparisons.
    pub const fn total(&self) -> AuditTally {
        let mut total = self.by_state.e;
        total.merge(&self.by_state.p);
        total
    }

    /// Frames that were drawn, looked at or not.
    pub const fn drawn(&self) -> u64 {
        self.missed.saturating_add(self.total().frames)
    }

    /// Recall against the detector: share of its boxes that had been shown. `None` when it found nothing.
    pub fn recall(&self) -> Option<AuditRate> {
        self.recall_of(&self.total())
    }

    /// The same within one group of these sums. The interval takes the boxes of a frame to hang together as much as in
    /// all frames.
    pub fn recall_of(&self, group: &AuditTally) -> Option<AuditRate> {
        let effect = design_effect(&self.total().detected, &self.spread.detected);
        AuditRate::new(&group.detected, effect)
    }

    /// Precision against the detector: share of the shown boxes that it confirms. `None` when nothing was shown.
    pub fn precision(&self) -> Option<AuditRate> {
        self.precision_of(&self.total())
    }

    /// The same within one group of these sums, with the interval as for [`recall_of`](Self::recall_of).
    pub fn precision_of(&self, group: &AuditTally) -> Option<AuditRate> {
        let effect = design_effect(&self.total().shown, &self.spread.shown);
        AuditRate::new(&group.shown, effect)
    }
}
