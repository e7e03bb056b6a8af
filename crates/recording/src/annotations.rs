//! Boxes as a viewer draws them over a picture.

use crate::foxglove::{
    Color, ImageAnnotations, LINE_LOOP, Point2, PointsAnnotation, TextAnnotation, timestamp,
};
use albireo_core::policy::BoxSource;
use albireo_wire::BoxMessage;
use prost_types::Timestamp;

/// Thickness of lines and size of letters, as parts of the picture's height.
const THICKNESS: f64 = 1.0 / 360.0;
const LETTERS: f64 = 1.0 / 45.0;

/// In a small picture, lines and letters of at least so many pixels can still be seen.
const THINNEST: f64 = 1.0;
const SMALLEST_LETTERS: f64 = 8.0;

/// The boxes of a frame of this time, in a picture of this height in pixels.
pub(crate) fn annotations(boxes: &[BoxMessage], t_ns: u64, height: u32) -> ImageAnnotations {
    let timestamp = timestamp(t_ns);
    let height = f64::from(height);
    ImageAnnotations {
        points: boxes.iter().map(|found| outline(found, timestamp, height)).collect(),
        texts: boxes.iter().map(|found| label(found, timestamp, height)).collect(),
        timestamp,
    }
}

fn outline(found: &BoxMessage, timestamp: Option<Timestamp>, height: f64) -> PointsAnnotation {
    let [left, top, right, bottom] = found.corners.map(f64::from);
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
    PointsAnnotation {
        timestamp,
        r#type: LINE_LOOP,
        points: corners.map(|(x, y)| Point2 { x, y }).to_vec(),
        outline_color: Some(color(found.source)),
        thickness: (height * THICKNESS).max(THINNEST),
    }
}

/// The class and the number of the object, at the top left corner.
fn label(found: &BoxMessage, timestamp: Option<Timestamp>, height: f64) -> TextAnnotation {
    let [left, top, ..] = found.corners.map(f64::from);
    let class = &found.class;
    TextAnnotation {
        timestamp,
        position: Some(Point2 { x: left, y: top }),
        text: match found.object {
            Some(object) => format!("{class} {}", object.0),
            None => class.clone(),
        },
        font_size: (height * LETTERS).max(SMALLEST_LETTERS),
        text_color: Some(color(found.source)),
    }
}

/// The colour of a box wherever one is drawn: red, green and blue. The node's page has the same.
pub const fn colour(source: BoxSource) -> [u8; 3] {
    match source {
        BoxSource::Detected => [79, 179, 255],
        BoxSource::Predicted => [107, 226, 143],
        BoxSource::Followed => [214, 226, 107],
        BoxSource::Rescued => [255, 180, 84],
    }
}

fn color(source: BoxSource) -> Color {
    let [r, g, b] = colour(source).map(|part| f64::from(part) / 255.0);
    Color { r, g, b, a: 1.0 }
}
