//! Albireo with optical flow, as an ablation: on every frame with objects the boxes are followed by optical flow, and
//! the filter takes each followed box as a measurement.
//!
//! A box that was followed over n frames since the detector measured it carries the error of n + 1 measurements: its
//! variance is (n + 1)·R. So τ grows from picture to picture, and the threshold `u` decides how often the detector runs,
//! as it does without pictures. An object that cannot be followed is predicted, and its τ grows as before.

use super::AlbireoSettings;
use super::expected_loss::{FLOW_GRID, FLOW_LEVELS, FLOW_WIDTH, LONGEST_GAP, grey_view};
use super::{
    Albireo, BoxSource, Evidence, FrameHead, GreyPicture, Knob, KnobError, Need, ObjectRecord,
    Outcome, Policy, PolicyConfig, PolicyConfigError,
};
use crate::detection::ObjectId;
use crate::flow::{BoxFlow, BoxFlowSettings, Pyramid};
use crate::geometry::{BoundingBox, PictureSize};
use crate::objects::ObjectState;

/// Where an object was in the last picture.
#[derive(Clone, Copy, Debug)]
struct Seen {
    object: ObjectId,
    bounding_box: BoundingBox,
    /// Looks since the detector measured it.
    looks: u32,
}

/// The policy.
#[derive(Clone, Debug)]
pub(crate) struct AlbireoFlow {
    inner: Albireo,
    flow: BoxFlow,
    before: Pyramid,
    now: Pyramid,
    /// Frames since the picture before.
    age: u32,
    seen: Vec<Seen>,
    /// The objects followed into the current frame.
    followed: Vec<Seen>,
    /// What is needed after the requested picture.
    after_picture: Option<Need>,
    /// Whether that need is fixed, whatever the flow finds.
    stands: bool,
    /// The state that [`Policy::rewind`] returns to; a copy of this policy, kept for its buffers.
    saved: Option<Box<Self>>,
}

impl AlbireoFlow {
    /// The name in configuration and reports.
    pub(crate) const NAME: &'static str = "albireo+flow";

    pub(super) fn from_config(config: &PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let inner = Albireo::new(AlbireoSettings::of(config.profile), config.u)?;
        Ok(Box::new(Self {
            inner,
            flow: BoxFlow::new(BoxFlowSettings::of(FLOW_GRID, FLOW_LEVELS)),
            before: Pyramid::default(),
            now: Pyramid::default(),
            age: 0,
            seen: Vec::new(),
            followed: Vec::new(),
            after_picture: None,
            stands: false,
            saved: None,
        }))
    }

    /// Takes over the state of `other`, a copy of this policy, but not its settings and threshold.
    fn copy_from(&mut self, other: &Self) {
        let Self {
            inner,
            flow: _,
            before,
            now,
            age,
            seen,
            followed,
            after_picture,
            stands,
            saved: _,
        } = other;
        self.inner.copy_from(inner);
        self.before.copy_from(before);
        self.now.copy_from(now);
        self.age = *age;
        self.seen.clone_from(seen);
        self.followed.clone_from(followed);
        self.after_picture = *after_picture;
        self.stands = *stands;
    }

    fn ask_for_picture(&mut self, after: Need, stands: bool) -> Need {
        self.after_picture = Some(after);
        self.stands = stands;
        self.picture_need()
    }

    fn picture_need(&self) -> Need {
        Need::SmallGreyPicture { width: FLOW_WIDTH }
    }

    /// Follows the objects into the picture; says what is needed then, `after` if nothing could be followed.
    fn look(&mut self, picture: GreyPicture<'_>, after: Need) -> Need {
        let Some(view) = grey_view(picture) else {
            return after;
        };
        self.now.fill(view, self.flow.settings().tracker.levels);
        if self.stands || self.before.size() != self.now.size() {
            return after;
        }
        let (flow, seen, followed) = (&mut self.flow, &self.seen, &mut self.followed);
        let (before, now, size) = (&self.before, &self.now, picture.size);
        self.inner.follow(|state| {
            let known = seen.iter().find(|known| known.object == state.id)?;
            let moved = followed_box(flow, before, now, size, known.bounding_box, state)?;
            let looks = known.looks.saturating_add(1);
            followed.push(Seen {
                object: state.id,
                bounding_box: moved,
                looks,
            });
            Some((moved, f64::from(looks) + 1.0))
        })
    }
}

