//! The table of heads: for each, the outputs that it reads, how its models want their pictures, and how `auto` finds it.

use super::columns::{self, ColumnList, MOST_BOXES};
use super::dense::{BoxForm, Dense, rows_with_classes};
use super::reading::{STRIDES, can_be, cells, cells_of_part, count};
use super::rt_detr::RtDetr;
use super::yolo::{BEFORE_CLASSES, Yolo};
use super::yolox::Yolox;
use super::{Bound, detr, fastestdet, pair};
use crate::detector::HeadName;
use crate::onnx::{Signature, TensorSpec};
use crate::picture::ColorOrder::{self, Bgr, Rgb};
use crate::picture::Fit::{self, Centre, Stretch, TopLeft};
use crate::picture::ValueRange::{self, ImageNet, To255, ToOne};
use albireo_core::geometry::PictureSize;

/// Binds a head to a model whose input has this size; the first difference if it does not fit.
type Bind = fn(&Signature, PictureSize) -> Result<Bound, String>;

/// One head: a row of the table.
pub(super) struct Family {
    pub(super) name: HeadName,
    /// The outputs of its models, in words.
    pub(super) looks_for: &'static str,
    pub(super) fit: Fit,
    pub(super) color_order: ColorOrder,
    pub(super) value_range: ValueRange,
    pub(super) bind: Bind,
    /// The reason why a model that could be bound does not look like one of this head; stricter than binding, which is for
    /// a user who knows the head.
    pub(super) looks_other: fn(&Signature, PictureSize) -> Option<String>,
}

/// All heads that have a name of their own.
pub(super) const FAMILIES: [Family; 10] = [
    Family {
        name: HeadName::Yolo,
        looks_for: "an output [1, 4 + classes, anchors] or [1, anchors, 4 + classes]",
        fit: Centre,
        color_order: Rgb,
        value_range: ToOne,
        bind: bind_yolo,
        looks_other: yolo_has_other_anchors,
    },
    Family {
        name: HeadName::Yolov5,
        looks_for: "an output [1, anchors, 5 + classes], decoded, or rows `batch x1 y1 x2 y2 class score`",
        fit: Centre,
        color_order: Rgb,
        value_range: ToOne,
        bind: bind_yolov5,
        looks_other: yolov5_looks_other,
    },
    Family {
        name: HeadName::Yolox,
        looks_for: "one output [1, cells of strides 8, 16 and 32, 5 + classes]",
        fit: TopLeft,
        color_order: Bgr,
        value_range: To255,
        bind: bind_yolox,
        looks_other: |_, _| None,
    },
    Family {
        name: HeadName::YoloNas,
        looks_for: "rows `batch x1 y1 x2 y2 score class`, or an output [1, cells, 4] and one [1, cells, classes]",
        fit: Centre,
        color_order: Rgb,
        value_range: ToOne,
        bind: bind_yolo_nas,
        looks_other: yolo_nas_looks_other,
    },
    Family {
        name: HeadName::EndToEnd,
        looks_for: "one output [1, boxes, 6] with rows `x1 y1 x2 y2 score class`",
        fit: Centre,
        color_order: Rgb,
        value_range: ToOne,
        bind: |signature, size| listed("x1 y1 x2 y2 score class", signature, size),
        looks_other: end_to_end_looks_other,
    },
    Family {
        name: HeadName::Detr,
        looks_for: "outputs `dets` [1, queries, 4] and `labels` [1, queries, classes], or `pred_boxes` and `logits`",
        fit: Stretch,
        color_order: Rgb,
        value_range: ImageNet,
        bind: bind_detr,
        looks_other: |signature, size| match detr::bind(&[detr::RF_DETR], signature, size) {
            Ok(_) => None,
            Err(_) => Some(RANGE_IS_OPEN.to_owned()),
        },
    },
    Family {
        name: HeadName::RtDetr,
        looks_for: "one output [1, queries, 4 + classes] or [1, queries, 6], or outputs `pred_boxes` and `logits` or `pred_logits`",
        fit: Stretch,
        color_order: Rgb,
        value_range: ToOne,
        bind: bind_rt_detr,
        looks_other: rt_detr_looks_other,
    },
    Family {
        name: HeadName::DFine,
        looks_for: "outputs `labels` [1, queries], `boxes` [1, queries, 4] and `scores` [1, queries]",
        fit: Stretch,
        color_order: Rgb,
        value_range: ToOne,
        bind: |signature, size| {
            listed(
                "boxes: x1 y1 x2 y2, scores: score, labels: class",
                signature,
                size,
            )
        },
        looks_other: |signature, _| {
            if signature.inputs.iter().any(|input| input.name == "orig_target_sizes") {
                return None;
            }
            Some("it has no input `orig_target_sizes`".to_owned())
        },
    },
    Family {
        name: HeadName::Rtmdet,
        looks_for: "outputs `dets` [1, boxes, 5] and `labels` int64 [1, boxes]",
        fit: TopLeft,
        color_order: Bgr,
        value_range: ImageNet,
        bind: |signature, size| listed("dets: x1 y1 x2 y2 score, labels: class", signature, size),
        looks_other: |_, _| Some("its outputs do not tell how it wants its pictures".to_owned()),
    },
    Family {
        name: HeadName::FastestDet,
        looks_for: "one output [1, 5 + classes, rows / 16, columns / 16]",
        fit: Stretch,
        color_order: Bgr,
        value_range: ToOne,
        bind: fastestdet::bind,
        looks_other: |_, _| None,
    },
];

