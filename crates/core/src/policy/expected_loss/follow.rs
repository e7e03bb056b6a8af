//! Boxes followed by optical flow on frames answered without the detector.
//!
//! Between the last picture used and this one, each box moves by (dx, dy) and grows by the factor s. The filter takes
//! these as measurements of differences of its state, with all sides in picture heights:
//!
//! ```text
//! x − x_then = dx,  y − y_then = dy,  ln w − ln w_then = ln h − ln h_then = ln s
//! √R_center = √((center_noise·s)² + (pixel_noise pixels)² + (spread·smaller side)²)
//! √R_size   = √(size_noise² + spread²)
//! ```
//!
//! so that the miss probability grows no faster than the uncertainty of the flow. That uncertainty does not cover what
//! the flow follows: an object that is hidden, turns or leaves takes its points with it. The health h of an object,
//! reset to 1 by each detection, becomes with each picture
//!
//! ```text
//! r = share of the points that agree · max(0, 1 − spread_weight·spread)
//! h ← h·(1 − doubt·(1 − r)),  and h·lost where flow fails
//! ```
//!
//! and the miss probability `1 − (1 − π)·h`.
//!
//! A side of the box on the picture's border marks the end of the picture, not of the object. What comes into view
//! there as the object moves inwards belongs to it: such a side stays on the border, and its possible error is the
//! distance over which it was held there since the last detection ([`Object::judge`]).

use super::motion::{AxisValues, LOG_HEIGHT, LOG_WIDTH, X, Y};
use super::object::Object;
use super::settings::{
    BORDER, CENTER_NOISE, DOUBT, FLOW_GRID, LONGEST_GAP, LOST_HEALTH, PIXEL_NOISE, SIZE_NOISE,
    SPREAD_WEIGHT,
};
use crate::flow::{BoxFlow, BoxMotion, GreyPicture, Pyramid};
use crate::geometry::Corners;

/// The last picture used, and the optical flow from it.
#[derive(Clone, Debug)]
pub(super) struct Follower {
    flow: BoxFlow,
    before: Pyramid,
    now: Pyramid,
    /// Frames since the previous picture.
    age: u32,
    /// True if it has received a picture since the start.
    examined: bool,
}

/// Largest distance of a followed box from the filter's, picture heights and natural logarithms.
const LARGEST_OFFSET: f64 = 1.0;

impl Default for Follower {
    fn default() -> Self {
        Self {
            flow: BoxFlow::new(FLOW_GRID),
            before: Pyramid::default(),
            now: Pyramid::default(),
            age: 0,
            examined: false,
        }
    }
}

impl Follower {
    /// Copies the pictures of `other`. Allocates only while buffers grow.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.before.copy_from(&other.before);
        self.now.copy_from(&other.now);
        self.age = other.age;
        self.examined = other.examined;
    }

    /// Resets to the state without pictures.
    pub(crate) fn clear(&mut self) {
        self.before.clear();
        self.now.clear();
        self.age = 0;
        self.examined = false;
    }

    /// True if it has received a picture since the start.
    pub(crate) fn has_followed(&self) -> bool {
        self.examined
    }

    /// Advances by `step` frames.
    pub(crate) fn advance(&mut self, step: u32) {
        self.now.clear();
        self.age = self.age.saturating_add(step);
        if self.age > LONGEST_GAP {
            self.before.clear();
        }
    }

    /// True if there is a picture to follow boxes from.
    pub(crate) fn can_follow(&self) -> bool {
        !self.before.is_empty()
    }

    /// Receives the picture of the current frame and follows the boxes into it. Ignores a picture whose number of
    /// pixels does not match its size.
    pub(crate) fn follow_all(
        &mut self,
        objects: &mut [Object],
        aspect: f64,
        picture: GreyPicture<'_>,
    ) {
        if !self.now.fill(picture) {
            return;
        }
        self.examined = true;
        if self.before.size() != self.now.size() {
            self.before.clear();
            return;
        }
        // Picture heights to pixels.
        let (width, height) = self.now.size();
        let scale = [width as f64 / aspect, height as f64];
        for object in objects {
            self.follow(object, aspect, scale);
        }
    }

    /// Follows one box from the last picture into this one: where it was then is the filter's memory, where it is looked
    /// for is the filter's prediction. `scale` converts picture heights to pixels.
    fn follow(&mut self, object: &mut Object, aspect: f64, scale: [f64; 2]) {
        let Some(mut then) = object.filter.remembered() else {
            return;
        };
        let now = object.trail();
        for (then, offset) in then.iter_mut().zip(object.offset.unwrap_or_default()) {
            *then += offset;
        }
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
            object.health *= LOST_HEALTH;
            return;
        };
        let moved = [
            motion.shift[0] / scale[0],
            motion.shift[1] / scale[1],
            motion.scale.ln(),
            motion.scale.ln(),
        ];
        let smaller = sides[0].min(sides[1]) / scale[1];
        let noise = variance(object, motion.spread, smaller, scale[1]);
        object.filter.follow(&moved, &noise);
        let filtered = object.filter.position();
        let mut end: AxisValues = std::array::from_fn(|axis| then[axis] + moved[axis]);
        let margin = BORDER / scale[1];
        object.border_shift[0] += hold(&then, &mut end, [X, LOG_WIDTH], aspect, margin);
        object.border_shift[1] += hold(&then, &mut end, [Y, LOG_HEIGHT], 1.0, margin);
        object.offset = Some(std::array::from_fn(|axis| {
            // Limits how far a wrong flow can carry a box away.
            (end[axis] - filtered[axis]).clamp(-LARGEST_OFFSET, LARGEST_OFFSET)
        }));
        object.followed = true;
        object.trailing = true;
        object.health *= 1.0 - DOUBT * (1.0 - reliability(agreement, &motion));
    }

    /// Ends the current frame: its picture becomes the start of the next flow.
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

