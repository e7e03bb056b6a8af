use super::*;
use crate::onnx::metadata;
use albireo_core::geometry::PictureSize;

#[test]
fn a_dynamic_input_takes_its_size_from_the_configuration_or_else_the_metadata() {
    let mut open = signature(&[-1, 3, -1, -1], &[("output0", &[-1, 84, -1])]);
    let configured = PictureSize::new(320, 256);
    let wanted = Some(configured);
    assert_eq!(open.picture_input(wanted).unwrap().size, configured);
    open.metadata = metadata(&[("imgsz", "[384, 640]")]);
    assert_eq!(open.picture_input(wanted).unwrap().size, configured);
    let own = open.picture_input(None).unwrap().size;
    assert_eq!(own, PictureSize::new(640, 384));
}

#[test]
fn a_dynamic_input_of_unknown_size_is_an_error_that_names_the_setting() {
    let open = signature(&[-1, 3, -1, -1], &[("output0", &[-1, 84, -1])]);
    let error = open.picture_input(None).unwrap_err();
    assert!(error.contains("detector.input_size"), "{error}");
}

#[test]
fn a_fixed_input_is_not_of_another_size() {
    let fixed = signature(&[1, 3, 640, 640], &[("output0", &[1, 84, 8400])]);
    let wanted = PictureSize::new(320, 256);
    let error = fixed.picture_input(Some(wanted)).unwrap_err();
    for size in ["640x640", "320x256"] {
        assert!(error.contains(size), "{error}");
    }
}

#[test]
fn an_input_that_is_no_picture_is_rejected_with_the_reason() {
    for (shape, reason) in [
        (&[4, 3, 64, 64][..], "4 pictures"),
        (&[1, 416], "neither"),
        (&[1, 4, 64, 64], "neither"),
        (&[1, 3, 9000, 64], "8192"),
        (&[1, 3, 0, 64], "8192"),
        (&[1, 3, 8000, 8000], "4096x4096"),
    ] {
        let error = signature(shape, &[]).picture_input(None).unwrap_err();
        assert!(error.contains(reason), "{error}");
    }
    let mut other = signature(&[1, 3, 64, 64], &[]);
    other.inputs[0].element = ElementType::Int64;
    assert!(other.picture_input(None).unwrap_err().contains("int64"));
    other.inputs.clear();
    assert!(other.picture_input(None).unwrap_err().contains("0 inputs"));
}

#[test]
fn a_model_that_does_not_fit_is_rejected_with_the_first_difference() {
    use HeadName::{Detr, EndToEnd, FastestDet, Yolo, Yolox};
    let one = |shape: &[i64]| plain(416, "output", shape);
    let mut int8 = one(&[1, 84, 3549]);
    int8.outputs[0].element = ElementType::Other("int8".to_owned());
    let two = model(416, &[("a", &[1, 84, 3549]), ("b", &[1, 84, 3549])], &[]);
    for (name, model, reason) in [
        (Yolox, one(&[1, 84, 8400]), "[1, 3549, 5 + classes]"),
        (Yolox, one(&[1, 3549, 5]), "another shape"),
        (Yolo, one(&[1, 4, 3549]), "another shape"),
        (Yolo, one(&[2, 84, 3549]), "another shape"),
        // As many columns as cells: what is open are the numbers of a cell.
        (Yolo, one(&[1, -1, 3549]), "another shape"),
        (Yolo, two, "2 outputs"),
        (Yolo, int8, "int8"),
        (EndToEnd, one(&[1, 300, 7]), "another shape"),
        (FastestDet, one(&[1, 85, 22, 22]), "26, 26"),
        (Detr, one(&[1, 300, 4]), "no such outputs"),
    ] {
        let misfit = fitted(name, &model).unwrap_err();
        assert!(misfit.contains(reason), "{misfit}");
    }
}

#[test]
fn an_output_in_half_precision_fits() {
    let mut half = plain(416, "output", &[1, 84, 3549]);
    half.outputs[0].element = ElementType::Float16;
    fitted(HeadName::Yolo, &half).unwrap();
}

fn fitted(name: HeadName, model: &Signature) -> Result<Head, String> {
    let input = model.picture_input(None).unwrap();
    bind(&name.into(), model, input, HeadOverrides::default())
}

