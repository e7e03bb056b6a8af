//! Boxes followed by optical flow on the frames that are answered without the detector.
//!
//! Between the last picture that was looked at and this one, each box moves by (dx, dy) and grows by the factor s.
//! The filter takes these as measurements of differences of its state, all sides in picture heights:
//!
//! ```text
//! x − x_then = dx,  y − y_then = dy,  ln w − ln w_then = ln h − ln h_then = ln s
//! √R_center = √((center_noise·s)² + (pixel_noise pixels)² + (spread_noise·spread·smaller side)²)
//! √R_size   = √(size_noise² + (spread_noise·spread)²)
//! ```
//!
//! and so the miss probability grows no faster than the flow is unsure. That knows nothing of what the flow is on:
//! an object that is hidden, turns or leaves takes its points with it. The health h of an object, 1 with each
//! detection, becomes at each look
//!
//! ```text
//! r = share of the points that agree · max(0, 1 − spread_weight·spread)
//! h ← h·(1 − doubt·(1 − r)),  and h·lost where flow fails
//! ```
//!
//! and the miss probability `1 − (1 − π)·h^health_weight`.

use super::motion::{LOG_HEIGHT, LOG_WIDTH, X, Y};
use super::object::Object;
use super::settings::Flow;
use crate::flow::{BoxFlow, BoxFlowSettings, BoxMotion, GreyView, Pyramid};
use crate::geometry::{Corners, PictureSize};
use crate::policy::GreyPicture;

/// The last picture that was looked at, and what follows boxes from there.
#[derive(Clone, Debug)]
pub(super) struct Follower {
    flow: BoxFlow,
    before: Pyramid,
    now: Pyramid,
    /// Frames since the picture before.
    age: u32,
    /// The typical spread of what was followed.
    spread: f64,
}

/// How fast the typical spread follows.
const SPREAD_RATE: f64 = 0.05;

impl Follower {
    pub(crate) fn new(settings: &Flow) -> Self {
        let standard = BoxFlowSettings::default();
        let mut tracker = standard.tracker;
        tracker.levels = settings.levels as usize;
        Self {
            flow: BoxFlow::new(BoxFlowSettings {
                grid: settings.grid as usize,
                tracker,
                ..standard
            }),
            before: Pyramid::default(),
            now: Pyramid::default(),
            age: 0,
            spread: 0.01,
        }
    }

    /// Forgets the pictures.
    pub(crate) fn clear(&mut self) {
        self.before.clear();
        self.now.clear();
    }

    /// Another `step` frames began.
    pub(crate) fn advance(&mut self, settings: &Flow, step: u32) {
        self.now.clear();
        self.age = self.age.saturating_add(step);
        if self.age > settings.longest_gap {
            self.before.clear();
        }
    }

    /// Whether there is a picture to follow boxes from.
    pub(crate) fn can_follow(&self) -> bool {
        !self.before.is_empty()
    }

    /// Takes the picture of the frame in hand and follows the boxes into it. A picture that has not as many pixels as
    /// its size says is none.
    pub(crate) fn look(
        &mut self,
        settings: &Flow,
        objects: &mut [Object],
        aspect: f64,
        picture: GreyPicture<'_>,
    ) {
        let PictureSize { width, height } = picture.size;
        let (width, height) = (width as usize, height as usize);
        let view = GreyView::new(width, height, width, picture.pixels);
        let Some(view) = view.filter(|_| picture.pixels.len() == width * height) else {
            return;
        };
        self.now.fill(view, self.flow.settings().tracker.levels);
        if self.before.size() != self.now.size() {
            self.before.clear();
            return;
        }
        // Picture heights to pixels.
        let scale = [width as f64 / aspect, height as f64];
        for object in objects {
            self.follow(settings, object, scale);
        }
    }

    fn follow(&mut self, settings: &Flow, object: &mut Object, scale: [f64; 2]) {
        let Some(then) = object.filter.remembered() else {
            return;
        };
        let now = object.filter.position();
        let sides = [
            then[LOG_WIDTH].exp() * scale[0],
            then[LOG_HEIGHT].exp() * scale[1],
        ];
        let middle = [then[X] * scale[0], then[Y] * scale[1]];
        let area = Corners {
            x1: middle[0] - sides[0] / 2.0,
            y1: middle[1] - sides[1] / 2.0,
            x2: middle[0] + sides[0] / 2.0,
            y2: middle[1] + sides[1] / 2.0,
        };
        let guess = [X, Y].map(|axis| (now[axis] - then[axis]) * scale[axis]);
        let followed = self.flow.follow(&self.before, &self.now, area, guess);
        let agreement = followed.agreement();
        let Some(motion) = followed.motion else {
            object.health *= settings.lost;
            object.agreement = 0.0;
            return;
        };
        self.spread += SPREAD_RATE * (motion.spread - self.spread);
        let moved = [
            motion.shift[0] / scale[0],
            motion.shift[1] / scale[1],
            motion.scale.ln(),
            motion.scale.ln(),
        ];
        let smaller = sides[0].min(sides[1]) / scale[1];
        let variance = variance(settings, object, motion.spread, smaller, scale[1]);
        object.filter.follow(&moved, &variance);
        object.followed = true;
        object.agreement = agreement;
        object.health *= 1.0 - settings.doubt * (1.0 - reliability(settings, agreement, &motion));
    }

