//! The objects in view and their tracking, independent of the trigger.

use super::association::associate;
use super::motion::{LARGEST_LOG, LOG_HEIGHT, LOG_WIDTH, X, Y};
use super::object::{Object, scale};
use super::settings::{
    BIRTH_CONFIDENCE, CAMERA_ALPHA_RATE, HITS_TO_CONFIRM, LEAST_CONFIDENCE, LEAST_SIDE,
    LEAST_VISIBLE, Pixels,
};
use super::velocity::{VelocityRegression, features};
use crate::detection::Detection;
use crate::geometry::{BoundingBox, Corners, PictureSize};
use crate::objects::{Pairing, is_usable};
use crate::policy::{BoxSource, ObjectId, OutputBox};

/// All objects of a stream.
#[derive(Clone, Debug)]
pub(super) struct Objects {
    objects: Vec<Object>,
    next_id: u64,
    picture: PictureSize,
    /// Width of the picture in picture heights.
    aspect: f64,
    /// The camera-wide covariance scale ᾱ.
    camera_alpha: f64,
    velocity: VelocityRegression,
    pairing: Pairing,
    rejected: u64,
}

impl Default for Objects {
    fn default() -> Self {
        Self {
            objects: Vec::new(),
            next_id: 0,
            picture: PictureSize::new(1, 1),
            aspect: 1.0,
            camera_alpha: 1.0,
            velocity: VelocityRegression::default(),
            pairing: Pairing::default(),
            rejected: 0,
        }
    }
}