fn model(side: i64, outputs: &[(&str, &[i64])], entries: &[(&str, &str)]) -> Signature {
    Signature {
        metadata: metadata(entries),
        ..signature(&[1, 3, side, side], outputs)
    }
}

fn plain(side: i64, output: &str, shape: &[i64]) -> Signature {
    model(side, &[(output, shape)], &[])
}

fn found(signature: &Signature, names: Option<usize>) -> Result<Recognised, String> {
    recognise(signature, signature.picture_input(None).unwrap(), names)
}

fn recognised(signature: &Signature, names: Option<usize>) -> Result<HeadName, String> {
    let only = found(signature, names)?.only(signature);
    only.map(|head| head.name).ok_or_else(|| "several heads fit".to_owned())
}

#[test]
fn models_are_recognised_by_their_exporters_conventions() {
    let ultralytics = [
        ("author", "Ultralytics"),
        ("task", "detect"),
        ("head", "Detect"),
        ("stride", "32"),
        ("names", "{0: 'car'}"),
    ];
    let with = |key, value| [&ultralytics[..], &[(key, value)]].concat();
    let one: &[(&str, &[i64])] = &[("output0", &[1, 5, 8400])];
    let boxes: &[(&str, &[i64])] = &[("output0", &[1, 300, 6])];
    let detr: [(&str, &[i64]); 3] = [
        ("dets", &[1, 300, 4]),
        ("labels", &[1, 300, 91]),
        ("masks", &[1, 300, 9, 9]),
    ];
    let nas: [(&str, &[i64]); 2] = [("904", &[1, 8400, 80]), ("913", &[1, 8400, 4])];
    use HeadName::{Detr, EndToEnd, FastestDet, RtDetr, Yolo, YoloNas, Yolov5};
    for (signature, names, expected) in [
        (model(640, one, &ultralytics), 1, Yolo),
        (model(640, one, &with("end2end", "False")), 1, Yolo),
        (model(640, boxes, &with("end2end", "True")), 1, EndToEnd),
        (
            model(640, boxes, &with("args", "{'nms': True}")),
            1,
            EndToEnd,
        ),
        (
            model(640, boxes, &with("args", "{\"nms\": true}")),
            1,
            EndToEnd,
        ),
        (model(640, boxes, &with("nms", "true")), 1, EndToEnd),
        // YOLOv10 of its authors: metadata that do not say so.
        (model(640, boxes, &ultralytics), 80, EndToEnd),
        (model(640, boxes, &[]), 80, EndToEnd),
        (plain(640, "output0", &[1, 300, 84]), 80, RtDetr),
        (model(640, boxes, &with("head", "RTDETRDecoder")), 1, RtDetr),
        (plain(640, "output0", &[1, 84, 8400]), 80, Yolo),
        // With a coarser fourth stride, and one that leaves its anchors open.
        (plain(640, "output0", &[1, 84, 8500]), 80, Yolo),
        (plain(640, "output0", &[-1, 84, -1]), 80, Yolo),
        // The other way round.
        (plain(640, "output0", &[1, 8400, 84]), 80, Yolo),
        // By other strides, where the names leave no doubt.
        (
            model(640, &[("output0", &[1, 9000, 5])], &ultralytics),
            1,
            Yolo,
        ),
        (plain(640, "output0", &[1, 25200, 85]), 80, Yolov5),
        (plain(640, "output", &[-1, 7]), 80, Yolov5),
        (plain(640, "graph2_flat_predictions", &[-1, 7]), 80, YoloNas),
        // DeepStream-Yolo.
        (plain(640, "output", &[-1, 8400, 6]), 80, EndToEnd),
        (plain(640, "758", &[1, 85, 40, 40]), 80, FastestDet),
        (model(640, &nas, &[]), 80, YoloNas),
        (model(640, &detr[..2], &[]), 91, Detr),
        (model(640, &detr, &[]), 91, Detr),
    ] {
        assert_eq!(
            recognised(&signature, Some(names)),
            Ok(expected),
            "{signature}"
        );
    }
}