/// The reason why outputs with the names of the transformers library do not tell the head.
const RANGE_IS_OPEN: &str = "its outputs do not tell how it wants its pictures";

/// The row of `name`; `None` for [`HeadName::Auto`] and [`HeadName::Columns`].
pub(super) fn family(name: HeadName) -> Option<&'static Family> {
    FAMILIES.iter().find(|family| family.name == name)
}

/// Binds final boxes in these columns.
fn listed(columns: &str, signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    columns::bind(&columns.parse::<ColumnList>()?, signature, size)
}

/// The sets of strides of YOLO models: three feature maps, or four with a finer or a coarser one.
const YOLO_STRIDES: [&[u32]; 3] = [&STRIDES, &[4, 8, 16, 32], &[8, 16, 32, 64]];

/// True if `anchors`, which may be open, can be those of an input of `size`, with one or three anchors per cell.
fn are_anchors(anchors: i64, size: PictureSize) -> bool {
    let of_strides = |strides: &&[u32]| {
        let cells = cells(size, strides);
        can_be(anchors, cells) || can_be(anchors, 3 * cells)
    };
    YOLO_STRIDES.iter().any(of_strides)
}

/// What is said of a number of anchors that no strides give.
fn other_anchors(anchors: i64, size: PictureSize) -> String {
    let all = YOLO_STRIDES.map(|strides| cells(size, strides).to_string()).join(", ");
    format!("it has {anchors} anchors, and an input of {size} has {all} (by strides)")
}

/// The index of the only output, or of the only one with a row or a column for each cell: exports for training have others
/// beside it.
fn with_anchors(signature: &Signature, size: PictureSize) -> Result<usize, String> {
    let outputs = &signature.outputs;
    if outputs.len() == 1 {
        return Ok(0);
    }
    let fits = |place: &usize| match *outputs[*place].shape.as_slice() {
        [1 | -1, first, second] if first != -1 && second != -1 => {
            is_cells(first, size) || is_cells(second, size)
        }
        _ => false,
    };
    let fitting: Vec<usize> = (0..outputs.len()).filter(fits).collect();
    match fitting.as_slice() {
        [only] => Ok(*only),
        _ => Err(format!("it has {} outputs instead of one", outputs.len())),
    }
}

/// True if a model with one anchor per cell can have `side` of them. A side that is no multiple of the strides may end with
/// a part of a cell.
pub(in crate::detector) fn is_cells(side: i64, size: PictureSize) -> bool {
    let of_strides = |strides: &&[u32]| {
        can_be(side, cells(size, strides)) || can_be(side, cells_of_part(size, strides))
    };
    side != -1 && YOLO_STRIDES.iter().any(of_strides)
}

/// How many numbers YOLO has for each anchor by the names of the classes in the metadata: they leave no doubt, whatever
/// strides the model has.
fn numbers_by_names(signature: &Signature) -> Option<usize> {
    let names = signature.metadata.class_names().ok()??;
    Some(BEFORE_CLASSES + names.len())
}

