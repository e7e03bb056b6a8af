//! The head of final boxes: outputs whose columns are the sides of a box, its score and its class, in any order. Most
//! exports with suppression inside are of this kind, and differ only in the order of the columns.

use super::families::is_cells;
use super::reading::{Rows, candidate, count, elements, unit};
use super::{Bound, Evidence, ReadOutputs};
use crate::onnx::{ElementType, Signature, TensorSpec, TensorView};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use std::fmt;
use std::str::FromStr;

/// The maximum number of final boxes. More rows are cells of which several may show one object.
pub(super) const MOST_BOXES: i64 = 1000;

/// The meaning of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Column {
    /// The number of the picture in the batch; there is one, and unused rows have -1.
    Batch,
    X1,
    Y1,
    X2,
    Y2,
    CentreX,
    CentreY,
    Width,
    Height,
    Score,
    Class,
    /// Anything else.
    Skipped,
}

/// Each column with its name in a setting.
const COLUMNS: [(Column, &str); 12] = [
    (Column::Batch, "batch"),
    (Column::X1, "x1"),
    (Column::Y1, "y1"),
    (Column::X2, "x2"),
    (Column::Y2, "y2"),
    (Column::CentreX, "cx"),
    (Column::CentreY, "cy"),
    (Column::Width, "w"),
    (Column::Height, "h"),
    (Column::Score, "score"),
    (Column::Class, "class"),
    (Column::Skipped, "_"),
];

/// The columns of one output.
#[derive(Clone, Debug, PartialEq, Eq)]
struct OutputColumns {
    /// The output's name; `None` for the only output.
    output: Option<String>,
    columns: Vec<Column>,
}

/// The columns of a model's outputs, as a setting lists them: `x1 y1 x2 y2 score class` for the only output, or
/// `boxes: x1 y1 x2 y2, scores: score, labels: class` for several by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnList(Vec<OutputColumns>);

impl FromStr for ColumnList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut outputs = Vec::new();
        let mut seen = Vec::new();
        let mut is_named_twice = false;
        for part in text.split(',') {
            // A name may hold a colon itself: `detection_boxes:0: y1 x1 y2 x2`.
            let (output, names) = match part.rsplit_once(": ") {
                Some((output, names)) => (Some(output.trim().to_owned()), names),
                None => (None, part),
            };
            let mut columns = Vec::new();
            for name in names.split_whitespace() {
                let Some(column) = Column::named(name) else {
                    let known = COLUMNS.map(|(_, known)| known).join(" ");
                    return Err(format!(
                        "`{name}` in the columns `{text}` is none of {known}"
                    ));
                };
                columns.push(column);
                if column != Column::Skipped {
                    is_named_twice |= seen.contains(&column);
                    seen.push(column);
                }
            }
            outputs.push(OutputColumns { output, columns });
        }
        if is_named_twice {
            return Err(format!("the columns `{text}` name one column twice"));
        }
        if outputs.len() > 1 && outputs.iter().any(|output| output.output.is_none()) {
            return Err(format!(
                "the columns `{text}` are of several outputs, which all need a name: `boxes: x1 y1 x2 y2, scores: score`"
            ));
        }
        let is_box = are_ends(&seen, ACROSS) && are_ends(&seen, DOWN);
        if !is_box || !seen.contains(&Column::Score) {
            return Err(format!(
                "the columns `{text}` need a box (x1 y1 x2 y2, or cx cy w h, or x1 y1 w h) and a score; `class` is \
                 left out if there is one class, `_` skips a column"
            ));
        }
        Ok(Self(outputs))
    }
}

impl fmt::Display for ColumnList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, output) in self.0.iter().enumerate() {
            if place > 0 {
                f.write_str(", ")?;
            }
            if let Some(name) = &output.output {
                write!(f, "{name}: ")?;
            }
            let names: Vec<_> = output.columns.iter().map(|column| column.name()).collect();
            f.write_str(&names.join(" "))?;
        }
        Ok(())
    }
}

/// The columns that may give one direction of a box: first end, centre, last end and length.
type EndColumns = [Column; 4];

const ACROSS: EndColumns = [Column::X1, Column::CentreX, Column::X2, Column::Width];
const DOWN: EndColumns = [Column::Y1, Column::CentreY, Column::Y2, Column::Height];

/// True if the columns that are there say where a box begins and ends in one direction, and no more than that.
fn are_ends(seen: &[Column], [first, centre, last, length]: EndColumns) -> bool {
    let is_there = [first, centre, last, length].map(|column| seen.contains(&column));
    matches!(
        is_there,
        [true, false, true, false] | [true, false, false, true] | [false, true, false, true]
    )
}

impl Column {
    fn named(name: &str) -> Option<Self> {
        let (column, _) = COLUMNS.iter().find(|(_, known)| *known == name)?;
        Some(*column)
    }

    fn name(self) -> &'static str {
        COLUMNS.iter().find(|(column, _)| *column == self).map_or("", |(_, name)| name)
    }
}

/// Where a column is.
#[derive(Clone, Copy, Debug)]
struct ColumnPlace {
    /// The index of its output among those that are read.
    output: usize,
    /// Its place in a row of that output.
    in_row: usize,
}

