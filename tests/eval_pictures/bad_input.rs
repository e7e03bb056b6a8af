//! Bad input to the evaluation is rejected with its place, cause and remedy.

use super::{by_hand, detector, eval, fixture_detector, write_pictures};
use crate::support::{assert_contains, grey_jpeg};
use albireo_core::geometry::PictureSize;
use albireo_eval::data::{GroundTruth, LoadReport, Rules, TruthFormat};
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_eval::pictures::{ModelRunner, PassSettings, run_pass};
use albireo_vision::screen::ScreenConfig;
use std::path::Path;

/// The error of a run that must fail.
fn refusal(command: &str) -> String {
    let ended = eval(command);
    assert!(ended.out.is_empty(), "no table after a failure");
    ended.fails()
}

fn on_pictures(folder: &Path, more: &str) -> String {
    let folder = folder.display();
    let detector = detector("colours.onnx");
    refusal(&format!("pictures {folder} --detector {detector} {more}"))
}

#[test]
fn a_missing_file_folder_or_model_is_named() {
    for (command, name) in [("video", "no/such.mp4"), ("pictures", "no/such")] {
        let said = refusal(&format!("{command} {name}"));
        assert_contains(&said, &[&format!("{name}: no such file or folder")]);
    }
    let folder = tempfile::tempdir().unwrap();
    assert_contains(&on_pictures(folder.path(), ""), &["no .jpg"]);
    write_pictures(folder.path(), 2);
    let drive = folder.path().display();
    let said = refusal(&format!("pictures {drive} --detector no/such.onnx"));
    assert_contains(&said, &["no/such.onnx"]);
    // Recorded screen verdicts need a screen model.
    let said = on_pictures(folder.path(), "--screen recorded");
    assert_contains(&said, &["--screen-model"]);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn ground_truth_of_other_classes_pictures_none_of_which_can_be_used_and_of_two_sizes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 3);
    let names = own_names(folder.path());
    let labels = folder.path().join("labels.json");
    for (label, refused) in [
        ("car", "person, bicycle, car"),
        ("tram", "tram; its own are cat"),
    ] {
        let truth = scalabel(folder.path(), 3, label);
        std::fs::write(&labels, truth).unwrap();
        let truth = format!("--truth-format bdd100k --ground-truth {}", labels.display());
        let said = on_pictures(folder.path(), &format!("--class-names {names} {truth}"));
        assert_contains(&said, &["cat, dog", "--class-names", refused]);
    }
    let second = folder.path().join("1.jpg");
    std::fs::write(&second, grey_jpeg(90, [64, 64])).unwrap();
    let said = on_pictures(folder.path(), "");
    assert_contains(&said, &["64x64, those before it are 1280x720"]);
}

/// Names of seven classes, none of which is on a road.
fn own_names(folder: &Path) -> String {
    let names = folder.join("names.txt");
    std::fs::write(&names, "cat\ndog\ncow\nhen\npig\newe\nfox\n").unwrap();
    names.display().to_string()
}

/// Labels of the clip in `folder`: the box of the fixture model, of the class `category`, on each of `frames` frames.
fn scalabel(folder: &Path, frames: usize, category: &str) -> String {
    let clip = folder.file_name().unwrap().to_string_lossy().into_owned();
    let clip = clip.trim_start_matches('.');
    let label = serde_json::json!({
        "id": "7", "category": category, "box2d": {"x1": 160, "y1": 80, "x2": 800, "y2": 400},
    });
    let frame = |frame| {
        serde_json::json!({
            "name": format!("{frame}.jpg"), "videoName": clip, "frameIndex": frame, "labels": [label],
        })
    };
    serde_json::json!((0..frames).map(frame).collect::<Vec<_>>()).to_string()
}

