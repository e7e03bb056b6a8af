//! Turns the model's output into detections: the head, classes, suppression, and counts of what is dropped.

use super::DetectorConfig;
use super::classes::{Classes, Reporting};
use super::head::{Candidate, Head, Suppression, keep_best, suppress};
use crate::onnx::{TensorView, shape_text};
use crate::picture::InputMapping;
use crate::worker::RunError;
use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::PictureSize;
use parking_lot::Mutex;
use std::sync::Arc;
use tracing::warn;

/// Rows and boxes of the model's output that were not reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HeadCounts {
    /// Rows with a number that is not finite or not possible, and boxes much larger than the input.
    pub rejected: u64,
    /// Boxes outside the picture.
    pub outside: u64,
    /// Boxes with a class number for which the model has no name.
    pub unknown_class: u64,
    /// Boxes beyond `MOST_CANDIDATES` of the suppression or the configured maximum of detections; at least one per
    /// frame that has any.
    pub over_limit: u64,
    /// Boxes of classes that are not reported (`detector.report_classes`).
    pub other_class: u64,
}

/// The counts of a detector's head for metrics; does not keep the detector running.
#[derive(Clone, Debug, Default)]
pub struct HeadMeter(Arc<Mutex<HeadCounts>>);

impl HeadMeter {
    /// Returns the counts since the detector started.
    pub fn read(&self) -> HeadCounts {
        *self.0.lock()
    }

    fn update(&self, update: impl FnOnce(&mut HeadCounts)) {
        update(&mut self.0.lock());
    }
}

/// The results in the output for one picture.
pub(super) struct ReadOut {
    pub(super) detections: Vec<Detection>,
    /// True if there are results and all of them are impossible.
    pub(super) is_impossible: bool,
}

/// Turns the model's output into detections.
pub(super) struct Reader {
    confidence: f64,
    suppression: Suppression,
    pub(super) classes: Classes,
    /// What the head has read, with the model's classes. This and the next two are reused from picture to picture.
    candidates: Vec<Candidate>,
    /// Those of classes that are reported, with the classes under which they are.
    reported: Vec<Candidate>,
    /// Those of classes that are not.
    others: Vec<Candidate>,
    pub(super) meter: HeadMeter,
}

impl Reader {
    /// Creates a reader for a model with these classes. It counts by itself until it is given a meter.
    pub(super) fn new(classes: Classes, config: &DetectorConfig) -> Self {
        Self {
            confidence: config.confidence,
            suppression: Suppression {
                overlap: config.suppression_overlap,
                per_class: true,
                most: config.most_detections,
            },
            classes,
            candidates: Vec::new(),
            reported: Vec::new(),
            others: Vec::new(),
            meter: HeadMeter::default(),
        }
    }

