//! Defines what boxes are judged against: the objects, and what the ground truth marks as not to be judged.

use crate::boxes::ScoredBox;
use albireo_core::detection::ClassId;
use albireo_core::geometry::Corners;

/// How boxes that lie on a marked place are treated, by the rules of the benchmark that marks it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A region without labels: KITTI's DontCare, the crowds and distractors of BDD100K, VisDrone's ignored regions.
    /// Any number of boxes with at least half of their area inside, which overlap no object by IoU 0.5, are left out.
    Region,
    /// COCO's `iscrowd`. At each IoU threshold, any number of boxes with at least this share of their own area inside,
    /// which match no object at this threshold, are left out.
    Crowd,
    /// COCO's `ignore`: an object. At each IoU threshold, the one box that matches it, and no other object, is left
    /// out.
    Object,
    /// MOTChallenge's distractors: an object. The boxes of a frame are assigned to all its objects so that the sum of
    /// their IoU of 0.5 and more is highest; a box that falls to a distractor is left out.
    Distractor,
    /// An object that MOTChallenge labels and does not judge: it takes part in that assignment, and a box that falls to
    /// it counts as wrong.
    Unjudged,
    /// A frame that nobody labelled, as most are in sparsely labelled data: nothing on it is judged, wherever it lies.
    Unlabelled,
}

/// A place that the ground truth marks as not to be judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ignored {
    /// In pixels.
    pub corners: Corners,
    /// The class of the boxes that are left out; `None` for any.
    pub class: Option<ClassId>,
    /// The rule.
    pub mark: Mark,
}

impl Ignored {
    /// The mark of a frame that nobody labelled.
    pub const UNLABELLED: Self = Self {
        corners: Corners {
            x1: 0.0,
            y1: 0.0,
            x2: 0.0,
            y2: 0.0,
        },
        class: None,
        mark: Mark::Unlabelled,
    };

    /// True if boxes of `class` can be left out here.
    pub(super) fn concerns(&self, class: ClassId) -> bool {
        self.class.is_none_or(|own| own == class)
    }
}

/// The ground truth of a clip, with one list per frame. If a list is shorter, its missing frames count as empty.
#[derive(Clone, Copy, Debug)]
pub struct Truth<'a> {
    /// The objects to be found.
    pub objects: &'a [Vec<ScoredBox>],
    /// The places where boxes are not judged.
    pub ignored: &'a [Vec<Ignored>],
}

impl<'a> Truth<'a> {
    /// The objects of a frame.
    pub(super) fn objects(self, frame: usize) -> &'a [ScoredBox] {
        self.objects.get(frame).map_or(&[], Vec::as_slice)
    }

    /// True if there are frames that nobody labelled.
    pub(super) fn is_sparse(self) -> bool {
        unlabelled(self.ignored) > 0
    }

    /// The marked places of a frame.
    pub(super) fn ignored(self, frame: usize) -> &'a [Ignored] {
        self.ignored.get(frame).map_or(&[], Vec::as_slice)
    }
}

/// The number of frames that nobody labelled, by the marks of each frame.
pub fn unlabelled(ignored: &[Vec<Ignored>]) -> usize {
    let is_unlabelled = |marks: &&Vec<Ignored>| marks.contains(&Ignored::UNLABELLED);
    ignored.iter().filter(is_unlabelled).count()
}

/// Keeps only the marks of frames that nobody labelled: those are for evaluators that make no other exception.
pub(crate) fn only_unlabelled(ignored: &mut Vec<Vec<Ignored>>) {
    for marks in ignored.iter_mut() {
        marks.retain(|ignored| ignored.mark == Mark::Unlabelled);
    }
    if ignored.iter().all(Vec::is_empty) {
        ignored.clear();
    }
}

impl<'a> From<&'a [Vec<ScoredBox>]> for Truth<'a> {
    /// Ground truth that marks nothing.
    fn from(objects: &'a [Vec<ScoredBox>]) -> Self {
        let ignored = &[];
        Self { objects, ignored }
    }
}

impl<'a> From<&'a Vec<Vec<ScoredBox>>> for Truth<'a> {
    fn from(objects: &'a Vec<Vec<ScoredBox>>) -> Self {
        Self::from(objects.as_slice())
    }
}

impl<'a, const N: usize> From<&'a [Vec<ScoredBox>; N]> for Truth<'a> {
    fn from(objects: &'a [Vec<ScoredBox>; N]) -> Self {
        Self::from(objects.as_slice())
    }
}
