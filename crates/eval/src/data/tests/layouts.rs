//! Each layout of a benchmark is read with its own counting, classes and marks.

use super::super::*;
use super::{assert_refused, folder, left_out};
use crate::data::classes::{CAR, PERSON};

const SEQINFO: &str =
    "[Sequence]\nname=M\nimDir=img1\nframeRate=30\nseqLength=2\nimWidth=640\nimHeight=480\n";

/// A sequence of MOTChallenge with rows of both releases.
fn mot_sequence() -> DataSet {
    let rows = "1,4,11,21,10,20,1,1,1.0\n2,4,11,21,10,20,0,1,1.0\n2,5,11,21,10,20,1,8,1\n2,6,1,1,5,5,1,6,1\n\
                 1,7,11,21,10,20,1,3.5,4.5,-1\n";
    let files = folder(&[
        ("train/M/seqinfo.ini", SEQINFO),
        ("train/M/gt/gt.txt", rows),
        ("train/M/det/det.txt", "2,-1,11,21,10,20,0.8,-1,-1,-1\n"),
        ("train/M/img1/000002.jpg", ""),
        ("train/M/img1/000001.jpg", ""),
    ]);
    mot_challenge::read(&files.path().join("train")).unwrap()
}

#[test]
fn a_sequence_of_mot_challenge_is_described_by_its_seqinfo() {
    let clip = &mot_sequence().clips[0];
    assert_eq!(clip.name, "M");
    assert_eq!(clip.frames, 2);
    assert_eq!(clip.frame_rate, Some(30.0));
    assert!(clip.pictures[0].ends_with("000001.jpg"));
}

#[test]
fn mot_challenge_counts_frames_and_pixels_from_one() {
    let clip = &mot_sequence().clips[0];
    let corners = Corners {
        x1: 10.0,
        y1: 20.0,
        x2: 20.0,
        y2: 40.0,
    };
    assert_eq!(clip.truth.as_ref().unwrap()[0][0].corners, corners);
    assert_eq!(clip.detections.as_ref().unwrap()[1][0].confidence, 0.8);
}

#[test]
fn the_people_of_both_releases_of_mot_challenge_are_objects() {
    let clip = &mot_sequence().clips[0];
    let people = &clip.truth.as_ref().unwrap()[0];
    assert!(people.iter().all(|object| object.class == PERSON));
    let numbers: Vec<_> = people.iter().map(|object| object.object).collect();
    assert_eq!(numbers, [Some(4), Some(7)]);
}

#[test]
fn what_mot_challenge_does_not_judge_is_no_object_and_counted() {
    let data = mot_sequence();
    let clip = &data.clips[0];
    assert!(clip.truth.as_ref().unwrap()[1].is_empty());
    let marks: Vec<_> = clip.ignored[1].iter().map(|ignored| ignored.mark).collect();
    assert_eq!(marks, [Mark::Unjudged, Mark::Distractor]);
    assert_eq!(left_out(&data.report, LeftOut::IgnoredRegion), 1);
    assert_eq!(left_out(&data.report, LeftOut::Unjudged), 1);
    assert_eq!(data.report.unmapped_classes["6"], 1);
}

#[test]
fn a_broken_row_of_mot_challenge_is_named_with_its_line() {
    for (row, part) in [
        ("1,4,11", "gt.txt:1: "),
        // Frames count from 1, and one less than this is no i64.
        (
            "-9223372036854775808,4,11,21,10,20,1,1,1.0",
            "gt.txt:1: frame -9223372036854775808 does not exist",
        ),
    ] {
        let broken = folder(&[("seqinfo.ini", SEQINFO), ("gt/gt.txt", row)]);
        assert_refused(mot_challenge::read(broken.path()), &[part]);
    }
}

