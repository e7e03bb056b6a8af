//! The states of all objects of one stream.

use super::{Association, LifeCycle, Matcher, Missed, ObjectState, is_usable};
use crate::detection::Detection;
use crate::detection::ObjectId;
use crate::geometry::PictureSize;
use crate::kalman::{FilterModel, FilterParameters};

/// Frames lost in a row after which all objects are forgotten. Neither paper nor code lose frames.
const LONGEST_GAP: u32 = 300;

/// Smallest side of an estimated box, pixels. Not in the paper.
const LEAST_SIDE: f64 = 1.0;

/// Everything that governs object states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectSettings {
    /// The filter's numbers.
    pub filter: FilterParameters,
    /// The rules of matching.
    pub association: Association,
    /// The rules of birth and death.
    pub life_cycle: LifeCycle,
}

/// What became of one detection of the last [`ObjectStates::observe`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sighting {
    /// False for a detection that was refused: it must not be reported either.
    pub usable: bool,
    /// The object it matched or created.
    pub object: Option<ObjectId>,
    /// Whether that object is confirmed now.
    pub confirmed: bool,
}

/// The object states of one stream, in order of their creation. Buffers are kept from frame to frame.
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
    /// No objects yet.
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

    /// Advances by `frames`, of which all but the last were lost, for pictures of size `picture`; and
    /// removes the objects that left the picture on the way.
    pub(crate) fn predict(&mut self, picture: PictureSize, frames: u32) {
        if picture != self.picture {
            self.set_picture(picture);
        }
        let life_cycle = &self.settings.life_cycle;
        if frames.saturating_sub(1) > LONGEST_GAP {
            self.states.clear();
            return;
        }
        let (model, [width, height]) = (&self.model, self.minimum_size);
        self.states.retain_mut(|state| {
            (0..frames).all(|_| {
                state.predict(model);
                state.filter.clamp_size(width, height);
                !life_cycle.has_left(state.filter.bounding_box())
            })
        });
    }

    /// Takes what the detector found: matches, updates, lets `missed` decide on each object without a
    /// detection, and creates objects from unmatched detections. So does the published code on every detector frame; the
    /// paper says it of `E+I` frames only, under which nothing that enters a busy scene would ever be followed.
    pub(crate) fn observe(
        &mut self,
        detections: &[Detection],
        mut missed: impl FnMut(&mut ObjectState) -> Missed,
    ) {
        self.screen(detections);
        let hits_to_confirm = self.settings.life_cycle.hits_to_confirm;
        let (model, [width, height]) = (&self.model, self.minimum_size);
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
            // One entry a state, in the same order.
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

    /// Notes which detections can be taken, and counts the others.
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
        let found = detections.iter().zip(&mut self.sightings);
        for ((detection, sighting), is_free) in found.zip(self.matcher.is_free()) {
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

    /// The objects, oldest first.
    pub(crate) fn states(&self) -> &[ObjectState] {
        &self.states
    }

    /// What became of each detection of the last [`observe`](Self::observe), in the detector's order.
    pub(crate) fn sightings(&self) -> &[Sighting] {
        &self.sightings
    }

    /// The settings in force.
    #[cfg(test)]
    pub(crate) fn settings(&self) -> &ObjectSettings {
        &self.settings
    }

    /// The filter's numbers for the present picture size.
    pub(crate) fn model(&self) -> &FilterModel {
        &self.model
    }

    /// Detections refused so far because a filter could not digest them.
    pub(crate) fn rejected_detections(&self) -> u64 {
        self.rejected
    }

    /// Takes over the objects of `other`, which has the same settings. Allocates only while buffers grow.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let Self {
            settings: _,
            picture,
            model,
            minimum_size,
            states,
            next_id,
            matcher: _,
            sightings,
            rejected,
        } = other;
        self.picture = *picture;
        self.model = *model;
        self.minimum_size = *minimum_size;
        self.states.clone_from(states);
        self.next_id = *next_id;
        self.sightings.clone_from(sightings);
        self.rejected = *rejected;
    }

    /// Forgets all objects; numbers start from 0 again. The count of refused detections stays.
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