/// The report of a run over the pictures in `folder`, and what it printed beside it.
fn judged(folder: &Path, more: &str) -> (serde_json::Value, String) {
    let out = tempfile::tempdir().unwrap();
    let at = out.path().display();
    let drive = folder.display();
    let colours = detector("colours.onnx");
    let ended = eval(&format!(
        "video {drive} --detector {colours} --policy vanilla --out {at} {more}"
    ));
    let said = ended.err.clone();
    ended.succeeds();
    let report = std::fs::read(out.path().join("report.json")).unwrap();
    (serde_json::from_slice(&report).unwrap(), said)
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_of_one_s_own_is_judged_by_all_its_classes_with_and_without_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 12);
    let names = own_names(folder.path());
    let saved = folder.path().join("saved");
    let save = format!(
        "--class-names {names} --save-detections {}",
        saved.display()
    );
    let (report, said) = judged(folder.path(), &save);
    assert!(!said.contains("not mapped"), "{said}");
    let of_clip = &report["clips"][0]["classes"];
    assert!(
        of_clip["cat"].is_object() && of_clip["dog"].is_object(),
        "{of_clip}"
    );
    // The names are saved with the numbers.
    let index = std::fs::read_to_string(saved.join("sequences.json")).unwrap();
    assert_contains(&index, &["\"cat\"", "\"fox\""]);

    let labels = folder.path().join("labels.json");
    std::fs::write(&labels, scalabel(folder.path(), 12, "dog")).unwrap();
    let truth = format!("--truth-format bdd100k --ground-truth {}", labels.display());
    let (report, _) = judged(folder.path(), &format!("--class-names {names} {truth}"));
    let classes = report["clips"][0]["classes"].as_object().unwrap();
    assert!(
        classes["dog"]["ap50"].as_f64().unwrap() > 0.0,
        "{classes:?}"
    );
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_bad_picture_of_a_folder_is_named_and_counted_and_the_others_stay_with_their_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 12);
    let labels = folder.path().join("labels.json");
    std::fs::write(&labels, scalabel(folder.path(), 12, "rider")).unwrap();
    let truth = format!("--truth-format bdd100k --ground-truth {}", labels.display());
    let (whole, said) = judged(folder.path(), &truth);
    assert!(!said.contains("cannot be used"), "{said}");
    // One whose header cannot be read, and one that cannot be decoded.
    std::fs::write(folder.path().join("2.jpg"), "<html>").unwrap();
    let bytes = std::fs::read(folder.path().join("7.jpg")).unwrap();
    std::fs::write(folder.path().join("7.jpg"), &bytes[..bytes.len() / 2]).unwrap();
    let (report, said) = judged(folder.path(), &truth);
    assert_contains(
        &said,
        &["2 of 12 pictures cannot be used", "2.jpg", "7.jpg"],
    );
    let frames = |report: &serde_json::Value| report["clips"][0]["frames"].as_u64();
    assert_eq!((frames(&whole), frames(&report)), (Some(12), Some(10)));
    assert!(report["clips"][0]["accuracy"]["ap50"].as_f64().is_some());
    // Without a single one that can be used, the first is named.
    for number in 0..12 {
        std::fs::write(folder.path().join(format!("{number}.jpg")), "<html>").unwrap();
    }
    let said = on_pictures(folder.path(), "");
    assert_contains(&said, &["none of its pictures can be used", "0.jpg"]);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_video_without_frames_is_an_error() {
    let mut models = ModelRunner::start(&fixture_detector(), &ScreenConfig::default()).unwrap();
    let mut report = LoadReport::default();
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 1);
    // A source at its end.
    let mut over = Pictures::of_folder(folder.path(), 25.0).unwrap();
    while over.next().unwrap().is_some() {}
    let keep = PassSettings::default();
    let error = run_pass(&mut over, &mut models, &keep, &mut report, &mut || ()).unwrap_err();
    let expected = format!("{}: it has no frames", over.name());
    assert_contains(&error.to_string(), &[&expected]);
}

/// Ground truth in Scalabel format: a car on each of `frames` frames of the clip `video`.
fn labels(folder: &Path, video: &str, frames: usize) -> GroundTruth {
    let entry = |frame: usize| {
        format!(
            r#"{{"name":"{frame}","videoName":"{video}","frameIndex":{frame},"labels":[
            {{"id":"7","category":"car","box2d":{{"x1":100,"y1":100,"x2":200,"y2":200}}}},
            {{"id":"8","category":"tram","box2d":{{"x1":1,"y1":1,"x2":20,"y2":20}}}}]}}"#
        )
    };
    let entries: Vec<String> = (0..frames).map(entry).collect();
    let path = folder.join(format!("{video}.json"));
    std::fs::write(&path, format!("[{}]", entries.join(","))).unwrap();
    GroundTruth::read(&[path], TruthFormat::Bdd100k, Rules::Benchmark).unwrap()
}

#[test]
fn ground_truth_is_found_by_name_and_rejected_for_other_frames_clips_or_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let mut clip = by_hand(3);
    let mut report = LoadReport::default();
    let mut truth = labels(folder.path(), "by-hand", 3);
    truth.attach_to(&mut clip, false, Some(3), &mut report).unwrap();
    assert!(clip.ignored.is_empty());
    let found = clip.truth.take().unwrap();
    assert!(found.iter().all(|frame| frame.len() == 1));
    assert_eq!(report.unmapped_classes["tram"], 3);

    for frames in [2, 4] {
        let mut other = labels(folder.path(), "by-hand", frames);
        let error = other.attach_to(&mut clip, false, Some(3), &mut report).unwrap_err();
        let expected = format!("is for {frames} frames, the clip has 3");
        assert_contains(&error.to_string(), &[&expected]);
    }
    // A clip that was cut to its first frames has the first of the ground truth.
    let mut longer = labels(folder.path(), "by-hand", 4);
    longer.attach_to(&mut clip, false, None, &mut report).unwrap();
    assert_eq!(clip.truth.take().unwrap().len(), 3);
    assert_eq!(longer.rate("by-hand", false), Some(5.0));

    let mut other = labels(folder.path(), "other", 3);
    other.attach_to(&mut clip, false, Some(3), &mut report).unwrap();
    assert_eq!(clip.truth, None);
    // The only ground truth applies to the only clip, whatever its name.
    other.attach_to(&mut clip, true, Some(3), &mut report).unwrap();
    assert!(clip.truth.is_some());
    let names = ["by-hand".to_owned(), "second".to_owned()];
    let error = other.check(&names).unwrap_err().to_string();
    assert_contains(&error, &["other", "by-hand, second"]);

    clip.truth = Some(vec![Vec::new(); 3]);
    albireo_eval::data::recorded::write(folder.path(), std::slice::from_ref(&clip)).unwrap();
    let paths = [folder.path().to_owned()];
    let mut truth = GroundTruth::read(&paths, TruthFormat::Recorded, Rules::Benchmark).unwrap();
    truth.attach_to(&mut clip, false, Some(3), &mut report).unwrap();
    assert!(clip.truth.is_some());
    clip.picture = PictureSize::new(640, 360);
    let error = truth.attach_to(&mut clip, false, Some(3), &mut report).unwrap_err();
    assert_contains(&error.to_string(), &["1280x720", "640x360"]);
}