/// True if an output of YOLO with these sides has a row per anchor; otherwise it has a row per number.
fn has_row_per_anchor(first: i64, second: i64, signature: &Signature, size: PictureSize) -> bool {
    let first_is_cells = is_cells(first, size);
    let second_is_cells = is_cells(second, size);
    if first_is_cells != second_is_cells {
        return first_is_cells;
    }
    if let Some(numbers) = numbers_by_names(signature)
        && (count(first) == numbers || count(second) == numbers)
    {
        return count(first) != numbers;
    }
    // The open side is that of the anchors.
    first == -1 && !second_is_cells && count(second) > BEFORE_CLASSES
}

/// A box and a score per class for each anchor, in either direction of the output.
fn bind_yolo(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    let index = with_anchors(signature, size)?;
    let output = signature.outputs.get(index).ok_or("it has no output")?.float()?;
    let [1 | -1, first, second] = *output.shape.as_slice() else {
        return Err("its output has another shape".to_owned());
    };
    if has_row_per_anchor(first, second, signature, size) {
        let (anchors, classes) = rows_with_classes(&output.shape, BEFORE_CLASSES)?;
        let reader = Dense {
            size,
            form: BoxForm::Centre,
            anchors,
            classes,
            has_objectness: false,
            boxes: index,
            scores: None,
        };
        return Ok(dense(reader));
    }
    let classes = count(first).saturating_sub(BEFORE_CLASSES);
    let have_numbers = (1..=usize::from(u16::MAX)).contains(&classes);
    let have_anchors = second == -1 || second > 0;
    if !have_numbers || !have_anchors {
        return Err("its output has another shape".to_owned());
    }
    Ok(Bound {
        classes: Some(classes),
        reader: Box::new(Yolo {
            size,
            output: index,
            classes,
            anchors: second,
        }),
    })
}

fn yolo_has_other_anchors(signature: &Signature, size: PictureSize) -> Option<String> {
    let index = with_anchors(signature, size).ok()?;
    let [_, first, second] = *signature.outputs.get(index)?.shape.as_slice() else {
        return None;
    };
    if let Some(numbers) = numbers_by_names(signature) {
        // Some hundred rows may be those of RT-DETR.
        let are_rows = count(second) == numbers && first > MOST_BOXES;
        if count(first) == numbers || are_rows {
            return None;
        }
    }
    if [first, second].iter().any(|&side| side == -1 || is_cells(side, size)) {
        return None;
    }
    Some(other_anchors(first.max(second), size))
}

fn yolov5_looks_other(signature: &Signature, size: PictureSize) -> Option<String> {
    let output = signature.outputs.get(decoded(signature).ok()?)?;
    match *output.shape.as_slice() {
        [_, _] if has_name_of_yolo_nas(output) => {
            Some("its output has the name of YOLO-NAS".to_owned())
        }
        [_, _] => None,
        [.., anchors, _] if !are_anchors(anchors, size) => Some(other_anchors(anchors, size)),
        _ => None,
    }
}

/// The index of the only output, or of the only one that is no feature map: YOLOv7 may have its maps beside it.
fn decoded(signature: &Signature) -> Result<usize, String> {
    let outputs = &signature.outputs;
    if outputs.len() == 1 {
        return Ok(0);
    }
    let is_no_map = |place: &usize| outputs[*place].shape.len() != 5;
    let others: Vec<usize> = (0..outputs.len()).filter(is_no_map).collect();
    match others.as_slice() {
        [only] => Ok(*only),
        _ => Err(format!("it has {} outputs instead of one", outputs.len())),
    }
}

fn yolo_nas_looks_other(signature: &Signature, _size: PictureSize) -> Option<String> {
    match signature.outputs.as_slice() {
        [only] if !has_name_of_yolo_nas(only) => {
            Some("its output has another name than `graph2_flat_predictions`".to_owned())
        }
        _ if pair::is_of_damo_yolo(signature) => {
            Some("its outputs are written as DAMO-YOLO writes them".to_owned())
        }
        _ => None,
    }
}