#[test]
fn mot_challenge_excuses_its_distractors_and_vehicles_only_for_vehicles() {
    // Classes 1 to 13, each marked as the benchmark's own files do.
    let mut rows = String::new();
    for class in 1..=13 {
        rows.push_str(&format!(
            "1,{class},11,21,10,20,{},{class},1\n",
            i32::from(class == 1)
        ));
    }
    let read = |name: &str| {
        let info = SEQINFO.replace("name=M", &format!("name={name}"));
        let files = folder(&[("seqinfo.ini", &info), ("gt/gt.txt", &rows)]);
        let data = mot_challenge::read(files.path()).unwrap();
        let clip = data.clips.into_iter().next().unwrap();
        assert_eq!(clip.truth.unwrap()[0].len(), 1);
        clip.ignored[0]
            .iter()
            .map(|ignored| (ignored.mark, ignored.class))
            .collect::<Vec<_>>()
    };
    let vehicles = |number| (Mark::Distractor, Some(ClassId(number)));
    let any = (Mark::Distractor, None);
    let unjudged = (Mark::Unjudged, None);
    // Person on a vehicle, car, bicycle, motorcycle; static person, distractor, three occluders, reflection, crowd.
    let car = vehicles(2);
    let bicycle = vehicles(1);
    let motorcycle = vehicles(3);
    let expected = [
        any, car, bicycle, motorcycle, any, any, unjudged, unjudged, unjudged, any, unjudged,
    ];
    assert_eq!(read("MOT17-02"), expected);
    // Since 2020 vehicles without motor are distractors, too.
    let with_vehicles = [&expected[..4], &[any], &expected[4..]].concat();
    assert_eq!(read("MOT20-01"), with_vehicles);
}

/// The classes of the first frame of a sequence with these rows and files beside them, and the numbers or names of
/// classes that are left out.
fn mot_classes(rows: &str, beside: &[(&str, &str)]) -> (Vec<u16>, Vec<String>) {
    let mut files = vec![("seqinfo.ini", SEQINFO), ("gt/gt.txt", rows)];
    files.extend(beside);
    let files = folder(&files);
    let data = mot_challenge::read(files.path()).unwrap();
    let objects = data.clips[0].truth.as_ref().unwrap()[0].iter();
    let classes = objects.map(|object| object.class.0).collect();
    let left_out = data.report.unmapped_classes.into_keys().collect();
    (classes, left_out)
}

#[test]
fn the_classes_that_a_sequence_names_itself_are_read_by_their_names() {
    let row = |class: usize| format!("1,{class},11,21,10,20,1,{class},1\n");
    let rows: String = [1, 2, 3, 14].map(row).concat();
    let names = "2 Bus\n\n14 traffic cone\n";
    let found = mot_classes(&rows, &[("classes.txt", names)]);
    // Pedestrian, bus, and MOTChallenge's car.
    assert_eq!(found, (vec![0, 5, 2], vec!["traffic cone".to_owned()]));
    let of_cvat = mot_classes(&rows, &[("gt/labels.txt", "car\ntruck\n")]);
    assert_eq!(of_cvat, (vec![2, 7, 2], vec!["14".to_owned()]));
}

#[test]
fn a_name_of_a_class_without_its_number_is_refused() {
    let files = folder(&[
        ("seqinfo.ini", SEQINFO),
        ("gt/gt.txt", ""),
        ("classes.txt", "2 bus\ncar\n"),
    ]);
    let parts = ["classes.txt:2: `car` is no number and name"];
    assert_refused(mot_challenge::read(files.path()), &parts);
}

#[test]
fn names_of_classes_without_any_number_are_another_programs_and_count_for_nothing() {
    let found = mot_classes("1,1,11,21,10,20,1,1,1\n", &[("classes.txt", "car\nbus\n")]);
    assert_eq!(found, (vec![0], Vec::new()));
}

#[test]
fn the_eighth_of_ten_columns_is_a_class_if_it_can_be_one_in_every_row_and_else_a_place() {
    let row = |eighth: &str| format!("1,1,11,21,10,20,1,{eighth},1,0\n");
    for (eighths, classes) in [
        (["3", "-1"], [2, 0]),
        // Some places are whole numbers, and some files have 0 for all.
        (["7", "3.5"], [0, 0]),
        (["3", "-2"], [0, 0]),
        (["0", "0"], [0, 0]),
    ] {
        let rows: String = eighths.map(row).concat();
        assert_eq!(
            mot_classes(&rows, &[]),
            (classes.to_vec(), Vec::new()),
            "{rows}"
        );
    }
}