/// Along the axis `center` of a picture of this `length`, extends the box `end` to the sides of the box `then` that
/// were within `margin` of the picture's border. Returns the increase in length.
fn hold(
    then: &AxisValues,
    end: &mut AxisValues,
    [center, side]: [usize; 2],
    length: f64,
    margin: f64,
) -> f64 {
    let span = |measured: &AxisValues| {
        let half = measured[side].exp() / 2.0;
        [measured[center] - half, measured[center] + half]
    };
    let [was_low, was_high] = span(then);
    let [mut low, mut high] = span(end);
    let own = high - low;
    if was_low <= margin {
        low = low.min(was_low.max(0.0));
    }
    if was_high >= length - margin {
        high = high.max(was_high.min(length));
    }
    let longer = high - low - own;
    if longer > 0.0 {
        end[center] = (low + high) / 2.0;
        end[side] = (high - low).ln();
    }
    longer.max(0.0)
}

/// Returns r, see above.
fn reliability(agreement: f64, motion: &BoxMotion) -> f64 {
    agreement * (1.0 - SPREAD_WEIGHT * motion.spread).max(0.0)
}

/// Returns R of the four axes; `smaller` is the box's smaller side, and the picture has `height` rows.
fn variance(object: &Object, spread: f64, smaller: f64, height: f64) -> [f64; 4] {
    let scatter = spread.powi(2);
    let center = (CENTER_NOISE * object.filter.size()).powi(2)
        + (PIXEL_NOISE / height).powi(2)
        + scatter * smaller * smaller;
    let size = SIZE_NOISE.powi(2) + scatter;
    [center, center, size, size]
}

#[cfg(test)]
mod tests {
    use super::hold;
    use crate::policy::expected_loss::object::Object;
    use crate::policy::expected_loss::settings::Pixels;
    use crate::policy::tests::{ride, seen};
    use crate::policy::{BoxSource, ObjectId};

    #[test]
    fn an_unpredictable_box_is_followed_and_calls_the_detector_once_it_cannot_be() {
        let (flow, calls) = ride("expected-loss+flow:1", usize::MAX);
        let (blind, more_calls) = ride("expected-loss:1", usize::MAX);
        let worst =
            |skipped: &[(BoxSource, f64)]| skipped.iter().map(|(_, off)| *off).fold(0.0, f64::max);
        // It reads every picture, and its error is always smaller than that of prediction.
        let followed = |(source, _): &(BoxSource, f64)| *source == BoxSource::Followed;
        assert!(flow.iter().any(followed));
        assert!(!blind.iter().any(followed));
        assert!(worst(&flow) < 0.5, "{flow:?}");
        assert!(worst(&blind) > 1.0, "{blind:?}");
        assert!(calls.len() < more_calls.len(), "{calls:?} {more_calls:?}");
        let (_, hidden) = ride("expected-loss+flow:1", 4);
        let from_there = |calls: &[usize]| calls.iter().filter(|index| **index >= 4).count();
        assert!(from_there(&hidden) > from_there(&calls), "{hidden:?}");
    }

    /// A box from `low` to `high` along x, held on its way `from` there in a picture of width 2: its sides and by how
    /// much it is longer.
    fn border_shift(from: [f64; 2], [low, high]: [f64; 2]) -> ([f64; 2], f64) {
        let along = |low: f64, high: f64| [(low + high) / 2.0, 0.5, (high - low).ln(), 0.0];
        let mut end = along(low, high);
        let longer = hold(&along(from[0], from[1]), &mut end, [0, 2], 2.0, 0.01);
        let half = end[2].exp() / 2.0;
        ([end[0] - half, end[0] + half], longer)
    }

    #[test]
    fn parts_that_enter_at_the_border_belong_to_the_object() {
        for (what, from, to, sides) in [
            ("at the left", [0.0, 0.1], [0.04, 0.15], [0.0, 0.15]),
            ("at the right", [1.8, 1.995], [1.7, 1.9], [1.7, 1.995]),
            ("leaving", [0.0, 0.1], [-0.03, 0.07], [-0.03, 0.07]),
            ("far inside", [0.1, 0.2], [0.15, 0.25], [0.15, 0.25]),
            // No farther out than the border.
            ("coming back", [-0.05, 0.05], [0.02, 0.12], [0.0, 0.12]),
        ] {
            let (found, by) = border_shift(from, to);
            let longer = (sides[1] - sides[0]) - (to[1] - to[0]);
            let off = [found[0] - sides[0], found[1] - sides[1], by - longer];
            let is_there = off.iter().all(|off| off.abs() < 1e-12);
            assert!(is_there, "{what}: {found:?} {by}");
        }
    }

    #[test]
    fn a_correctly_followed_box_is_no_surprise() {
        let surprise = |trailing: bool| {
            let first = seen(0.4, 0.9);
            let mut object = Object::new(ObjectId(0), &first, 1.0, &[0.0; 3], 1.0, Pixels::Flow);
            object.predict();
            object.offset = Some([0.1, 0.0, 0.0, 0.0]);
            object.trailing = trailing;
            object.update(&seen(0.5, 0.9), 1.0)
        };
        assert!(surprise(true) < 1e-12);
        assert!(surprise(false) > 0.5);
    }
}
