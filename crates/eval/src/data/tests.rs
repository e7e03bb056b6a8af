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

#[test]
fn clips_without_detections_are_dropped_by_name_or_rejected() {
    let clip = |name: &str| Clip::new(name.to_owned(), PictureSize::new(10, 10), 1);
    let truth = Path::new("gt.json");
    let mut data = DataSet::default();
    data.push(clip("b"));
    assert_refused(data.clone().only_with_detections(truth), &["--detections"]);
    data.push(Clip {
        detections: Some(vec![Vec::new()]),
        ..clip("a")
    });
    let kept = data.only_with_detections(truth).unwrap();
    let names: Vec<&str> = kept.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["a"]);
    let lines = kept.report.lines().join("\n");
    let expected = "b: ground truth without stored detections";
    assert!(lines.contains(expected), "{lines}");
}

#[test]
fn clips_with_equal_names_get_different_file_names() {
    let mut data = DataSet::default();
    for name in ["a/b", "a-b", "..", "a-b"] {
        data.push(Clip::new(name.to_owned(), PictureSize::new(10, 10), 1));
    }
    let names: Vec<&str> = data.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["a-b", "a-b-2", "-2", "a-b-3"]);
}

#[test]
fn a_folder_for_a_coco_file_is_that_of_an_export_or_says_what_is_expected() {
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
    let set = r#"{"images": [{"id": 1, "file_name": "a/1.jpg", "width": 64, "height": 48}], "categories": [], "annotations": []}"#;
    std::fs::write(folder.path().join("annotations.json"), set).unwrap();
    assert_eq!(
        coco::read(folder.path(), no_results).unwrap().clips.len(),
        1
    );
}
