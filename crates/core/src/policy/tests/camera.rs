//! A camera for the policies' tests: it plays frames one by one and provides evidence on request.

use super::*;

pub(crate) const PICTURE: PictureSize = PictureSize::new(1280, 720);

/// Random numbers from 0 to 1.
pub(crate) fn random(mut state: u64) -> impl FnMut() -> f64 {
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A detection at `x`, in the middle of the picture's height.
pub(crate) fn seen(x: f64, confidence: f64) -> Detection {
    Detection {
        bounding_box: BoundingBox::new(x, 0.5, 0.1, 0.1),
        class: ClassId(0),
        confidence,
    }
}

/// A frame of a stream without gaps.
pub(in crate::policy) fn head(index: u64) -> FrameHead {
    FrameHead {
        index,
        step: 1,
        picture: PICTURE,
    }
}

/// The policy `asked` for, `NAME[:ARGUMENT]`.
pub(in crate::policy) fn built(asked: &str, profile: Profile) -> Box<dyn Policy> {
    let mut config = PolicyConfig::default();
    config.select(asked).unwrap();
    config.profile = profile;
    config.build().unwrap()
}

/// The value of `spec` at this share of its useful range.
pub(in crate::policy) fn useful(spec: ThresholdSpec, share: f64) -> f64 {
    spec.useful_minimum + share * (spec.useful_maximum - spec.useful_minimum)
}

pub(in crate::policy) fn records<P: Policy + ?Sized>(policy: &P) -> Vec<ObjectRecord> {
    let mut records = Vec::new();
    policy.objects(&mut |record| records.push(*record));
    records
}

pub(in crate::policy) struct Run<P: ?Sized = dyn Policy> {
    pub policy: Box<P>,
    pub outcome: Outcome,
    /// Requests of the last frame.
    pub needs: Vec<Need>,
    pub index: u64,
    pub picture: PictureSize,
}

impl Run {
    pub(in crate::policy) fn new(asked: &str, profile: Profile) -> Self {
        Self::with(built(asked, profile))
    }
}

impl<P: Policy + ?Sized> Run<P> {
    pub(in crate::policy) fn with(policy: Box<P>) -> Self {
        Self {
            policy,
            outcome: Outcome::default(),
            needs: Vec::new(),
            index: 0,
            picture: PICTURE,
        }
    }

    /// Begins a frame that the test answers itself.
    pub(in crate::policy) fn begin(&mut self, step: u32) -> Need {
        self.index += u64::from(step) - 1;
        let head = FrameHead {
            index: self.index,
            step,
            picture: self.picture,
        };
        self.index += 1;
        self.policy.begin(head)
    }

    /// Plays a whole frame, `step` after the previous one.
    pub(in crate::policy) fn frame(&mut self, step: u32, known: FrameEvidence<'_>) -> FrameState {
        assert!(self.frame_within(usize::MAX, step, known));
        self.outcome.state
    }

    /// Plays a frame that is abandoned if it asks for more than `most` pieces of evidence; returns false then.
    pub(in crate::policy) fn frame_within(
        &mut self,
        most: usize,
        step: u32,
        mut known: FrameEvidence<'_>,
    ) -> bool {
        self.needs.clear();
        let mut need = self.begin(step);
        while need != Need::Nothing {
            if self.needs.len() == most {
                return false;
            }
            self.needs.push(need);
            assert!(self.needs.len() <= 3, "{:?}", self.needs);
            let Ok(evidence) = known.evidence(need);
            need = self.policy.answer(evidence);
        }
        self.policy.finish(&mut self.outcome);
        true
    }

    /// Plays a frame in which the detector, if called, finds `found`, and the screen answers "not empty".
    pub(in crate::policy) fn see(&mut self, found: &[Detection]) -> FrameState {
        self.frame(1, FrameEvidence::in_view(found))
    }

    pub(in crate::policy) fn blind(&mut self) -> FrameState {
        self.frame(1, FrameEvidence::default())
    }

    pub(in crate::policy) fn records(&self) -> Vec<ObjectRecord> {
        records(&*self.policy)
    }

    /// Source, centre and confidence of each box reported.
    pub(in crate::policy) fn reported(&self) -> Vec<(BoxSource, f64, f64)> {
        let mut reported = Vec::new();
        for shown in &self.outcome.boxes {
            reported.push((shown.source, shown.bounding_box.center_x, shown.confidence));
        }
        reported
    }
}

const GREY: PictureSize = PictureSize::new(320, 180);

/// A textured world that has moved to the right by this many pixels.
pub(in crate::policy) fn textured(size: PictureSize, shift: f64) -> Vec<u8> {
    let value = |index: u32| {
        let x = f64::from(index % size.width) - shift;
        let y = f64::from(index / size.width);
        let waves = [(0.31, 0.11), (-0.17, 0.29), (0.07, -0.41), (0.53, 0.23)];
        let sum: f64 = waves.iter().map(|(a, b)| (a * x + b * y).sin()).sum();
        (128.0 + 28.0 * sum) as u8
    };
    (0..size.width * size.height).map(value).collect()
}

/// The policy `asked` for in a world that moves by 3 pixels a frame and is hidden from frame `hidden` on, for 12
/// frames; the detector sees a box ride on it all the while. Returns the source of each box on frames without the
/// detector with its error in pixels of the small picture, and the frames with the detector.
pub(in crate::policy) fn ride(asked: &str, hidden: usize) -> (Vec<(BoxSource, f64)>, Vec<usize>) {
    let mut run = Run::new(asked, Profile::Paper);
    let mut skipped = Vec::new();
    let mut calls = Vec::new();
    for index in 0..12 {
        let shift = 3.0 * index as f64;
        let pixels = if index < hidden {
            textured(GREY, shift)
        } else {
            vec![60; 320 * 180]
        };
        let found = [Detection {
            bounding_box: BoundingBox::new((100.0 + shift) / 320.0, 0.5, 0.2, 0.25),
            ..seen(0.5, 0.9)
        }];
        let grey = GreyPicture {
            size: GREY,
            pixels: &pixels,
        };
        let known = FrameEvidence {
            grey: Some(grey),
            ..FrameEvidence::in_view(&found)
        };
        if !run.frame(1, known).is_skipped() {
            calls.push(index);
            continue;
        }
        for (source, x, _) in run.reported() {
            skipped.push((source, (320.0 * x - 100.0 - shift).abs()));
        }
    }
    (skipped, calls)
}
