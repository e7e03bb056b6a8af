//! The states of all objects of one stream.

use super::{Association, LifeCycle, Matcher, Missed, ObjectState, is_usable};
use crate::detection::{Detection, ObjectId};
use crate::geometry::PictureSize;
use crate::kalman::{FilterModel, FilterParameters};

/// Consecutive lost frames above which all objects are forgotten. Neither the paper nor the code loses frames.
const LONGEST_GAP: u32 = 300;

/// Smallest side of an estimated box, pixels. Not in the paper.
const LEAST_SIDE: f64 = 1.0;

/// All settings of object states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectSettings {
    /// The parameters of the filter.
    pub filter: FilterParameters,
    /// The rules of matching.
    pub association: Association,
    /// The rules of birth and death.
    pub life_cycle: LifeCycle,
}

/// The result for one detection of the last [`ObjectStates::observe`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sighting {
    /// False for a rejected detection, which must not be reported either.
    pub usable: bool,
    /// The object that it matched or created.
    pub object: Option<ObjectId>,
    /// True if that object is now confirmed.
    pub confirmed: bool,
}

/// The object states of one stream, in order of creation. Buffers are reused between frames.
#[derive(Clone, Debug)]
pub(crate) struct ObjectStates {
    settings: ObjectSettings,
    picture: PictureSize,
    model: FilterModel,
    minimum_size: [f64; 2],
    states: Vec<ObjectState>,
    next_id: u64,
    matcher: Matcher,
    sightings: Vec<Sighting>,
    rejected: u64,
}

impl ObjectStates {
    /// Creates an empty collection.
    pub(crate) fn new(settings: ObjectSettings) -> Self {
        let picture = PictureSize::new(1, 1);
        let mut objects = Self {
            settings,
            picture,
            model: FilterModel::new(&settings.filter, picture),
            minimum_size: [0.0; 2],
            states: Vec::new(),
            next_id: 0,
            matcher: Matcher::default(),
            sightings: Vec::new(),
            rejected: 0,
        };
        objects.set_picture(picture);
        objects
    }

    /// Advances by `frames`, all but the last of which were lost, for pictures of size `picture`, and removes the
    /// objects that left the picture.
    pub(crate) fn predict(&mut self, picture: PictureSize, frames: u32) {
        if picture != self.picture {
            self.set_picture(picture);
        }
        let life_cycle = &self.settings.life_cycle;
        if frames.saturating_sub(1) > LONGEST_GAP {
            self.states.clear();
            return;
        }
        let model = &self.model;
        let [width, height] = self.minimum_size;
        self.states.retain_mut(|state| {
            // `all` ends where an object leaves. It is compiled to fewer instructions than a loop that returns.
            (0..frames).all(|_| {
                state.predict(model);
                state.filter.clamp_size(width, height);
                !life_cycle.has_left(state.filter.bounding_box())
            })
        });
    }

    /// Processes the detections: matches, updates, lets `missed` decide on each object without a detection, and creates
    /// objects from unmatched detections. The published code does so on every detector frame; the paper only on `E+I`
    /// frames, so that an object entering a busy scene would never be followed.
    pub(crate) fn observe(
        &mut self,
        detections: &[Detection],
        mut missed: impl FnMut(&mut ObjectState) -> Missed,
    ) {
        self.screen(detections);
        let hits_to_confirm = self.settings.life_cycle.hits_to_confirm;
        let model = &self.model;
        let [width, height] = self.minimum_size;
        let detection_of = self.matcher.associate(
            &self.settings.association,
            model,
            &self.states,
            detections,
            self.sightings.iter().map(|sighting| sighting.usable),
        );
        let mut detection_of = detection_of.iter();
        let sightings = &mut self.sightings;
        self.states.retain_mut(|state| {
            // One entry per state, in the same order.
            if let Some(&Some(index)) = detection_of.next() {
                state.update(&detections[index as usize], hits_to_confirm, model);
                state.filter.clamp_size(width, height);
                sightings[index as usize].object = Some(state.id);
                sightings[index as usize].confirmed = state.confirmed;
                true
            } else {
                missed(state) != Missed::Removed
            }
        });
        self.create(detections);
    }

    /// Records which detections are usable and counts the others.
    fn screen(&mut self, detections: &[Detection]) {
        self.sightings.clear();
        for detection in detections {
            let usable = is_usable(detection);
            self.rejected = self.rejected.saturating_add(u64::from(!usable));
            self.sightings.push(Sighting {
                usable,
                object: None,
                confirmed: false,
            });
        }
    }

    fn create(&mut self, detections: &[Detection]) {
        let hits_to_confirm = self.settings.life_cycle.hits_to_confirm;
        let found = detections.iter().zip(&mut self.sightings).zip(self.matcher.is_free());
        for ((detection, sighting), is_free) in found {
            if *is_free {
                let id = ObjectId(self.next_id);
                self.next_id += 1;
                let state = ObjectState::new(id, detection, hits_to_confirm, &self.model);
                sighting.object = Some(id);
                sighting.confirmed = state.confirmed;
                self.states.push(state);
            }
        }
    }

    /// Returns the objects, oldest first.
    pub(crate) fn states(&self) -> &[ObjectState] {
        &self.states
    }

    /// Returns the results for the detections of the last [`observe`](Self::observe), in the detector's order.
    pub(crate) fn sightings(&self) -> &[Sighting] {
        &self.sightings
    }

    /// Returns the filter model for the current picture size.
    pub(crate) fn model(&self) -> &FilterModel {
        &self.model
    }

    /// Returns the number of detections rejected so far because a filter could not use them.
    pub(crate) fn rejected_detections(&self) -> u64 {
        self.rejected
    }

    /// Copies the objects of `other`, which has the same settings. Allocates only while buffers grow.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.states.clone_from(&other.states);
        self.sightings.clone_from(&other.sightings);
        // All but the buffers, which stay.
        *self = Self {
            states: std::mem::take(&mut self.states),
            sightings: std::mem::take(&mut self.sightings),
            matcher: std::mem::take(&mut self.matcher),
            ..*other
        };
    }

    /// Forgets all objects; numbers restart from 0. Keeps the count of rejected detections.
    pub(crate) fn clear(&mut self) {
        self.states.clear();
        self.sightings.clear();
        self.next_id = 0;
    }

    fn set_picture(&mut self, picture: PictureSize) {
        self.picture = picture;
        self.model = FilterModel::new(&self.settings.filter, picture);
        let side = |pixels: u32| LEAST_SIDE / f64::from(pixels.max(1));
        self.minimum_size = [side(picture.width), side(picture.height)];
    }
}

#[cfg(test)]
mod tests;
