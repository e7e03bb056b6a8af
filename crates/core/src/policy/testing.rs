//! A camera for the tests of the policies: frames one after the other, and evidence as it is asked for.

use super::*;

pub(super) const PICTURE: PictureSize = PictureSize::new(1280, 720);

/// A detection at `x`, in the middle of the picture's height.
pub(super) fn seen(x: f64, confidence: f64) -> Detection {
    Detection {
        bounding_box: BoundingBox::new(x, 0.5, 0.1, 0.1),
        class: ClassId(0),
        confidence,
    }
}

/// What can be had for a frame.
#[derive(Clone, Copy, Default)]
pub(super) struct Available<'a> {
    pub empty: Option<bool>,
    pub picture: Option<GreyPicture<'a>>,
    pub detections: Option<&'a [Detection]>,
}

impl<'a> Available<'a> {
    pub(crate) fn detections(detections: &'a [Detection]) -> Self {
        Self {
            detections: Some(detections),
            ..Self::default()
        }
    }

    fn evidence(&self, need: Need) -> Evidence<'a> {
        let evidence = match need {
            Need::Nothing => None,
            Need::Screen => self.empty.map(|empty| Evidence::Screen { empty }),
            Need::GreyPicture => self.picture.map(Evidence::GreyPicture),
            Need::Detections => self.detections.map(Evidence::Detections),
        };
        evidence.unwrap_or(Evidence::Unavailable)
    }
}

/// A policy with a frame counter.
pub(super) struct Run {
    pub policy: Box<dyn Policy>,
    pub outcome: Outcome,
    /// What the last frame asked for.
    pub needs: Vec<Need>,
    pub index: u64,
}

impl Run {
    /// The policy `asked` for, `NAME[:ARGUMENT]`.
    pub(crate) fn new(asked: &str, profile: Profile) -> Self {
        let mut config = PolicyConfig {
            profile,
            ..PolicyConfig::default()
        };
        config.select(asked).unwrap();
        Self::of(&config)
    }

    pub(crate) fn of(config: &PolicyConfig) -> Self {
        Self {
            policy: config.build().unwrap(),
            outcome: Outcome::default(),
            needs: Vec::new(),
            index: 0,
        }
    }

    pub(crate) fn begin(&mut self, step: u32) -> Need {
        self.index += u64::from(step) - 1;
        let frame = FrameHead {
            index: self.index,
            step,
            picture: PICTURE,
        };
        self.index += 1;
        self.policy.begin(frame)
    }

    /// A whole frame, `step` after the one before.
    pub(crate) fn frame(&mut self, step: u32, available: Available<'_>) -> FrameState {
        self.needs.clear();
        let mut need = self.begin(step);
        while need != Need::Nothing {
            self.needs.push(need);
            assert!(self.needs.len() <= 3, "{:?}", self.needs);
            need = self.policy.answer(available.evidence(need));
        }
        self.policy.finish(&mut self.outcome);
        self.outcome.state
    }

    /// A frame in which the detector, if asked, finds `found`, and the screen says "not empty".
    pub(crate) fn see(&mut self, found: &[Detection]) -> FrameState {
        self.frame(
            1,
            Available {
                empty: Some(false),
                ..Available::detections(found)
            },
        )
    }

    /// A frame for which nothing can be had.
    pub(crate) fn blind(&mut self) -> FrameState {
        self.frame(1, Available::default())
    }

    pub(crate) fn records(&self) -> Vec<ObjectRecord> {
        let mut records = Vec::new();
        self.policy.objects(&mut |record| records.push(*record));
        records
    }

    /// Source, centre and confidence of each box reported.
    pub(crate) fn reported(&self) -> Vec<(BoxSource, f64, f64)> {
        let boxes = self.outcome.boxes.iter();
        boxes
            .map(|b| (b.source, b.bounding_box.center_x, b.confidence))
            .collect()
    }
}
