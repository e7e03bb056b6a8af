//! Which models fit which heads, and which are recognised.

use super::*;
use crate::picture::{ColorOrder, TensorLayout, ValueRange};
use albireo_core::geometry::PictureSize;

#[test]
fn the_input_format_follows_byte_and_channels_last_models() {
    let mut model = signature(&[1, 320, 640, 3], &[("output0", &[1, 84, 4200])]);
    model.inputs[0].element = ElementType::Uint8;
    let input = model.picture_input(None).unwrap();
    let format = bind(HeadName::Yolo, &model, input).unwrap().input_format;
    assert_eq!(format.size, PictureSize::new(640, 320));
    assert_eq!(format.layout, TensorLayout::Nhwc);
    assert_eq!(format.value_range, ValueRange::To255);
    assert_eq!(format.shape(), [1, 320, 640, 3]);
    assert_eq!(format.color_order, ColorOrder::Rgb);
}

#[test]
fn a_dynamic_input_takes_its_size_from_the_configuration_or_the_metadata() {
    let open = signature(&[-1, 3, -1, -1], &[("output0", &[-1, 84, -1])]);
    let size = PictureSize::new(320, 256);
    let wanted = Some(size);
    assert_eq!(open.picture_input(wanted).unwrap().size, size);
    let error = open.picture_input(None).unwrap_err();
    assert!(error.contains("detector.input_size"), "{error}");
    let read = with_metadata(open, &[("imgsz", "[384, 640]")]);
    let own = read.picture_input(None).unwrap().size;
    assert_eq!(own, PictureSize::new(640, 384));
    assert_eq!(read.picture_input(wanted).unwrap().size, size);
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
    let input = [1, 3, 416, 416];
    for (name, output, reason) in [
        (Yolox, &[1, 84, 8400][..], "[1, 3549, 5 + classes]"),
        (Yolox, &[1, 3549, 5], "another shape"),
        (Yolo, &[1, 4, 3549], "another shape"),
        (Yolo, &[2, 84, 3549], "another shape"),
        (EndToEnd, &[1, 300, 7], "another shape"),
        (FastestDet, &[1, 85, 22, 22], "26, 26"),
        (Detr, &[1, 300, 4], "no such outputs"),
    ] {
        let signature = signature(&input, &[("output", output)]);
        let picture = signature.picture_input(None).unwrap();
        let misfit = bind(name, &signature, picture).unwrap_err();
        assert!(misfit.reason.contains(reason), "{misfit:?}");
        assert!(misfit.expected.contains("[1, "), "{misfit:?}");
    }
}

#[test]
fn more_outputs_or_another_element_type_are_rejected() {
    let mut two = signature(&[1, 3, 64, 64], &[("a", &[1, 6, 84]), ("b", &[1])]);
    let input = two.picture_input(None).unwrap();
    let reason = bind(HeadName::Yolo, &two, input).unwrap_err().reason;
    assert!(reason.contains("2 outputs"), "{reason}");
    two.outputs.pop();
    two.outputs[0].element = ElementType::Other("int8".to_owned());
    let reason = bind(HeadName::Yolo, &two, input).unwrap_err().reason;
    assert!(reason.contains("int8"), "{reason}");
    two.outputs[0].element = ElementType::Float16;
    assert!(bind(HeadName::Yolo, &two, input).is_ok());
}

fn recognised(signature: &Signature) -> Result<HeadName, Unrecognised> {
    recognise(signature, signature.picture_input(None).unwrap())
}

#[test]
fn models_are_recognised_by_their_exporters_conventions() {
    let names = ("names", "{0: 'car'}");
    let ultralytics = [
        ("author", "Ultralytics"),
        ("task", "detect"),
        ("head", "Detect"),
        ("stride", "32"),
        names,
    ];
    let square = [1, 3, 640, 640];
    let model = |outputs: &[(&str, &[i64])], entries: &[(&str, &str)]| {
        with_metadata(signature(&square, outputs), entries)
    };
    let end = [&ultralytics[..], &[("end2end", "True")]].concat();
    let not_end = [&ultralytics[..], &[("end2end", "False")]].concat();
    let nms = [&ultralytics[..], &[("args", "{'nms': True}")]].concat();
    let one: &[(&str, &[i64])] = &[("output0", &[1, 5, 8400])];
    let boxes: &[(&str, &[i64])] = &[("output0", &[1, 300, 6])];
    let detr: [(&str, &[i64]); 3] = [
        ("dets", &[1, 300, 4]),
        ("labels", &[1, 300, 91]),
        ("masks", &[1, 300, 9, 9]),
    ];
    use HeadName::{Detr, EndToEnd, FastestDet, Yolo, Yolox};
    for (signature, expected) in [
        (model(one, &ultralytics), Yolo),
        (model(one, &not_end), Yolo),
        (model(boxes, &end), EndToEnd),
        (model(boxes, &nms), EndToEnd),
        (model(boxes, &[]), EndToEnd),
        (model(&[("output0", &[1, 84, 8400])], &[]), Yolo),
        // With a coarser fourth stride, and one that leaves its anchors open.
        (model(&[("output0", &[1, 84, 8500])], &[]), Yolo),
        (model(&[("output0", &[-1, 84, -1])], &[]), Yolo),
        (model(&[("output", &[1, 8400, 85])], &[]), Yolox),
        (model(&[("758", &[1, 85, 40, 40])], &[]), FastestDet),
        (model(&detr[..2], &[]), Detr),
        (model(&detr, &[]), Detr),
    ] {
        assert_eq!(recognised(&signature), Ok(expected), "{signature}");
    }
}

#[test]
fn an_unknown_or_ambiguous_model_is_rejected_with_every_head_that_was_tried() {
    let square = [1, 3, 64, 64];
    let model = |outputs: &[(&str, &[i64])]| signature(&square, outputs);
    let ultralytics = |entry: (&str, &str)| {
        let entries = [("author", "Ultralytics"), entry];
        with_metadata(model(&[("output0", &[1, 6, 84])]), &entries)
    };
    let large = signature(&[1, 3, 640, 640], &[("output0", &[1, 25200, 85])]);
    let boxes: (&str, &[i64]) = ("pred_boxes", &[1, 300, 4]);
    for (signature, reason) in [
        (model(&[("logits", &[1, 1000])]), "none of them"),
        // YOLOv5: three boxes per cell.
        (large, "none of them"),
        // A transformer with unknown scores and colours.
        (model(&[("logits", &[1, 300, 80]), boxes]), "none of them"),
        // Either YOLOX with one class, or 84 finished boxes.
        (
            model(&[("output", &[1, 84, 6])]),
            "each of end-to-end, yolox",
        ),
        (ultralytics(("task", "segment")), "`segment`"),
        // Metadata that contradicts the shape.
        (ultralytics(("end2end", "True")), "`end-to-end`"),
    ] {
        let refusal = recognised(&signature).unwrap_err();
        assert!(refusal.reason.contains(reason), "{refusal:?}");
        assert_eq!(refusal.looked_for.len(), HeadName::RECOGNISED.len());
        for (head, line) in HeadName::RECOGNISED.iter().zip(&refusal.looked_for) {
            assert!(line.starts_with(head.as_str()), "{line}");
        }
    }
}
