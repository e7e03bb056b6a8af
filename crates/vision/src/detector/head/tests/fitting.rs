use super::*;
use crate::detector::metadata::tests::metadata;
use albireo_core::geometry::PictureSize;

#[test]
fn a_dynamic_input_takes_its_size_from_the_configuration_or_the_metadata() {
    let mut open = signature(&[-1, 3, -1, -1], &[("output0", &[-1, 84, -1])]);
    let size = PictureSize::new(320, 256);
    let wanted = Some(size);
    assert_eq!(open.picture_input(wanted).unwrap().size, size);
    let error = open.picture_input(None).unwrap_err();
    assert!(error.contains("detector.input_size"), "{error}");
    open.metadata = metadata(&[("imgsz", "[384, 640]")]);
    let own = open.picture_input(None).unwrap().size;
    assert_eq!(own, PictureSize::new(640, 384));
    assert_eq!(open.picture_input(wanted).unwrap().size, size);
    let fixed = signature(&[1, 3, 640, 640], &[("output0", &[1, 84, 8400])]);
    let error = fixed.picture_input(wanted).unwrap_err();
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
    other.inputs[0].element = ElementType::Other("int64".to_owned());
    assert!(other.picture_input(None).unwrap_err().contains("int64"));
    other.inputs.clear();
    assert!(other.picture_input(None).unwrap_err().contains("0 inputs"));
}

#[test]
fn a_model_that_does_not_fit_is_rejected_with_the_first_difference() {
    use HeadName::{Detr, EndToEnd, FastestDet, Yolo, Yolox};
    let fits = |name, model: &Signature| bind(name, model, model.picture_input(None).unwrap());
    let one = |shape: &[i64]| plain(416, "output", shape);
    let mut bytes = one(&[1, 84, 3549]);
    bytes.outputs[0].element = ElementType::Other("int8".to_owned());
    let two = model(416, &[("a", &[1, 84, 3549]), ("b", &[1])], &[]);
    for (name, model, reason) in [
        (Yolox, one(&[1, 84, 8400]), "[1, 3549, 5 + classes]"),
        (Yolox, one(&[1, 3549, 5]), "another shape"),
        (Yolo, one(&[1, 4, 3549]), "another shape"),
        (Yolo, one(&[2, 84, 3549]), "another shape"),
        (Yolo, two, "2 outputs"),
        (Yolo, bytes.clone(), "int8"),
        (EndToEnd, one(&[1, 300, 7]), "another shape"),
        (FastestDet, one(&[1, 85, 22, 22]), "26, 26"),
        (Detr, one(&[1, 300, 4]), "no such outputs"),
    ] {
        let misfit = fits(name, &model).unwrap_err();
        assert!(misfit.contains(reason), "{misfit}");
        assert!(name.looks_for().contains("[1, "), "{name:?}");
    }
    bytes.outputs[0].element = ElementType::Float16;
    assert!(fits(Yolo, &bytes).is_ok());
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

fn recognised(signature: &Signature) -> Result<HeadName, String> {
    recognise(signature, signature.picture_input(None).unwrap())
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
    use HeadName::{Detr, EndToEnd, FastestDet, Yolo, Yolox};
    for (signature, expected) in [
        (model(640, one, &ultralytics), Yolo),
        (model(640, one, &with("end2end", "False")), Yolo),
        (model(640, boxes, &with("end2end", "True")), EndToEnd),
        (model(640, boxes, &with("args", "{'nms': True}")), EndToEnd),
        (model(640, boxes, &[]), EndToEnd),
        (plain(640, "output0", &[1, 84, 8400]), Yolo),
        // With a coarser fourth stride, and one that leaves its anchors open.
        (plain(640, "output0", &[1, 84, 8500]), Yolo),
        (plain(640, "output0", &[-1, 84, -1]), Yolo),
        (plain(640, "output", &[1, 8400, 85]), Yolox),
        (plain(640, "758", &[1, 85, 40, 40]), FastestDet),
        (model(640, &detr[..2], &[]), Detr),
        (model(640, &detr, &[]), Detr),
    ] {
        assert_eq!(recognised(&signature), Ok(expected), "{signature}");
    }
}

#[test]
fn an_unknown_or_ambiguous_model_is_rejected_with_every_head_that_was_tried() {
    let ultralytics = |key, value| {
        let entries = [("author", "Ultralytics"), (key, value)];
        model(64, &[("output0", &[1, 6, 84])], &entries)
    };
    let outputs: [(&str, &[i64]); 2] = [("logits", &[1, 300, 80]), ("pred_boxes", &[1, 300, 4])];
    let unknown_transformer = model(64, &outputs, &[]);
    // Either YOLOX with one class, or 84 finished boxes.
    let ambiguous = plain(64, "output", &[1, 84, 6]);
    for (signature, reason) in [
        (plain(64, "logits", &[1, 1000]), "none of them"),
        // YOLOv5: three boxes per cell.
        (plain(640, "output0", &[1, 25200, 85]), "none of them"),
        (unknown_transformer, "none of them"),
        (ambiguous, "each of end-to-end, yolox"),
        (ultralytics("task", "segment"), "`segment`"),
        // Metadata that contradicts the shape.
        (ultralytics("end2end", "True"), "`end-to-end`"),
    ] {
        let refusal = recognised(&signature).unwrap_err();
        assert!(refusal.contains(reason), "{refusal}");
        let (_, looked_for) = refusal.split_once(". Looked for ").unwrap();
        assert_eq!(looked_for.split("; ").count(), HeadName::RECOGNISED.len());
        for (head, line) in HeadName::RECOGNISED.iter().zip(looked_for.split("; ")) {
            assert!(line.starts_with(head.as_str()), "{line}");
        }
    }
}
