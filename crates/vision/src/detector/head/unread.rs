//! Models that no head reads by itself, each with what to do.

use super::pair;
use crate::onnx::{ElementType, Signature, TensorSpec};

/// The reason why a model of a known kind is not read, with the way out; `None` if its kind is not known.
pub(super) fn reason(signature: &Signature) -> Option<String> {
    let kinds = [
        tensorflow,
        paddle,
        plug_in,
        transformers,
        mmdeploy,
        damo_yolo,
        final_boxes,
        training_heads,
        segmentation,
        rows,
        classifier,
    ];
    kinds.into_iter().find_map(|kind| kind(signature))
}

/// Models of the DETR family, whose names do not tell how they want their pictures.
fn transformers(signature: &Signature) -> Option<String> {
    signature.output("pred_boxes").ok()?;
    Some(
        "its outputs have the names that every model of the DETR family has, and not how it wants its pictures. Set \
         detector.head = \"rt-detr\" for RT-DETR, D-FINE and DEIM (values from 0 to 1), or \"detr\" for those that are \
         normalised as for ImageNet. Models with a class for \"no object\" by softmax (DETR itself, YOLOS) are not read"
            .to_owned(),
    )
}

/// Models that mmdeploy exported.
fn mmdeploy(signature: &Signature) -> Option<String> {
    let (_, boxes) = signature.output("dets").ok()?;
    signature.output("labels").ok()?;
    if boxes.shape.last() != Some(&5) {
        return None;
    }
    Some(
        "mmdeploy writes these outputs for every detector, and not how it wants its pictures. Set detector.head = \
         \"rtmdet\" for RTMDet; for another, also set detector.range, color_order and fit"
            .to_owned(),
    )
}

/// DAMO-YOLO, whose outputs have the shapes of YOLO-NAS's.
fn damo_yolo(signature: &Signature) -> Option<String> {
    if !pair::is_of_damo_yolo(signature) {
        return None;
    }
    Some(
        "its outputs are written as DAMO-YOLO writes them: the scores first, as `output`. Set detector.head = \
         \"yolo-nas\", detector.range = \"0..255\", and detector.fit = \"letterbox-corner\", or \"stretch\" if it was \
         trained with `keep_ratio` off; for YOLO-NAS itself the head alone"
            .to_owned(),
    )
}

/// Final boxes with their scores and classes in outputs of their own, as of SSD in TensorFlow Lite.
fn final_boxes(signature: &Signature) -> Option<String> {
    let outputs = &signature.outputs;
    let has_four =
        |output: &&TensorSpec| matches!(*output.shape.as_slice(), [_, 4] | [1 | -1, _, 4]);
    let boxes = outputs.iter().find(has_four)?;
    let (_, rows) = boxes.shape.split_last()?;
    let has_one = |output: &&TensorSpec| match (output.shape.as_slice(), rows) {
        ([these], [rows]) | ([1 | -1, these], [_, rows]) => these == rows,
        _ => false,
    };
    let with_one: Vec<&TensorSpec> = outputs.iter().filter(has_one).collect();
    let find = |is_it: fn(&TensorSpec) -> bool| with_one.iter().find(|output| is_it(output));
    let by_name = [find(is_named_score), find(is_named_class)];
    let [scores, classes] = match (by_name, with_one.as_slice()) {
        ([Some(scores), Some(classes)], _) => [scores, classes],
        (_, [first, second]) if is_of_classes(second) && !is_of_classes(first) => [first, second],
        // TensorFlow Lite writes the classes before the scores.
        (_, [first, second]) => [second, first],
        _ => return None,
    };
    let is_of_tensorflow = |output: &TensorSpec| {
        output.name.starts_with("TFLite_") || output.name.starts_with("StatefulPartitionedCall")
    };
    let corners = if outputs.iter().any(is_of_tensorflow) {
        "y1 x1 y2 x2"
    } else {
        "x1 y1 x2 y2"
    };
    Some(format!(
        "its outputs look like final boxes with their scores and classes (SSD in TensorFlow Lite and others), and do \
         not say how it wants its pictures. Set detector.head = {{ columns = \"{}: {corners}, {}: score, {}: class\" \
         }}, or with another order of the sides if it has that, and detector.range, color_order and fit if they are \
         not \"0..1\", \"rgb\" and \"letterbox\" (SSD: fit = \"stretch\")",
        boxes.name, scores.name, classes.name
    ))
}

/// True if the numbers of an output are those of classes, by its elements or its name.
fn is_of_classes(output: &TensorSpec) -> bool {
    let has_whole_numbers = matches!(
        output.element,
        ElementType::Int32 | ElementType::Int64 | ElementType::Whole(_)
    );
    has_whole_numbers || is_named_class(output)
}

fn is_named_class(output: &TensorSpec) -> bool {
    let name = output.name.to_lowercase();
    ["class", "label", "cls"].iter().any(|part| name.contains(part))
}

fn is_named_score(output: &TensorSpec) -> bool {
    let name = output.name.to_lowercase();
    ["score", "conf"].iter().any(|part| name.contains(part)) && !is_of_classes(output)
}

/// The full name of the output that is called `part`, but for what a graph adds: at the end rather than before.
fn named<'a>(signature: &'a Signature, part: &str) -> Option<&'a str> {
    let names = || signature.outputs.iter().map(|output| output.name.as_str());
    let at_start = names().find(|name| name.starts_with(part));
    at_start.or_else(|| names().find(|name| name.contains(part)))
}