#[test]
fn a_decoded_output_beside_feature_maps_is_that_of_yolov5() {
    let yolov7: [(&str, &[i64]); 4] = [
        ("output", &[1, 25200, 85]),
        ("map8", &[1, 3, 80, 80, 85]),
        ("map16", &[1, 3, 40, 40, 85]),
        ("map32", &[1, 3, 20, 20, 85]),
    ];
    let found = recognised(&model(640, &yolov7, &[]), Some(80));
    assert_eq!(found, Ok(HeadName::Yolov5));
}

/// What a run tells of this model if its output has this shape, begins with these rows and is 0 elsewhere.
fn told(
    model: &Signature,
    names: usize,
    shape: [i64; 3],
    rows: &[&[f32]],
) -> Result<HeadName, String> {
    told_with_words(model, names, shape, rows).map(|head| head.name)
}

fn told_with_words(
    model: &Signature,
    names: usize,
    shape: [i64; 3],
    rows: &[&[f32]],
) -> Result<RecognisedHead, String> {
    let [_, count, length] = shape.map(|side| side as usize);
    let mut values = vec![0.0; count * length];
    for (row, numbers) in rows.iter().enumerate() {
        values[row * length..][..numbers.len()].copy_from_slice(numbers);
    }
    let output = TensorView {
        shape: &shape,
        values: &values,
    };
    let input = model.picture_input(None).unwrap();
    found(model, Some(names))?.by_values(model, input, Some(names), &[output])
}

#[test]
fn formats_of_one_shape_are_told_apart_by_the_values_of_a_run() {
    use HeadName::{EndToEnd, RtDetr, Yolo, Yolov5, Yolox};
    let logarithms: &[f32] = &[0.5, 0.5, -0.5, -0.7, 0.9, 0.9];
    let centre: &[f32] = &[32.0, 32.0, 20.0, 10.0, 0.9, 0.8];
    let whole_class: &[f32] = &[10.0, 10.0, 30.0, 20.0, 0.9, 0.0];
    let query: &[f32] = &[0.5, 0.5, 0.2, 0.1, 0.9, 0.1];
    for (name, shape, names, rows, expected) in [
        // Not decoded, so no YOLOv6 whatever its output is called.
        ("any", [1, 84, 6], 1, &[logarithms; 20][..], Yolox),
        ("outputs", [1, 84, 6], 1, &[centre], Yolov5),
        ("output", [1, 84, 6], 1, &[centre], Yolox),
        ("output", [1, 84, 6], 1, &[whole_class], EndToEnd),
        ("output", [1, 84, 6], 2, &[whole_class], EndToEnd),
        ("output", [1, 84, 6], 2, &[centre], Yolo),
        ("output", [1, 300, 6], 2, &[query; 300], RtDetr),
        ("output", [1, 300, 6], 2, &[whole_class], EndToEnd),
        // Nothing is found on black: no row of final boxes is used, and every query would be.
        ("output", [1, 300, 6], 1, &[], EndToEnd),
        ("output", [1, 300, 6], 2, &[], EndToEnd),
    ] {
        let head = told(&plain(64, name, &shape), names, shape, rows);
        assert_eq!(head, Ok(expected), "{name} {shape:?}");
    }
}

#[test]
fn a_head_whose_outputs_others_share_comes_with_words_that_say_so() {
    let pair: [(&str, &[i64]); 2] = [("913", &[1, 8400, 4]), ("904", &[1, 8400, 80])];
    let nas = model(640, &pair, &[]);
    let only = found(&nas, Some(80)).unwrap().only(&nas).unwrap();
    let words = only.assumed.unwrap();
    assert!(words.contains("detector.head = \"yolo-nas\""), "{words}");
    let shape = [1, 84, 6];
    let logarithms: &[f32] = &[0.5, 0.5, -0.5, -0.7, 0.9, 0.9];
    let centre: &[f32] = &[32.0, 32.0, 20.0, 10.0, 0.9, 0.8];
    let of_run = |input: &str, output: &str, rows: &[&[f32]]| {
        let mut model = plain(64, output, &shape);
        model.inputs[0].name = input.to_owned();
        told_with_words(&model, 1, shape, rows).unwrap().assumed
    };
    assert_eq!(of_run("x", "output", &[logarithms; 20]), None);
    let words = of_run("x", "output", &[centre]).unwrap();
    let said = "from \"yolov5\": set detector.head to \"yolox\" if what it finds is right, or else to \"yolov5\"";
    assert!(words.contains(said), "{words}");
    // As YOLOX's own exporter calls them.
    assert_eq!(of_run("images", "output", &[centre]), None);
    // Every head that fits is offered. Nothing is found on black, so no row of final boxes is used.
    let words = of_run("images", "output", &[]).unwrap();
    let said = "or else to \"yolov5\" or \"end-to-end\"";
    assert!(words.contains(said), "{words}");
}

