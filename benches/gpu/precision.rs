//! Compares a model in half precision with the same model in float32: time, and boxes picture by picture.

use super::arguments::{Arguments, name_of};
use super::page::{NONE, median, ms};
use super::pieces::{Piece, Row, Table, TableName};
use super::stages::{decode_for, frames};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::{DetectorConfig, DetectorNetwork};
use albireo_vision::picture::Picture;
use std::path::{Path, PathBuf};

/// Boxes below this confidence are not compared: nobody sees them.
const CONFIDENCE: f64 = 0.25;

/// Two boxes are the same within so many pixels and so much confidence.
const PIXELS: f64 = 2.0;
const SCORE: f64 = 0.02;

pub(crate) fn table() -> Table {
    Table {
        heading: "Float32 against half precision",
        text: format!(
            "The same pictures through both files of a model, one after the other; medians of one run of the model. Boxes of \
             confidence {CONFIDENCE} or more; a pair overlaps most and has one class, and is *equal* within {PIXELS:.0} pixels and \
             {SCORE} of confidence."
        ),
        columns: &[
            "model",
            "float32, ms",
            "half, ms",
            "ratio",
            "boxes, float32",
            "boxes, half",
            "pairs",
            "of them equal",
            "largest distance, px",
            "largest difference of confidence",
        ],
    }
}

/// The pairs among `models`: `NAME.half.onnx` beside `NAME.open.onnx` or `NAME.onnx`.
pub(crate) fn pairs(models: &[PathBuf]) -> Vec<Piece> {
    let halves = models.iter().filter_map(|half| {
        let name = name_of(half);
        let stem = name.strip_suffix(".half.onnx")?;
        let names = [format!("{stem}.open.onnx"), format!("{stem}.onnx")];
        let whole = names
            .iter()
            .find_map(|name| models.iter().find(|model| name_of(model) == *name))?;
        Some(Piece::Precision {
            whole: whole.clone(),
            half: half.clone(),
        })
    });
    halves.collect()
}

pub(crate) fn measure(
    arguments: &Arguments,
    whole: &Path,
    half: &Path,
) -> anyhow::Result<Vec<Row>> {
    let whole = Answers::of(arguments, whole)?;
    let found = Answers::of(arguments, half)?;
    let mut comparison = Comparison::default();
    for (expected, found) in whole.pictures.iter().zip(&found.pictures) {
        comparison.add(&expected.boxes, &found.boxes, expected.size);
    }
    let ratio = whole.ms.zip(found.ms).map(|(whole, half)| format!("{:.2}", half / whole));
    Ok(vec![Row {
        table: TableName::Precision,
        cells: vec![
            name_of(half),
            ms(whole.ms),
            ms(found.ms),
            ratio.unwrap_or_else(|| NONE.to_owned()),
            whole.boxes().to_string(),
            found.boxes().to_string(),
            comparison.pairs.to_string(),
            comparison.equal.to_string(),
            format!("{:.2}", comparison.pixels),
            format!("{:.4}", comparison.score),
        ],
    }])
}

/// What one file of the model answers.
struct Answers {
    /// The median milliseconds of the model.
    ms: Option<f64>,
    pictures: Vec<AnsweredPicture>,
}

struct AnsweredPicture {
    size: PictureSize,
    boxes: Vec<Detection>,
}

impl Answers {
    fn of(arguments: &Arguments, model: &Path) -> anyhow::Result<Self> {
        let mut network = DetectorNetwork::open(&DetectorConfig {
            confidence: CONFIDENCE,
            ..arguments.detector(model)
        })?;
        let mut picture = Picture::default();
        let mut times = Vec::new();
        let mut pictures = Vec::new();
        for encoded in frames()? {
            decode_for(&network, &encoded, &mut picture)?;
            let prepared = network.preparation().prepare(&picture)?;
            let found = network.detect(&prepared)?;
            times.push(found.model.as_secs_f64() * 1e3);
            pictures.push(AnsweredPicture {
                size: encoded.size,
                boxes: found.detections,
            });
        }
        let ms = median(&times);
        Ok(Self { ms, pictures })
    }

    /// The number of boxes in all pictures.
    fn boxes(&self) -> usize {
        self.pictures.iter().map(|picture| picture.boxes.len()).sum()
    }
}

#[derive(Default)]
struct Comparison {
    pairs: usize,
    equal: usize,
    pixels: f64,
    score: f64,
}

impl Comparison {
    /// Pairs each expected box with the box of its class that overlaps it most.
    fn add(&mut self, expected: &[Detection], found: &[Detection], size: PictureSize) {
        let mut free: Vec<&Detection> = found.iter().collect();
        for one in expected {
            let overlap =
                |other: &Detection| one.bounding_box.intersection_over_union(other.bounding_box);
            let mut best = None;
            // Less than half is another object.
            let mut largest = 0.5;
            for (place, other) in free.iter().enumerate() {
                if other.class == one.class && overlap(other) > largest {
                    best = Some(place);
                    largest = overlap(other);
                }
            }
            let Some(best) = best else { continue };
            let other = free.swap_remove(best);
            let pixels = distance(one, other, size);
            let score = (one.confidence - other.confidence).abs();
            self.pairs += 1;
            self.equal += usize::from(pixels <= PIXELS && score <= SCORE);
            self.pixels = self.pixels.max(pixels);
            self.score = self.score.max(score);
        }
    }
}

/// The largest distance of two boxes' sides in pixels of the picture.
fn distance(one: &Detection, other: &Detection, size: PictureSize) -> f64 {
    let one = one.bounding_box.pixel_corners(size);
    let other = other.bounding_box.pixel_corners(size);
    [
        one.x1 - other.x1,
        one.y1 - other.y1,
        one.x2 - other.x2,
        one.y2 - other.y2,
    ]
    .into_iter()
    .fold(0.0, |largest, side| side.abs().max(largest))
}