/// SSD and others of TensorFlow's model zoo.
fn tensorflow(signature: &Signature) -> Option<String> {
    let boxes = named(signature, "detection_boxes")?;
    let scores = named(signature, "detection_scores")?;
    let classes = named(signature, "detection_classes")?;
    Some(format!(
        "its outputs are those of TensorFlow's models (SSD and others), which do not say how they want their pictures. \
         Set detector.head = {{ columns = \"{boxes}: y1 x1 y2 x2, {scores}: score, {classes}: class\" }}, detector.fit = \
         \"stretch\", detector.range = \"0..255\" unless it takes bytes, and detector.input_size to the size that it was \
         trained with. Its class numbers begin with 1: the first of detector.class_names is one that does not occur"
    ))
}

/// PP-YOLOE and others of PaddleDetection.
fn paddle(signature: &Signature) -> Option<String> {
    if !signature.inputs.iter().any(|input| input.name == "scale_factor") {
        return None;
    }
    let has_rows = |output: &&TensorSpec| output.shape.last() == Some(&6);
    let reason = match signature.outputs.iter().find(has_rows) {
        Some(output) => format!(
            "it is a model of PaddleDetection (PP-YOLOE and others), which does not say how it wants its pictures. Set \
             detector.head = {{ columns = \"{}: class score x1 y1 x2 y2\" }}, detector.fit = \"stretch\", and \
             detector.range = \"0..1\" for PP-YOLOE+ or \"imagenet\" for PP-YOLOE",
            output.name
        ),
        None => "it is a model of PaddleDetection (PP-YOLOE and others) without its suppression: export it with \
                 `export.nms=True`"
            .to_owned(),
    };
    Some(reason)
}

/// TensorRT's suppression, if this ONNX Runtime could load it.
fn plug_in(signature: &Signature) -> Option<String> {
    let boxes = named(signature, "det_boxes").or_else(|| named(signature, "nmsed_boxes"))?;
    let scores = named(signature, "det_scores").or_else(|| named(signature, "nmsed_scores"))?;
    let classes = named(signature, "det_classes").or_else(|| named(signature, "nmsed_classes"))?;
    Some(format!(
        "its outputs are those of a suppression plug-in, which do not say how the model wants its pictures. Set \
         detector.head = {{ columns = \"{boxes}: x1 y1 x2 y2, {scores}: score, {classes}: class\" }}, and detector.range, \
         color_order and fit if they are not \"0..1\", \"rgb\" and \"letterbox\""
    ))
}

/// Feature maps that are not decoded: two or more with an axis for the boxes of a cell, or four or more of any kind.
fn training_heads(signature: &Signature) -> Option<String> {
    let is_map = |output: &TensorSpec| output.shape.len() == 5;
    if signature.outputs.iter().filter(|output| is_map(output)).count() >= 2 {
        return Some(
            "its outputs are feature maps of YOLOv5 or YOLOv7 that are not decoded: export it for inference (YOLOv5: \
             `python export.py --include onnx`; YOLOv7: `python export.py --grid`)"
                .to_owned(),
        );
    }
    let has_axes = |output: &TensorSpec| output.shape.len() >= 3;
    if signature.outputs.len() < 4 || !signature.outputs.iter().all(has_axes) {
        return None;
    }
    Some(format!(
        "its {} outputs are feature maps that are not decoded (as of NanoDet, PicoDet or CenterFace), which nothing here \
         reads: export it with its decoding in the graph, as one output with a row per box, and list the row's columns in \
         detector.head = {{ columns = \"x1 y1 x2 y2 score class\" }}",
        signature.outputs.len()
    ))
}

fn segmentation(signature: &Signature) -> Option<String> {
    // Prototypes of masks, of which every export has 32.
    let are_masks = |output: &TensorSpec| matches!(output.shape.as_slice(), [_, 32, _, _]);
    if signature.outputs.len() != 2 || !signature.outputs.iter().any(are_masks) {
        return None;
    }
    Some(
        "it is a segmentation model, whose masks nothing here reads: use the detection model of the same family"
            .to_owned(),
    )
}

/// Final boxes in rows without a batch, of columns that only the exporter knows.
fn rows(signature: &Signature) -> Option<String> {
    let [output] = signature.outputs.as_slice() else {
        return None;
    };
    let [rows, numbers] = *output.shape.as_slice() else {
        return None;
    };
    // One row, or one for each picture, may be the scores of a classifier.
    let may_be_scores = rows == 1 || (rows == -1 && has_open_batch(signature));
    // A box and its score are five numbers.
    if may_be_scores || numbers < 5 {
        return None;
    }
    Some(format!(
        "its output looks like rows of final boxes, with {numbers} numbers each, and does not say which they are. List \
         them in detector.head = {{ columns = \"x1 y1 x2 y2 score class\" }}, in their order and with `_` for each that \
         is none of these, and set detector.range, color_order and fit if they are not \"0..1\", \"rgb\" and \
         \"letterbox\""
    ))
}

/// True if the model takes any number of pictures.
fn has_open_batch(signature: &Signature) -> bool {
    signature.inputs.iter().any(|input| input.shape.first() == Some(&-1))
}

fn classifier(signature: &Signature) -> Option<String> {
    let [output] = signature.outputs.as_slice() else {
        return None;
    };
    match output.shape.as_slice() {
        // From 4 to 8 numbers may be those of one box.
        [1 | -1, classes] if !(4..=8).contains(classes) => Some(
            "its output is one row of scores: it is a classifier and finds no boxes; a detector is needed"
                .to_owned(),
        ),
        _ => None,
    }
}