#[test]
fn formats_that_not_even_a_run_tells_apart_are_refused_with_the_heads_to_choose_from() {
    // YOLOX with decoding in the graph, or YOLOv6.
    let shape = [1, 84, 6];
    let centre: &[f32] = &[32.0, 32.0, 20.0, 10.0, 0.9, 0.8];
    let refusal = told(&plain(64, "any", &shape), 1, shape, &[centre]).unwrap_err();
    for part in ["detector.head", "\"yolov5\"", "\"yolox\""] {
        assert!(refusal.contains(part), "{refusal}");
    }
}

#[test]
fn a_model_without_names_need_not_have_the_classes_of_coco() {
    use HeadName::{EndToEnd, Yolov5};
    let one_class: &[f32] = &[320.0, 320.0, 200.0, 100.0, 0.01, 0.9];
    let run = |name: &str, shape: [i64; 3]| {
        let unnamed = plain(640, name, &shape);
        let values = one_class.repeat(shape[1] as usize);
        let output = TensorView {
            shape: &shape,
            values: &values,
        };
        let input = unnamed.picture_input(None).unwrap();
        let told = found(&unnamed, None).unwrap().by_values(&unnamed, input, None, &[output]);
        told.map(|head| head.name)
    };
    assert_eq!(run("output0", [1, 25_200, 6]), Ok(Yolov5));
    // One class with an objectness, or two: names are asked for, and no number of them is taken for right.
    for name in ["outputs", "output", "output0"] {
        let refusal = run(name, [1, 8400, 6]).unwrap_err();
        assert!(refusal.contains("detector.class_names"), "{refusal}");
        assert!(!refusal.contains("yolo"), "{refusal}");
    }
    // Of 80 classes that the shape shows.
    let coco = plain(640, "output0", &[1, 300, 84]);
    assert_eq!(recognised(&coco, None), Ok(HeadName::RtDetr));
    let named = plain(640, "output0", &[1, 300, 6]);
    assert_eq!(recognised(&named, Some(80)), Ok(EndToEnd));
}

#[test]
fn a_head_that_a_run_tells_against_is_refused_with_the_head_that_may_read_the_model() {
    // 300 is no multiple of the strides, and the model has cells for what remains.
    let shape = [1, 84, 1905];
    let yolo = plain(300, "output0", &shape);
    let mut values = vec![0.0; 84 * 1905];
    values[0] = 150.0;
    let output = TensorView {
        shape: &shape,
        values: &values,
    };
    let input = yolo.picture_input(None).unwrap();
    let head = fitted(HeadName::RtDetr, &yolo).unwrap();
    let evidence = head.evidence(&[output], 1e-4);
    assert!(matches!(evidence, Evidence::Against(_)));
    let words = way_out(&yolo, input, None, &[output]);
    assert!(
        words.contains("detector.head = \"yolo\" (for 80 names"),
        "{words}"
    );
    assert!(!words.contains("columns"), "{words}");
    // Where nothing else reads it the columns can be listed.
    let final_boxes = [0.0, 1.0, 0.9, 0.4, 0.4, 0.5, 0.5, 0.0, 0.0].repeat(20);
    let boxes = plain(640, "output0", &[1, 20, 9]);
    let output = TensorView {
        shape: &[1, 20, 9],
        values: &final_boxes,
    };
    let words = way_out(&boxes, input, None, &[output]);
    assert!(words.contains("columns = "), "{words}");
    // Of one class more than a box it is said without a plural.
    let one_class = plain(64, "output0", &[1, 84, 5]);
    let words = way_out(&one_class, input, Some(1), &[]);
    assert!(words.contains("(for 1 name in"), "{words}");
}