/// Where the box of the picture before is in this one; the search begins where the filter has it.
fn followed_box(
    flow: &mut BoxFlow,
    before: &Pyramid,
    now: &Pyramid,
    size: PictureSize,
    then: BoundingBox,
    state: &ObjectState,
) -> Option<BoundingBox> {
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let expected = state.filter.bounding_box();
    let guess = [
        (expected.center_x - then.center_x) * width,
        (expected.center_y - then.center_y) * height,
    ];
    let followed = flow.follow(before, now, then.pixel_corners(size), guess);
    let motion = followed.motion?;
    Some(BoundingBox {
        center_x: then.center_x + motion.shift[0] / width,
        center_y: then.center_y + motion.shift[1] / height,
        width: then.width * motion.scale,
        height: then.height * motion.scale,
    })
}

impl Policy for AlbireoFlow {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn knob(&self) -> Option<Knob> {
        self.inner.knob()
    }

    fn knob_value(&self) -> Option<f64> {
        self.inner.knob_value()
    }

    fn set_knob(&mut self, value: f64) -> Result<(), KnobError> {
        self.inner.set_knob(value)
    }

    fn begin(&mut self, frame: FrameHead) -> Need {
        self.age = self.age.saturating_add(frame.step.max(1));
        if self.age > LONGEST_GAP {
            self.before.clear();
        }
        self.now.clear();
        self.followed.clear();
        self.after_picture = None;
        match self.inner.begin(frame) {
            Need::Screen => Need::Screen,
            need => self.ask_for_picture(need, false),
        }
    }

    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        if let Some(after) = self.after_picture.take() {
            return match evidence {
                Evidence::GreyPicture(picture) => self.look(picture, after),
                _ => after,
            };
        }
        match self.inner.answer(evidence) {
            // After the screen's verdict: the picture is needed to follow new objects from.
            Need::Detections if self.now.is_empty() => self.ask_for_picture(Need::Detections, true),
            need => need,
        }
    }

    fn pictures(&self) -> Option<Need> {
        Some(self.picture_need())
    }

    fn longest_pause(&self) -> Option<u32> {
        self.inner.longest_pause()
    }

    fn finish(&mut self, outcome: &mut Outcome) {
        self.inner.finish(outcome);
        let followed = &self.followed;
        let find = |id: ObjectId| followed.iter().find(|seen| seen.object == id).copied();
        for reported in &mut outcome.boxes {
            if reported.source == BoxSource::Predicted && reported.object.and_then(find).is_some() {
                reported.source = BoxSource::Followed;
            }
        }
        if self.now.is_empty() {
            return;
        }
        std::mem::swap(&mut self.before, &mut self.now);
        self.now.clear();
        self.age = 0;
        self.seen.clear();
        self.seen.extend(self.inner.states().iter().map(|state| {
            let own = Seen {
                object: state.id,
                bounding_box: state.filter.bounding_box(),
                looks: state.since_update,
            };
            match state.since_update {
                0 => Seen {
                    bounding_box: state.detected,
                    ..own
                },
                _ => find(state.id).unwrap_or(own),
            }
        }));
    }

    fn can_rewind(&self) -> bool {
        true
    }

    fn save(&mut self) {
        let mut saved = (self.saved.take()).unwrap_or_else(|| Box::new(self.clone()));
        saved.copy_from(self);
        self.saved = Some(saved);
    }

    fn rewind(&mut self) {
        if let Some(saved) = self.saved.take() {
            self.copy_from(&saved);
            self.saved = Some(saved);
        }
    }

    fn reset(&mut self) {
        self.inner.reset();
        self.before.clear();
        self.now.clear();
        self.age = 0;
        self.seen.clear();
        self.followed.clear();
        self.after_picture = None;
    }

    fn objects(&self, visit: &mut dyn FnMut(&ObjectRecord)) {
        self.inner.objects(visit);
    }

    fn rejected_detections(&self) -> u64 {
        self.inner.rejected_detections()
    }
}

#[cfg(test)]
mod tests {
    use crate::policy::BoxSource;
    use crate::policy::tests::ride;

    #[test]
    fn a_followed_box_is_a_measurement_that_spares_calls() {
        let flow = ride("albireo+flow", usize::MAX);
        let blind = ride("albireo", usize::MAX);
        assert!(flow.calls.len() < blind.calls.len());
        let followed = flow.skipped.iter();
        assert!(
            followed
                .clone()
                .all(|(source, _)| *source == BoxSource::Followed)
        );
        let worst = |skipped: &[(BoxSource, f64)]| {
            let off = skipped.iter().map(|(_, off)| *off);
            off.fold(0.0, f64::max)
        };
        assert!(worst(&flow.skipped) < worst(&blind.skipped));
    }

    #[test]
    fn what_can_no_longer_be_followed_is_predicted_and_calls_the_detector() {
        let seen = ride("albireo+flow", usize::MAX);
        let hidden = ride("albireo+flow", 4);
        assert!(hidden.calls.len() > seen.calls.len());
        let predicted = |(source, _): &(BoxSource, f64)| *source == BoxSource::Predicted;
        assert!(hidden.skipped.iter().any(predicted));
    }
}