impl Objects {
    /// Copies the objects of `other`. Allocates only while buffers grow.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.objects.clone_from(&other.objects);
        // All but the buffers, which stay.
        *self = Self {
            objects: std::mem::take(&mut self.objects),
            pairing: std::mem::take(&mut self.pairing),
            ..*other
        };
    }

    /// Forgets the objects, but keeps the learnt parameters.
    pub(crate) fn forget(&mut self) {
        self.objects.clear();
    }

    /// Forgets all objects and the learnt parameters; numbers restart from 0.
    pub(crate) fn clear(&mut self) {
        self.objects.clear();
        self.next_id = 0;
        self.camera_alpha = 1.0;
        self.velocity = VelocityRegression::default();
    }

    /// Returns the objects, oldest first.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Object> {
        self.objects.iter()
    }

    /// Returns the number of objects.
    pub(crate) fn len(&self) -> usize {
        self.objects.len()
    }

    /// Returns the width of the picture in picture heights.
    pub(crate) fn aspect(&self) -> f64 {
        self.aspect
    }

    /// Returns the number of detections rejected so far.
    pub(crate) fn rejected_detections(&self) -> u64 {
        self.rejected
    }

    /// Sets the picture size of the next frame. A change of the aspect ratio changes the view, so the objects are
    /// forgotten.
    pub(crate) fn set_picture(&mut self, picture: PictureSize) {
        if picture == self.picture {
            return;
        }
        self.picture = picture;
        let aspect = f64::from(picture.width.max(1)) / f64::from(picture.height.max(1));
        if aspect != self.aspect {
            self.objects.clear();
            self.aspect = aspect;
        }
    }

    /// Advances by one frame; removes the objects that leave the picture.
    pub(crate) fn predict(&mut self) {
        let aspect = self.aspect;
        self.objects.retain_mut(|object| {
            object.predict();
            object.visible_share(aspect) >= LEAST_VISIBLE
        });
    }

    /// Computes the miss probability of each predicted box, once per frame after the last [`predict`](Self::predict).
    pub(crate) fn judge(&mut self) {
        for object in &mut self.objects {
            object.judge();
        }
    }

    /// Returns the objects for following.
    pub(crate) fn as_mut_slice(&mut self) -> &mut [Object] {
        &mut self.objects
    }

    /// Processes the detections: matches, updates, removes, creates. Returns the summed scores of the new objects.
    pub(crate) fn observe(&mut self, pixels: Pixels, detections: &[Detection]) -> f64 {
        let aspect = self.aspect;
        let pairing = &mut self.pairing;
        let rejected = &mut self.rejected;
        let usable = detections.iter().map(|detection| {
            let usable = is_usable(detection);
            *rejected = rejected.saturating_add(u64::from(!usable));
            usable
        });
        associate(pairing, &self.objects, detections, usable, aspect);
        self.velocity.fade();
        let velocity = &mut self.velocity;
        let camera_alpha = &mut self.camera_alpha;
        let mut detection_of = self.pairing.detection_of().iter();
        self.objects.retain_mut(|object| {
            // One entry per object, in the same order.
            let Some(&Some(index)) = detection_of.next() else {
                return object.miss();
            };
            let n = object.update(&detections[index as usize], aspect);
            *camera_alpha = scale(*camera_alpha, n, CAMERA_ALPHA_RATE);
            if object.hits >= HITS_TO_CONFIRM {
                velocity.learn(&object_features(object, aspect), &object.filter.velocity());
            }
            true
        });
        self.create(pixels, detections)
    }

    /// Creates an object from each free detection that is sure enough; returns the sum of their scores.
    fn create(&mut self, pixels: Pixels, detections: &[Detection]) -> f64 {
        let mut scores = 0.0;
        for (detection, is_free) in detections.iter().zip(self.pairing.is_free()) {
            if !*is_free || detection.confidence < BIRTH_CONFIDENCE {
                continue;
            }
            scores += detection.confidence;
            let found = detection.bounding_box;
            let area = found.width * self.aspect * found.height;
            // The area of a thin box may round to 0.
            let log_size = (area.ln() / 2.0).max(-LARGEST_LOG);
            let place = features(found.center_x, found.center_y, log_size);
            let velocity = self.velocity.expect(&place);
            let id = ObjectId(self.next_id);
            self.next_id += 1;
            let alpha = self.camera_alpha;
            let object = Object::new(id, detection, self.aspect, &velocity, alpha, pixels);
            self.objects.push(object);
        }
        scores
    }

    /// Appends the boxes to report. `detected` is true if the detector ran on this frame.
    pub(crate) fn report(&self, detected: bool, boxes: &mut Vec<OutputBox>) -> Report {
        let mut report = Report::default();
        let least = [
            LEAST_SIDE / f64::from(self.picture.width.max(1)),
            LEAST_SIDE / f64::from(self.picture.height.max(1)),
        ];
        for object in &self.objects {
            let confidence = object.confidence();
            if object.misses > 0 && confidence < LEAST_CONFIDENCE {
                continue;
            }
            let Some(bounding_box) = clip(object.bounding_box(self.aspect), least) else {
                continue;
            };
            let source = match (detected, object.detected_box) {
                (false, _) if object.followed => BoxSource::Followed,
                (false, _) => BoxSource::Predicted,
                (true, Some(_)) => BoxSource::Detected,
                (true, None) => BoxSource::Rescued,
            };
            report.confidence += confidence;
            report.rescued |= source == BoxSource::Rescued;
            boxes.push(OutputBox {
                bounding_box,
                class: object.class,
                confidence,
                source,
                object: Some(object.id),
                confirmed: object.hits >= HITS_TO_CONFIRM,
            });
        }
        report
    }
}

/// Summary of the boxes of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Report {
    /// Sum of the confidences.
    pub confidence: f64,
    /// True if a box is rescued.
    pub rescued: bool,
}

fn object_features(object: &Object, aspect: f64) -> super::velocity::Features {
    let position = object.filter.position();
    let log_size = (position[LOG_WIDTH] + position[LOG_HEIGHT]) / 2.0;
    features(position[X] / aspect, position[Y], log_size)
}

/// Returns the part of a box inside the picture, if its sides are longer than `least`.
fn clip(bounding_box: BoundingBox, least: [f64; 2]) -> Option<BoundingBox> {
    let Corners { x1, y1, x2, y2 } = bounding_box.corners().clipped();
    let clipped = BoundingBox::new((x1 + x2) / 2.0, (y1 + y2) / 2.0, x2 - x1, y2 - y1);
    let is_large_enough = clipped.width > least[0] && clipped.height > least[1];
    is_large_enough.then_some(clipped)
}
