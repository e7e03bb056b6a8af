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
    let (folder, detector) = (folder.display(), detector("colours.onnx"));
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
fn a_detector_without_evaluated_classes_a_broken_picture_and_one_of_another_size_are_named() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 3);
    let names = folder.path().join("names.txt");
    std::fs::write(&names, "cat\ndog\ncow\nhen\npig\newe\nfox\n").unwrap();
    let said = on_pictures(folder.path(), &format!("--class-names {}", names.display()));
    assert_contains(&said, &["cat, dog", "--class-names"]);
    let second = folder.path().join("1.jpg");
    let whole = std::fs::read(&second).unwrap();
    std::fs::write(&second, &whole[..whole.len() / 2]).unwrap();
    assert_contains(&on_pictures(folder.path(), ""), &["frame 1"]);
    std::fs::write(&second, grey_jpeg(90, [64, 64])).unwrap();
    let said = on_pictures(folder.path(), "");
    assert_contains(&said, &["64x64, those before it are 1280x720"]);
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
    let entries: Vec<String> = (0..frames)
        .map(|frame| {
            format!(
                r#"{{"name":"{frame}","videoName":"{video}","frameIndex":{frame},"labels":[
                {{"id":"7","category":"car","box2d":{{"x1":100,"y1":100,"x2":200,"y2":200}}}},
                {{"id":"8","category":"tram","box2d":{{"x1":1,"y1":1,"x2":20,"y2":20}}}}]}}"#
            )
        })
        .collect();
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
    truth.attach_to(&mut clip, false, true, &mut report).unwrap();
    assert!(clip.ignored.is_empty());
    let found = clip.truth.take().unwrap();
    assert!(found.iter().all(|frame| frame.len() == 1));
    assert_eq!(report.unmapped_classes["tram"], 3);

    for frames in [2, 4] {
        let mut other = labels(folder.path(), "by-hand", frames);
        let error = other.attach_to(&mut clip, false, true, &mut report).unwrap_err();
        let expected = format!("is for {frames} frames, the clip has 3");
        assert_contains(&error.to_string(), &[&expected]);
    }
    // A clip that was cut to its first frames has the first of the ground truth.
    let mut longer = labels(folder.path(), "by-hand", 4);
    longer.attach_to(&mut clip, false, false, &mut report).unwrap();
    assert_eq!(clip.truth.take().unwrap().len(), 3);
    assert_eq!(longer.rate("by-hand", false), Some(5.0));

    let mut other = labels(folder.path(), "other", 3);
    other.attach_to(&mut clip, false, true, &mut report).unwrap();
    assert_eq!(clip.truth, None);
    // The only ground truth applies to the only clip, whatever its name.
    other.attach_to(&mut clip, true, true, &mut report).unwrap();
    assert!(clip.truth.is_some());
    let names = ["by-hand".to_owned(), "second".to_owned()];
    let error = other.check(&names).unwrap_err().to_string();
    assert_contains(&error, &["other", "by-hand, second"]);

    clip.truth = Some(vec![Vec::new(); 3]);
    albireo_eval::data::recorded::write(folder.path(), std::slice::from_ref(&clip)).unwrap();
    let paths = [folder.path().to_owned()];
    let mut truth = GroundTruth::read(&paths, TruthFormat::Recorded, Rules::Benchmark).unwrap();
    truth.attach_to(&mut clip, false, true, &mut report).unwrap();
    assert!(clip.truth.is_some());
    clip.picture = PictureSize::new(640, 360);
    let error = truth.attach_to(&mut clip, false, true, &mut report).unwrap_err();
    assert_contains(&error.to_string(), &["1280x720", "640x360"]);
}
