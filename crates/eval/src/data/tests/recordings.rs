//! Recorded detections are read and written back, and a broken file is named.

use super::super::*;
use super::{assert_refused, folder, left_out};
use crate::data::classes::CAR;

// "classes" is for people and is not read; the key that is read, "class_names", is absent here.
const INDEX: &str = r#"{"classes": {"2": "car"},
    "sequences": [{"name": "a", "width": 100, "height": 50, "fps": 10, "frames": 3}]}"#;
const HEADER: &str = "frame,x1,y1,x2,y2,score,class\n";
const TRUTH_HEADER: &str = "frame,x1,y1,x2,y2,class,object_id\n";
const IGNORED_HEADER: &str = "frame,x1,y1,x2,y2,class,mark\n";

/// No file of detections, or none of ground truth.
const NO_FILE: Option<&str> = None;
/// A file with only its header.
const NO_ROWS: Option<&str> = Some("");

/// Reads a recording with this index, these rows of detections and these of ground truth.
fn recorded(index: &str, rows: Option<&str>, truth: Option<&str>) -> Result<DataSet, EvalError> {
    let detections = rows.map(|rows| format!("{HEADER}{rows}"));
    let truth = truth.map(|rows| format!("{TRUTH_HEADER}{rows}"));
    let mut files = vec![("sequences.json", index)];
    files.extend(detections.as_deref().map(|text| ("detections/a.csv", text)));
    files.extend(truth.as_deref().map(|text| ("groundtruth/a.csv", text)));
    recorded::read(folder(&files).path())
}

/// A recording with detections, ground truth and an ignored region.
fn whole_recording() -> DataSet {
    let rows = "0,0.1,0.30000000000000004,3.5,4,0.9,2\n2,1,1,9,9,0.3333333333333333,0\n";
    let truth = format!("{TRUTH_HEADER}1,0,0,5,5,2,7\n");
    let files = folder(&[
        ("sequences.json", INDEX),
        ("detections/a.csv", &format!("{HEADER}{rows}")),
        ("groundtruth/a.csv", &truth),
        ("ignore/a.csv", "frame,x1,y1,x2,y2\n1,0,0,50,20.5\n"),
    ]);
    recorded::read(files.path()).unwrap()
}

#[test]
fn recorded_detections_truth_and_ignored_regions_are_read_frame_by_frame() {
    let read = whole_recording();
    assert_eq!(read.report, LoadReport::default());
    let clip = &read.clips[0];
    let detections = clip.detections.as_ref().unwrap();
    let counts: Vec<usize> = detections.iter().map(Vec::len).collect();
    assert_eq!(counts, [1, 0, 1]);
    assert_eq!(detections[0][0].corners.x2, 3.5);
    assert_eq!(detections[0][0].class, CAR);
    assert_eq!(clip.truth.as_ref().unwrap()[1][0].object, Some(7));
    let regions: Vec<usize> = clip.ignored.iter().map(Vec::len).collect();
    assert_eq!(regions, [0, 1, 0]);
    assert_eq!(clip.ignored[1][0].corners.y2, 20.5);
}

#[test]
fn a_recording_that_is_written_and_read_again_is_the_same_to_the_last_bit() {
    let read = whole_recording();
    let copy = tempfile::tempdir().unwrap();
    recorded::write(copy.path(), &read.clips).unwrap();
    let again = recorded::read(copy.path()).unwrap();
    assert_eq!(again.clips, read.clips);
}

#[test]
fn an_object_keeps_its_number_in_a_recording_however_large_it_is() {
    let numbers = [Some(9_223_372_036_854_775_808), Some(u64::MAX), None];
    let rows =
        "0,0,0,5,5,2,9223372036854775808\n1,0,0,5,5,2,18446744073709551615\n2,0,0,5,5,2,-1\n";
    let read = recorded(INDEX, NO_ROWS, Some(rows)).unwrap();
    let copy = tempfile::tempdir().unwrap();
    recorded::write(copy.path(), &read.clips).unwrap();
    let again = recorded::read(copy.path()).unwrap();
    for data in [read, again] {
        let objects = data.clips[0].truth.as_ref().unwrap().iter().flatten();
        assert!(objects.map(|object| object.object).eq(numbers));
    }
}