#[test]
fn rows_of_nothing_are_read_as_those_of_rt_detr_with_words_that_say_so() {
    use HeadName::{EndToEnd, RtDetr};
    let shape: &[i64] = &[1, 20, 7];
    let rows = plain(64, "output0", shape);
    let told_by_metadata = model(64, &[("output0", shape)], &[("head", "RTDETRDecoder")]);
    let nothing = [0.0; 140];
    let query = [0.5, 0.4, 0.2, 0.1, 0.01, 0.02, 0.03].repeat(20);
    for (name, signature, values, is_said) in [
        (RtDetr, &rows, &nothing[..], true),
        (RtDetr, &rows, &query, false),
        (RtDetr, &told_by_metadata, &nothing, false),
        (EndToEnd, &rows, &nothing, false),
    ] {
        let words = assumed_of_nothing(name, signature, &[TensorView { shape, values }]);
        assert_eq!(words.is_some(), is_said, "{name:?} {signature}");
    }
}

#[test]
fn a_recognised_head_must_fit_the_rows_of_a_run_which_may_be_cells_rounded_up() {
    let open: [(&str, &[i64]); 2] = [("boxes", &[1, -1, 4]), ("scores", &[1, -1, 80])];
    let mut model = model(640, &open, &[]);
    model.inputs[0].shape = vec![1, 3, 360, 640];
    let input = model.picture_input(None).unwrap();
    // 80 * 45, 40 * 23 and 20 * 12.
    for (rows, fits) in [(4760, true), (4700, true), (50, false)] {
        let shapes = [[1, rows, 4], [1, rows, 80]];
        let values = vec![0.0; rows as usize * 80];
        let outputs = shapes.each_ref().map(|shape| TensorView {
            shape,
            values: &values[..(shape[1] * shape[2]) as usize],
        });
        let misfit = misfit(HeadName::YoloNas, &model, input, &outputs);
        assert_eq!(misfit.is_none(), fits, "{rows} rows: {misfit:?}");
    }
}

#[test]
fn an_open_number_of_rows_is_that_of_a_run() {
    use HeadName::{RtDetr, Yolo, Yolov5};
    let with_objectness: &[f32] = &[320.0, 320.0, 200.0, 100.0, 0.9, 0.8];
    let in_pixels: &[f32] = &[320.0, 320.0, 200.0, 100.0, 0.9];
    let as_parts: &[f32] = &[0.5, 0.5, 0.3, 0.2, 0.9];
    // The input has 8400 cells.
    for (row, length, rows, expected) in [
        (with_objectness, 85, 3 * 8400, Yolov5),
        (in_pixels, 84, 8400, Yolo),
        (as_parts, 84, 300, RtDetr),
    ] {
        let open = plain(640, "output0", &[-1, -1, length]);
        let head = told(&open, 80, [1, rows, length], &[row]);
        assert_eq!(head, Ok(expected), "{rows} rows of {length}");
    }
}

#[test]
fn a_run_with_the_rows_of_two_heads_or_none_is_refused_with_both() {
    let with_objectness: &[f32] = &[320.0, 320.0, 200.0, 100.0, 0.9, 0.8];
    let open = plain(640, "output0", &[-1, -1, 85]);
    // A black picture may give no row at all.
    for (row, rows) in [(with_objectness, 8400), (&[], 0)] {
        let refusal = told(&open, 80, [1, rows, 85], &[row]).unwrap_err();
        let either = "could be any of \"yolov5\", \"yolox\"";
        assert!(refusal.contains(either), "{rows} rows: {refusal}");
    }
}