    /// Reads the output for one picture with the head of its input.
    ///
    /// # Errors
    /// If the output does not have the shape that the model announced.
    pub(super) fn read(
        &mut self,
        head: &Head,
        outputs: &[TensorView<'_>],
        mapping: InputMapping,
    ) -> Result<ReadOut, RunError> {
        self.candidates.clear();
        let rejected = head
            .read(outputs, self.confidence, &mut self.candidates)
            .map_err(RunError::Failed)?;
        Ok(self.detections(head.overlaps_in(outputs), mapping, rejected))
    }

    /// The detections of reported classes of at least `confidence` in the output for one picture; counts nothing.
    ///
    /// # Errors
    /// If the output does not have the shape that the model announced.
    pub(super) fn uncounted(
        &mut self,
        head: &Head,
        outputs: &[TensorView<'_>],
        mapping: InputMapping,
        confidence: f64,
    ) -> Result<Vec<Detection>, String> {
        self.candidates.clear();
        head.read(outputs, confidence, &mut self.candidates)?;
        self.reported.clear();
        for candidate in &self.candidates {
            if let Reporting::As(class) = self.classes.reporting(candidate.class) {
                self.reported.push(Candidate {
                    class,
                    ..*candidate
                });
            }
        }
        if head.overlaps_in(outputs) {
            suppress(&mut self.reported, self.suppression);
        }
        Ok(self.mapped(mapping))
    }

    /// The reported candidates as detections in the source picture, without those outside it.
    fn mapped(&self, mapping: InputMapping) -> Vec<Detection> {
        self.reported
            .iter()
            .filter_map(|candidate| detection(candidate, mapping))
            .collect()
    }

    /// Returns the candidates that stay, as detections in the source picture; counts the others and the `rejected`. If
    /// candidates may overlap, one object keeps one of them.
    fn detections(&mut self, overlap: bool, mapping: InputMapping, rejected: u64) -> ReadOut {
        let mut counts = HeadCounts {
            rejected,
            ..HeadCounts::default()
        };
        let mut nameless = None;
        self.reported.clear();
        self.others.clear();
        for candidate in &self.candidates {
            match self.classes.reporting(candidate.class) {
                Reporting::As(class) => self.reported.push(Candidate {
                    class,
                    ..*candidate
                }),
                Reporting::LeftOut => self.others.push(*candidate),
                Reporting::NoSuchClass => {
                    counts.unknown_class += 1;
                    nameless = Some(candidate.class);
                }
            }
        }
        if let Some(class) = nameless {
            self.tell_once_of(class);
        }
        let are_all_reported = self.others.is_empty() && counts.unknown_class == 0;
        if overlap {
            suppress(&mut self.others, self.suppression);
        }
        counts.other_class = self.others.len() as u64;
        counts.over_limit = if overlap {
            suppress(&mut self.reported, self.suppression)
        } else {
            keep_best(&mut self.reported, self.suppression.most)
        };
        let detections = self.mapped(mapping);
        counts.outside = (self.reported.len() - detections.len()) as u64;
        self.meter.update(|total| {
            total.rejected += counts.rejected;
            total.outside += counts.outside;
            total.unknown_class += counts.unknown_class;
            total.over_limit += counts.over_limit;
            total.other_class += counts.other_class;
        });
        let some_are_impossible = counts.rejected + counts.outside > 0;
        ReadOut {
            is_impossible: some_are_impossible && are_all_reported && detections.is_empty(),
            detections,
        }
    }

    /// Says with the first box of a class without a name that there are such boxes: their number may be all that shows
    /// that the names of the others are wrong. Call before it is counted.
    fn tell_once_of(&self, class: ClassId) {
        if self.meter.read().unknown_class == 0 {
            warn!(
                class = class.0,
                "the model finds a class for which there is no name, and its boxes are not reported. If the numbers of its \
                 classes begin with 1, all names are shifted by one: let detector.class_names begin with a name that does \
                 not occur, or set it to \"coco91\" for the category numbers of COCO"
            );
        }
    }
}

/// The candidate clipped to the source picture; `None` if no part of it is inside.
fn detection(candidate: &Candidate, mapping: InputMapping) -> Option<Detection> {
    let clipped = mapping.to_source(candidate.corners).corners().clipped();
    if clipped.area() <= 0.0 {
        return None;
    }
    Some(Detection {
        bounding_box: clipped.normalise(PictureSize::new(1, 1)),
        class: candidate.class,
        confidence: f64::from(candidate.confidence),
    })
}

/// The outputs of a run for several pictures, split: each picture gets all outputs with a batch of 1.
pub(super) struct Parts {
    shapes: Vec<Vec<i64>>,
    pictures: usize,
}

impl Parts {
    /// Splits the outputs of a run of `pictures`.
    ///
    /// # Errors
    /// If an output is for another number of pictures.
    pub(super) fn of(outputs: &[TensorView<'_>], pictures: usize) -> Result<Self, RunError> {
        let shape_of_one = |output: &TensorView<'_>| match output.shape {
            [batch, rest @ ..] if usize::try_from(*batch) == Ok(pictures) => {
                Ok([&[1], rest].concat())
            }
            shape => Err(RunError::Failed(format!(
                "the model returned an output of {} for a batch of {pictures}",
                shape_text(shape)
            ))),
        };
        Ok(Self {
            shapes: outputs.iter().map(shape_of_one).collect::<Result<_, _>>()?,
            pictures,
        })
    }

    /// The outputs for picture number `picture`.
    pub(super) fn get<'a>(
        &'a self,
        outputs: &[TensorView<'a>],
        picture: usize,
    ) -> Vec<TensorView<'a>> {
        let part = |(output, shape): (&TensorView<'a>, &'a Vec<i64>)| {
            let length = output.values.len() / self.pictures;
            TensorView {
                shape,
                values: &output.values[picture * length..][..length],
            }
        };
        outputs.iter().zip(&self.shapes).map(part).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::HeadName;
    use crate::detector::head::tests::bound;
    use crate::picture::{Letterbox, Picture};

    fn view<'a>(shape: &'a [i64], values: &'a [f32]) -> TensorView<'a> {
        TensorView { shape, values }
    }

    /// What a YOLO model with one class has found when all its boxes have this centre and these sides, and this score.
    fn read(boxes: [f32; 4], score: f32) -> ReadOut {
        const ANCHORS: usize = 42;
        let shape = [1, 5, ANCHORS as i64];
        let head = bound(HeadName::Yolo, &[1, 3, 32, 64], &[("output0", &shape)]);
        let mut letterbox = Letterbox::new(head.input_format);
        let black = Picture::black(head.input_format.size);
        let mapping = letterbox.fill(&black).unwrap();
        let config = DetectorConfig::default();
        let classes = Classes::new(&["car".to_owned()], &config).unwrap();
        let [x, y, width, height] = boxes;
        let values = [x, y, width, height, score].map(|value| [value; ANCHORS]);
        let output = view(&shape, values.as_flattened());
        Reader::new(classes, &config).read(&head, &[output], mapping).unwrap()
    }

    #[test]
    fn output_is_impossible_if_all_of_its_boxes_are_rejected() {
        const SOUND: [f32; 4] = [24.0, 12.0, 32.0, 16.0];
        for (boxes, score, found, is_impossible) in [
            (SOUND, 0.9, 1, false),
            (SOUND, 0.1, 0, false),
            (SOUND, f32::NAN, 0, true),
            ([500.0, 500.0, 32.0, 16.0], 0.9, 0, true),
        ] {
            let read_out = read(boxes, score);
            assert_eq!(read_out.detections.len(), found, "{boxes:?} {score}");
            assert_eq!(read_out.is_impossible, is_impossible, "{boxes:?} {score}");
        }
    }

    #[test]
    fn a_class_without_a_name_is_told_once_with_what_mends_it() {
        let shape = [1, 1, 6];
        let head = bound(HeadName::EndToEnd, &[1, 3, 32, 64], &[("output0", &shape)]);
        let black = Picture::black(head.input_format.size);
        let mapping = Letterbox::new(head.input_format).fill(&black).unwrap();
        let config = DetectorConfig::default();
        let classes = Classes::new(&["car".to_owned()], &config).unwrap();
        let mut reader = Reader::new(classes, &config);
        let file = tempfile::NamedTempFile::new().unwrap();
        let subscriber = tracing_subscriber::fmt().with_writer(file.reopen().unwrap()).finish();
        let _logging = tracing::subscriber::set_default(subscriber);
        for class in [0.0, 1.0, 1.0] {
            let values = [8.0, 4.0, 40.0, 20.0, 0.9, class];
            reader.read(&head, &[view(&shape, &values)], mapping).unwrap();
        }
        let log = std::fs::read_to_string(&file).unwrap();
        assert_eq!(log.matches("detector.class_names").count(), 1, "{log}");
        assert_eq!(reader.meter.read().unknown_class, 2);
    }

    #[test]
    fn outputs_of_a_batch_are_split_by_picture() {
        let boxes: Vec<f32> = (0..12).map(|value| value as f32).collect();
        let outputs = [view(&[2, 3, 2], &boxes), view(&[2, 1], &[0.5, 0.6])];
        let parts = Parts::of(&outputs, 2).unwrap();
        let second = parts.get(&outputs, 1);
        assert_eq!(
            second,
            [view(&[1, 3, 2], &boxes[6..]), view(&[1, 1], &[0.6])]
        );
    }

    #[test]
    fn outputs_for_another_number_of_pictures_are_an_error() {
        let outputs = [view(&[2, 3, 2], &[0.0; 12]), view(&[2, 1], &[0.5, 0.6])];
        let error = Parts::of(&outputs, 3).err().unwrap().to_string();
        assert!(error.contains("[2, 3, 2] for a batch of 3"), "{error}");
    }
}