/// An output that is read.
#[derive(Debug)]
struct ReadOutput {
    /// Its index in the model.
    index: usize,
    shape: Vec<i64>,
    /// The length of a row.
    length: usize,
}

/// The parameters for reading the outputs.
#[derive(Debug)]
struct Finished {
    size: PictureSize,
    outputs: Vec<ReadOutput>,
    batch: Option<ColumnPlace>,
    /// Left or centre, and right or width: what each column means, and where it is.
    across: [(Column, ColumnPlace); 2],
    down: [(Column, ColumnPlace); 2],
    score: ColumnPlace,
    class: Option<ColumnPlace>,
}

/// Binds the columns to a model.
pub(super) fn bind(
    list: &ColumnList,
    signature: &Signature,
    size: PictureSize,
) -> Result<Bound, String> {
    let mut outputs = Vec::new();
    let mut places = Vec::new();
    // -1 until an output tells their number.
    let mut rows = -1;
    for part in &list.0 {
        let (index, spec) = match &part.output {
            Some(name) => signature.output(name)?,
            None => (0, signature.only_output()?),
        };
        if matches!(spec.element, ElementType::Uint8 | ElementType::Other(_)) {
            return Err(format!(
                "the elements of its output `{}` are {}",
                spec.name, spec.element
            ));
        }
        let length = part.columns.len();
        let these = rows_of(spec, length)?;
        if rows == -1 {
            rows = these;
        } else if these != -1 && these != rows {
            return Err("its outputs have different numbers of rows".to_owned());
        }
        let output = outputs.len();
        for (in_row, column) in part.columns.iter().enumerate() {
            places.push((*column, ColumnPlace { output, in_row }));
        }
        outputs.push(ReadOutput {
            index,
            shape: spec.shape.clone(),
            length,
        });
    }
    let find = |wanted: Column| places.iter().find(|(column, _)| *column == wanted).copied();
    let place_of = |wanted: Column| find(wanted).map(|(_, place)| place);
    let two_of = |options: EndColumns| {
        let mut found = options.into_iter().filter_map(find);
        Some([found.next()?, found.next()?])
    };
    // The list was checked when it was read.
    let incomplete = || "its columns are incomplete".to_owned();
    let finished = Finished {
        size,
        batch: place_of(Column::Batch),
        across: two_of(ACROSS).ok_or_else(incomplete)?,
        down: two_of(DOWN).ok_or_else(incomplete)?,
        score: place_of(Column::Score).ok_or_else(incomplete)?,
        class: place_of(Column::Class),
        outputs,
    };
    Ok(Bound {
        // Without a column for it there is one class; with one, the shapes do not tell how many.
        classes: if finished.class.is_none() {
            Some(1)
        } else {
            None
        },
        reader: Box::new(finished),
    })
}

/// The number of rows of an output with rows of `length`, -1 if open: `[rows, length]`, `[1, rows, length]`, or without
/// the last dimension if there is one column.
fn rows_of(spec: &TensorSpec, length: usize) -> Result<i64, String> {
    let is_one = |side: i64| side == 1 || side == -1;
    match *spec.shape.as_slice() {
        [batch, rows, last] if is_one(batch) && count(last) == length => Ok(rows),
        [batch, rows] if length == 1 && is_one(batch) => Ok(rows),
        [rows, last] if count(last) == length && length > 1 => Ok(rows),
        [rows] if length == 1 => Ok(rows),
        _ => Err(format!(
            "its output `{}` has another shape than [rows, {length}] or [1, rows, {length}]",
            spec.name
        )),
    }
}

/// The numbers of one row.
struct FinalBox {
    /// In the model's own unit.
    corners: Corners,
    score: f32,
    /// `None` if the number is that of no class, or the row is of another picture.
    class: Option<ClassId>,
    /// True if the number of the class would be a score, and the score the number of a class.
    is_exchanged: bool,
}

/// The numbers of one run.
struct Numbers<'a> {
    /// Those of each output that is read.
    outputs: Vec<&'a [f32]>,
    /// The number of rows, which is the same in all of them.
    rows: usize,
}

