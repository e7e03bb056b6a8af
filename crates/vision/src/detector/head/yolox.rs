//! YOLOX: a row per cell, decoded in the graph or not. Nothing but the boxes of a run tells which.

use super::dense::{Anchors, BoxForm, Dense, cell_of};
use super::reading::{Rows, largest_number};
use super::{Evidence, ReadOutputs};
use crate::onnx::TensorView;
use std::sync::OnceLock;

/// Logarithms of sides stay below it: e^8 cells are longer than any input. Sides in pixels do not: a model whose boxes
/// are all of at most eight pixels finds nothing.
const LARGEST_LOGARITHM: f64 = 8.0;

/// The parameters for reading the output.
#[derive(Debug)]
pub(super) struct Yolox {
    /// How it is read if it is decoded.
    decoded: Dense,
    strides: &'static [u32],
    /// True if it is decoded. The first run with boxes decides it for all: one model does not write them in two ways.
    is_decoded: OnceLock<bool>,
}

impl Yolox {
    pub(super) fn new(decoded: Dense, strides: &'static [u32]) -> Self {
        Self {
            decoded,
            strides,
            is_decoded: OnceLock::new(),
        }
    }

    /// How the outputs are read.
    fn reading(&self, outputs: &[TensorView<'_>]) -> Result<Dense, String> {
        let is_decoded = match self.is_decoded.get() {
            Some(known) => *known,
            None => match self.told_by(&self.decoded.anchors(outputs)?) {
                Some(told) => *self.is_decoded.get_or_init(|| told),
                None => false,
            },
        };
        if is_decoded {
            return Ok(self.decoded);
        }
        Ok(Dense {
            form: BoxForm::InCells(self.strides),
            ..self.decoded
        })
    }

    /// True if the boxes of a run are decoded: most have a number that is no logarithm, or they are parts of the input's
    /// sides, where nearly all cells beside the middle have their centre on their own side of it. Offsets in cells are about
    /// the same everywhere. `None` if there are no boxes.
    fn told_by(&self, anchors: &Anchors<'_>) -> Option<bool> {
        let mut total = 0_usize;
        let mut in_pixels = 0_usize;
        let mut across = Halves::default();
        let mut down = Halves::default();
        let size = self.decoded.size;
        for (number, sides) in anchors.sides().enumerate() {
            let Some(largest) = largest_number(sides) else {
                continue;
            };
            total += 1;
            if largest > LARGEST_LOGARITHM {
                in_pixels += 1;
            } else if let Some(cell) = cell_of(number, self.strides, size) {
                let [x, y, width, height] = sides;
                let has_area = width > 0.0 && height > 0.0;
                let part_of = |place: f64, side: u32| (place + 0.5) * cell.stride / f64::from(side);
                across.add(part_of(cell.column, size.width), x, has_area);
                down.add(part_of(cell.line, size.height), y, has_area);
            }
        }
        if total == 0 {
            return None;
        }
        Some(2 * in_pixels > total || (across.are_apart() && down.are_apart()))
    }
}

/// The cells of the first and of the last third of the input, in one direction.
#[derive(Default)]
struct Halves {
    first: Half,
    last: Half,
}

/// Cells on one side of the middle.
#[derive(Default)]
struct Half {
    cells: u32,
    /// Those whose box has an area, and its centre on the same side.
    with_their_box: u32,
}

impl Halves {
    /// Adds a cell in this place and the centre of its box, both as parts of the input's side.
    fn add(&mut self, cell: f64, centre: f64, has_area: bool) {
        if cell < 1.0 / 3.0 {
            self.first.add(has_area && centre < 0.5);
        } else if cell > 2.0 / 3.0 {
            self.last.add(has_area && centre > 0.5);
        }
    }

    fn are_apart(&self) -> bool {
        self.first.is_whole() && self.last.is_whole()
    }
}

impl Half {
    fn add(&mut self, is_with_its_box: bool) {
        self.cells += 1;
        self.with_their_box += u32::from(is_with_its_box);
    }

    /// True if nearly all of its cells have their boxes there.
    fn is_whole(&self) -> bool {
        self.cells > 0 && 10 * self.with_their_box >= 9 * self.cells
    }
}

impl ReadOutputs for Yolox {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        self.reading(outputs)?.read(outputs, rows)
    }

    fn evidence(&self, outputs: &[TensorView<'_>], confidence: f64) -> Evidence {
        match self.reading(outputs) {
            Ok(reading) => reading.evidence(outputs, confidence),
            Err(_) => Evidence::None,
        }
    }
}