#[test]
fn visdrone_marks_regions_others_and_objects_of_score_zero() {
    let rows = "1,0,0,0,100,50,0,0,0,0\n1,1,10,20,30,40,1,5,0,0\n2,2,10,20,30,40,0,1,0,0\n\
                2,3,10,20,30,40,1,11,0,0\n2,4,10,20,30,40,1,7,0,0\n";
    let files = folder(&[("annotations/uav.txt", rows)]);
    let data = visdrone::read(files.path(), PictureSize::new(640, 360)).unwrap();
    let clip = &data.clips[0];
    assert_eq!(clip.name, "uav");
    assert_eq!(clip.frames, 2);
    let truth = clip.truth.as_ref().unwrap();
    assert_eq!(truth[0][0].class, CAR);
    assert_eq!(truth[0][0].object, Some(1));
    assert_eq!(truth[0][0].corners.x2, 40.0);
    assert!(truth[1].is_empty());
    let regions: Vec<usize> = clip.ignored.iter().map(Vec::len).collect();
    assert_eq!(regions, [1, 2]);
    assert_eq!(data.report.unmapped_classes["tricycle"], 1);
}

#[test]
fn types_of_kitti_are_read_in_capitals_or_not() {
    let label = "0 1 car 0 0 -1.5 10 20 60 80\n0 2 PEDESTRIAN 0 0 -1.5 10 20 60 80\n\
                 0 -1 dontcare -1 -1 -10 1 1 5 5\n";
    let files = folder(&[("label_02/0007.txt", label)]);
    let data = kitti::read(files.path()).unwrap();
    assert_eq!(data.clips[0].truth_boxes(), 2);
    assert_eq!(data.clips[0].ignored[0].len(), 1);
    assert!(data.report.unmapped_classes.is_empty());
}

/// A sequence of KITTI tracking whose detections reach a frame further than its labels.
fn kitti_sequence() -> DataSet {
    let label = "0 1 Van 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n\
                 0 -1 DontCare -1 -1 -10 1 1 5 5 -1 -1 -1 -1 -1 -1 -1\n\
                 2 2 Tram 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n\
                 2 3 Cyclist 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n";
    let found = "3 -1 Car 0 0 0 10 20 60 80 1 1 1 1 1 1 0 0.75\n";
    let files = folder(&[("label_02/0007.txt", label), ("det_02/0007.txt", found)]);
    kitti::read(files.path()).unwrap()
}

#[test]
fn kitti_tracking_maps_its_types_and_counts_unmapped_ones() {
    let data = kitti_sequence();
    let truth = data.clips[0].truth.as_ref().unwrap();
    assert_eq!(truth[0][0].class, CAR);
    assert_eq!(truth[2].len(), 1);
    assert_eq!(data.report.unmapped_classes["Tram"], 1);
}

#[test]
fn a_sequence_of_kitti_is_as_long_as_the_longer_of_labels_and_detections() {
    let clip = &kitti_sequence().clips[0];
    assert_eq!(clip.name, "0007");
    assert_eq!(clip.frames, 4);
    assert_eq!(clip.detections.as_ref().unwrap()[3][0].confidence, 0.75);
}

#[test]
fn boxes_where_kitti_does_not_care_are_not_judged() {
    let clip = &kitti_sequence().clips[0];
    assert_eq!(clip.ignored.iter().flatten().count(), 1);
    assert_eq!(clip.ignored[0][0].corners.x2, 5.0);
}

/// Labels of BDD100K in its older spelling, of the first and the third frame of a video and of one frame of another.
const OLD_SPELLING: &str = r#"[{"name": "v-1.jpg", "video_name": "v", "index": 0, "labels": [
    {"id": "00122062", "category": "rider", "attributes": {"Crowd": true},
     "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}},
    {"id": "3", "category": "trailer", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]},
    {"name": "v-3.jpg", "video_name": "v", "index": 2, "labels": null},
    {"name": "w-1.jpg", "video_name": "w", "index": 0, "labels": null}]"#;