    /// The variances that a look is expected to measure an object's shift and growth with.
    pub(crate) fn expected_variance(&self, settings: &Flow, object: &Object) -> [f64; 4] {
        let height = self.before.size().1.max(1) as f64;
        let [width, tall] = object.filter.sides();
        variance(settings, object, self.spread, width.min(tall), height)
    }

    /// The frame in hand is answered: what was seen of it is what the next look begins from.
    pub(crate) fn remember(&mut self, objects: &mut [Object]) {
        if self.now.is_empty() {
            return;
        }
        std::mem::swap(&mut self.before, &mut self.now);
        self.now.clear();
        self.age = 0;
        for object in objects {
            object.filter.remember();
        }
    }
}

fn reliability(settings: &Flow, agreement: f64, motion: &BoxMotion) -> f64 {
    agreement * (1.0 - settings.spread_weight * motion.spread).max(0.0)
}

/// R of the four axes; `smaller` is the box's smaller side and the picture has `height` rows.
fn variance(settings: &Flow, object: &Object, spread: f64, smaller: f64, height: f64) -> [f64; 4] {
    let wide = (settings.spread_noise * spread).powi(2);
    let center = (settings.center_noise * object.filter.size()).powi(2)
        + (settings.pixel_noise / height).powi(2)
        + wide * smaller * smaller;
    let size = settings.size_noise.powi(2) + wide;
    [center, center, size, size]
}

#[cfg(test)]
mod tests {
    use crate::detection::{ClassId, Detection};
    use crate::geometry::{BoundingBox, PictureSize};
    use crate::policy::{
        BoxSource, Evidence, ExpectedLoss, ExpectedLossSettings, FrameHead, GreyPicture, Need,
        Outcome, Pixels, Policy, Trigger,
    };

    const SIZE: PictureSize = PictureSize::new(320, 180);

    /// A textured world that has moved to the right by so many pixels.
    fn picture(shift: f64) -> Vec<u8> {
        let value = |index: usize| {
            let (x, y) = ((index % 320) as f64 - shift, (index / 320) as f64);
            let waves = [(0.31, 0.11), (-0.17, 0.29), (0.07, -0.41), (0.53, 0.23)];
            let sum: f64 = waves.iter().map(|(a, b)| (a * x + b * y).sin()).sum();
            (128.0 + 28.0 * sum) as u8
        };
        (0..320 * 180).map(value).collect()
    }

    fn detection(shift: f64) -> Detection {
        Detection {
            bounding_box: BoundingBox::new((100.0 + shift) / 320.0, 0.5, 0.2, 0.25),
            class: ClassId(0),
            confidence: 0.9,
        }
    }

    /// How far the boxes of skipped frames are off, pixels, with their sources; what is to be seen moves by 3 pixels a
    /// frame and is hidden from frame `hidden` on.
    fn play(pixels: Pixels, hidden: usize) -> (Vec<(BoxSource, f64)>, Vec<usize>) {
        let settings = ExpectedLossSettings {
            pixels,
            ..ExpectedLossSettings::default()
        };
        let trigger = Trigger::ExpectedLoss { lambda: 1.0 };
        let mut policy = ExpectedLoss::new(settings, trigger).unwrap();
        let (mut outcome, mut skipped, mut called) = (Outcome::default(), Vec::new(), Vec::new());
        for index in 0..12 {
            let shift = 3.0 * index as f64;
            let seen = if index < hidden {
                picture(shift)
            } else {
                vec![60; 320 * 180]
            };
            let found = [detection(shift)];
            let mut need = policy.begin(FrameHead {
                index: index as u64,
                step: 1,
                picture: SIZE,
            });
            while need != Need::Nothing {
                need = policy.answer(match need {
                    Need::GreyPicture => Evidence::GreyPicture(GreyPicture {
                        size: SIZE,
                        pixels: &seen,
                    }),
                    Need::Detections => {
                        called.push(index);
                        Evidence::Detections(&found)
                    }
                    _ => Evidence::Unavailable,
                });
            }
            policy.finish(&mut outcome);
            if outcome.state.is_skipped() {
                let at = outcome.boxes[0].bounding_box.center_x * 320.0;
                skipped.push((outcome.boxes[0].source, (at - 100.0 - shift).abs()));
            }
        }
        (skipped, called)
    }

    #[test]
    fn a_box_is_followed_where_prediction_cannot_know_its_motion() {
        let (followed, calls) = play(Pixels::Flow, usize::MAX);
        assert!(
            followed
                .iter()
                .all(|(source, _)| *source == BoxSource::Followed)
        );
        assert!(followed.iter().all(|(_, off)| *off < 0.5), "{followed:?}");
        let (blind, blind_calls) = play(Pixels::Off, usize::MAX);
        assert!(
            blind
                .iter()
                .all(|(source, _)| *source == BoxSource::Predicted)
        );
        assert!(calls.len() < blind_calls.len(), "{calls:?} {blind_calls:?}");
    }

    #[test]
    fn what_can_no_longer_be_followed_calls_the_detector() {
        let (_, calls) = play(Pixels::Flow, usize::MAX);
        let (_, with_loss) = play(Pixels::Flow, 4);
        let after = |calls: &[usize]| calls.iter().filter(|index| **index >= 4).count();
        assert!(after(&with_loss) > after(&calls), "{calls:?} {with_loss:?}");
    }
}
