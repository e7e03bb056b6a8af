mod ground_truth;
mod layouts;
mod recordings;

use super::*;
use tempfile::TempDir;

/// A folder with these files, each given as its path and content.
fn folder(files: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("it has a folder")).expect("made");
        std::fs::write(path, content).expect("written");
    }
    folder
}

/// Asserts that `read` failed with an error that contains all of `parts`.
fn assert_refused(read: Result<DataSet, EvalError>, parts: &[&str]) {
    let message = read.expect_err("it must be refused").to_string();
    for part in parts {
        assert!(message.contains(part), "{part} in {message}");
    }
}

/// The number of rows and clips that were left out for this reason.
fn left_out(report: &LoadReport, reason: LeftOut) -> usize {
    report.left_out.get(&reason).map_or(0, |(count, _)| *count)
}

/// A clip of one frame, without detections.
fn undetected(name: &str) -> Clip {
    Clip::new(name.to_owned(), PictureSize::new(10, 10), 1)
}

#[test]
fn clips_without_detections_are_left_out_by_name() {
    let mut data = DataSet::default();
    data.push(undetected("b"));
    data.push(Clip {
        detections: Some(vec![Vec::new()]),
        ..undetected("a")
    });
    let kept = data.only_with_detections(Path::new("gt.json")).unwrap();
    let names: Vec<&str> = kept.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["a"]);
    let lines = kept.report.lines().join("\n");
    let expected = "b: ground truth without stored detections";
    assert!(lines.contains(expected), "{lines}");
}

#[test]
fn data_without_any_detections_is_refused() {
    let mut data = DataSet::default();
    data.push(undetected("b"));
    let truth = Path::new("gt.json");
    assert_refused(data.only_with_detections(truth), &["--detections"]);
}

#[test]
fn clips_with_equal_names_get_different_file_names() {
    let mut data = DataSet::default();
    for name in ["a/b", "a-b", "..", "a-b"] {
        data.push(undetected(name));
    }
    let names: Vec<&str> = data.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["a-b", "a-b-2", "-2", "a-b-3"]);
}

#[test]
fn a_folder_without_an_export_in_place_of_a_coco_file_is_refused_with_what_is_expected() {
    let folder = tempfile::tempdir().unwrap();
    let no_results = None;
    let error = coco::read(folder.path(), no_results).unwrap_err().to_string();
    let path = folder.path().display();
    let expected = format!("{path}: this is a folder, and COCO is one JSON file");
    assert!(error.starts_with(&expected), "{error}");
    assert!(
        error.ends_with(&format!("such as {path}/annotations.json")),
        "{error}"
    );
}

#[test]
fn the_folder_of_an_export_is_read_as_its_coco_file() {
    let set = r#"{"images": [{"id": 1, "file_name": "a/1.jpg", "width": 64, "height": 48}], "categories": [], "annotations": []}"#;
    let folder = folder(&[("annotations.json", set)]);
    let no_results = None;
    let data = coco::read(folder.path(), no_results).unwrap();
    assert_eq!(data.clips.len(), 1);
}

#[test]
fn the_mark_of_the_byte_order_is_no_part_of_a_text() {
    let files = folder(&[
        ("labels.json", "\u{feff}[]"),
        ("gt/label_02/a.txt", "\u{feff}0 1 Car 0 0 0 10 20 60 80\n"),
    ]);
    let text = crate::files::read_text(&files.path().join("labels.json"), "").unwrap();
    assert_eq!(text, "[]");
    let clip = kitti::read(&files.path().join("gt")).unwrap().clips.remove(0);
    assert_eq!(clip.truth_boxes(), 1);
}

#[test]
fn a_compressed_file_and_one_that_is_no_text_are_told_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set.json");
    let no_results = None;
    for (bytes, said) in [
        (&[0x1f, 0x8b, 8, 0], "it is compressed: gunzip it first"),
        (&[0xff, 0xfe, b'{', 0], "it is not text in UTF-8"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        assert_refused(coco::read(&path, no_results), &["set.json: ", said]);
    }
}