impl Finished {
    fn numbers<'a>(&self, outputs: &[TensorView<'a>]) -> Result<Numbers<'a>, String> {
        let mut numbers = Vec::with_capacity(self.outputs.len());
        let mut rows = None;
        for read in &self.outputs {
            let output = outputs
                .get(read.index)
                .ok_or_else(|| format!("the model returned {} outputs", outputs.len()))?;
            // The first of three dimensions is the batch, which may be open and is 1.
            let mut expected = read.shape.clone();
            if let [batch, _, _] = expected.as_mut_slice() {
                *batch = 1;
            }
            let values = elements(output, &expected)?;
            let these = values.len() / read.length;
            if rows.is_some_and(|rows| rows != these) {
                return Err("the model returned outputs with different numbers of rows".to_owned());
            }
            rows = Some(these);
            numbers.push(values);
        }
        Ok(Numbers {
            outputs: numbers,
            rows: rows.unwrap_or_default(),
        })
    }

    /// The left and the right side, or the upper and the lower one, of a row.
    fn sides(
        columns: &[(Column, ColumnPlace); 2],
        number: impl Fn(ColumnPlace) -> f32,
    ) -> (f64, f64) {
        let [(first, first_place), (last, last_place)] = *columns;
        let first_number = f64::from(number(first_place));
        let last_number = f64::from(number(last_place));
        if matches!(first, Column::CentreX | Column::CentreY) {
            let half = last_number / 2.0;
            (first_number - half, first_number + half)
        } else if matches!(last, Column::Width | Column::Height) {
            (first_number, first_number + last_number)
        } else {
            (first_number, last_number)
        }
    }

    /// Calls `each` with every row of the first picture that is at least as confident as `least`, whose score is not a
    /// number, or whose score and class are exchanged.
    fn each_row(
        &self,
        outputs: &[TensorView<'_>],
        least: f64,
        mut each: impl FnMut(FinalBox),
    ) -> Result<(), String> {
        let numbers = self.numbers(outputs)?;
        for row in 0..numbers.rows {
            let number = |place: ColumnPlace| {
                let length = self.outputs[place.output].length;
                numbers.outputs[place.output][row * length + place.in_row]
            };
            let score = number(self.score);
            let batch = self.batch.map_or(0.0, number);
            let is_unused = batch == -1.0;
            let is_exchanged = class_number(score).is_some()
                && self.class.is_some_and(|place| is_part(number(place)));
            // Unused rows are all 0 or -1. NaN is not skipped, so that it is counted; nor is the first class, 0, in place of
            // a score.
            if is_unused || (f64::from(score) < least && !is_exchanged) {
                continue;
            }
            let (x1, x2) = Self::sides(&self.across, number);
            let (y1, y2) = Self::sides(&self.down, number);
            let class = if batch != 0.0 {
                // There is one picture, number 0: another number is something else.
                None
            } else if let Some(place) = self.class {
                class_number(number(place))
            } else {
                Some(ClassId(0))
            };
            each(FinalBox {
                corners: Corners { x1, y1, x2, y2 },
                score,
                class,
                is_exchanged,
            });
        }
        Ok(())
    }
}

impl ReadOutputs for Finished {
    fn read(&self, outputs: &[TensorView<'_>], rows: &mut Rows<'_>) -> Result<(), String> {
        let mut found = Vec::new();
        self.each_row(outputs, rows.confidence, |row| found.push(row))?;
        let sides = found.iter().map(|row| {
            let Corners { x1, y1, x2, y2 } = row.corners;
            [x1, y1, x2, y2]
        });
        let written_in = unit(sides, self.size);
        for row in found {
            let in_pixels = written_in.pixels(row.corners);
            rows.add(row.class.and_then(|class| candidate(in_pixels, class, row.score)));
        }
        Ok(())
    }

    /// More rows than a model has final boxes, or as many as the input has cells, are cells of which several show one object.
    fn overlaps_in(&self, outputs: &[TensorView<'_>]) -> bool {
        let Ok(numbers) = self.numbers(outputs) else {
            return false;
        };
        let rows = numbers.rows as i64;
        rows > MOST_BOXES || is_cells(rows, self.size)
    }

    fn evidence(&self, outputs: &[TensorView<'_>], confidence: f64) -> Evidence {
        let mut total = 0_u32;
        let mut exchanged = 0_u32;
        let mut no_class = 0_u32;
        let mut no_box = 0_u32;
        let mut no_score = 0_u32;
        let read = self.each_row(outputs, confidence, |row| {
            let Corners { x1, y1, x2, y2 } = row.corners;
            total += 1;
            exchanged += u32::from(row.is_exchanged);
            no_class += u32::from(row.class.is_none());
            no_box += u32::from(x2 <= x1 || y2 <= y1);
            no_score += u32::from(row.score > 1.001);
        });
        let most = |count: u32| 2 * count > total;
        if read.is_err() || total == 0 {
            Evidence::None
        } else if most(exchanged) {
            Evidence::against_with(
                "its score and its class are exchanged: the column of the score holds whole numbers, and that of the class \
                 parts of 1",
                "List its columns with the two in each other's place (for rows of six numbers detector.head = { columns = \
                 \"x1 y1 x2 y2 class score\" })",
            )
        } else if most(no_class) {
            Evidence::against(
                "the columns of its class or batch hold something else: no whole numbers, or no 0",
            )
        } else if most(no_score) {
            Evidence::against("the numbers in the column of its score are above 1")
        } else if most(no_box) {
            Evidence::against(
                "the right and lower sides of its boxes are not beyond the left and upper ones",
            )
        } else {
            Evidence::For
        }
    }
}

/// True for what a score can be, and no class: a number between 0 and 1.
fn is_part(value: f32) -> bool {
    value > 0.0 && value < 1.0
}

/// A class number written as a floating-point number.
fn class_number(value: f32) -> Option<ClassId> {
    let whole = value.fract() == 0.0 && (0.0..=f32::from(u16::MAX)).contains(&value);
    if whole {
        Some(ClassId(value as u16))
    } else {
        None
    }
}