#[test]
fn a_model_that_is_not_recognised_is_refused_with_the_reason_and_every_head_that_was_tried() {
    let ultralytics = |key, value| {
        let entries = [("author", "Ultralytics"), (key, value)];
        model(64, &[("output0", &[1, 6, 84])], &entries)
    };
    let transformer: [(&str, &[i64]); 2] =
        [("logits", &[1, 300, 80]), ("pred_boxes", &[1, 300, 4])];
    let mmdeploy: [(&str, &[i64]); 2] = [("dets", &[1, 100, 5]), ("labels", &[1, 100])];
    let tensorflow: [(&str, &[i64]); 3] = [
        ("detection_boxes:0", &[1, 100, 4]),
        ("detection_scores:0", &[1, 100]),
        ("detection_classes:0", &[1, 100]),
    ];
    let lite: [(&str, &[i64]); 4] = [
        ("TFLite_Detection_PostProcess", &[1, 10, 4]),
        ("TFLite_Detection_PostProcess:1", &[1, 10]),
        ("TFLite_Detection_PostProcess:2", &[1, 10]),
        ("TFLite_Detection_PostProcess:3", &[1]),
    ];
    let damo: [(&str, &[i64]); 2] = [("output", &[1, 84, 80]), ("1117", &[1, 84, 4])];
    let maps: [(&str, &[i64]); 2] = [("a", &[1, 3, 8, 8, 85]), ("b", &[1, 3, 4, 4, 85])];
    let mut of_mmdeploy = model(64, &mmdeploy, &[]);
    of_mmdeploy.outputs[1].element = ElementType::Int64;
    for (signature, reason) in [
        (plain(64, "logits", &[1, 1000]), "classifier"),
        (
            signature(&[-1, 3, 64, 64], &[("logits", &[-1, 1000])]),
            "classifier",
        ),
        (plain(64, "x", &[1, 7, 3, 2]), "none of the models"),
        (model(64, &transformer, &[]), "\"rt-detr\" for RT-DETR"),
        (of_mmdeploy, "\"rtmdet\" for RTMDet"),
        (
            model(64, &tensorflow, &[]),
            "detection_boxes:0: y1 x1 y2 x2",
        ),
        (
            model(64, &lite, &[]),
            "TFLite_Detection_PostProcess: y1 x1 y2 x2, TFLite_Detection_PostProcess:2: score",
        ),
        (model(64, &damo, &[]), "as DAMO-YOLO writes them"),
        (model(64, &maps, &[]), "--grid"),
        (ultralytics("task", "segment"), "`segment`"),
        // Metadata that contradicts the shape.
        (ultralytics("end2end", "True"), "`end-to-end`"),
    ] {
        let refusal = recognised(&signature, None).unwrap_err();
        assert!(refusal.contains(reason), "{refusal}");
        let (_, looked_for) = refusal.split_once("\n  Looked for\n").unwrap();
        assert_eq!(looked_for.lines().count(), families::FAMILIES.len());
    }
}

#[test]
fn final_boxes_of_no_known_exporter_are_refused_with_the_list_of_their_columns() {
    let of_suppression: [(&str, &[i64]); 4] = [
        ("num_dets", &[1, 1]),
        ("bboxes", &[1, 100, 4]),
        ("scores", &[1, 100]),
        ("labels", &[1, 100]),
    ];
    let detectron: [(&str, &[i64]); 4] = [
        ("boxes", &[2, 4]),
        ("classes", &[2]),
        ("scores", &[2]),
        ("image_size", &[2]),
    ];
    let torchvision: [(&str, &[i64]); 3] =
        [("boxes", &[-1, 4]), ("labels", &[-1]), ("scores", &[-1])];
    let raw: [(&str, &[i64]); 4] = [
        ("raw_detection_boxes", &[1, 1917, 4]),
        ("detection_boxes", &[1, 100, 4]),
        ("detection_scores", &[1, 100]),
        ("detection_classes", &[1, 100]),
    ];
    for (signature, reason) in [
        (
            plain(64, "output", &[-1, 16]),
            "rows of final boxes, with 16 numbers",
        ),
        (
            model(64, &of_suppression, &[]),
            "\"bboxes: x1 y1 x2 y2, scores: score, labels: class\"",
        ),
        (
            model(64, &detectron, &[]),
            "\"boxes: x1 y1 x2 y2, scores: score, classes: class\"",
        ),
        (
            model(64, &torchvision, &[]),
            "\"boxes: x1 y1 x2 y2, scores: score, labels: class\"",
        ),
        (
            model(64, &raw, &[]),
            "\"detection_boxes: y1 x1 y2 x2, detection_scores: score",
        ),
    ] {
        let refusal = recognised(&signature, None).unwrap_err();
        assert!(refusal.contains(reason), "{refusal}");
    }
}