#[test]
fn clips_that_are_written_one_by_one_are_there_after_each() {
    let clip = |name: &str| Clip {
        detections: Some(vec![Vec::new(); 3]),
        ..Clip::new(name.to_owned(), PictureSize::new(100, 50), 3)
    };
    let clips = [clip("a"), clip("b")];
    let folder = tempfile::tempdir().unwrap();
    for done in 1..=clips.len() {
        recorded::write_last(folder.path(), &clips[..done]).unwrap();
        assert_eq!(recorded::read(folder.path()).unwrap().clips, clips[..done]);
    }
}

#[test]
fn every_mark_of_a_recording_is_written_and_read_back() {
    let ignored = |class: Option<u16>, mark: Mark| Ignored {
        corners: Corners {
            x1: 0.1,
            y1: 0.0,
            x2: 50.0,
            y2: 20.5,
        },
        class: class.map(ClassId),
        mark,
    };
    let clip = Clip {
        detections: Some(vec![Vec::new(); 3]),
        truth: Some(vec![Vec::new(); 3]),
        ignored: vec![
            vec![
                ignored(Some(2), Mark::Crowd),
                ignored(None, Mark::Distractor),
                ignored(None, Mark::Unjudged),
            ],
            vec![ignored(Some(0), Mark::Object), ignored(None, Mark::Region)],
            vec![Ignored::UNLABELLED],
        ],
        ..Clip::new("a".to_owned(), PictureSize::new(100, 50), 3)
    };
    let folder = tempfile::tempdir().unwrap();
    recorded::write(folder.path(), std::slice::from_ref(&clip)).unwrap();
    assert_eq!(recorded::read(folder.path()).unwrap().clips, [clip]);
}

#[test]
fn a_mark_that_is_no_rule_is_refused_by_name() {
    let files = folder(&[
        ("sequences.json", INDEX),
        ("detections/a.csv", HEADER),
        (
            "ignore/a.csv",
            &format!("{IGNORED_HEADER}0,0,0,50,20.5,2,cloud\n"),
        ),
    ]);
    let parts = ["ignore/a.csv:2: ", "`cloud`"];
    assert_refused(recorded::read(files.path()), &parts);
}

#[test]
fn a_sequence_of_more_frames_than_are_read_is_refused_by_name() {
    let index = INDEX.replace("\"frames\": 3", "\"frames\": 1000000000000000");
    assert_ne!(index, INDEX);
    let files = folder(&[("sequences.json", &index), ("detections/a.csv", HEADER)]);
    let parts = ["sequences.json", "`a`", "1000000000000000 frames"];
    assert_refused(recorded::read(files.path()), &parts);
}

#[test]
fn a_mark_for_a_class_that_cannot_be_is_refused() {
    let files = folder(&[
        ("sequences.json", INDEX),
        ("detections/a.csv", HEADER),
        (
            "ignore/a.csv",
            &format!("{IGNORED_HEADER}0,0,0,50,20.5,70000,region\n"),
        ),
    ]);
    let parts = ["ignore/a.csv:2: ", "70000"];
    assert_refused(recorded::read(files.path()), &parts);
}

#[test]
fn a_broken_row_is_named_with_file_and_line() {
    for (row, part) in [
        ("0,1,2,3,4,0.9", "the row has 6 columns"),
        ("0,1,2,x,4,0.9,2", "`x2` is `x`"),
        ("3,1,2,3,4,0.9,2", "frame 3 does not exist"),
        ("-1,1,2,3,4,0.9,2", "frame -1 does not exist"),
        ("0.5,1,2,3,4,0.9,2", "`frame` is `0.5`"),
        ("0,1,2,3,4,0.9,-2", "`class` is `-2`"),
    ] {
        let rows = format!("0,1,2,3,4,0.9,2\n{row}\n");
        let parts = ["detections/a.csv:3: ", part];
        assert_refused(recorded(INDEX, Some(&rows), NO_FILE), &parts);
    }
}

#[test]
fn missing_detections_are_named_with_their_file() {
    let parts = ["detections/a.csv", "needs its detections"];
    assert_refused(recorded(INDEX, NO_FILE, NO_FILE), &parts);
}