/// Predictions for the second frame of the first video, in the newer spelling.
const NEW_SPELLING: &str = r#"{"frames": [{"name": "v-2.jpg", "videoName": "v", "frameIndex": 1, "labels": [
    {"category": "car", "score": 0.5, "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]}]}"#;

const NO_LABELS: Option<&str> = None;
const NO_PREDICTIONS: Option<&str> = None;

/// Reads a file of labels and one of predictions, as far as they are given.
fn bdd100k(
    labels: Option<&str>,
    predictions: Option<&str>,
    rules: Rules,
) -> Result<DataSet, EvalError> {
    let files = folder(&[
        ("gt.json", labels.unwrap_or_default()),
        ("pred.json", predictions.unwrap_or_default()),
    ]);
    let [truth, found] = ["gt.json", "pred.json"].map(|name| files.path().join(name));
    bdd100k::read(&bdd100k::Source {
        truth: labels.is_some().then_some(&truth),
        detections: predictions.is_some().then_some(&found),
        picture: PictureSize::new(1280, 720),
        frame_rate: Some(bdd100k::BDD100K_FRAME_RATE),
        rules,
    })
}

#[test]
fn bdd100k_is_read_in_both_spellings() {
    let data = bdd100k(Some(OLD_SPELLING), Some(NEW_SPELLING), Rules::Paper).unwrap();
    let clip = &data.clips[0];
    assert_eq!(clip.name, "v");
    assert_eq!(clip.frames, 3);
    assert_eq!(clip.detections.as_ref().unwrap()[1].len(), 1);
    assert_eq!(data.clips[1].detections, None, "no predictions for `w`");
}

#[test]
fn the_papers_evaluator_takes_a_crowd_of_bdd100k_for_an_object_and_does_not_know_trailers() {
    let data = bdd100k(Some(OLD_SPELLING), NO_PREDICTIONS, Rules::Paper).unwrap();
    let clip = &data.clips[0];
    let rider = clip.truth.as_ref().unwrap()[0][0];
    assert_eq!(rider.class, PERSON);
    assert_eq!(rider.object, Some(122_062));
    assert_eq!(data.report.unmapped_classes["trailer"], 1);
    let marks: Vec<_> = clip.ignored.iter().flatten().collect();
    assert_eq!(marks, [&Ignored::UNLABELLED], "of the second frame");
}

#[test]
fn crowds_and_trailers_of_bdd100k_are_not_judged_by_its_own_rules() {
    let data = bdd100k(Some(OLD_SPELLING), NO_PREDICTIONS, Rules::Benchmark).unwrap();
    let clip = &data.clips[0];
    assert!(clip.truth.as_ref().unwrap()[0].is_empty());
    let regions: Vec<usize> = clip.ignored.iter().map(Vec::len).collect();
    assert_eq!(
        regions,
        [2, 1, 0],
        "the labels do not list the second frame"
    );
    assert_eq!(clip.unlabelled(), 1);
}

#[test]
fn predictions_of_bdd100k_without_scores_are_refused() {
    let labels_for_predictions = bdd100k(NO_LABELS, Some(OLD_SPELLING), Rules::Paper);
    assert_refused(labels_for_predictions, &["has no `score`"]);
}

#[test]
fn a_list_of_something_else_than_frames_is_refused() {
    let other_lists = [
        (
            r#"[{"id": 0, "annotations": [], "data": {"image": "1.jpg"}}]"#,
            "entry 0 has neither `name` nor `frameIndex` nor `labels`",
        ),
        (
            r#"[{"name": "1.jpg", "labels": null}, {"token": "a"}]"#,
            "entry 1 has neither",
        ),
        (
            r#"[{"name": "1.jpg", "frameIndex": 0, "frames": [{"objects": []}]}]"#,
            "entry 0 has `frames` or `objects`",
        ),
        (r#"[{"name": "cat"}]"#, "no frame has `labels`"),
    ];
    for (text, said) in other_lists {
        let read = bdd100k(Some(text), NO_PREDICTIONS, Rules::Benchmark);
        assert_refused(read, &["gt.json: this is not a list of frames", said]);
    }
}

#[test]
fn labels_of_bdd100k_without_a_box_are_counted_with_the_first_place() {
    let label = r#"{"category": "car", "poly2d": []}"#;
    let frame = |name: usize| format!(r#"{{"name": "{name}.jpg", "labels": [{label}, {label}]}}"#);
    let text = format!("[{}, {}]", frame(1), frame(2));
    let data = bdd100k(Some(&text), NO_PREDICTIONS, Rules::Benchmark).unwrap();
    let (count, first) = &data.report.left_out[&LeftOut::NoBox];
    assert_eq!(*count, 4);
    assert!(first.ends_with("frame 1.jpg, label 0"), "{first}");
}

#[test]
fn frames_of_bdd100k_without_an_index_are_in_the_order_of_their_names_in_each_video() {
    let frame = |video: &str, name: &str, labels: &str| {
        format!(r#"{{"name": "{name}", "videoName": "{video}", "labels": [{labels}]}}"#)
    };
    let car = r#"{"category": "car", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}"#;
    let nothing = "";
    let frames = [
        frame("a", "f_10.jpg", car),
        frame("b", "f_3.jpg", nothing),
        frame("a", "f_2.jpg", nothing),
        frame("b", "f_4.jpg", car),
    ];
    let text = format!("[{}]", frames.join(","));
    let data = bdd100k(Some(&text), NO_PREDICTIONS, Rules::Benchmark).unwrap();
    let boxes = |clip: &Clip| clip.truth.iter().flatten().map(Vec::len).collect::<Vec<_>>();
    let of_clips: Vec<_> = data.clips.iter().map(boxes).collect();
    assert_eq!(of_clips, [[0, 1], [0, 1]]);
}

#[test]
fn names_that_differ_in_more_than_numbers_leave_the_frames_of_a_list_in_its_order() {
    let frame = |name: &str, labels: &str| {
        format!(r#"{{"name": "{name}", "videoName": "a", "labels": [{labels}]}}"#)
    };
    let car = r#"{"category": "car", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}"#;
    for names in [["f3b.jpg", "a07c.jpg"], ["b/1.jpg", "a/1.jpg"]] {
        let text = format!("[{}, {}]", frame(names[0], car), frame(names[1], ""));
        let data = bdd100k(Some(&text), NO_PREDICTIONS, Rules::Benchmark).unwrap();
        let truth = data.clips[0].truth.as_ref().unwrap();
        assert_eq!(truth[0].len(), 1, "{names:?}");
    }
}

#[test]
fn a_video_whose_frames_lack_the_key_of_labels_has_no_objects() {
    let text = r#"[{"name": "1.jpg", "videoName": "a", "frameIndex": 0},
        {"name": "2.jpg", "videoName": "a", "frameIndex": 1}]"#;
    let data = bdd100k(Some(text), NO_PREDICTIONS, Rules::Benchmark).unwrap();
    assert_eq!(data.clips[0].frames, 2);
    assert_eq!(data.clips[0].truth_boxes(), 0);
}

#[test]
fn a_frame_of_bdd100k_that_occurs_twice_is_refused() {
    let twice = OLD_SPELLING.replace("\"index\": 2", "\"index\": 0");
    let repeated = bdd100k(Some(&twice), NO_PREDICTIONS, Rules::Paper);
    assert_refused(repeated, &["occurs twice"]);
}

#[test]
fn frames_behind_the_last_picture_that_labels_name_are_not_judged() {
    let labels = r#"[{"name": "v-0000001.jpg", "labels": []}]"#;
    let predictions = r#"[{"name": "v-0000001.jpg", "labels": []}, {"name": "v-0000002.jpg", "labels": [
        {"category": "car", "score": 0.5, "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]}]"#;
    let data = bdd100k(Some(labels), Some(predictions), Rules::Benchmark).unwrap();
    let [clip] = data.clips.as_slice() else {
        panic!("{:?}", data.clips);
    };
    assert_eq!(clip.ignored, [vec![], vec![Ignored::UNLABELLED]]);
}

#[test]
fn labels_without_videos_are_divided_by_the_names_of_their_pictures() {
    let frame = |name: &str| format!(r#"{{"name": "{name}", "labels": []}}"#);
    let names = ["b1c6-0000002.jpg", "b1c6-0000001.jpg", "b1ca-0000001.jpg"];
    let text = format!("[{}]", names.map(frame).join(","));
    let files = folder(&[
        ("val_gt.json", &text),
        ("other.json", &text.replace("-000000", "-")),
    ]);
    let read = |name: &str| {
        let truth = files.path().join(name);
        let source = bdd100k::Source {
            truth: Some(&truth),
            detections: None,
            picture: PictureSize::new(1280, 720),
            frame_rate: None,
            rules: Rules::Benchmark,
        };
        let clips = bdd100k::read(&source).unwrap().clips;
        clips.into_iter().map(|clip| (clip.name, clip.frames)).collect::<Vec<_>>()
    };
    let expected = [("b1c6".to_owned(), 2), ("b1ca".to_owned(), 1)];
    assert_eq!(read("val_gt.json"), expected);
    // Names that are not BDD100K's say nothing: the file is one video.
    assert_eq!(read("other.json"), [("other".to_owned(), 3)]);
}

/// COCO's labels of two pictures in a folder, with a crowd, an ignored object, another class and an inverted box.
const COCO_SET: &str = r#"{"images": [
    {"id": 5, "file_name": "v/2.jpg", "width": 100, "height": 50},
    {"id": 4, "file_name": "v/1.jpg", "width": 100, "height": 50}],
    "categories": [{"id": 3, "name": "car"}, {"id": 9, "name": "boat"}],
    "annotations": [
    {"id": 1, "image_id": 5, "category_id": 3, "bbox": [1, 2, 10, 20], "iscrowd": 0, "track_id": 8},
    {"id": 2, "image_id": 5, "category_id": 3, "bbox": [1, 2, 10, 20], "iscrowd": 1},
    {"id": 5, "image_id": 5, "category_id": 3, "bbox": [1, 2, 10, 20], "ignore": true},
    {"id": 6, "image_id": 5, "category_id": 9, "bbox": [1, 2, 10, 20], "iscrowd": 1},
    {"id": 3, "image_id": 4, "category_id": 9, "bbox": [1, 2, 10, 20]},
    {"id": 4, "image_id": 4, "category_id": 3, "bbox": [1, 2, -10, 20]}]}"#;

#[test]
fn annotations_of_coco_may_share_an_id_if_they_are_others() {
    let set = COCO_SET.replace(r#""id": 1, "image_id": 5"#, r#""id": 3, "image_id": 5"#);
    let files = folder(&[("set.json", &set)]);
    let no_results = None;
    let data = coco::read(&files.path().join("set.json"), no_results).unwrap();
    assert_eq!(data.clips[0].truth_boxes(), 1);
}

/// A result on one of these pictures.
const COCO_RESULTS: &str =
    r#"[{"image_id": 4, "category_id": 3, "bbox": [1, 2, 10, 20], "score": 0.5}]"#;

/// Reads [`COCO_SET`] with these results.
fn coco_set(results: &str) -> Result<DataSet, EvalError> {
    let files = folder(&[("set.json", COCO_SET), ("results.json", results)]);
    let found = files.path().join("results.json");
    coco::read(&files.path().join("set.json"), Some(&found))
}

#[test]
fn coco_groups_images_into_clips_in_order_of_their_names() {
    let data = coco_set(COCO_RESULTS).unwrap();
    let clip = &data.clips[0];
    assert_eq!(clip.name, "v");
    assert_eq!(clip.frames, 2);
    let truth = clip.truth.as_ref().unwrap();
    assert_eq!(truth[1][0].object, Some(8));
    assert_eq!(truth[1][0].corners.x2, 11.0);
    assert!(truth[0].is_empty());
    assert_eq!(clip.detections.as_ref().unwrap()[0].len(), 1);
}

#[test]
fn coco_marks_crowds_and_ignored_objects_of_its_classes() {
    let data = coco_set(COCO_RESULTS).unwrap();
    let clip = &data.clips[0];
    let marks: Vec<_> =
        clip.ignored[1].iter().map(|ignored| (ignored.mark, ignored.class)).collect();
    let car = Some(CAR);
    assert_eq!(marks, [(Mark::Crowd, car), (Mark::Object, car)]);
    assert_eq!(left_out(&data.report, LeftOut::IgnoredRegion), 2);
}

#[test]
fn inverted_boxes_and_other_classes_of_coco_are_counted() {
    let report = coco_set(COCO_RESULTS).unwrap().report;
    assert_eq!(left_out(&report, LeftOut::EmptyBox), 1);
    assert_eq!(report.unmapped_classes["boat"], 2);
}

#[test]
fn a_result_of_coco_on_an_image_that_is_not_listed_is_refused() {
    let lost = COCO_RESULTS.replace("\"image_id\": 4", "\"image_id\": 77");
    assert_refused(coco_set(&lost), &["image 77"]);
}

#[test]
fn an_id_that_belongs_to_two_entries_of_coco_is_refused_with_both() {
    for (own, other, said) in [
        (
            r#""id": 4, "file_name""#,
            r#""id": 5, "file_name""#,
            "the id 5 belongs to two images: v/2.jpg and v/1.jpg",
        ),
        (
            r#""id": 9, "name""#,
            r#""id": 3, "name""#,
            "the id 3 belongs to two categories: car and boat",
        ),
        (
            r#""id": 5, "image_id": 5"#,
            r#""id": 2, "image_id": 5"#,
            "the annotation 2 is listed twice, on the image 5",
        ),
    ] {
        let set = COCO_SET.replace(own, other);
        let files = folder(&[("set.json", &set)]);
        let no_results = None;
        let read = coco::read(&files.path().join("set.json"), no_results);
        assert_refused(read, &["set.json: ", said]);
    }
}