/// True if an output is called as YOLO-NAS calls that of its final boxes.
fn has_name_of_yolo_nas(output: &TensorSpec) -> bool {
    output.name.contains("flat_predictions")
}

fn end_to_end_looks_other(signature: &Signature, size: PictureSize) -> Option<String> {
    match *signature.outputs.first()?.shape.as_slice() {
        [_, _] => Some(
            "its output has no dimension for the batch, as exports of other columns do".to_owned(),
        ),
        [_, rows, _] if rows > MOST_BOXES && !are_anchors(rows, size) => {
            Some(format!("it has {rows} boxes"))
        }
        _ => None,
    }
}

/// A head of anchors.
fn dense(reader: Dense) -> Bound {
    Bound {
        classes: Some(reader.classes),
        reader: Box::new(reader),
    }
}

/// Objectness and a score per class for each anchor, of which a cell has one (YOLOv6) or three; or final boxes.
fn bind_yolov5(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    let index = decoded(signature)?;
    let output = signature.outputs[index].float()?;
    if output.shape.len() == 2 {
        return listed("batch x1 y1 x2 y2 class score", signature, size);
    }
    let (anchors, classes) = rows_with_classes(&output.shape, BEFORE_CLASSES + 1)?;
    let reader = Dense {
        size,
        form: BoxForm::Centre,
        anchors,
        classes,
        has_objectness: true,
        boxes: index,
        scores: None,
    };
    Ok(dense(reader))
}

fn bind_yolox(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    if !size.width.is_multiple_of(32) || !size.height.is_multiple_of(32) {
        return Err(format!(
            "its input of {size} has a side that is not a multiple of 32"
        ));
    }
    let cells = cells(size, &STRIDES);
    let (rows, classes) = rows_with_classes(&signature.only_output()?.shape, BEFORE_CLASSES + 1)
        .map_err(|_| other_than_cells(cells))?;
    if !can_be(rows, cells) {
        return Err(other_than_cells(cells));
    }
    let decoded = Dense {
        size,
        form: BoxForm::Centre,
        anchors: cells as i64,
        classes,
        has_objectness: true,
        boxes: 0,
        scores: None,
    };
    Ok(Bound {
        classes: Some(classes),
        reader: Box::new(Yolox::new(decoded, &STRIDES)),
    })
}

fn other_than_cells(cells: usize) -> String {
    format!("its output has another shape than [1, {cells}, 5 + classes]")
}

fn bind_yolo_nas(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    match signature.outputs.as_slice() {
        [first, second] => pair::bind(first, second, size),
        _ => listed("batch x1 y1 x2 y2 score class", signature, size),
    }
}

fn bind_detr(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    detr::bind(
        &[detr::RF_DETR, detr::OTHERS[0], detr::OTHERS[1]],
        signature,
        size,
    )
}

fn rt_detr_looks_other(signature: &Signature, size: PictureSize) -> Option<String> {
    let [output] = signature.outputs.as_slice() else {
        return Some(RANGE_IS_OPEN.to_owned());
    };
    let queries = output.shape.get(1).copied().unwrap_or_default();
    // An open number is judged later: if several heads remain, by the sizes of a run.
    let are_cells = queries != -1 && are_anchors(queries, size);
    if are_cells || queries > MOST_BOXES {
        return Some(format!(
            "the number of its rows is {queries}, and not some hundred"
        ));
    }
    None
}

/// A score per class for each query, or the best of them with their classes, as Ultralytics has exported since it writes the
/// head into the metadata.
fn bind_rt_detr(signature: &Signature, size: PictureSize) -> Result<Bound, String> {
    let [output] = signature.outputs.as_slice() else {
        return detr::bind(&detr::OTHERS, signature, size);
    };
    if signature.metadata.is_rt_detr() && output.shape.last() == Some(&6) {
        return listed("cx cy w h score class", signature, size);
    }
    let (anchors, classes) = rows_with_classes(&output.float()?.shape, BEFORE_CLASSES)?;
    let reader = Dense {
        size,
        form: BoxForm::CentreInSides,
        anchors,
        classes,
        has_objectness: false,
        boxes: 0,
        scores: None,
    };
    Ok(Bound {
        classes: Some(classes),
        reader: Box::new(RtDetr(reader)),
    })
}