#[test]
fn a_table_with_another_header_is_refused() {
    let files = folder(&[("sequences.json", INDEX), ("detections/a.csv", "frame,x\n")]);
    let header = "a.csv:1: the header is `frame,x`";
    assert_refused(recorded::read(files.path()), &[header]);
}

#[test]
fn a_table_without_a_line_is_told_that_its_header_is_missing() {
    let files = folder(&[("sequences.json", INDEX), ("detections/a.csv", "")]);
    let missing = "a.csv:1: the header is missing, expected `frame,x1";
    assert_refused(recorded::read(files.path()), &[missing]);
}

#[test]
fn an_index_that_is_no_json_is_named_with_its_line() {
    let index = "{\n\"sequences\": [{]}";
    assert_refused(recorded(index, NO_ROWS, NO_FILE), &["sequences.json:2: "]);
}

#[test]
fn an_impossible_description_is_rejected() {
    let outside = INDEX.replace("\"a\"", "\"../a\"");
    for (index, part) in [
        (outside, "cannot be a sequence's name"),
        (INDEX.replace("100", "0"), "pictures of 0x50"),
        (INDEX.replace("10,", "-1,"), "frame rate"),
    ] {
        assert_refused(recorded(&index, NO_ROWS, NO_FILE), &[part]);
    }
}

#[test]
fn meaningless_rows_are_left_out_counted_and_named() {
    let rows = [
        "0,1,2,3,4,NaN,2",
        "0,inf,2,3,4,0.9,2",
        // Its right side is left of its left one.
        "0,5,2,3,4,0.9,2",
        // It has no height.
        "0,1,4,3,4,0.9,2",
        "0,200,2,300,4,0.9,2",
        "0,1,2,3,4,1.5,2",
    ];
    let inverted_truth = "0,9,9,5,5,2,1\n";
    let data = recorded(INDEX, Some(&rows.join("\n")), Some(inverted_truth)).unwrap();
    let report = &data.report;
    assert_eq!(left_out(report, LeftOut::NotFinite), 2);
    assert_eq!(left_out(report, LeftOut::EmptyBox), 3);
    assert_eq!(left_out(report, LeftOut::OutsidePicture), 1);
    assert_eq!(left_out(report, LeftOut::ConfidenceRange), 1);
    assert_eq!(data.clips[0].detections, Some(vec![Vec::new(); 3]));
    let lines = report.lines().join("\n");
    assert!(lines.contains("detections/a.csv:2"), "{lines}");
}

#[test]
fn a_box_that_reaches_outside_the_picture_is_kept_and_counted() {
    let data = recorded(INDEX, Some("1,-5,2,3,4,0.9,2\n"), NO_FILE).unwrap();
    assert_eq!(data.report.reaching_outside, 1);
    let frames = data.clips[0].detections.as_ref().unwrap();
    assert_eq!(frames[1].len(), 1);
}

#[test]
fn a_clip_without_a_single_detection_is_noted() {
    let undetected = recorded(INDEX, NO_ROWS, Some("0,1,1,5,5,2,1\n")).unwrap();
    let notes = undetected.report.notes.join("\n");
    assert!(notes.contains("no detections"), "{notes}");
}

#[test]
fn a_clip_without_ground_truth_is_noted() {
    let unlabelled = recorded(INDEX, Some("0,1,2,3,4,0.9,2\n"), NO_FILE).unwrap();
    let notes = unlabelled.report.notes.join("\n");
    assert!(notes.contains("no ground truth"), "{notes}");
}

#[test]
fn ground_truth_whose_boxes_the_index_counts_must_be_there() {
    let counted = INDEX.replace("\"frames\"", "\"ground_truth_boxes\": 4, \"frames\"");
    assert_refused(recorded(&counted, NO_ROWS, NO_FILE), &["groundtruth/a.csv"]);
}

#[test]
fn a_recording_of_an_empty_clip_is_refused_as_such() {
    let empty = INDEX.replace("\"frames\": 3", "\"frames\": 0");
    assert_refused(recorded(&empty, NO_ROWS, NO_FILE), &["clip without frames"]);
}
